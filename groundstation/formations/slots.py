"""The slots of a fleet's formations, from the fleet file itself, from shapes, drawings or files.

A slot is the place of one vehicle in a formation. Orders, missions and shows get the slots of a
formation from :func:`formation_slots`.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from groundstation.formations import shapes, slot_drawing
from groundstation.paths.path_files import read_columns
from onboard.arrays import Array
from onboard.config.fleet import ConfigError, FleetConfig, parking_distance_m
from onboard.config.formation_shape import FormationShape
from onboard.tuples import Xyz

_SPACING_FACTOR = 1.15  # default spacing over the smallest distance that the law permits
_SAME_SPOT_M = 1e-6  # slots that are nearer than this are at one spot

# shapes that need only the number of slots
_PLAIN = {
    "line": shapes.line,
    "column": shapes.column,
    "circle": shapes.circle,
    "sphere": shapes.sphere,
}


@dataclass(frozen=True, slots=True)
class HeldFormation:
    """The formation that moves of several vehicles keep."""

    name: str | None  # name in the fleet file; None if the file has no formation
    # distance of the two slots that are nearest to each other; None: as in the fleet file
    spacing_m: float | None = None
    rotation_deg: float = 0.0  # rotation from the fleet file's formation, counterclockwise
    # Vehicles that have exchanged their slots: vehicle -> the vehicle whose slot it flies in.
    # A vehicle without an entry flies in its own slot. None: nobody has exchanged slots. A spare
    # has the name of the vehicle that it replaces.
    takes: Mapping[str, str] | None = None


def formation_names(fleet: FleetConfig) -> tuple[str, ...]:
    """Return the names of all formations, those with slots first."""
    return tuple(dict.fromkeys((*fleet.formations, *fleet.shapes)))  # without repetitions


def formation_files(fleet: FleetConfig) -> list[str]:
    """Return the paths of all files that the fleet's formations read, sorted."""
    files: set[str] = set()
    for shape in fleet.shapes.values():
        files.update(_files(shape, fleet.path))
    return sorted(files)


def formation_slots(fleet: FleetConfig, name: str) -> dict[str, Xyz]:
    """Return the offsets of a formation as the fleet file defines it, or the mission.

    Args:
        fleet: the fleet file.
        name: name of the formation.

    Returns:
        Offset of each vehicle from the formation's position, metres ENU.

    Raises:
        ConfigError: the shape cannot be made, for instance because a file does not exist.
    """
    # a shape of the same name is that of a mission
    if name not in fleet.shapes:
        return fleet.formations[name]

    shape = fleet.shapes[name]
    key = f"'formations.{name}'"
    names = tuple(
        vehicle for vehicle in fleet.select(shape.vehicles) if vehicle in fleet.enabled_names
    )
    if not names:
        raise ConfigError(f"{key} has no vehicle that is enabled. Correct its 'vehicles'.")
    try:
        stamps = tuple(_stamp(file) for file in _files(shape, fleet.path))
        slots = _slots(shape, len(names), fleet.path, parking_distance_m(fleet), stamps)
    except ConfigError as error:
        raise ConfigError(f"{key}: {error}") from None
    return dict(zip(names, slots, strict=True))


def stretched(
    slots: Mapping[str, Xyz], spacing_m: float | None, rotation_deg: float = 0.0
) -> dict[str, Xyz]:
    """Return offsets that are stretched to another spacing and turned.

    Args:
        slots: offset of each vehicle [m], ENU.
        spacing_m: horizontal distance of the two nearest slots that are not above each other [m];
            None: no stretching.
        rotation_deg: angle to turn by, counterclockwise, seen from above.

    Returns:
        The new offsets; heights do not change.

    Raises:
        ConfigError: all slots are above each other, and there is a spacing.
    """
    if not slots:
        return {}
    if spacing_m is None and not rotation_deg:
        return dict(slots)

    points = np.array(list(slots.values()))
    if spacing_m is not None and len(points) > 1:
        nearest_m = shapes.nearest_m(points, apart_m=_SAME_SPOT_M)
        if nearest_m == math.inf:
            raise ConfigError(
                f"All {len(points)} slots are above each other, and a spacing of {spacing_m:g} m "
                "is horizontal. Leave the spacing out."
            )
        points[:, :2] *= spacing_m / nearest_m
    if rotation_deg:
        points = shapes.turned(points, rotation_deg)
    return {name: (x, y, z) for name, (x, y, z) in zip(slots, points.tolist(), strict=True)}


