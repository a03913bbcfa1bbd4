"""Leads many vehicles around static things at once, as :mod:`onboard.control.router` leads one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onboard.arrays import BoolArray, IntArray
from onboard.avoidance.params import Capsule
from onboard.control.pipeline import PipelineParams
from onboard.control.router import Maps, Router
from onboard.rollout.rows import Layout, Rows, zero
from onboard.types import Goal, Neighbour, State

_STATE = Layout(zero(State))
_GOAL = Layout(zero(Goal))
_NEIGHBOUR = Layout(zero(Neighbour))


class FleetRoutes:
    """The routers of all vehicles of F flights.

    Args:
        flight_count: number of flights.
        params: parameters of the N vehicles.
        still: static things, the same for all.
    """

    def __init__(
        self, flight_count: int, params: Sequence[PipelineParams], still: Sequence[Capsule]
    ) -> None:
        self._routers: list[list[Router]] = []
        if still:
            maps: Maps = {}
            for _ in range(flight_count):
                self._routers.append([Router(still, own.law, maps) for own in params])

    def goals(
        self, states: Rows, goals: Rows, neighbours: Rows, is_present: BoolArray, dt_s: float
    ) -> Rows:
        """Return the goals (F, N) of the trajectories for this tick.

        Args:
            states, goals: estimates and goals (F, N).
            neighbours, is_present: neighbours, and whether each exists (F, N, K).
            dt_s: length of the tick.
        """
        if not self._routers:
            return goals

        legs = []
        for flight, routers in enumerate(self._routers):
            own_states = _STATE.values(states[flight])
            own_goals = _GOAL.values(goals[flight])
            for vehicle, router in enumerate(routers):
                near: list[Neighbour] = []
                if router.is_due(own_goals[vehicle], dt_s):
                    rows = neighbours[flight, vehicle]
                    near = _NEIGHBOUR.values(rows[is_present[flight, vehicle]])
                legs.append(router.toward(own_states[vehicle], own_goals[vehicle], near, dt_s))
        return _GOAL.packed(legs).reshape(goals.shape)

    def keep(self, flights: IntArray) -> None:
        """Keep only these flights of the batch, by index."""
        if self._routers:
            self._routers = [self._routers[flight] for flight in np.asarray(flights).tolist()]
