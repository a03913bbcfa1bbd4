"""Says whether the raised ground of a take-off spot is in the way of a flight. Pure.

A spot may be on a roof or a table, from which vehicles also fly to lower goals beside it. On a
flight to a goal the height changes evenly, on the straight line or up to the first corner of the
route around fences and obstacles.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from onboard.arrays import Array
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.config.ground import ground_by_spots_m, ground_m, is_level, least_height_m
from onboard.control.router import Surroundings, in_the_way, map_of
from onboard.tuples import Xyz
from onboard.vectors import Vec2

# Height at which a flight passes above raised ground, as a share of the least height of goals
# there. A vehicle that is not where a mission or an order expected it still passes the later check.
IN_MISSION = 1.0
IN_ORDER = 0.75
ON_VEHICLE = 0.5
_CHOSEN = 1.5  # of a goal whose height is chosen
_ADVISED = 1.25  # of a height that is advised

# Over the ground on which it began, a flight may be lower than that, but not this much lower than
# its begin.
_SINKS_M = 0.05
# A flight that begins below raised ground, as beside a table, may lead this far aside below it.
_ASIDE_M = 0.3
_STEP_M = 0.05  # distance between two checked points


class _Profile(NamedTuple):
    """Points of a flight."""

    shares: Array  # (n,) of the change of height
    heights_m: Array  # (n,)
    least_m: Array  # (n,) least height there; minus infinity where the ground is not raised

    @property
    def top_m(self) -> float:
        """Least height at which the flight passes everything that it would touch, or -inf."""
        touched_m = self.least_m[self.heights_m < self.least_m]
        return float(touched_m.max(initial=-math.inf))


def ground_refusal(
    fleet: FleetConfig,
    vehicle: Vehicle,
    around: Surroundings,
    begin_enu_m: Xyz,
    goal_enu_m: Xyz,
    clear_share: float,
) -> str:
    """Return why a flight would touch raised ground, and what to do first; empty if it would not.

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
        around: static things around it.
        begin_enu_m, goal_enu_m: its position, and the goal [m], ENU.
        clear_share: one of the shares above.
    """
    begin_x, begin_y, begin_z = begin_enu_m
    _, _, goal_z = goal_enu_m
    clear_m = clear_share * least_height_m(vehicle)
    if is_level(fleet) or min(begin_z, goal_z) >= _highest_spot_m(fleet) + clear_m:
        return ""

    top_m = _profile(fleet, around, begin_enu_m, goal_enu_m, clear_m).top_m
    if top_m == -math.inf:
        return ""

    spare_m = (_ADVISED - clear_share) * least_height_m(vehicle)
    over_m = max(begin_z, math.ceil(10.0 * (top_m + spare_m)) / 10.0)
    above = (begin_x, begin_y, over_m)
    if _profile(fleet, around, above, goal_enu_m, clear_m).top_m == -math.inf:
        first = f"climb to {over_m:.2f} m"
    elif over_m == begin_z:
        first = f"fly at {over_m:.2f} m to a point beside it"
    else:
        first = f"climb to {over_m:.2f} m and fly past it at that height"
    return (
        f"cannot be reached from ({begin_x:.2f}, {begin_y:.2f}, {begin_z:.2f}): the raised ground "
        f"of a take-off spot is in the way; first {first}"
    )


def height_over_ground_m(
    fleet: FleetConfig,
    vehicle: Vehicle,
    around: Surroundings,
    begins_enu_m: Iterable[Xyz],
    goal_enu_m: Xyz,
) -> float:
    """Return a height of a goal to which a flight passes over raised ground [m].

    It is the goal's own height if that is enough, and otherwise as low as possible.

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
        around: static things around it.
        begins_enu_m: positions from which the flight may begin [m], ENU.
        goal_enu_m: the goal [m], ENU.
    """
    _, _, height_m = goal_enu_m
    if is_level(fleet):
        return height_m

    clear_m = _CHOSEN * least_height_m(vehicle)
    for begin_enu_m in begins_enu_m:
        _, _, begin_z = begin_enu_m
        profile = _profile(fleet, around, begin_enu_m, goal_enu_m, clear_m)
        touches = profile.heights_m < profile.least_m
        climbs_m = (profile.least_m[touches] - begin_z) / profile.shares[touches]
        height_m = max(height_m, begin_z + float(climbs_m.max(initial=-math.inf)))
    return height_m


def _highest_spot_m(fleet: FleetConfig) -> float:
    return max(fleet.vehicles[name].start_enu_m[2] for name in fleet.enabled_names)


def _profile(
    fleet: FleetConfig, around: Surroundings, begin_enu_m: Xyz, goal_enu_m: Xyz, clear_m: float
) -> _Profile:
    """Return points of a flight that passes at this clearance above raised ground."""
    begin_x, begin_y, begin_z = begin_enu_m
    goal_x, goal_y, goal_z = goal_enu_m
    begin = Vec2(float(begin_x), float(begin_y))
    goal = Vec2(float(goal_x), float(goal_y))
    route_map = map_of(in_the_way(around.still, begin_z, goal_z), around)
    route = route_map.route(begin, goal)
    if not route:  # the vehicle would fly straight
        route = [goal]

    xs = []
    ys = []
    shares = []
    first_share = 0.0
    for here, there in pairwise([begin, *route]):
        count = 2 + math.ceil(math.dist(here, there) / _STEP_M)
        xs.append(np.linspace(here.x, there.x, count))
        ys.append(np.linspace(here.y, there.y, count))
        shares.append(np.linspace(first_share, 1.0, count))
        first_share = 1.0  # the height changes up to the first corner

    x_m = np.concatenate(xs)
    y_m = np.concatenate(ys)
    share = np.concatenate(shares)
    grounds_m = ground_by_spots_m(fleet, x_m, y_m)
    least_m = grounds_m + clear_m

    is_begun_on = np.logical_and.accumulate(grounds_m <= grounds_m[0])
    if begin_z < grounds_m[0]:
        is_begun_on &= np.hypot(x_m - begin.x, y_m - begin.y) <= _ASIDE_M
    least_m = np.where(is_begun_on, np.minimum(least_m, begin_z - _SINKS_M), least_m)
    return _Profile(
        shares=share,
        heights_m=begin_z + share * (goal_z - begin_z),
        least_m=np.where(grounds_m > ground_m(fleet), least_m, -np.inf),
    )
