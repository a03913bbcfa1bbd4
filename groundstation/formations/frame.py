"""Paths of a formation that moves, turns, stretches and changes its shape on the way. Pure.

A frame carries the formation: its centre and its angle follow smooth curves through the given
points, and so does the offset of each vehicle within the frame. The path of a vehicle is the sum.
If a point has no duration, all paths are slowed until they are within the vehicles' limits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from groundstation.formations.assignment import nearest_slots
from groundstation.formations.slots import (
    HeldFormation,
    formation_names,
    formation_slots,
    stretched,
)
from groundstation.paths.checks import limits_of, needed_slowing, sample
from groundstation.paths.pieces import GRID_S, fitted, slowed
from onboard.arrays import Array
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.control.path import Path, sampled
from onboard.tuples import Xyz

_SPEED_SHARE = 0.6  # share of the top speed that is flown if no duration is given
_SLOWING_MARGIN = 1.005  # factor by which paths are slowed more than necessary
_MIN_S = 2.0  # shortest duration between two points
_LONGEST_S = 3600.0  # longest duration of a whole way
_MAX_POINTS = 1000


class FramePoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A point on the way of a formation, which is flown through, not stopped at."""

    position_enu_m: Xyz | None = None  # position of the formation; by default as before
    turn_deg: float = 0.0  # turn on the way to this point, counterclockwise
    # spacing from here on; by default as before, or the new formation's own if `name` is given
    spacing_m: float | None = None
    name: str | None = None  # formation that it takes up on the way here; by default as before
    # duration of the way to this point; 0: the time that it takes at six tenths of the top speed
    duration_s: float = 0.0


class FormationStart(msgspec.Struct, frozen=True, kw_only=True):
    """A formation before it sets off."""

    name: str
    position_enu_m: Xyz
    rotation_deg: float = 0.0
    spacing_m: float | None = None
    # vehicle whose position is the formation's, and about which it turns; None: the formation's own
    leader: str | None = None


class FormationPaths(dict[str, Path]):
    """Paths of the vehicles of a formation, and the formation in which they end.

    Args:
        paths: path of each vehicle.
        end: formation at the end of the paths.
    """

    def __init__(self, paths: Mapping[str, Path], end: HeldFormation) -> None:
        super().__init__(paths)
        self.end = end


class _Keyframe(NamedTuple):
    """The frame of a formation at one point of its way."""

    name: str  # formation
    spacing_m: float | None  # None: the formation's own
    centre_enu_m: Xyz
    angle_rad: float
    slots: dict[str, Xyz]  # vehicle -> its offset [m] within the frame
    takes: Mapping[str, str]  # vehicle -> the vehicle whose slot it flies in
    time_s: float

    @property
    def offsets_m(self) -> Array:
        """Offset of each vehicle within the frame, (N, 3) [m]."""
        return np.array(list(self.slots.values()))


def frame_paths(
    fleet: FleetConfig,
    start: FormationStart,
    points: Sequence[FramePoint],
    positions: Mapping[str, Xyz] | None = None,
) -> FormationPaths:
    """Return the path of each vehicle of a formation whose frame flies through points.

    All paths begin and end at rest.

    Args:
        fleet: the fleet file.
        start: the formation before it sets off.
        points: points that are flown through.
        positions: positions of the vehicles before the start; they decide who gets which slot, in
            later shapes as well. None: each vehicle has its own slots, as always with a leader.

    Returns:
        Paths with a common start, and the formation at their end.

    Raises:
        ConfigError: a formation does not exist or has no slot for a vehicle, or the way has no
            points, too many, or takes too long.
    """
    if not points:
        raise ConfigError("A formation's way needs at least one point.")
    if len(points) > _MAX_POINTS:
        raise ConfigError(
            f"A formation's way has {len(points)} points; {_MAX_POINTS} is the most. "
            "Fly it in several steps."
        )

    if start.leader is not None:
        positions = None
    slots = _slots(fleet, start.name, start.spacing_m, start.leader)
    names = list(slots)
    takes = {vehicle: vehicle for vehicle in names}
    if positions is not None:
        turned = stretched(slots, None, start.rotation_deg)
        takes = nearest_slots(turned, positions, start.position_enu_m)
        slots = {vehicle: slots[takes[vehicle]] for vehicle in names}

    keyframes = [
        _Keyframe(
            name=start.name,
            spacing_m=start.spacing_m,
            centre_enu_m=start.position_enu_m,
            angle_rad=math.radians(start.rotation_deg),
            slots=slots,
            takes=takes,
            time_s=0.0,
        )
    ]
    slowest_m_s = min(fleet.vehicles[vehicle].max_speed_m_s for vehicle in names)
    for number, point in enumerate(points, start=1):
        before = keyframes[-1]
        reached = _reached(fleet, start, before, point, is_assigned=positions is not None)
        duration_s = point.duration_s
        if not duration_s:
            duration_s = max(_MIN_S, _longest_m(before, reached) / (_SPEED_SHARE * slowest_m_s))

        time_s = before.time_s + duration_s
        if not time_s <= _LONGEST_S:
            raise ConfigError(
                f"Point {number} of a formation's way would be reached after {time_s:g} s; "
                f"{_LONGEST_S:g} s is the most. Fly a shorter way, turn less, or give a shorter "
                "duration_s."
            )
        keyframes.append(reached._replace(time_s=time_s))

    paths = _carried(names, keyframes)
    if any(not point.duration_s for point in points):
        factor, _ = needed_slowing(sample(paths), limits_of(fleet, names))
        factor = _SLOWING_MARGIN * max(factor, 1.0)
        paths = {vehicle: slowed(path, factor) for vehicle, path in paths.items()}
    return FormationPaths(paths, _held(keyframes[-1]))


