"""Hindrances between a vehicle and its goal: neighbours, obstacles, the fence. Pure.

The results of moves that did not end in time get these sentences.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from groundstation.fleet.state import FleetState
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.result import Results
from onboard.bus.schema import Telemetry
from onboard.config import areas
from onboard.config.fleet import FleetConfig, parking_distance_m, parking_height_share
from onboard.config.flight_space import flight_space_of
from onboard.config.pair_separation import separation_m
from onboard.tuples import Xyz

_BLOCKED = ("unfinished", "timed out")  # phases of results that get an explanation
_NEAR_WALL_M = 0.5  # distance from a body's edge at which an obstacle or the fence counts as near
_MOST_NAMED = 3  # hindrances that a sentence names
_ACTIVE_M_S2 = 0.05  # smallest intervention of the law that a sentence mentions
_STEP_COUNT = 20  # steps of the straight way, at whose ends it is compared with obstacles


def explained(
    results: Results, planned: PlannedOrder, fleet: FleetConfig, state: FleetState, now_ns: int
) -> Results:
    """Return the results of an order, with the hindrances of the moves that are unfinished.

    Args:
        results: results of its vehicles.
        planned: the order.
        fleet: the fleet file.
        state: the fleet as known now.
        now_ns: the ground's monotonic clock [ns].
    """
    explained_results = {}
    for name, result in results.items():
        words = ""
        order = planned.orders.get(name)
        if result.phase in _BLOCKED and order is not None and order.position_enu_m is not None:
            words = in_the_way(fleet, state, name, order.position_enu_m, now_ns)
        explained_results[name] = result.with_more(words)
    return explained_results


def in_the_way(fleet: FleetConfig, state: FleetState, name: str, goal: Xyz, now_ns: int) -> str:
    """Return the hindrances between a vehicle and its goal, with distances, the nearest first.

    Args:
        fleet: the fleet file.
        state: the fleet as known now.
        name: name of the vehicle.
        goal: goal of its order [m], ENU.
        now_ns: the ground's monotonic clock [ns].

    Returns:
        Sentences; empty if the vehicle's position is not known.
    """
    view = state.vehicles.get(name)
    if view is None or view.telemetry is None:
        return ""
    position = view.position_enu_m(now_ns)
    if position is None:
        return ""

    distance_sentence = f"It is {math.dist(position, goal):.2f} m from its goal."
    hindrances = [
        *_neighbours(fleet, state, name, position, goal, now_ns),
        *_walls(fleet, position, goal),
    ]
    hindrances.sort()  # by distance
    words = "; ".join(text for _, text in hindrances[:_MOST_NAMED])
    if not words:
        return f"{distance_sentence} Nothing known is in its way."
    return f"{distance_sentence} In its way: {words}.{_law_words(view.telemetry)}"


def _law_words(telemetry: Telemetry) -> str:
    """Return to whom the vehicle gives way, and by how much; empty if to nobody."""
    if not telemetry.avoids or math.isnan(telemetry.intervention_m_s2):
        return ""
    by_how_much = ""
    if telemetry.intervention_m_s2 > _ACTIVE_M_S2:
        by_how_much = f" by {telemetry.intervention_m_s2:.1f} m/s²"
    return f" It gives way to {telemetry.avoids}{by_how_much}."


def _neighbours(
    fleet: FleetConfig, state: FleetState, name: str, position: Xyz, goal: Xyz, now_ns: int
) -> Iterator[tuple[float, str]]:
    """Yield vehicles near the straight way, with their distances [m]."""
    near_m = parking_distance_m(fleet)
    height_share = parking_height_share(fleet)

    for other, view in state.vehicles.items():
        if other == name:
            continue
        other_position = view.position_enu_m(now_ns)
        if other_position is None:
            continue
        if _distance_m(other_position, position, goal, height_share) >= near_m:
            continue

        away_m = math.dist(other_position[:2], position[:2])
        from_goal_m = math.dist(other_position[:2], goal[:2])
        ground_words = "" if view.is_airborne else " on the ground"
        yield (
            away_m,
            f"{other}{ground_words}, {away_m:.2f} m from it and {from_goal_m:.2f} m from the goal",
        )


def _walls(fleet: FleetConfig, position: Xyz, goal: Xyz) -> Iterator[tuple[float, str]]:
    """Yield obstacles near the straight way, and sides of the fence near the vehicle."""
    near_m = _NEAR_WALL_M + 0.5 * fleet.fleet.body_diameter_m

    shares = [k / _STEP_COUNT for k in range(_STEP_COUNT + 1)]
    route = [
        (
            position[0] + share * (goal[0] - position[0]),
            position[1] + share * (goal[1] - position[1]),
        )
        for share in shares
    ]
    for obstacle in fleet.obstacles:
        if min(obstacle.distance_m(point) for point in route) < near_m:
            away_m = obstacle.distance_m(position)
            yield away_m, f"obstacle '{obstacle.name}', {away_m:.2f} m from it"

    height_m = position[2]
    for area in flight_space_of(fleet).areas:
        if areas.counts_at(area, low_m=height_m, high_m=height_m):
            away_m = areas.nearest(area, position[0], position[1]).room_m - area.buffer_m
            if away_m < near_m:
                yield away_m, f"the fence '{area.name}', {away_m:.2f} m from its buffer"

    fence = fleet.fleet.geofence_m
    for axis, value, (low, high) in zip("xyz", position, (fence.x, fence.y, fence.z), strict=True):
        away_m = value - low
        end = low
        if high - value < away_m:
            away_m = high - value
            end = high

        is_floor = axis == "z" and end == low
        if away_m < near_m and not is_floor:
            yield away_m, f"the fence at {axis} = {end:g} m, {away_m:.2f} m from it"


def _distance_m(point: Xyz, begin: Xyz, end: Xyz, height_share: float) -> float:
    """Return the separation of a point from the straight way between two other points.

    The result is the true separation or less, because the height of the way is not computed at each
    place. The way counts as if it had all heights between its ends at once.
    """
    route = (end[0] - begin[0], end[1] - begin[1])
    length_squared_m2 = route[0] ** 2 + route[1] ** 2
    along = (point[0] - begin[0]) * route[0] + (point[1] - begin[1]) * route[1]

    share = 0.0
    if length_squared_m2 > 0.0:
        share = min(max(along / length_squared_m2, 0.0), 1.0)

    low, high = sorted((begin[2], end[2]))
    nearest_height = min(max(point[2], low), high)
    nearest = (begin[0] + share * route[0], begin[1] + share * route[1], nearest_height)
    return separation_m(point, nearest, height_share)
