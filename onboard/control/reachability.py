"""Says whether a vehicle finds a way to a goal around the static things of its fleet. Pure."""

from __future__ import annotations

from onboard.control.router import Surroundings, in_the_way, map_of
from onboard.tuples import Xyz
from onboard.vectors import Vec2

# A goal that is too near to an obstacle by less than this can be reached nevertheless: a vehicle
# that the law holds so far away from its goal counts as arrived.
_TOO_NEAR_M = 0.1


def no_way(around: Surroundings, vehicle_name: str, begin_enu_m: Xyz, goal_enu_m: Xyz) -> str:
    """Return the words that say why there is no way to a goal; empty if there is one.

    Args:
        around: what surrounds the vehicle.
        vehicle_name: the vehicle that shall fly there.
        begin_enu_m, goal_enu_m: where it is, and the goal [m], ENU.
    """
    if not around.still:
        return ""

    things = in_the_way(around.still, begin_enu_m[2], goal_enu_m[2])
    route_map = map_of(things, around)
    begin = Vec2(float(begin_enu_m[0]), float(begin_enu_m[1]))
    goal = Vec2(float(goal_enu_m[0]), float(goal_enu_m[1]))
    clearance_m = around.spacing.clearance_m

    room_m = route_map.room_m(goal)
    if room_m < -_TOO_NEAR_M:
        return (
            f"cannot be reached: it is {-room_m:.2f} m too near to an obstacle, of which "
            f"{vehicle_name} keeps {clearance_m:.2f} m clear"
        )

    if route_map.route(begin, goal) or not route_map.is_complete:
        return ""

    return (
        f"cannot be reached from ({begin.x:.2f}, {begin.y:.2f}): no way around the obstacles and "
        f"fences leaves {clearance_m:.2f} m on both sides of {vehicle_name}"
    )
