"""Reads pictures of the ground for the scene from a folder of tiles on this computer.

The folder has the layout that map tools write, ``{z}/{x}/{y}.png`` in Web Mercator, with y counted
from the north (XYZ, not TMS). The tiles that cover the fence are taken at the finest zoom at which
they are few enough. Nothing is downloaded: a tile that the folder lacks is left out.

The makers of the pictures are named in ``attribution.txt`` beside them, and the scene shows it.
"""

from __future__ import annotations

import base64
import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from onboard.config.earth import Origin, east_north_m, latitude_longitude_deg
from onboard.config.file_reading import MAP_TILE, TILE_ATTRIBUTION, read_bytes, read_text
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.plain_text import plain_line

ATTRIBUTION_NAME = "attribution.txt"
MAX_TILES = 64
MAX_BYTES = 8_000_000  # most bytes of all tiles together
_MAX_ZOOM = 24
_MAX_SIDE_PX = 1024
_MAX_LETTERS = 200  # most letters of the attribution
_MARGIN_SHARE = 0.15  # margin around the fence, as a share of its size
_MERCATOR_LATITUDE_DEG = 85.05  # largest latitude with tiles in Web Mercator
_PNG_BEGIN = b"\x89PNG\r\n\x1a\n"
_HEADER_BYTES = 24  # bytes of a PNG up to the end of its size in pixels


class GroundTile(NamedTuple):
    """One picture of the ground."""

    corners_enu_m: tuple[tuple[float, float], ...]  # north-west, north-east, south-west, south-east
    png: bytes


class GroundTiles(NamedTuple):
    """Pictures of the ground below a fleet."""

    attribution: str
    tiles: tuple[GroundTile, ...]


class _Address(NamedTuple):
    """Zoom, column and row of a tile."""

    zoom: int
    x: int
    y: int


def read_ground_tiles(folder: Path, fleet: FleetConfig) -> GroundTiles:
    """Return the tiles of a folder that cover a fleet's fence.

    Args:
        folder: the folder with the tiles ``{z}/{x}/{y}.png``.
        fleet: the fleet file; it needs an ``origin`` on Earth.

    Raises:
        ConfigError: the fleet has no origin, no tile covers its fence, a tile is not a PNG or is
            too large, or all tiles together are too large.
    """
    origin = fleet.fleet.origin
    if isinstance(origin, str):
        raise ConfigError(
            f"--tiles: fleet '{fleet.fleet.name}' has no origin on Earth, so nobody knows which "
            "ground lies below it. Write origin = { latitude_deg = ..., longitude_deg = ..., "
            "altitude_m = ... } in [fleet]."
        )
    if not folder.is_dir():
        raise ConfigError(f"--tiles {folder}: there is no such folder.")

    present = [
        address for address in _wanted(folder, fleet, origin) if _path_of(folder, address).exists()
    ]
    if not present:
        raise ConfigError(_no_tiles_words(folder, fleet, origin))

    bytes_left = MAX_BYTES
    tiles = []
    for address in present:
        png = _png(_path_of(folder, address))
        bytes_left -= len(png)
        if bytes_left < 0:
            raise ConfigError(
                f"--tiles {folder}: the tiles of zoom {address.zoom} that cover the fence have more"
                f" than {MAX_BYTES // 1_000_000} MB. Leave this zoom out of the folder, or pack "
                "its tiles smaller."
            )
        tiles.append(GroundTile(corners_enu_m=_corners(address, origin), png=png))
    return GroundTiles(attribution=_attribution(folder), tiles=tuple(tiles))


def ground_message(ground: GroundTiles | None, *, is_inside_page: bool) -> dict[str, Any] | None:
    """Return the pictures as data for the scene's script; None if there are none.

    Args:
        ground: the pictures.
        is_inside_page: whether the data contain the pictures; otherwise the page loads them from
            its server.
    """
    if ground is None:
        return None

    tiles = []
    for number, tile in enumerate(ground.tiles):
        source = f"tiles/{number}"
        if is_inside_page:
            source = f"data:image/png;base64,{base64.b64encode(tile.png).decode('ascii')}"
        tiles.append({"source": source, "corners_enu_m": tile.corners_enu_m})
    return {"attribution": ground.attribution, "tiles": tiles}


# -- choice of tiles -------------------------------------------------------------------------------


def _wanted(folder: Path, fleet: FleetConfig, origin: Origin) -> list[_Address]:
    """Return the tiles that cover the fence, of the finest zoom whose tiles exist and are few."""
    for zoom in sorted(_zooms(folder), reverse=True):
        addresses = list(_covering(zoom, fleet, origin))
        if len(addresses) > MAX_TILES:
            continue
        if any(_path_of(folder, address).exists() for address in addresses):
            return addresses
    return []


def _zooms(folder: Path) -> Iterator[int]:
    for path in folder.iterdir():
        is_number = path.name.isascii() and path.name.isdigit() and len(path.name) < 3
        if is_number and int(path.name) <= _MAX_ZOOM and path.is_dir():
            yield int(path.name)


