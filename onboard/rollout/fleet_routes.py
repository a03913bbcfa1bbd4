"""Routes many vehicles around static obstacles, with :mod:`onboard.control.router` for each one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.avoidance.params import Capsule, LawParams
from onboard.control import goal_conflict, parked, router
from onboard.control.pipeline import INTENT_1_S, PipelineParams
from onboard.control.router import RouteMemory, Surroundings
from onboard.rollout.rows import Layout, Rows, zero
from onboard.types import Goal, Neighbour, State

_STATE = Layout(zero(State))
_GOAL = Layout(zero(Goal))
_NEIGHBOUR = Layout(zero(Neighbour))


class FleetRoutes:
    """The routes of all vehicles of F flights.

    To save time, the router does not run for every vehicle at every tick. Without static obstacles,
    it runs at every tick only for vehicles that follow a route around parked vehicles. Occasionally
    it also runs for vehicles that stand away from their goal.

    Args:
        flight_count: number of flights.
        params: parameters of the N vehicles.
        still: static obstacles, the same for all.
    """

    def __init__(
        self, flight_count: int, params: Sequence[PipelineParams], still: Sequence[Capsule]
    ) -> None:
        self._memories = [[RouteMemory()] * len(params) for _ in range(flight_count)]
        self._around = _surroundings(params, still)
        # distance within which a vehicle is near its goal (N,)
        self._near_goal_m = np.array(
            [goal_conflict.near_goal_m(around.spacing) for around in self._around]
        )

        # whether the router may change a vehicle's goal at any tick (F, N)
        self._is_led = np.full((flight_count, len(params)), bool(still))
        # whether a vehicle's route memory is empty (F, N)
        self._is_idle = np.full((flight_count, len(params)), True)
        self._since_search_s = 0.0  # time since the router ran for standing vehicles

    def goals(
        self, states: Rows, goals: Rows, neighbours: Rows, is_present: BoolArray, dt_s: float
    ) -> Rows:
        """Return the goals (F, N) after routing, since a vehicle may first have to fly to a corner.

        Args:
            states, goals: estimates and goals (F, N).
            neighbours, is_present: neighbours, and whether each exists (F, N, K).
            dt_s: length of the tick.
        """
        # choose the vehicles (F, N) for which the router runs at this tick
        chosen = self._is_led.copy()
        self._since_search_s += dt_s
        if self._since_search_s >= router.PERIOD_S - 1e-9:
            self._since_search_s = 0.0
            chosen |= ~self._is_idle | _may_be_held(states, goals)
            chosen |= self._may_have_rival(states, goals, neighbours, is_present)
        if not chosen.any():
            return goals

        routed_goals = goals.copy()
        for flight, vehicle in np.argwhere(chosen).tolist():
            memory = self._memories[flight][vehicle]
            step_s = router.PERIOD_S  # time since the router ran for this vehicle
            if self._is_led[flight, vehicle]:
                step_s = dt_s
            (state,) = _STATE.values(states[flight, vehicle, None])
            (goal,) = _GOAL.values(goals[flight, vehicle, None])
            around = self._around[vehicle]
            near: list[Neighbour] = []
            if router.is_due(memory, goal, step_s) and router.uses_neighbours(
                memory, state, goal, around
            ):
                near = _NEIGHBOUR.values(neighbours[flight, vehicle][is_present[flight, vehicle]])

            memory, routed_goal = router.step(memory, state, goal, near, around, step_s)
            self._memories[flight][vehicle] = memory
            self._is_idle[flight, vehicle] = router.is_idle(memory)
            self._is_led[flight, vehicle] = bool(around.still) or router.is_led(memory)
            if routed_goal is not goal:
                (row,) = _GOAL.packed([routed_goal])
                routed_goals[flight, vehicle] = row
        return routed_goals

    def _may_have_rival(
        self, states: Rows, goals: Rows, neighbours: Rows, is_present: BoolArray
    ) -> BoolArray:
        """Return whether each vehicle (F, N) is short of its goal, and a neighbour's goal is
        near.

        The router makes the exact test.
        """
        away_m = _level_distance_m(goals["position_enu_m"], states["position_enu_m"])
        is_short_of_goal = (away_m > goal_conflict.ARRIVED_M) & (away_m <= self._near_goal_m)
        if not is_short_of_goal.any():
            return is_short_of_goal

        own_goals_m = goals["position_enu_m"][is_short_of_goal]
        around = neighbours[is_short_of_goal]
        their_goals_m = around["predicted_position_enu_m"] + around["intent_enu_m_s"] / INTENT_1_S
        apart_m = _level_distance_m(own_goals_m[:, None], their_goals_m)
        is_near = is_present[is_short_of_goal] & (apart_m < self._near_goal_m.max())

        may_have_rival = np.zeros_like(is_short_of_goal)
        may_have_rival[is_short_of_goal] = is_near.any(-1)
        return may_have_rival

    def keep(self, flights: IntArray) -> None:
        """Keep only these flights of the batch, by index."""
        self._memories = [self._memories[flight] for flight in np.asarray(flights).tolist()]
        self._is_led = self._is_led[flights]
        self._is_idle = self._is_idle[flights]


def _may_be_held(states: Rows, goals: Rows) -> BoolArray:
    """Return whether each vehicle (F, N) stands away from its goal."""
    speed_m_s = np.hypot(*np.moveaxis(states["velocity_enu_m_s"][..., :2], -1, 0))
    away_m = _level_distance_m(goals["position_enu_m"], states["position_enu_m"])
    return np.asarray((speed_m_s < parked.STANDING_M_S) & (away_m > parked.AWAY_M))


def _level_distance_m(a: Array, b: Array) -> Array:
    """Return the horizontal distance between positions (..., 3)."""
    x, y, _ = np.moveaxis(a - b, -1, 0)
    return np.asarray(np.hypot(x, y))


def _surroundings(params: Sequence[PipelineParams], still: Sequence[Capsule]) -> list[Surroundings]:
    """Return the surroundings of each vehicle; vehicles with the same law share theirs."""
    by_law: dict[LawParams, Surroundings] = {}
    for own in params:
        if own.law not in by_law:
            by_law[own.law] = router.surroundings(still, own.law)
    return [by_law[own.law] for own in params]
