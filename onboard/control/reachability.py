"""Says whether a vehicle finds a way to a goal around the static things of its fleet. Pure."""

from __future__ import annotations

from onboard.avoidance.params import law_params, still
from onboard.config.fleet import FleetConfig
from onboard.control.route_map import route_map_of
from onboard.control.router import in_the_way
from onboard.tuples import Xyz
from onboard.vectors import Vec2


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
    route_map = route_map_of(things, clearance_m, law.fence)
    begin = Vec2(float(begin_enu_m[0]), float(begin_enu_m[1]))
    goal = Vec2(float(goal_enu_m[0]), float(goal_enu_m[1]))
    if route_map.route(begin, goal) or not route_map.is_complete:
        return ""

    return (
        f"cannot be reached from ({begin.x:.2f}, {begin.y:.2f}): no way around the obstacles and "
        f"fences leaves {clearance_m:.2f} m on both sides of {vehicle_name}"
    )
