"""Paths of a formation that moves, turns, stretches and changes its shape on the way. Pure.

A frame carries the formation: its centre and its angle follow smooth curves through the given
points, and so does the offset of each vehicle within the frame. The path of a vehicle is the sum.
If a point has no duration, all paths are slowed until they are within the vehicles' limits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from groundstation.formations.assignment import nearest_slots
from groundstation.formations.slots import formation_names, formation_slots, stretched
from groundstation.paths.checks import limits_of, needed_slowing, sample
from groundstation.paths.pieces import GRID_S, fitted, slowed
from onboard.arrays import Array
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.control.path import Path, sampled
from onboard.tuples import Xyz

_SPEED_SHARE = 0.6  # share of the top speed that is flown if no duration is given
_SLOWING_MARGIN = 1.005  # factor by which paths are slowed more than necessary
_LEAST_S = 2.0  # shortest duration between two points
_LONGEST_S = 3600.0  # longest duration of a whole way
_MOST_POINTS = 1000


class FramePoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A point on the way of a formation, which is flown through, not stopped at."""

    position_enu_m: Xyz | None = None  # position of the formation; by default as before
    turn_deg: float = 0.0  # turn on the way to this point, counterclockwise
    # spacing from here on; by default as before, or the new formation's own if `name` is given
    spacing_m: float | None = None
    name: str | None = None  # formation that it takes up on the way here; by default as before
    # duration of the way to this point; 0: the time that it takes at six tenths of the top speed
    duration_s: float = 0.0


class Begin(msgspec.Struct, frozen=True, kw_only=True):
    """A formation before it sets off."""

    name: str
    position_enu_m: Xyz
    rotation_deg: float = 0.0
    spacing_m: float | None = None
    # vehicle whose position is the formation's, and about which it turns; None: the formation's own
    leader: str | None = None


def frame_paths(
    fleet: FleetConfig,
    begin: Begin,
    points: Sequence[FramePoint],
    positions: Mapping[str, Xyz] | None = None,
) -> dict[str, Path]:
    """Return the path of each vehicle of a formation whose frame flies through points.

    All paths begin and end at rest.

    Args:
        fleet: the fleet file.
        begin: the formation at the start.
        points: points that are flown through.
        positions: positions of the vehicles before the start; they decide who gets which slot, in
            later shapes as well. None: each vehicle has its own slots, as always with a leader.

    Returns:
        Paths with a common start.

    Raises:
        ConfigError: a formation does not exist or has no slot for a vehicle, or the way has no
            points, too many, or takes too long.
    """
    if not points:
        raise ConfigError("A formation's way needs at least one point.")
    if len(points) > _MOST_POINTS:
        raise ConfigError(
            f"A formation's way has {len(points)} points; {_MOST_POINTS} is the most. "
            "Fly it in several steps."
        )

    assigned_by = positions if begin.leader is None else None
    slots = _slots(fleet, begin.name, begin.spacing_m, begin.leader)
    names = list(slots)
    if assigned_by is not None:
        turned = stretched(slots, None, begin.rotation_deg)
        slot_of = nearest_slots(turned, assigned_by, begin.position_enu_m)
        slots = {vehicle: slots[slot_of[vehicle]] for vehicle in names}

    # The frame and the offsets (N, 3) within it, at the start and at each point.
    name = begin.name
    spacing_m = begin.spacing_m
    centres = [begin.position_enu_m]
    angles_rad = [math.radians(begin.rotation_deg)]
    offsets = [_array(slots, names)]
    times_s = [0.0]
    slowest_m_s = min(fleet.vehicles[vehicle].max_speed_m_s for vehicle in names)

    for point in points:
        if point.name is not None or point.spacing_m is not None:
            if point.spacing_m:
                spacing_m = point.spacing_m
            elif point.name:
                spacing_m = None  # the new formation's own
            if point.name:
                name = point.name
            slots = _slots(fleet, name, spacing_m, begin.leader)
            if set(slots) != set(names):
                raise ConfigError(
                    f"Formation '{name}' has slots for other vehicles than '{begin.name}'."
                )
            if assigned_by is not None:
                offset_of = {
                    vehicle: _xyz(offset)
                    for vehicle, offset in zip(names, offsets[-1], strict=True)
                }
                slot_of = nearest_slots(slots, offset_of, (0.0, 0.0, 0.0))
                slots = {vehicle: slots[slot_of[vehicle]] for vehicle in names}

        centre = centres[-1]
        if point.position_enu_m is not None:
            centre = point.position_enu_m
        angle_rad = angles_rad[-1] + math.radians(point.turn_deg)
        offsets.append(_array(slots, names))

        # An upper bound of the length of each path: the vehicle moves within the frame, with the
        # frame, and around its centre.
        within_m = np.linalg.norm(offsets[-1] - offsets[-2], axis=-1)
        with_frame_m = math.dist(centre, centres[-1])
        radius_m = np.hypot(offsets[-1][:, 0], offsets[-1][:, 1])
        around_m = abs(angle_rad - angles_rad[-1]) * radius_m
        length_m = within_m + with_frame_m + around_m

        duration_s = point.duration_s
        if not duration_s:
            duration_s = max(_LEAST_S, float(length_m.max()) / (_SPEED_SHARE * slowest_m_s))

        centres.append(centre)
        angles_rad.append(angle_rad)
        times_s.append(times_s[-1] + duration_s)
        if not times_s[-1] <= _LONGEST_S:
            raise ConfigError(
                f"Point {len(times_s) - 1} of a formation's way would be reached after "
                f"{times_s[-1]:g} s; {_LONGEST_S:g} s is the most. Fly a shorter way, turn less, "
                "or give a shorter duration_s."
            )

    paths = _carried(
        names,
        times_s=np.array(times_s),
        centres=np.array(centres),
        angles_rad=np.array(angles_rad),
        offsets=np.array(offsets),
    )
    if any(not point.duration_s for point in points):
        factor, _ = needed_slowing(sample(paths), limits_of(fleet, names))
        factor = _SLOWING_MARGIN * max(factor, 1.0)
        paths = {vehicle: slowed(path, factor) for vehicle, path in paths.items()}
    return paths


def _carried(
    names: Sequence[str], *, times_s: Array, centres: Array, angles_rad: Array, offsets: Array
) -> dict[str, Path]:
    """Return the path of each vehicle in a frame that flies through K points.

    The frame has centres (K, 3) and angles (K,); the vehicles have offsets (K, N, 3) in it.
    """
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


def _array(slots: Mapping[str, Xyz], names: Sequence[str]) -> Array:
    return np.array([slots[name] for name in names])


def _xyz(point: Array) -> Xyz:
    x, y, z = point.tolist()
    return (x, y, z)
