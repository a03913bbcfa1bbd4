"""Leads many vehicles around static things at once, as :mod:`onboard.control.router` leads one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onboard.arrays import BoolArray, IntArray
from onboard.avoidance.params import Capsule, LawParams
from onboard.control import router
from onboard.control.pipeline import PipelineParams
from onboard.control.router import RouteMemory, Surroundings
from onboard.rollout.rows import Layout, Rows, zero
from onboard.types import Goal, Neighbour, State

_STATE = Layout(zero(State))
_GOAL = Layout(zero(Goal))
_NEIGHBOUR = Layout(zero(Neighbour))


class FleetRoutes:
    """The ways of all vehicles of F flights.

    Args:
        flight_count: number of flights.
        params: parameters of the N vehicles.
        still: static things, the same for all.
    """

    def __init__(
        self, flight_count: int, params: Sequence[PipelineParams], still: Sequence[Capsule]
    ) -> None:
        self._memories: list[list[RouteMemory]] = []
        self._around: list[Surroundings] = []
        if still:
            self._memories = [[RouteMemory()] * len(params) for _ in range(flight_count)]
            self._around = _surroundings(params, still)

    def goals(
        self, states: Rows, goals: Rows, neighbours: Rows, is_present: BoolArray, dt_s: float
    ) -> Rows:
        """Return the goals (F, N) of the trajectories for this tick.

        Args:
            states, goals: estimates and goals (F, N).
            neighbours, is_present: neighbours, and whether each exists (F, N, K).
            dt_s: length of the tick.
        """
        if not self._memories:
            return goals

        legs = []
        for flight, memories in enumerate(self._memories):
            own_states = _STATE.values(states[flight])
            own_goals = _GOAL.values(goals[flight])
            for vehicle, memory in enumerate(memories):
                near: list[Neighbour] = []
                if router.is_due(memory, own_goals[vehicle], dt_s):
                    rows = neighbours[flight, vehicle]
                    near = _NEIGHBOUR.values(rows[is_present[flight, vehicle]])
                memories[vehicle], leg = router.step(
                    memory,
                    own_states[vehicle],
                    own_goals[vehicle],
                    near,
                    self._around[vehicle],
                    dt_s,
                )
                legs.append(leg)
        return _GOAL.packed(legs).reshape(goals.shape)

    def keep(self, flights: IntArray) -> None:
        """Keep only these flights of the batch, by index."""
        if self._memories:
            self._memories = [self._memories[flight] for flight in np.asarray(flights).tolist()]


def _surroundings(params: Sequence[PipelineParams], still: Sequence[Capsule]) -> list[Surroundings]:
    """Return the surroundings of each vehicle; vehicles with the same law share theirs."""
    by_law: dict[LawParams, Surroundings] = {}
    for own in params:
        if own.law not in by_law:
            by_law[own.law] = router.surroundings(still, own.law)
    return [by_law[own.law] for own in params]
