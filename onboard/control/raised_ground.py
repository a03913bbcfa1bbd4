"""Says whether the ground at a raised take-off spot is in the way of a flight. Pure.

A spot may be on a roof or a table, from which vehicles also fly to lower places beside it. A flight
to a goal is a straight line, on which the height changes evenly.
"""

from __future__ import annotations

import math

import numpy as np

from onboard.arrays import Array
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.config.ground import ground_by_spots_m, ground_m, is_level, least_height_m
from onboard.tuples import Xyz

# A way leads over raised ground at this share of the least height of goals above it.
_CLEAR_SHARE = 0.5
# Over the ground on which it began, a way may lead lower than that, but not this much lower than
# its begin.
_SINKS_M = 0.05
_STEP_M = 0.05  # distance between two checked points of a way
# A chosen height leaves this to spare, because the vehicle moves until its order begins.
_SPARE_M = 0.2


def ground_in_the_way(
    fleet: FleetConfig, vehicle: Vehicle, begin_enu_m: Xyz, goal_enu_m: Xyz
) -> str:
    """Return the words that say why a straight flight would touch raised ground; empty if not.

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
        begin_enu_m, goal_enu_m: its position, and the goal [m], ENU.
    """
    top_m = _top_in_the_way_m(fleet, vehicle, begin_enu_m, goal_enu_m)
    if top_m is None:
        return ""

    begin_x, begin_y, begin_z = begin_enu_m
    over_m = max(begin_z, math.ceil(10.0 * top_m) / 10.0)
    above = (begin_x, begin_y, over_m)
    if _top_in_the_way_m(fleet, vehicle, above, goal_enu_m) is None:
        how = f"after a climb to {over_m:.2f} m it can"
    elif over_m == begin_z:
        how = f"from beside that ground, after a flight at {over_m:.2f} m, it can"
    else:
        how = f"after a climb to {over_m:.2f} m, and a flight at that height, it can"
    return (
        f"cannot be reached from ({begin_x:.2f}, {begin_y:.2f}, {begin_z:.2f}): the raised ground "
        f"of a take-off spot is in the way; {how}"
    )


def height_over_ground_m(
    fleet: FleetConfig, vehicle: Vehicle, begin_enu_m: Xyz, goal_enu_m: Xyz
) -> float:
    """Return a height of a goal to which a straight flight passes over raised ground [m].

    It is the goal's own height if that is enough, and otherwise as low as possible.

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
        begin_enu_m, goal_enu_m: its position, and the goal [m], ENU.
    """
    _, _, goal_z = goal_enu_m
    if _top_in_the_way_m(fleet, vehicle, begin_enu_m, goal_enu_m) is None:
        return goal_z

    shares, heights_m, floors_m = _way(fleet, vehicle, begin_enu_m, goal_enu_m)
    is_in_the_way = heights_m < floors_m
    _, _, begin_z = begin_enu_m
    climbs_m = floors_m[is_in_the_way] + _SPARE_M - begin_z
    return begin_z + float((climbs_m / shares[is_in_the_way]).max())


def _top_in_the_way_m(
    fleet: FleetConfig, vehicle: Vehicle, begin_enu_m: Xyz, goal_enu_m: Xyz
) -> float | None:
    """Return the height at which a flight passes all that it would touch [m]; None: nothing."""
    if is_level(fleet):
        return None

    _, heights_m, floors_m = _way(fleet, vehicle, begin_enu_m, goal_enu_m)
    is_in_the_way = heights_m < floors_m
    if not is_in_the_way.any():
        return None
    return float(floors_m[is_in_the_way].max())


def _way(
    fleet: FleetConfig, vehicle: Vehicle, begin_enu_m: Xyz, goal_enu_m: Xyz
) -> tuple[Array, Array, Array]:
    """Return points of a straight flight: share of the way, height, and least height there [m].

    The least height is minus infinity where the ground is not raised.
    """
    count = 1 + max(1, math.ceil(math.dist(begin_enu_m, goal_enu_m) / _STEP_M))
    shares = np.linspace(0.0, 1.0, count)
    begin = np.array(begin_enu_m)
    points = begin + shares[:, None] * (np.array(goal_enu_m) - begin)

    grounds_m = ground_by_spots_m(fleet, points[:, 0], points[:, 1])
    floors_m = grounds_m + _CLEAR_SHARE * least_height_m(vehicle)
    is_begun_on = grounds_m <= grounds_m[0]
    floors_m = np.where(is_begun_on, np.minimum(floors_m, begin[2] - _SINKS_M), floors_m)
    floors_m = np.where(grounds_m > ground_m(fleet), floors_m, -np.inf)
    return shares, points[:, 2], floors_m
