"""Leads one vehicle around static things, by giving its trajectory the next corner as a goal.

A point is in sight if the straight line to it is free. If the goal is in sight, it stays the
trajectory's goal. If not, the vehicle flies to the first corner of the shortest route
(:mod:`onboard.control.route_map`) until the next corner is in sight. The route is searched several
times a second from the present position, so other vehicles may push the vehicle off its route.

If two vehicles meet in a passage that is too narrow for both, one of them flies back and waits
beside the passage until the other has passed (:mod:`onboard.control.yielding`). If their goals are
too near to each other, one of them waits until the other has arrived
(:mod:`onboard.control.goal_conflict`). If parked vehicles keep a vehicle from its goal, it also
flies around them (:mod:`onboard.control.parked`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations_with_replacement, pairwise
from typing import NamedTuple

from onboard.avoidance.params import Capsule, LawParams, Spacing, Walls
from onboard.control import goal_conflict, parked, yielding
from onboard.control.goal_conflict import Rival
from onboard.control.route_map import RouteMap
from onboard.tuples import Xyz
from onboard.types import NO_SEQUENCE, Goal, Neighbour, State
from onboard.vectors import Vec2, Vec3, horizontal, is_finite

PERIOD_S = 0.2  # time from one search to the next

# If there is room, the trajectory aims at a point this far behind the corner, because it would stop
# at a corner that it aims at. The next corner is in sight before the vehicle reaches that point.
_BEYOND_M = (1.0, 0.5, 0.25)  # the first distance that is free

_SAME_POINT_M = 1e-6  # a point nearer than this has no direction and no route
_MAX_WAIT_S = 15.0  # a vehicle that gave way continues after this time at the latest
NOBODY = -1  # stands for no vehicle


class RouteMemory(NamedTuple):
    """Where a vehicle is on its route, between two ticks."""

    sequence: int = NO_SEQUENCE  # sequence of the present goal
    left_s: float = 0.0  # time until the next search

    corner: Vec2 | None = None  # corner that the vehicle flies to; None: straight to the goal
    aim: Vec2 | None = None  # end of the trajectory: the corner, or a point behind it
    leg_count: int = 0  # number of corners flown to so far, each on its own leg
    is_around: bool = False  # whether the route to this goal has led around something
    pace_s_m: float = 0.0  # ordered duration per length of the route; 0: no duration was ordered
    leg_s: float = 0.0  # part of the ordered duration for the present leg

    met_s: float = 0.0  # how long it has stood face to face with another vehicle
    rival_s: float = 0.0  # how long another vehicle's goal has been too near to its own
    refuge: Vec2 | None = None  # point at which it waits until the other vehicle goes on
    waited_s: float = 0.0  # time since it left for the refuge
    waits_for: int = NOBODY  # table index of the other vehicle

    stood_s: float = 0.0  # how long it has stood away from its goal
    past_parked: RouteMap | None = None  # map with the parked vehicles that hold it back


class Surroundings(NamedTuple):
    """The static things around a vehicle, and how far it stays from them."""

    still: tuple[Capsule, ...]  # obstacles, and edges of areas, in fleet ENU
    spacing: Spacing
    walls: Walls
    maps: Mapping[tuple[Capsule, ...], RouteMap]  # by the things that are in the way of a flight


def surroundings(still: Sequence[Capsule], law: LawParams) -> Surroundings:
    """Return the surroundings of a vehicle with all maps, because computing a map in flight takes
    too long.

    Args:
        still: static things of the fleet.
        law: numbers of the vehicle's law.
    """
    all_still = tuple(still)
    maps = {}
    for things in _by_height(all_still):
        maps[things] = RouteMap(things, law.spacing.clearance_m, law.fence)
    return Surroundings(still=all_still, spacing=law.spacing, walls=law.fence, maps=maps)


def map_of(still: tuple[Capsule, ...], around: Surroundings) -> RouteMap:
    """Return the map of some of the surrounding things."""
    known = around.maps.get(still)
    if known is not None:
        return known
    return RouteMap(still, around.spacing.clearance_m, around.walls)


def is_led(memory: RouteMemory) -> bool:
    """Return whether the trajectory may lead to a corner instead of the vehicle's goal."""
    return memory.aim is not None or memory.is_around


