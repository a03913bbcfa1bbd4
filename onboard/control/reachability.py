"""Says why there is no route to a goal around the static things of a fleet. Pure."""

from __future__ import annotations

from onboard.control.route_map import is_beyond
from onboard.control.router import Surroundings, in_the_way, map_of
from onboard.tuples import Xyz
from onboard.vectors import Vec2

# A goal may be closer to an obstacle than the clearance, by up to this much. The law then stops the
# vehicle this far from its goal, which counts as an arrival.
_TOO_NEAR_M = 0.1


def route_refusal(
    around: Surroundings, vehicle_name: str, begin_enu_m: Xyz, goal_enu_m: Xyz
) -> str:
    """Return why a vehicle cannot fly to a goal, and what to do first; empty if it can.

    Args:
        around: static things around the vehicle.
        vehicle_name: the vehicle that should fly there.
        begin_enu_m, goal_enu_m: its position, and the goal [m], ENU.
    """
    begin_x, begin_y, begin_z = begin_enu_m
    goal_x, goal_y, goal_z = goal_enu_m
    where_from = f"cannot be reached from ({begin_x:.2f}, {begin_y:.2f}, {begin_z:.2f})"

    # The vehicle changes its height on its whole route, so it sinks into a fence below it.
    if _is_above_fence(around, begin_enu_m, goal_z):
        beside = (goal_x, goal_y, begin_z)
        words = _route_refusal_at_all_heights(around, vehicle_name, beside, goal_enu_m)
        if words:
            return words
        return f"{where_from}: a fence is below; first fly at {begin_z:.2f} m to a point beside it"

    # It climbs into a fence above it, too.
    if is_below_fence(around, begin_enu_m, goal_z):
        words = _route_refusal_at_all_heights(around, vehicle_name, goal_enu_m, goal_enu_m)
        if words:
            return words
        return f"{where_from}: a fence is above this point; first fly out from below it"

    words = _route_refusal_at_all_heights(around, vehicle_name, begin_enu_m, goal_enu_m)
    if not words:
        return ""

    # A fence that ends below the goal, or begins above it, is in the way only while the height
    # changes.
    at_goal_height = (begin_x, begin_y, goal_z)
    to_height = _route_refusal_at_all_heights(around, vehicle_name, begin_enu_m, at_goal_height)
    at_height = _route_refusal_at_all_heights(around, vehicle_name, at_goal_height, goal_enu_m)
    if not to_height and not at_height:
        fence = "a fence that ends below the goal"
        change = "climb"
        if goal_z < begin_z:
            fence = "a fence that begins above the goal"
            change = "descend"
        return f"{where_from}: {fence} is in the way; first {change} to {goal_z:.2f} m"
    return words


def is_below_fence(around: Surroundings, position_enu_m: Xyz, high_m: float) -> bool:
    """Return whether a fence to stay out of begins above a position, and not above a height.

    Args:
        around: static things around the vehicle.
        position_enu_m: the position [m], ENU.
        high_m: the height, which is greater.
    """
    x, y, z = position_enu_m
    above = [edge for edge in around.still if z < edge.low_m <= high_m]
    return is_beyond(Vec2(float(x), float(y)), above)


def _is_above_fence(around: Surroundings, position_enu_m: Xyz, low_m: float) -> bool:
    """Return whether a fence to stay out of ends below a position, and not below a height.

    Args:
        around: static things around the vehicle.
        position_enu_m: the position [m], ENU.
        low_m: the height, which is lower.
    """
    x, y, z = position_enu_m
    below = [edge for edge in around.still if low_m <= edge.high_m < z]
    return is_beyond(Vec2(float(x), float(y)), below)


def _route_refusal_at_all_heights(
    around: Surroundings, vehicle_name: str, begin_enu_m: Xyz, goal_enu_m: Xyz
) -> str:
    """Return why no route exists that may use every height between those of begin and goal.

    It is empty if one does.
    """
    if not around.still:
        return ""

    begin_x, begin_y, begin_z = begin_enu_m
    goal_x, goal_y, goal_z = goal_enu_m
    begin = Vec2(float(begin_x), float(begin_y))
    goal = Vec2(float(goal_x), float(goal_y))
    route_map = map_of(in_the_way(around.still, begin_z, goal_z), around)
    clearance_m = around.spacing.clearance_m

    room_m = route_map.room_m(goal)
    if room_m < -_TOO_NEAR_M:
        return (
            f"cannot be reached: it is {-room_m:.2f} m too near to an obstacle, of which "
            f"{vehicle_name} keeps {clearance_m:.2f} m clear; choose another point"
        )

    # an incomplete map does not find every route
    if route_map.route(begin, goal) or not route_map.is_complete:
        return ""

    return (
        f"cannot be reached from ({begin.x:.2f}, {begin.y:.2f}): no way around the obstacles and "
        f"fences leaves {clearance_m:.2f} m on both sides of {vehicle_name}; choose another point"
    )
