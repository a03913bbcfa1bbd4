"""Leads one vehicle around static things: gives its trajectory the next corner as its goal.

A goal that is in sight passes unchanged. For another one the vehicle flies to the first corner of
the shortest way (:mod:`onboard.control.route_map`) until it sees the next one. The way is found
anew several times a second from where the vehicle is, so others may push it off its way.

Where two meet in a passage that is too narrow for both, one flies back and waits beside it until
the other one has passed (:mod:`onboard.control.yielding`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from onboard.avoidance.params import Capsule, LawParams, Walls
from onboard.control import yielding
from onboard.control.route_map import RouteMap
from onboard.types import Goal, Neighbour, State
from onboard.vectors import Vec2, Vec3, is_finite

PERIOD_S = 0.2  # from one search to the next

# The trajectory aims at a point behind the corner where there is room, since it would stop at the
# corner itself: the next corner is in sight before.
_BEYOND_M = (1.0, 0.5, 0.25)

_MOST_WAIT_S = 15.0  # a vehicle that gave way goes on after this time at the latest

# maps by what is in the way, how far the vehicle stays from it, and the walls of the box
Maps = dict[tuple[tuple[Capsule, ...], float, Walls], RouteMap]


class Router:
    """Finds the way of one vehicle.

    Args:
        still: static things of the fleet: obstacles, and edges of areas.
        law: numbers of the vehicle's law, which say how far it stays from them.
        maps: maps that were computed before, which several routers may share.
    """

    def __init__(self, still: Sequence[Capsule], law: LawParams, maps: Maps | None = None) -> None:
        self._still = tuple(still)
        self._law = law
        self._maps = {} if maps is None else maps
        if self._still:
            self._map(self._still).prepare()

        self._sequence: int | None = None  # of the goal that is flown to
        self._is_around = False  # whether the way to this goal has led around something
        self._wait_s = 0.0  # time until the next search

        self._corner: Vec2 | None = None  # that is flown to; None: straight to the goal
        self._aim: Vec2 | None = None  # of the trajectory: the corner, or a point behind it
        self._count = 0  # corners that were flown to, which number their legs

        self._met_s = 0.0  # time for which it has stood face to face with another vehicle
        self._refuge: Vec2 | None = None  # place at which it waits until the other has passed
        self._waited_s = 0.0  # time since it left for that place

    def toward(
        self, state: State, goal: Goal, neighbours: Sequence[Neighbour], dt_s: float
    ) -> Goal:
        """Return the goal of the trajectory for this tick: the vehicle's goal, or a corner.

        Where there is no way, it is the vehicle's goal.

        Args:
            state: own estimate.
            goal: where the vehicle shall go.
            neighbours: the known neighbours.
            dt_s: time since the last call.
        """
        is_usable = is_finite(state.position_enu_m) and is_finite(goal.position_enu_m)
        if not self._still or goal.is_on_path or not is_usable:
            return goal

        is_due = self.is_due(goal, dt_s)
        self._wait_s -= dt_s
        if goal.sequence != self._sequence:
            self._sequence = goal.sequence
            self._is_around = False
            self._met_s = 0.0
            self._refuge = None
        if is_due:
            self._wait_s = PERIOD_S
            self._search(state, goal.position_enu_m, neighbours)
        return self._leg(goal)

    def is_due(self, goal: Goal, dt_s: float) -> bool:
        """Return whether the next call of :meth:`toward` looks for a way, and uses neighbours."""
        return goal.sequence != self._sequence or self._wait_s <= dt_s

    def _search(self, state: State, goal: Vec3, neighbours: Sequence[Neighbour]) -> None:
        """Find the way anew."""
        here = Vec2(state.position_enu_m.x, state.position_enu_m.y)
        goal_m = Vec2(goal.x, goal.y)
        still = in_the_way(self._still, state.position_enu_m.z, goal.z)
        route_map = self._map(still)

        way = route_map.route(here, goal_m)
        if self._refuge is None:
            self._refuge = self._refuge_from(state, [here, *(way or [goal_m])], neighbours, still)
        else:
            self._waited_s += PERIOD_S
            is_free = yielding.is_way_free([here, *way], neighbours, self._law.spacing)
            if is_free or self._waited_s >= _MOST_WAIT_S:
                self._refuge = None

        if self._refuge is not None:
            way = route_map.route(here, self._refuge)
        self._follow(here, way, route_map)

    def _refuge_from(
        self,
        state: State,
        way: Sequence[Vec2],
        neighbours: Sequence[Neighbour],
        still: tuple[Capsule, ...],
    ) -> Vec2 | None:
        """Return the place at which this vehicle waits for another one, if it has to give way."""
        here = way[0]
        ahead_m = math.dist(here, way[1])
        if ahead_m < 1e-6:
            return None
        direction = Vec2((way[1].x - here.x) / ahead_m, (way[1].y - here.y) / ahead_m)

        spacing = self._law.spacing
        opponent = yielding.opponent_of(state, direction, neighbours, spacing)
        if opponent is None:
            self._met_s = 0.0
            return None

        self._met_s += PERIOD_S
        if not yielding.is_to_yield(here, opponent, self._met_s):
            return None
        self._met_s = 0.0
        self._waited_s = 0.0
        return yielding.place_to_wait(here, opponent, self._map(still), still, spacing)

    def _follow(self, here: Vec2, way: Sequence[Vec2], route_map: RouteMap) -> None:
        """Choose the corner and the aim of the trajectory."""
        is_last = len(way) <= 1
        if is_last and self._refuge is None:
            self._corner = None
            self._aim = None
            return

        corner = self._refuge if is_last else way[0]
        if corner is not None and corner != self._corner:
            self._corner = corner
            self._aim = corner if is_last else _behind(here, corner, route_map)
            self._is_around = True
            self._count += 1

    def _map(self, still: tuple[Capsule, ...]) -> RouteMap:
        """Return the map of these things, which is computed once."""
        key = (still, self._law.spacing.clearance_m, self._law.fence)
        if key not in self._maps:
            self._maps[key] = RouteMap(*key)
        return self._maps[key]

    def _leg(self, goal: Goal) -> Goal:
        """Return the goal of the present leg. After a corner an ordered duration does not count."""
        if self._aim is not None:
            position = Vec3(self._aim.x, self._aim.y, goal.position_enu_m.z)
            return goal._replace(position_enu_m=position, duration_s=0.0, sequence=-self._count)
        if self._is_around:
            return goal._replace(duration_s=0.0)
        return goal


def in_the_way(
    still: Sequence[Capsule], height_m: float, goal_height_m: float
) -> tuple[Capsule, ...]:
    """Return the static things that count for a flight between two heights [m]."""
    low_m = min(height_m, goal_height_m)
    high_m = max(height_m, goal_height_m)
    return tuple(
        capsule for capsule in still if capsule.low_m <= high_m and capsule.high_m >= low_m
    )


def _behind(here: Vec2, corner: Vec2, route_map: RouteMap) -> Vec2:
    """Return a point behind a corner, as seen from here, to which the way from the corner is free.

    It is the corner itself where there is no room.
    """
    away_m = math.dist(here, corner)
    if away_m < 1e-6:
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