def is_idle(memory: RouteMemory) -> bool:
    """Return whether the memory holds nothing that the next search needs."""
    avoids_vehicles = memory.refuge is not None or memory.past_parked is not None
    has_waited = memory.stood_s > 0.0 or memory.met_s > 0.0 or memory.rival_s > 0.0
    return not (is_led(memory) or avoids_vehicles or has_waited)


def is_due(memory: RouteMemory, goal: Goal, dt_s: float) -> bool:
    """Return whether the next step searches for a route."""
    return goal.sequence != memory.sequence or memory.left_s <= dt_s


def uses_neighbours(memory: RouteMemory, state: State, goal: Goal, around: Surroundings) -> bool:
    """Return whether the next search uses the neighbours."""
    is_long_held = memory.stood_s + PERIOD_S >= parked.STANDING_S
    is_short_of_goal = goal_conflict.is_short_of_goal(state, goal.position_enu_m, around.spacing)
    return bool(around.still) or is_led(memory) or is_long_held or is_short_of_goal


def step(
    memory: RouteMemory,
    state: State,
    goal: Goal,
    neighbours: Sequence[Neighbour],
    around: Surroundings,
    dt_s: float,
) -> tuple[RouteMemory, Goal]:
    """Return the memory, and the goal of the trajectory for this tick.

    The goal is a corner of the route; without a route it is the vehicle's own goal.

    Args:
        memory: memory of the last tick.
        state: own estimate.
        goal: the vehicle's own goal.
        neighbours: the known neighbours.
        around: static things of the fleet.
        dt_s: time since the last tick.
    """
    if goal.is_on_path or not is_finite(goal.position_enu_m):
        return memory, goal

    if not is_finite(state.position_enu_m):
        if goal.sequence != memory.sequence:
            return memory, goal
        return memory, _goal_of_leg(memory, goal)

    if not is_due(memory, goal, dt_s):
        memory = memory._replace(left_s=memory.left_s - dt_s)
        return memory, _goal_of_leg(memory, goal)

    if goal.sequence != memory.sequence:
        memory = RouteMemory(sequence=goal.sequence, leg_count=memory.leg_count)
        memory = memory._replace(pace_s_m=_pace_s_m(state, goal, around))
    memory = _searched(memory, state, goal, neighbours, around)
    return memory._replace(left_s=PERIOD_S), _goal_of_leg(memory, goal)


def _searched(
    memory: RouteMemory,
    state: State,
    goal: Goal,
    neighbours: Sequence[Neighbour],
    around: Surroundings,
) -> RouteMemory:
    """Return the memory after a new search for the route."""
    here = horizontal(state.position_enu_m)
    still = in_the_way(around.still, state.position_enu_m.z, goal.position_enu_m.z)
    goal_m = horizontal(goal.position_enu_m)

    memory = _held_by_parked(memory, state, goal_m, neighbours, still, around)

    rival = None
    is_short_of_goal = goal_conflict.is_short_of_goal(state, goal.position_enu_m, around.spacing)
    if is_short_of_goal or memory.refuge is not None:
        rival = goal_conflict.rival_of(state, goal.position_enu_m, neighbours, around.spacing)
    if memory.refuge is None:
        memory = _yielded_to_rival(memory, here, rival, neighbours, map_of(still, around))

    if not (still or memory.past_parked or memory.refuge or is_led(memory)):
        return memory  # nothing is in the way

    route_map = memory.past_parked
    if route_map is None:
        route_map = map_of(still, around)
    route = route_map.route(here, goal_m, memory.corner)

    if memory.refuge is None:
        whole_route = [here, goal_m]
        if route:
            whole_route = [here, *route]
        memory = _yielded(memory, state, whole_route, neighbours, route_map, around.spacing)
    else:
        is_free = yielding.is_route_free([here, *route], neighbours, around.spacing)
        memory = _waiting(memory, is_free=is_free and rival is None)

    if memory.refuge is not None:
        route = route_map.route(here, memory.refuge)
    if not route:
        route = [goal_m]
    return _following(memory, here, route, route_map)


