"""Hindrances between a vehicle and its goal: neighbours, obstacles, the fence. Pure.

The results of moves that did not end in time get these sentences.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from groundstation.fleet.slot_owners import stand_ins
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
_MAX_NAMED = 3  # hindrances that a sentence names
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
    words = "; ".join(text for _, text in hindrances[:_MAX_NAMED])
    law_sentence = _law_words(state, view.telemetry, now_ns)
    way_sentence = ""
    if words:
        way_sentence = f" In its way: {words}."
    elif not law_sentence:
        way_sentence = " Nothing known is in its way."
    return f"{distance_sentence}{way_sentence}{law_sentence}"


def _law_words(state: FleetState, telemetry: Telemetry, now_ns: int) -> str:
    """Return what the vehicle gives way to, and by how much; empty if to nothing."""
    if not telemetry.avoids or math.isnan(telemetry.intervention_m_s2):
        return ""
    by_how_much = ""
    if telemetry.intervention_m_s2 > _ACTIVE_M_S2:
        by_how_much = f" by {telemetry.intervention_m_s2:.1f} m/s²"

    avoided = state.vehicles.get(telemetry.avoids)
    where_words = ""
    if avoided is not None and avoided.telemetry is not None and not avoided.is_airborne:
        where_words = ", which is on the ground"
        if avoided.position_enu_m(now_ns) is None:
            where_words += ", and its place is not known exactly"
    return f" It gives way to {telemetry.avoids}{by_how_much}{where_words}."


def _neighbours(
    fleet: FleetConfig, state: FleetState, name: str, position: Xyz, goal: Xyz, now_ns: int
) -> Iterator[tuple[float, str]]:
    """Yield vehicles near the straight way, with their distances [m].

    A vehicle whose position is not known now is avoided where it was last seen, unless another one
    stands in for it.
    """
    near_m = parking_distance_m(fleet)
    height_share = parking_height_share(fleet)
    replaced = stand_ins(state)

    for other, view in state.vehicles.items():
        if other == name:
            continue
        other_position = view.position_enu_m(now_ns)
        seen_words = ""
        if other_position is None:
            sighting = view.sighting
            if sighting is None or other in replaced:
                continue
            other_position = sighting.position_enu_m
            seen_words = "last seen "
        if _distance_m(other_position, position, goal, height_share) >= near_m:
            continue

        away_m = math.dist(other_position[:2], position[:2])
        from_goal_m = math.dist(other_position[:2], goal[:2])
        ground_words = "" if view.is_airborne else " on the ground"
        yield (
            away_m,
            f"{other}{ground_words}, {seen_words}{away_m:.2f} m from it"
            f" and {from_goal_m:.2f} m from the goal",
        )


def _walls(fleet: FleetConfig, position: Xyz, goal: Xyz) -> Iterator[tuple[float, str]]:
    """Yield obstacles near the straight way, and sides of the fence near the vehicle."""
    near_m = _NEAR_WALL_M + 0.5 * fleet.fleet.body_diameter_m

    x, y, height_m = position
    goal_x, goal_y, _ = goal
    shares = [step / _STEP_COUNT for step in range(_STEP_COUNT + 1)]
    route = [(x + share * (goal_x - x), y + share * (goal_y - y)) for share in shares]
    for obstacle in fleet.obstacles:
        if min(obstacle.distance_m(point) for point in route) < near_m:
            away_m = obstacle.distance_m(position)
            yield away_m, f"obstacle '{obstacle.name}', {away_m:.2f} m from it"

    for area in flight_space_of(fleet).areas:
        if areas.counts_at(area, low_m=height_m, high_m=height_m):
            away_m = areas.nearest(area, x, y).room_m - area.buffer_m
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
    x, y, z = point
    begin_x, begin_y, begin_z = begin
    end_x, end_y, end_z = end
    route_x = end_x - begin_x
    route_y = end_y - begin_y
    length_squared_m2 = route_x**2 + route_y**2
    along = (x - begin_x) * route_x + (y - begin_y) * route_y

    share = 0.0
    if length_squared_m2 > 0.0:
        share = min(max(along / length_squared_m2, 0.0), 1.0)

    low, high = sorted((begin_z, end_z))
    nearest_z = min(max(z, low), high)
    nearest = (begin_x + share * route_x, begin_y + share * route_y, nearest_z)
    return separation_m(point, nearest, height_share)