@functools.lru_cache(maxsize=64)
def _slots(
    shape: FormationShape,
    count: int,
    path: str,
    least_m: float,
    stamps: tuple[tuple[int, int], ...],  # a part of the cache's key
) -> tuple[Xyz, ...]:
    """Return the slots of a shape for `count` vehicles.

    `least_m` is the law's least distance. With other `stamps` the files of the shape are read anew.
    """
    outline_count = count
    if shape.stacked:
        outline_count = math.ceil(count / shape.layers)
    points = _outline(shape, outline_count, path)
    nearest_m = shapes.nearest_m(points)

    # The metres of a CSV file are not changed, unless the shape has a spacing.
    spacing_m = shape.spacing_m
    if spacing_m is None and shape.shape != "csv":
        spacing_m = _SPACING_FACTOR * least_m
    if spacing_m is not None and nearest_m < math.inf:
        if nearest_m < _SAME_SPOT_M:
            raise ConfigError("two of its slots are at one spot. Correct its shape or its file.")
        points = points * (spacing_m / nearest_m)

    points = shapes.layered(
        points, shape.layers, shape.layer_height_m, is_stacked=shape.stacked, count=count
    )
    if shape.shape != "csv":
        points = shapes.centred(points)
    points = np.round(shapes.turned(points, shape.rotation_deg), 4)
    return tuple((x, y, z) for x, y, z in points.tolist())


def _files(shape: FormationShape, path: str) -> list[str]:
    """Return the paths of the files that a shape reads."""
    return [slot_drawing.beside(path, file) for file in (shape.file, shape.font) if file]


def _stamp(file: str) -> tuple[int, int]:
    """Return time of change and size of a file; zeros if there is none."""
    try:
        status = os.stat(file)
    except OSError:
        return (0, 0)
    return status.st_mtime_ns, status.st_size


def _outline(shape: FormationShape, count: int, path: str) -> Array:
    """Return the slots of a shape before they are stretched, turned and layered."""
    if shape.shape in _PLAIN:
        return _PLAIN[shape.shape](count)
    if shape.shape == "v":
        return shapes.v(count, shape.opening_deg)
    if shape.shape == "wedge":
        return shapes.wedge(count, shape.opening_deg)
    if shape.shape == "grid":
        return shapes.grid(count, shape.columns)
    if shape.shape == "polygon":
        return shapes.polygon(count, shape.sides)

    if shape.shape == "text":
        font = None
        if shape.font is not None:
            font = slot_drawing.beside(path, shape.font)
        return slot_drawing.text_slots(shape.text, font, count)

    file = slot_drawing.beside(path, shape.file or "")
    if shape.shape == "image":
        return slot_drawing.image_slots(file, count)
    return _from_csv(file, count)


def _from_csv(file: str, count: int) -> Array:
    columns, numbers = read_columns(file)
    if columns not in (("x", "y"), ("x", "y", "z")):
        raise ConfigError(
            f"{file}: the columns {', '.join(columns[:6])} are no slots. Name them x,y or x,y,z."
        )
    if len(numbers) != count:
        raise ConfigError(
            f"{file} has {len(numbers)} slots for {count} vehicles. Give each vehicle one line."
        )
    if len(columns) == 2:
        return np.column_stack([numbers, np.zeros(count)])
    return numbers