def _held_by_parked(
    memory: RouteMemory,
    state: State,
    goal: Vec2,
    neighbours: Sequence[Neighbour],
    still: tuple[Capsule, ...],
    around: Surroundings,
) -> RouteMemory:
    """Return the memory with a map of parked vehicles, if they have held the vehicle for a long
    time.
    """
    is_waiting = memory.refuge is not None
    if is_waiting or not parked.is_standing_away(state, goal):
        return memory._replace(stood_s=max(memory.stood_s - PERIOD_S, 0.0))

    stood_s = memory.stood_s + PERIOD_S
    if stood_s < parked.STANDING_S:
        return memory._replace(stood_s=stood_s)

    most = parked.most_pillars(len(map_of(still, around).corners), len(still))
    pillars = parked.pillars(state, neighbours, around.spacing)[:most]
    past_parked = None
    if pillars:
        past_parked = RouteMap((*still, *pillars), around.spacing.clearance_m, around.walls)
    return memory._replace(stood_s=0.0, past_parked=past_parked)


def _yielded_to_rival(
    memory: RouteMemory,
    here: Vec2,
    rival: Rival | None,
    neighbours: Sequence[Neighbour],
    route_map: RouteMap,
) -> RouteMemory:
    """Return the memory with a refuge to wait at, if a rival flies to its goal first."""
    if rival is None:
        return memory._replace(rival_s=0.0)

    rival_s = memory.rival_s + PERIOD_S
    if not yielding.is_to_yield(here, rival.position_m, rival_s):
        return memory._replace(rival_s=rival_s)

    refuge = goal_conflict.waiting_point(here, rival, neighbours, route_map)
    if refuge is None:
        return memory._replace(rival_s=0.0)
    return memory._replace(rival_s=0.0, refuge=refuge, waited_s=0.0, waits_for=rival.table_index)


def _yielded(
    memory: RouteMemory,
    state: State,
    route: Sequence[Vec2],
    neighbours: Sequence[Neighbour],
    route_map: RouteMap,
    spacing: Spacing,
) -> RouteMemory:
    """Return the memory with a refuge to wait at, if the vehicle must give way."""
    here, ahead, *_ = route
    ahead_m = math.dist(here, ahead)
    if ahead_m < _SAME_POINT_M:
        return memory

    direction = Vec2((ahead.x - here.x) / ahead_m, (ahead.y - here.y) / ahead_m)
    opponent = yielding.opponent_of(state, direction, neighbours, spacing)
    if opponent is None:
        return memory._replace(met_s=0.0)

    met_s = memory.met_s + PERIOD_S
    if not yielding.is_to_yield(here, opponent.position_m, met_s):
        return memory._replace(met_s=met_s)

    refuge = yielding.nearest_refuge(here, opponent, route_map)
    if refuge is None:
        return memory._replace(met_s=0.0)
    return memory._replace(met_s=0.0, refuge=refuge, waited_s=0.0, waits_for=opponent.table_index)


def _waiting(memory: RouteMemory, is_free: bool) -> RouteMemory:
    """Return the memory without the refuge, once the route and the goal are free."""
    waited_s = memory.waited_s + PERIOD_S
    if is_free or waited_s >= _MAX_WAIT_S:
        return memory._replace(refuge=None, waits_for=NOBODY)
    return memory._replace(waited_s=waited_s)


def _following(
    memory: RouteMemory, here: Vec2, route: Sequence[Vec2], route_map: RouteMap
) -> RouteMemory:
    """Return the memory with the corner and the aim of the trajectory, and the time for the leg."""
    # a route of one point leads straight to its end: the refuge, or the goal (None)
    corner = memory.refuge
    if len(route) > 1:
        corner = route[0]
    if corner == memory.corner:
        return memory
    if corner is None:
        leg_s = memory.pace_s_m * math.dist(here, route[0])
        return memory._replace(corner=None, aim=None, leg_s=leg_s)

    aim = corner
    leg_s = 0.0  # a vehicle that gives way flies as fast as it can
    if memory.refuge is None:
        aim = _behind(here, corner, route_map)
        leg_s = memory.pace_s_m * math.dist(here, aim)
    return memory._replace(
        corner=corner,
        aim=aim,
        leg_count=memory.leg_count + 1,
        is_around=True,
        leg_s=leg_s,
    )