def _covering(zoom: int, fleet: FleetConfig, origin: Origin) -> Iterator[_Address]:
    """Yield the tiles of a zoom that touch the fence, at most one more than MAX_TILES."""
    count = 2**zoom
    corners = [_column_and_row(origin, corner, count) for corner in _fence_corners(fleet)]
    x_middle, _ = _column_and_row(origin, (0.0, 0.0), count)

    # Columns are counted the shorter way around the Earth, which may cross the date line.
    columns = [x_middle + math.remainder(x - x_middle, count) for x, _ in corners]
    rows = [y for _, y in corners]
    first_x = math.floor(min(columns))
    last_x = math.floor(max(columns))
    first_y = max(0, math.floor(min(rows)))
    last_y = min(count - 1, math.floor(max(rows)))

    yielded = 0
    for x in range(first_x, last_x + 1):
        for y in range(first_y, last_y + 1):
            yield _Address(zoom=zoom, x=x % count, y=y)
            yielded += 1
            if yielded > MAX_TILES:
                return


def _fence_corners(fleet: FleetConfig) -> Iterator[tuple[float, float]]:
    """Yield the corners (east, north) [m] of the fence with a margin."""
    west_m, east_m = fleet.fleet.geofence_m.x
    south_m, north_m = fleet.fleet.geofence_m.y
    margin_m = _MARGIN_SHARE * max(east_m - west_m, north_m - south_m)
    for corner_east_m in (west_m - margin_m, east_m + margin_m):
        for corner_north_m in (south_m - margin_m, north_m + margin_m):
            yield corner_east_m, corner_north_m


def _column_and_row(
    origin: Origin, east_north: tuple[float, float], count: int
) -> tuple[float, float]:
    """Return column and row of a point in Web Mercator, with their fractions."""
    latitude_deg, longitude_deg = latitude_longitude_deg(origin, *east_north)
    latitude_deg = min(max(latitude_deg, -_MERCATOR_LATITUDE_DEG), _MERCATOR_LATITUDE_DEG)
    northwards = math.asinh(math.tan(math.radians(latitude_deg))) / math.pi
    return (longitude_deg + 180.0) / 360.0 * count, (1.0 - northwards) / 2.0 * count


def _corners(address: _Address, origin: Origin) -> tuple[tuple[float, float], ...]:
    """Return the corners of a tile [m], in the order of :class:`GroundTile`."""
    count = 2**address.zoom
    corners = []
    for row in (address.y, address.y + 1):
        latitude_deg = math.degrees(math.atan(math.sinh(math.pi * (1.0 - 2.0 * row / count))))
        for column in (address.x, address.x + 1):
            longitude_deg = 360.0 * column / count - 180.0
            east_m, north_m = east_north_m(origin, latitude_deg, longitude_deg)
            corners.append((round(east_m, 3), round(north_m, 3)))
    return tuple(corners)


def _path_of(folder: Path, address: _Address) -> Path:
    return folder / str(address.zoom) / str(address.x) / f"{address.y}.png"


def _no_tiles_words(folder: Path, fleet: FleetConfig, origin: Origin) -> str:
    """Return the refusal of a folder without a tile at the fence, with a tile that would do."""
    zooms = [zoom for zoom in range(_MAX_ZOOM + 1) if _is_few(zoom, fleet, origin)]
    finest = next(_covering(zooms[-1], fleet, origin))
    return (
        f"--tiles {folder}: no tile of it covers the fence. Put the tiles of one zoom, "
        f"{finest.zoom} or less, into it as ZOOM/COLUMN/ROW.png, with rows counted from the north, "
        f"such as {finest.zoom}/{finest.x}/{finest.y}.png."
    )


def _is_few(zoom: int, fleet: FleetConfig, origin: Origin) -> bool:
    """Return whether at most MAX_TILES tiles of a zoom cover the fence."""
    return len(list(_covering(zoom, fleet, origin))) <= MAX_TILES


# -- files -----------------------------------------------------------------------------------------


def _png(path: Path) -> bytes:
    """Return the bytes of a tile, after a check that it is a PNG of a usual size."""
    data = read_bytes(path, MAP_TILE)
    if len(data) < _HEADER_BYTES or not data.startswith(_PNG_BEGIN):
        raise ConfigError(f"{path} is no PNG. Export the tiles as PNG.")

    # The size follows the signature and the start of the first chunk.
    width_px, height_px = struct.unpack(">II", data[16:_HEADER_BYTES])
    if not 1 <= width_px <= _MAX_SIDE_PX or not 1 <= height_px <= _MAX_SIDE_PX:
        raise ConfigError(
            f"{path} has {width_px} x {height_px} pixels; {_MAX_SIDE_PX} a side are the most."
            " Export tiles of 256 or 512."
        )
    return data


def _attribution(folder: Path) -> str:
    path = folder / ATTRIBUTION_NAME
    if not path.exists():
        return ""
    return plain_line(" ".join(read_text(path, TILE_ATTRIBUTION).split()))[:_MAX_LETTERS]
