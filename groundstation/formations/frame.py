"""A frame that carries a formation: it moves, turns and stretches, and the shape changes on the
way. Pure.
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
from onboard.config.fleet import ConfigError, FleetConfig, Vec3
from onboard.control.path import Path, sampled

_SHARE, _ROOM = 0.6, 1.005  # of the top speed, where no duration is given; more than what is needed
_LEAST_S = 2.0


class FramePoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A point on the way of a formation, which is flown through, not stopped at."""

    position_enu_m: Vec3 | None = None  # of the formation; by default as before
    turn_deg: float = 0.0  # counterclockwise, on the way to this point
    spacing_m: float | None = None  # from here on; by default as before
    name: str | None = None  # of the formation that it has become here; by default as before
    # of the way to this point; 0: as fast as six tenths of the top speed allow
    duration_s: float = 0.0


class Begin(msgspec.Struct, frozen=True, kw_only=True):
    """A formation before it sets off."""

    name: str
    position_enu_m: Vec3
    rotation_deg: float = 0.0
    spacing_m: float | None = None
    leader: str | None = None  # positions are this vehicle's, and the formation turns about it


def frame_paths(
    fleet: FleetConfig,
    begin: Begin,
    points: Sequence[FramePoint],
    positions: Mapping[str, Vec3] | None = None,
) -> dict[str, Path]:
    """Return the path of each vehicle of a formation whose frame flies through points, from rest to
    rest.

    Args:
        fleet: the fleet file.
        begin: the formation at the begin.
        points: that are flown through.
        positions: of the vehicles before, by which the slots are dealt out anew, also those of
            later shapes; None: each vehicle has its own slots.

    Returns:
        Paths with a common begin.

    Raises:
        ConfigError: a formation does not exist or has no slot for a vehicle, or there is no way.
    """
    if not points:
        raise ConfigError("A formation's way needs at least one point.")
    slots = _slots(fleet, begin.name, begin.spacing_m, begin.leader)
    names = list(slots)
    if positions is not None and begin.leader is None:
        turned = stretched(slots, None, begin.rotation_deg)
        takes = nearest_slots(turned, positions, begin.position_enu_m)
        slots = {name: slots[takes[name]] for name in names}
    name, spacing_m, angle, place = (
        begin.name,
        begin.spacing_m,
        math.radians(begin.rotation_deg),
        begin.position_enu_m,
    )
    own, centres, angles, times = [_array(slots, names)], [place], [angle], [0.0]
    for point in points:
        if point.name is not None or point.spacing_m is not None:
            name, spacing_m = (
                point.name or name,
                point.spacing_m or (None if point.name else spacing_m),
            )
            following = _slots(fleet, name, spacing_m, begin.leader)
            if set(following) != set(names):
                raise ConfigError(
                    f"Formation '{name}' has slots for other vehicles than '{begin.name}'."
                )
            before = {one: _vec3(at) for one, at in zip(names, own[-1], strict=True)}
            same = positions is None or begin.leader is not None
            takes = (
                {one: one for one in names}
                if same
                else nearest_slots(following, before, (0.0, 0.0, 0.0))
            )
            slots = {one: following[takes[one]] for one in names}
        place, angle = point.position_enu_m or place, angle + math.radians(point.turn_deg)
        own.append(_array(slots, names))
        way_m = np.linalg.norm(own[-1] - own[-2], axis=-1) + math.dist(place, centres[-1])
        way_m = way_m + abs(angle - angles[-1]) * np.hypot(own[-1][:, 0], own[-1][:, 1])
        slowest_m_s = min(fleet.vehicles[one].max_speed_m_s for one in names)
        duration_s = point.duration_s or max(_LEAST_S, float(way_m.max()) / (_SHARE * slowest_m_s))
        centres, angles, times = (
            [*centres, place],
            [*angles, angle],
            [*times, times[-1] + duration_s],
        )
    paths = _carried(names, np.array(times), np.array(centres), np.array(angles), np.array(own))
    if any(not point.duration_s for point in points):
        factor, _ = needed_slowing(sample(paths), limits_of(fleet, names))
        paths = {one: slowed(path, _ROOM * max(factor, 1.0)) for one, path in paths.items()}
    return paths


def _carried(
    names: Sequence[str], times_s: Array, centres: Array, angles: Array, own: Array
) -> dict[str, Path]:
    """Return the paths of slots (K, N, 3) in a frame at (K, 3) with angles (K,)."""
    grid = np.linspace(0.0, times_s[-1], max(2, math.ceil(times_s[-1] / GRID_S) + 1))
    centre = _smooth(times_s, centres, grid)
    angle = _smooth(times_s, np.column_stack([angles, np.zeros((len(angles), 2))]), grid)[:, 0]
    c, s = np.cos(angle), np.sin(angle)
    paths = {}
    for k, name in enumerate(names):
        local = _smooth(times_s, own[:, k], grid)
        x, y = c * local[:, 0] - s * local[:, 1], s * local[:, 0] + c * local[:, 1]
        world = centre + np.column_stack([x, y, local[:, 2]])
        paths[name] = fitted(grid, np.column_stack([world, np.zeros(len(grid))]))
    return paths


def _smooth(times_s: Array, values: Array, grid: Array) -> Array:
    """Return values (K, 3) at times, joined smoothly, on a grid that is as long."""
    path = fitted(times_s, np.column_stack([values, np.zeros(len(values))]))
    return np.asarray(sampled(path, grid * (path.duration_s / grid[-1]))[0][:, :3])


def _slots(
    fleet: FleetConfig, name: str, spacing_m: float | None, leader: str | None
) -> dict[str, Vec3]:
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
    return {one: _vec3(np.array(at) - np.array(slots[leader])) for one, at in slots.items()}


def _array(slots: Mapping[str, Vec3], names: Sequence[str]) -> Array:
    return np.array([slots[name] for name in names])


def _vec3(point: Array) -> Vec3:
    x, y, z = point.tolist()
    return (x, y, z)