def _pace_s_m(state: State, goal: Goal, around: Surroundings) -> float:
    """Return the ordered time per metre of the route; 0: the order gives no time."""
    if goal.duration_s <= 0.0:
        return 0.0
    length_m = route_length_m(around, state.position_enu_m, goal.position_enu_m)
    if length_m < _SAME_POINT_M:
        return 0.0
    return goal.duration_s / length_m


def _goal_of_leg(memory: RouteMemory, goal: Goal) -> Goal:
    """Return the goal of the present leg, with its share of an ordered duration.

    Legs to corners have negative sequences, because the sequences of the vehicle's own goals are
    never negative.
    """
    leg_s = memory.leg_s
    if memory.aim is not None:
        position = Vec3(memory.aim.x, memory.aim.y, goal.position_enu_m.z)
        return goal._replace(position_enu_m=position, duration_s=leg_s, sequence=-memory.leg_count)
    if memory.is_around:
        return goal._replace(duration_s=leg_s)
    return goal


def route_length_m(around: Surroundings, begin_enu_m: Xyz, goal_enu_m: Xyz) -> float:
    """Return the length [m] of the route to a goal, or of the straight line if there is no route.

    Args:
        around: static things of the fleet.
        begin_enu_m, goal_enu_m: where the vehicle is, and its goal [m], ENU.
    """
    if not around.still:
        return math.dist(begin_enu_m, goal_enu_m)

    level_m = 0.0
    for here, there in pairwise(route_between(around, begin_enu_m, goal_enu_m)):
        level_m += math.dist(here, there)

    _, _, begin_z = begin_enu_m
    _, _, goal_z = goal_enu_m
    return math.hypot(level_m, goal_z - begin_z)


def route_between(around: Surroundings, begin_enu_m: Xyz, goal_enu_m: Xyz) -> list[Vec2]:
    """Return the points of the route to a goal, with begin and goal.

    Without a route it is the straight line, which the vehicle would fly.

    Args:
        around: static things of the fleet.
        begin_enu_m, goal_enu_m: where the vehicle is, and its goal [m], ENU.
    """
    begin_x, begin_y, begin_z = begin_enu_m
    goal_x, goal_y, goal_z = goal_enu_m
    begin = Vec2(float(begin_x), float(begin_y))
    goal = Vec2(float(goal_x), float(goal_y))
    still = in_the_way(around.still, begin_z, goal_z)
    route = map_of(still, around).route(begin, goal)
    if not route:
        route = [goal]
    return [begin, *route]


def in_the_way(
    still: Sequence[Capsule], height_m: float, goal_height_m: float
) -> tuple[Capsule, ...]:
    """Return the static things that may be in the way of a flight between two heights [m]."""
    low_m = min(height_m, goal_height_m)
    high_m = max(height_m, goal_height_m)
    return tuple(
        capsule for capsule in still if capsule.low_m <= high_m and capsule.high_m >= low_m
    )


def _by_height(still: tuple[Capsule, ...]) -> set[tuple[Capsule, ...]]:
    """Return the possible sets of things in the way, for flights at or between any heights."""
    limits: set[float] = set()
    for capsule in still:
        limits.update((capsule.low_m, capsule.high_m))
    heights = sorted(limit for limit in limits if math.isfinite(limit))

    # The limits divide the heights into bands. Take one height from each band: below all limits,
    # between two neighbouring limits, and above all limits.
    middles = [0.5 * (low + high) for low, high in pairwise(heights)]
    band_heights = [0.0]
    if heights:
        band_heights = [heights[0] - 1.0, *middles, heights[-1] + 1.0]

    flights = combinations_with_replacement(band_heights, 2)
    return {in_the_way(still, low, high) for low, high in flights}


def _behind(here: Vec2, corner: Vec2, route_map: RouteMap) -> Vec2:
    """Return a point behind a corner, on the line from here; the corner itself if there is no room.

    The point is in sight of the corner.
    """
    away_m = math.dist(here, corner)
    if away_m < _SAME_POINT_M:
        return corner

    for beyond_m in _BEYOND_M:
        share = beyond_m / away_m
        aim = Vec2(
            corner.x + share * (corner.x - here.x),
            corner.y + share * (corner.y - here.y),
        )
        if route_map.is_free(corner, aim):
            return aim
    return corner