def _held(keyframe: _Keyframe) -> HeldFormation:
    """Return the formation at a keyframe, which moves and rotations after it keep."""
    return HeldFormation(
        name=keyframe.name,
        spacing_m=keyframe.spacing_m,
        rotation_deg=math.remainder(math.degrees(keyframe.angle_rad), 360.0),
        takes=keyframe.takes,
    )


def _reached(
    fleet: FleetConfig,
    start: FormationStart,
    before: _Keyframe,
    point: FramePoint,
    *,
    is_assigned: bool,
) -> _Keyframe:
    """Return the frame at a point, still with the time of the keyframe before.

    Args:
        fleet: the fleet file.
        start: the formation before it sets off.
        before: the frame at the point before.
        point: the point.
        is_assigned: whether vehicles take the nearest slots of a new shape.
    """
    centre_enu_m = before.centre_enu_m
    if point.position_enu_m is not None:
        centre_enu_m = point.position_enu_m
    moved = before._replace(
        centre_enu_m=centre_enu_m,
        angle_rad=before.angle_rad + math.radians(point.turn_deg),
    )
    if point.name is None and point.spacing_m is None:
        return moved

    name = point.name or before.name
    spacing_m = before.spacing_m
    if point.spacing_m:
        spacing_m = point.spacing_m
    elif point.name:
        spacing_m = None  # the new formation's own

    slots = _slots(fleet, name, spacing_m, start.leader)
    if set(slots) != set(before.slots):
        raise ConfigError(f"Formation '{name}' has slots for other vehicles than '{start.name}'.")
    takes = {vehicle: vehicle for vehicle in before.slots}
    if is_assigned:
        takes = nearest_slots(slots, before.slots, (0.0, 0.0, 0.0))
    slots = {vehicle: slots[takes[vehicle]] for vehicle in before.slots}
    return moved._replace(name=name, spacing_m=spacing_m, slots=slots, takes=takes)


def _longest_m(before: _Keyframe, after: _Keyframe) -> float:
    """Return an upper bound of the longest path between two keyframes.

    A vehicle moves within the frame, with the frame, and around its centre.
    """
    offsets_m = after.offsets_m
    within_m = np.linalg.norm(offsets_m - before.offsets_m, axis=-1)
    with_frame_m = math.dist(before.centre_enu_m, after.centre_enu_m)
    radius_m = np.hypot(offsets_m[:, 0], offsets_m[:, 1])
    around_m = abs(after.angle_rad - before.angle_rad) * radius_m
    return float((within_m + with_frame_m + around_m).max())


def _carried(names: Sequence[str], keyframes: Sequence[_Keyframe]) -> dict[str, Path]:
    """Return the path of each vehicle in a frame that flies through K keyframes."""
    times_s = np.array([keyframe.time_s for keyframe in keyframes])
    centres = np.array([keyframe.centre_enu_m for keyframe in keyframes])
    angles_rad = np.array([keyframe.angle_rad for keyframe in keyframes])
    offsets = np.array([keyframe.offsets_m for keyframe in keyframes])  # (K, N, 3)

    count = max(2, math.ceil(times_s[-1] / GRID_S) + 1)
    grid_s = np.linspace(0.0, times_s[-1], count)
    centre = _smooth(times_s, centres, grid_s)
    # _smooth takes three columns: the angle and two zeros
    padded = np.column_stack([angles_rad, np.zeros((len(angles_rad), 2))])
    angle_rad = _smooth(times_s, padded, grid_s)[:, 0]
    cosine = np.cos(angle_rad)
    sine = np.sin(angle_rad)

    paths = {}
    for index, name in enumerate(names):
        offset = _smooth(times_s, offsets[:, index], grid_s)
        x = cosine * offset[:, 0] - sine * offset[:, 1]
        y = sine * offset[:, 0] + cosine * offset[:, 1]
        position = centre + np.column_stack([x, y, offset[:, 2]])
        paths[name] = fitted(grid_s, np.column_stack([position, np.zeros(len(grid_s))]))
    return paths


def _smooth(times_s: Array, values: Array, grid: Array) -> Array:
    """Return a smooth curve through values (K, 3) at given times, sampled on a grid of times.

    The fitted path takes longer than the times, because it begins and ends at rest. The grid is
    stretched to it.
    """
    path = fitted(times_s, np.column_stack([values, np.zeros(len(values))]))
    stretch = path.duration_s / grid[-1]
    values, _, _ = sampled(path, grid * stretch)  # values (T, 4) and their two derivatives
    return np.asarray(values[:, :3])


def _slots(
    fleet: FleetConfig, name: str, spacing_m: float | None, leader: str | None
) -> dict[str, Xyz]:
    """Return the offsets of a formation, from its leader if it has one."""
    if name not in formation_names(fleet):
        known = ", ".join(formation_names(fleet)) or "none"
        raise ConfigError(
            f"'{name}' is no formation of fleet '{fleet.fleet.name}': it has {known}."
        )

    slots = stretched(formation_slots(fleet, name), spacing_m)
    if leader is None:
        return slots
    if leader not in slots:
        raise ConfigError(f"The leader '{leader}' has no slot in formation '{name}'.")

    leader_slot = np.array(slots[leader])
    return {vehicle: _xyz(np.array(slot) - leader_slot) for vehicle, slot in slots.items()}


def _xyz(point: Array) -> Xyz:
    x, y, z = point.tolist()
    return (x, y, z)
