"""What stands between a vehicle and its goal, in words: neighbours, obstacles, the fence. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator

from groundstation.fleet.state import FleetState
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.result import Results
from onboard.config.fleet import FleetConfig, Vec3, parking_distance_m, parking_height_share
from onboard.config.pair_separation import separation_m

_BLOCKED = ("unfinished", "timed out")
_NEAR_WALL_M = 0.5
_MOST = 3
_ACTIVE_M_S2 = 0.05  # of the law's intervention


def explained(
    results: Results, planned: PlannedOrder, fleet: FleetConfig, state: FleetState, now_ns: int
) -> Results:
    """Return the results of an order; those of moves that are not finished say what stands in the
    way.

    Args:
        results: of its vehicles.
        planned: the order.
        fleet: the fleet file.
        state: the fleet as known now.
        now_ns: the ground's monotonic clock [ns].
    """
    blocked = [
        name for name, one in results.items() if one.phase in _BLOCKED and name in planned.orders
    ]
    goals = {name: planned.orders[name].position_enu_m for name in blocked}
    words = {
        name: in_the_way(fleet, state, name, goal, now_ns)
        for name, goal in goals.items()
        if goal is not None
    }
    return {name: one.with_more(words.get(name, "")) for name, one in results.items()}


def in_the_way(fleet: FleetConfig, state: FleetState, name: str, goal: Vec3, now_ns: int) -> str:
    """Return what keeps a vehicle from its goal now, the nearest first, with distances.

    Args:
        fleet: the fleet file.
        state: the fleet as known now.
        name: of the vehicle.
        goal: of its order [m], ENU.
        now_ns: the ground's monotonic clock [ns].

    Returns:
        Sentences; empty when its position is not known.
    """
    view = state.vehicles.get(name)
    position = None if view is None else view.position_enu_m(now_ns)
    if view is None or view.telemetry is None or position is None:
        return ""
    left = f"It is {math.dist(position, goal):.2f} m from its goal."
    near = sorted(
        [*_neighbours(fleet, state, name, position, goal, now_ns), *_walls(fleet, position, goal)]
    )
    words = "; ".join(sentence for _, sentence in near[:_MOST])
    if not words:
        return f"{left} Nothing known is in its way."
    telemetry = view.telemetry
    is_pushed = telemetry.avoids and telemetry.intervention_m_s2 > _ACTIVE_M_S2
    law = (
        f" The law gives way to {telemetry.avoids} by {telemetry.intervention_m_s2:.1f} m/s²."
        if is_pushed
        else ""
    )
    return f"{left} In its way: {words}.{law}"


def _neighbours(
    fleet: FleetConfig, state: FleetState, name: str, position: Vec3, goal: Vec3, now_ns: int
) -> Iterator[tuple[float, str]]:
    room_m, share = parking_distance_m(fleet), parking_height_share(fleet)
    for other, view in state.vehicles.items():
        at = view.position_enu_m(now_ns) if other != name else None
        if at is None or not view.is_airborne or _distance_m(at, position, goal, share) >= room_m:
            continue
        away_m, from_goal_m = math.dist(at[:2], position[:2]), math.dist(at[:2], goal[:2])
        yield away_m, f"{other}, {away_m:.2f} m from it and {from_goal_m:.2f} m from the goal"


def _walls(fleet: FleetConfig, position: Vec3, goal: Vec3) -> Iterator[tuple[float, str]]:
    room_m = _NEAR_WALL_M + 0.5 * fleet.fleet.body_diameter_m
    steps = [k / 20.0 for k in range(21)]
    way = [
        (position[0] + k * (goal[0] - position[0]), position[1] + k * (goal[1] - position[1]))
        for k in steps
    ]
    for obstacle in fleet.obstacles:
        if min(map(obstacle.distance_m, way)) < room_m:
            away_m = obstacle.distance_m(position)
            yield away_m, f"obstacle '{obstacle.name}', {away_m:.2f} m from it"
    fence = fleet.fleet.geofence_m
    for axis, value, (low, high) in zip("xyz", position, (fence.x, fence.y, fence.z), strict=True):
        away_m, end = min((value - low, low), (high - value, high))
        if away_m < room_m and not (axis == "z" and end == low):
            yield away_m, f"the fence at {axis} = {end:g} m, {away_m:.2f} m from it"


def _distance_m(point: Vec3, begin: Vec3, end: Vec3, height_share: float) -> float:
    """Return the separation of a point from the straight way between two others."""
    way = (end[0] - begin[0], end[1] - begin[1])
    length_2 = way[0] ** 2 + way[1] ** 2
    along = (point[0] - begin[0]) * way[0] + (point[1] - begin[1]) * way[1]
    share = min(max(along / length_2, 0.0), 1.0) if length_2 > 0.0 else 0.0
    low, high = sorted((begin[2], end[2]))  # at some time on the way it has each height between
    nearest = begin[0] + share * way[0], begin[1] + share * way[1], min(max(point[2], low), high)
    return separation_m(point, nearest, height_share)
