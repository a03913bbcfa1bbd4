"""A frame that carries a formation: it moves, turns and stretches, and the shape changes. Pure."""

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

_SPEED_SHARE = 0.6  # of the top speed, where no duration is given
_ROOM = 1.005  # by which paths are slowed beyond what is needed
_LEAST_S = 2.0
_LONGEST_S = 3600.0  # of a whole way, as of every other step
_MOST_POINTS = 1000


class FramePoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A point on the way of a formation, which is flown through, not stopped at."""

    position_enu_m: Xyz | None = None  # of the formation; by default as before
    turn_deg: float = 0.0  # counterclockwise, on the way to this point
    spacing_m: float | None = None  # from here on; by default as before
    name: str | None = None  # of the formation that it has become here; by default as before
    # of the way to this point; 0: as fast as six tenths of the top speed allow
    duration_s: float = 0.0


class Begin(msgspec.Struct, frozen=True, kw_only=True):
    """A formation before it sets off."""

    name: str
    position_enu_m: Xyz
    rotation_deg: float = 0.0
    spacing_m: float | None = None
    leader: str | None = None  # positions are this vehicle's, and the formation turns about it


def frame_paths(
    fleet: FleetConfig,
    begin: Begin,
    points: Sequence[FramePoint],
    positions: Mapping[str, Xyz] | None = None,
) -> dict[str, Path]:
    """Return the path of each vehicle of a formation whose frame flies through points.

    All paths lead from rest to rest.

    Args:
        fleet: the fleet file.
        begin: the formation at the begin.
        points: points that are flown through.
        positions: positions of the vehicles before, by which the slots are dealt out anew, also
            those of later shapes; None: each vehicle has its own slots.

    Returns:
        Paths with a common begin.

    Raises:
        ConfigError: a formation does not exist or has no slot for a vehicle, or there is no way.
    """
    if not points:
        raise ConfigError("A formation's way needs at least one point.")
    if len(points) > _MOST_POINTS:
        raise ConfigError(
            f"A formation's way has {len(points)} points; {_MOST_POINTS} is the most. "
            "Fly it in several steps."
        )

    is_dealt_out = positions is not None and begin.leader is None
    slots = _slots(fleet, begin.name, begin.spacing_m, begin.leader)
    names = list(slots)
    if positions is not None and is_dealt_out:
        turned = stretched(slots, None, begin.rotation_deg)
        dealt = nearest_slots(turned, positions, begin.position_enu_m)
        slots = {name: slots[dealt[name]] for name in names}

    # the frame and the slots within it, at the begin and at each point
    name = begin.name
    spacing_m = begin.spacing_m
    centres = [begin.position_enu_m]
    angles_rad = [math.radians(begin.rotation_deg)]
    offsets = [_array(slots, names)]
    times_s = [0.0]
    slowest_m_s = min(fleet.vehicles[one].max_speed_m_s for one in names)

    for point in points:
        if point.name is not None or point.spacing_m is not None:
            if point.spacing_m:
                spacing_m = point.spacing_m
            elif point.name:
                spacing_m = None
            name = point.name or name
            slots = _slots(fleet, name, spacing_m, begin.leader)
            if set(slots) != set(names):
                raise ConfigError(
                    f"Formation '{name}' has slots for other vehicles than '{begin.name}'."
                )
            if is_dealt_out:
                before = {one: _vec3(at) for one, at in zip(names, offsets[-1], strict=True)}
                dealt = nearest_slots(slots, before, (0.0, 0.0, 0.0))
                slots = {one: slots[dealt[one]] for one in names}

        centre = point.position_enu_m or centres[-1]
        angle_rad = angles_rad[-1] + math.radians(point.turn_deg)
        offsets.append(_array(slots, names))

        # at most as far as this: within the frame, with the frame, and around its centre
        length_m = np.linalg.norm(offsets[-1] - offsets[-2], axis=-1)
        length_m = length_m + math.dist(centre, centres[-1])
        radius_m = np.hypot(offsets[-1][:, 0], offsets[-1][:, 1])
        length_m = length_m + abs(angle_rad - angles_rad[-1]) * radius_m
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
        factor = _ROOM * max(factor, 1.0)
        paths = {one: slowed(path, factor) for one, path in paths.items()}
    return paths


def _carried(
    names: Sequence[str], *, times_s: Array, centres: Array, angles_rad: Array, offsets: Array
) -> dict[str, Path]:
    """Return the paths of offsets (K, N, 3) in a frame at centres (K, 3) with angles (K,)."""
    count = max(2, math.ceil(times_s[-1] / GRID_S) + 1)
    grid_s = np.linspace(0.0, times_s[-1], count)
    centre = _smooth(times_s, centres, grid_s)
    padded = np.column_stack([angles_rad, np.zeros((len(angles_rad), 2))])
    angle_rad = _smooth(times_s, padded, grid_s)[:, 0]
    c = np.cos(angle_rad)
    s = np.sin(angle_rad)

    paths = {}
    for k, name in enumerate(names):
        local = _smooth(times_s, offsets[:, k], grid_s)
        x = c * local[:, 0] - s * local[:, 1]
        y = s * local[:, 0] + c * local[:, 1]
        world = centre + np.column_stack([x, y, local[:, 2]])
        paths[name] = fitted(grid_s, np.column_stack([world, np.zeros(len(grid_s))]))
    return paths


def _smooth(times_s: Array, values: Array, grid: Array) -> Array:
    """Return values (K, 3) at times, joined smoothly, on a grid that is as long."""
    path = fitted(times_s, np.column_stack([values, np.zeros(len(values))]))
    longer = path.duration_s / grid[-1]  # by the rests at both ends
    return np.asarray(sampled(path, grid * longer)[0][:, :3])


def _slots(
    fleet: FleetConfig, name: str, spacing_m: float | None, leader: str | None
) -> dict[str, Xyz]:
    """Return the offsets of a formation, from its leader where it has one."""
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


def _array(slots: Mapping[str, Xyz], names: Sequence[str]) -> Array:
    return np.array([slots[name] for name in names])


def _vec3(point: Array) -> Xyz:
    x, y, z = point.tolist()
    return (x, y, z)
