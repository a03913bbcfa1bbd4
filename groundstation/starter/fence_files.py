"""Reads fences of other programs, and writes them as the ``[[fences]]`` of a fleet file.

Two formats are read: the geoFence of QGroundControl's ``.plan``, and GeoJSON (RFC 7946). From
GeoJSON come polygons, their holes as areas to stay out of, and points with a radius. All
coordinates are latitudes and longitudes, both in the files and in the result.

In PX4 a vehicle may be in any of several areas to stay in; in Covey all fences hold at once. So a
file with more than one area to stay in is refused: vehicles could only be where these overlap.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from groundstation.starter.fleet_edit import fleet_of_text
from onboard.config.fences import MAX_CORNERS, MAX_FENCES, Fence, FenceCircle
from onboard.config.file_reading import (
    FENCE_FILE,
    FLEET_FILE,
    json_values,
    read_bytes,
    read_text,
)
from onboard.config.fleet import ConfigError
from onboard.plain_text import listed

PLAN_VERSION = 1
GEOFENCE_VERSION = 2
SHAPE_VERSION = 1
_CRS84 = ("CRS84", "EPSG::4326", "EPSG:4326")  # names of the coordinates of GeoJSON
_LONGEST_NAME = 40
_REMEDY = "Give a .plan that QGroundControl saved, or a GeoJSON of polygons."

# In this file ``where`` names the place of a value in the file, for refusals.

Degrees = tuple[float, float]  # latitude, longitude


def read_fences(
    path: str | os.PathLike[str],
    buffer_m: float = 0.0,
    height_m: tuple[float, float] | None = None,
) -> list[Fence]:
    """Return the fences of a file.

    Args:
        path: path of a ``.plan`` or GeoJSON file.
        buffer_m: buffer of each fence.
        height_m: floor and top of each fence; None for all heights.

    Raises:
        ConfigError: the file has another format, has no fence, or has a fence of a kind that Covey
            does not have.
    """
    name = os.fspath(path)
    if name.lower().endswith((".kml", ".kmz")):
        raise ConfigError(
            f"{name}: KML is not read. Open it in a GIS such as QGIS, and export the polygons as "
            "GeoJSON."
        )
    data = json_values(read_bytes(path, FENCE_FILE), name)
    if not isinstance(data, dict):
        raise ConfigError(f"{name} is no .plan and no GeoJSON: it is no table. {_REMEDY}")

    stem = Path(name).stem[:_LONGEST_NAME]
    if data.get("fileType") == "Plan":
        found = list(_plan_fences(data, name, stem))
    elif isinstance(data.get("type"), str):
        found = list(_geojson_fences(data, name, stem))
    else:
        raise ConfigError(
            f"{name} is no .plan of QGroundControl (fileType is not 'Plan') and no GeoJSON (it has "
            f"no type). {_REMEDY}"
        )

    if not found:
        raise ConfigError(f"{name} has no fence. Draw one, and save it again.")
    if len(found) > MAX_FENCES:
        raise ConfigError(f"{name} has {len(found)} fences; {MAX_FENCES} are the most.")
    areas_to_stay_in = [fence for fence in found if fence.keep == "in"]
    if len(areas_to_stay_in) > 1:
        raise ConfigError(
            f"{name} has {len(areas_to_stay_in)} areas to stay in. In Covey all fences hold at "
            "once, so that only what these share would be left. Join them into one polygon."
        )
    return [
        Fence(
            name=fence.name,
            keep=fence.keep,
            polygon_deg=fence.polygon_deg,
            circle=fence.circle,
            height_m=height_m,
            buffer_m=buffer_m,
        )
        for fence in found
    ]


def refuse_imported(fences: list[Fence], path: Path) -> None:
    """Refuse fences whose names a fleet file has already, as after an earlier import.

    Args:
        fences: fences that were read.
        path: path of the fleet file.

    Raises:
        ConfigError: the fleet file has such names, or is wrong itself.
    """
    fleet = fleet_of_text(path, read_text(path, FLEET_FILE))
    known = {fence.name for fence in fleet.fences}
    names = [_without_escapes(fence.name) for fence in fences]
    names = [name for name in names if name in known]
    if names:
        raise ConfigError(
            f"{path} has fences named {listed(names)} already, perhaps of an earlier import. "
            "Remove these [[fences]] from it, or give them other names, and import again."
        )


def toml_of(fences: list[Fence]) -> str:
    """Return the text of fences for a fleet file.

    Args:
        fences: fences in latitude and longitude.
    """
    blocks = []
    for fence in fences:
        lines = ["[[fences]]", f"name = {_text(fence.name)}", f'keep = "{fence.keep}"']

        if fence.circle is not None and fence.circle.center_deg is not None:
            center = _point(fence.circle.center_deg)
            radius_m = float(fence.circle.radius_m)
            lines.append(f"circle = {{ center_deg = {center}, radius_m = {radius_m} }}")
        else:
            lines.append("polygon_deg = [")
            lines += [f"  {_point(corner)}," for corner in fence.polygon_deg or ()]
            lines.append("]")

        if fence.height_m is not None:
            low_m, high_m = fence.height_m
            lines.append(f"height_m = [{float(low_m)}, {float(high_m)}]")

        lines.append(f"buffer_m = {float(fence.buffer_m)}")
        blocks.append("\n".join(lines))
    return "\n\n".join(blocks) + "\n"


def _text(name: str) -> str:
    """Return a name as a TOML string, without letters that would need an escape."""
    return f'"{_without_escapes(name)}"'


def _without_escapes(name: str) -> str:
    return "".join(letter for letter in name if letter.isprintable() and letter not in '"\\')


def _point(degrees: Degrees) -> str:
    latitude, longitude = degrees
    return f"[{latitude:.8f}, {longitude:.8f}]"  # eight decimals are a millimetre


# -- QGroundControl --------------------------------------------------------------------------------


def _plan_fences(data: dict[str, Any], name: str, stem: str) -> Iterator[Fence]:
    """Yield the fences of a .plan."""
    _check_version(data, PLAN_VERSION, name, "this .plan")
    fence = data.get("geoFence", {})
    if not isinstance(fence, dict):
        raise ConfigError(f"{name}: geoFence is no table. Save the plan again.")
    if not fence:
        return
    _check_version(fence, GEOFENCE_VERSION, name, "its geoFence")

    polygons = _list(fence, "polygons", name)
    for number, polygon in enumerate(polygons, start=1):
        where = f"{name}: polygon {number} of geoFence"
        shape = _table(polygon, where)
        _check_version(shape, SHAPE_VERSION, name, f"polygon {number} of geoFence")
        ring = _ring(shape.get("polygon", []), f"{where}: polygon")
        corners = [_degrees(corner, where) for corner in ring]
        yield Fence(
            name=f"{stem} {number}",
            keep=_keep(shape.get("inclusion"), where),
            polygon_deg=tuple(_opened(corners)),
        )

    for number, circle in enumerate(_list(fence, "circles", name), start=1):
        where = f"{name}: circle {number} of geoFence"
        outer = _table(circle, where)
        _check_version(outer, SHAPE_VERSION, name, f"circle {number} of geoFence")
        inner = _table(outer.get("circle"), where)
        yield Fence(
            name=f"{stem} {len(polygons) + number}",
            keep=_keep(outer.get("inclusion"), where),
            circle=FenceCircle(
                radius_m=_number(inner.get("radius"), where),
                center_deg=_degrees(inner.get("center"), where),
            ),
        )


def _check_version(data: dict[str, Any], version: int, name: str, part: str) -> None:
    actual = data.get("version")
    if actual != version:
        raise ConfigError(
            f"{name}: {part} has version {str(actual)[:20]}; version {version} can be read. Open "
            "it in a QGroundControl of today, and save it again."
        )


def _keep(inclusion: Any, where: str) -> Any:
    if inclusion is True:
        return "in"
    if inclusion is False:
        return "out"
    raise ConfigError(f"{where} does not say whether it is an inclusion. Save the plan again.")


# -- GeoJSON ---------------------------------------------------------------------------------------


def _geojson_fences(data: dict[str, Any], name: str, stem: str) -> Iterator[Fence]:
    """Yield the fences of a GeoJSON: features, a feature, or a geometry."""
    if "crs" in data and not any(word in str(data["crs"]) for word in _CRS84):
        raise ConfigError(
            f"{name}: its crs is not that of GeoJSON. Export it with WGS 84 longitudes and "
            "latitudes (EPSG:4326)."
        )

    features = [data]
    if data["type"] == "FeatureCollection":
        features = [_table(feature, name) for feature in _list(data, "features", name)]
    for number, feature in enumerate(features, start=1):
        where = f"{name}: feature {number}"
        geometry = feature
        properties: dict[str, Any] = {}
        if feature.get("type") == "Feature":
            if feature.get("geometry") is None:
                raise ConfigError(f"{where} has no geometry. Draw it again, or remove it.")
            geometry = _table(feature["geometry"], where)
            properties = feature.get("properties") or {}
            if not isinstance(properties, dict):
                raise ConfigError(f"{where}: its properties are no table.")

        label = properties.get("name")
        if not isinstance(label, str) or not _without_escapes(label[:_LONGEST_NAME]).strip():
            label = f"{stem} {number}"
        yield from _geometry_fences(geometry, properties, label[:_LONGEST_NAME], where)


def _geometry_fences(
    geometry: dict[str, Any], properties: dict[str, Any], label: str, where: str
) -> Iterator[Fence]:
    """Yield the fences of one geometry."""
    keep = properties.get("keep", "in")
    if keep not in ("in", "out"):
        raise ConfigError(f"{where}: its property keep is {str(keep)[:20]!r}; write 'in' or 'out'.")

    kind = str(geometry.get("type"))
    if kind == "Point":
        radius = properties.get("radius_m", properties.get("radius"))
        if radius is None:
            raise ConfigError(f"{where} is a point. Give it a property radius_m, or remove it.")
        center = _swapped(geometry.get("coordinates"), where)
        circle = FenceCircle(radius_m=_number(radius, where), center_deg=center)
        yield Fence(name=label, keep=keep, circle=circle)
        return

    if kind == "Polygon":
        polygons = [geometry.get("coordinates")]
    elif kind == "MultiPolygon":
        polygons = _list(geometry, "coordinates", where)
    else:
        raise ConfigError(
            f"{where} is a {kind[:30]}; polygons, and points with a radius_m, are read. Remove it."
        )

    # The first ring of a polygon is its edge, and the others are its holes.
    for number, rings in enumerate(polygons, start=1):
        polygon_label = label
        if len(polygons) > 1:
            polygon_label = f"{label} {number}"
        if not isinstance(rings, list) or not rings:
            raise ConfigError(f"{where} has no corners. Draw it again.")
        for ring_index, ring in enumerate(rings):
            corners = _opened([_swapped(corner, where) for corner in _ring(ring, where)])
            is_edge = ring_index == 0
            if is_edge:
                yield Fence(name=polygon_label, keep=keep, polygon_deg=tuple(corners))
            elif keep == "out":
                raise ConfigError(
                    f"{where} is to stay out of, and has a hole. Remove the hole, or draw what is "
                    "left as polygons without."
                )
            else:
                hole_label = f"{polygon_label}, hole {ring_index}"
                yield Fence(name=hole_label, keep="out", polygon_deg=tuple(corners))


def _swapped(point: Any, where: str) -> Degrees:
    """Return latitude and longitude of a GeoJSON position, whose longitude comes first."""
    values = _items(point, where)
    if len(values) not in (2, 3):
        raise ConfigError(f"{where} has a point of {len(values)} numbers; write two.")
    longitude, latitude, *_ = values
    return _number(latitude, where), _number(longitude, where)


# -- values ----------------------------------------------------------------------------------------


def _ring(value: Any, where: str) -> list[Any]:
    """Return the corners of a polygon, the first of which may be repeated at the end."""
    corners = _items(value, where)
    if len(corners) > MAX_CORNERS + 1:
        raise ConfigError(
            f"{where} has {len(corners)} corners; {MAX_CORNERS} are the most. Leave out those "
            "that a straight edge can join."
        )
    return corners


def _opened(corners: list[Degrees]) -> list[Degrees]:
    """Return corners without the last one, if it repeats the first one."""
    if len(corners) > 1 and corners[-1] == corners[0]:
        return corners[:-1]
    return corners


def _table(value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ConfigError(f"{where} is no table. Save it again.")
    return value


def _list(data: dict[str, Any], key: str, where: str) -> list[Any]:
    return _items(data.get(key, []), f"{where}: {key}")


def _items(value: Any, where: str) -> list[Any]:
    if not isinstance(value, list):
        raise ConfigError(f"{where} is no list where one is needed. Save it again.")
    return value


def _degrees(point: Any, where: str) -> Degrees:
    values = _items(point, where)
    if len(values) != 2:
        raise ConfigError(
            f"{where} has a point of {len(values)} numbers; it has a latitude and a longitude."
        )
    latitude, longitude = values
    return _number(latitude, where), _number(longitude, where)


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"{where} has {str(value)[:30]!r} where a number is needed. Correct it.")
    return float(value)
