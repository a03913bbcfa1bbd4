"""Says whether a vehicle finds a way to a goal around the static things of its fleet. Pure."""

from __future__ import annotations

from functools import lru_cache

from onboard.avoidance.params import law_params, still
from onboard.config.fleet import FleetConfig
from onboard.control.route_map import RouteMap
from onboard.control.router import in_the_way
from onboard.tuples import Xyz
from onboard.vectors import Vec2

# Who passes somewhere with less room than this is not refused: the law decides there.
_DOUBT_M = 0.10


def no_way(fleet: FleetConfig, vehicle_name: str, begin_enu_m: Xyz, goal_enu_m: Xyz) -> str:
    """Return the words that say why there is no way to a goal; empty if there is one.

    Args:
        fleet: checked configuration.
        vehicle_name: the vehicle that shall fly there.
        begin_enu_m, goal_enu_m: where it is, and the goal [m], ENU.
    """
    things = in_the_way(still(fleet), begin_enu_m[2], goal_enu_m[2])
    if not things:
        return ""

    law = law_params(fleet, vehicle_name)
    clearance_m = law.spacing.clearance_m
    route_map = _map(things, max(clearance_m - _DOUBT_M, 0.0), law.fence)
    begin = Vec2(float(begin_enu_m[0]), float(begin_enu_m[1]))
    goal = Vec2(float(goal_enu_m[0]), float(goal_enu_m[1]))
    if not route_map.is_complete or route_map.route(begin, goal):
        return ""

    return (
        f"cannot be reached from ({begin.x:.2f}, {begin.y:.2f}): no way around the obstacles and "
        f"fences leaves {clearance_m:.2f} m on both sides of {vehicle_name}"
    )


_map = lru_cache(maxsize=16)(RouteMap)
