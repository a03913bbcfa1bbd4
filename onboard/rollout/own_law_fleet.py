"""Runs the pipelines of many vehicles with a user's own law: interpreted, vehicle by vehicle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.avoidance.own_law_runner import OwnLawRunner
from onboard.avoidance.params import Capsule
from onboard.config.fleet import OwnLaw
from onboard.control import pipeline
from onboard.control.control_mode import ControlMode
from onboard.rollout import batch
from onboard.rollout.fleet_routes import FleetRoutes
from onboard.rollout.rows import Rows
from onboard.vectors import Vec3


class OwnLawFleet:
    """The pipelines of all vehicles with a user's own law.

    It implements :class:`onboard.rollout.batch.Controller`.

    Args:
        law: the law that the fleet file names.
        params: parameters of the N vehicles.
        start_enu_m: positions (F, N, 3) at which the vehicles hover [m].
        obstacles: static obstacles, the same for all.
    """

    def __init__(
        self,
        law: OwnLaw,
        params: Sequence[pipeline.PipelineParams],
        start_enu_m: Array,
        obstacles: Sequence[Capsule] = (),
    ) -> None:
        self._params = params
        self._obstacles = tuple(obstacles)
        self._routes = FleetRoutes(len(start_enu_m), params, obstacles)

        # for each flight: law and pipeline memory of each vehicle
        self._flights = []
        for positions_enu_m in start_enu_m.tolist():
            vehicles = []
            for own_params, position in zip(params, positions_enu_m, strict=True):
                memory = pipeline.initial(own_params, Vec3(*position))
                vehicles.append((OwnLawRunner(law), memory))
            self._flights.append(vehicles)
        # number of each flight in the whole batch, before :meth:`keep` removed any
        self._numbers = list(range(len(self._flights)))

        # number of a flight -> why its first vehicle changed from the user's own law to Covey's law
        self.refusals: dict[int, str] = {}

    def step(
        self, states: Rows, goals: Rows, neighbours: Rows, is_present: BoolArray, dt_s: float
    ) -> Rows:
        """Return the ticks of all vehicles, see :class:`onboard.rollout.batch.Controller`."""
        routed_goals = self._routes.goals(states, goals, neighbours, is_present, dt_s)
        all_states = batch.STATE.values(states.ravel())
        all_goals = batch.GOAL.values(routed_goals.ravel())
        all_neighbours = neighbours.reshape(states.size, -1)
        all_present = is_present.reshape(states.size, -1)

        ticks = []
        for m in range(states.size):
            flight, vehicle = divmod(m, len(self._params))
            near = batch.NEIGHBOUR.values(all_neighbours[m][all_present[m]])

            law, memory = self._flights[flight][vehicle]
            memory, tick = pipeline.step(
                memory,
                all_states[m],
                all_goals[m],
                near,
                self._obstacles,
                ControlMode.FLYING,
                self._params[vehicle],
                dt_s,
                law_step=law.step,
            )
            self._flights[flight][vehicle] = (law, memory)
            ticks.append(tick)

            if law.refusal:
                self.refusals.setdefault(self._numbers[flight], law.refusal)
        return batch.TICK.packed(ticks).reshape(states.shape)

    def keep(self, flights: IntArray) -> None:
        """Keep only these flights of the batch, by index."""
        chosen = np.asarray(flights).tolist()
        self._flights = [self._flights[flight] for flight in chosen]
        self._numbers = [self._numbers[flight] for flight in chosen]
        self._routes.keep(flights)
