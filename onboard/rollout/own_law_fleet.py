"""Runs the pipelines of many vehicles with a user's own law.

The user's law is called vehicle by vehicle; everything else is computed for all vehicles at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.avoidance.interface import INFEASIBLE
from onboard.avoidance.own_law import LawInputs, law_inputs
from onboard.avoidance.own_law_runner import OwnLawRunner
from onboard.avoidance.params import Capsule
from onboard.config.fleet import OwnLaw
from onboard.control import pipeline
from onboard.control.control_mode import ControlMode
from onboard.rollout import batch, layouts
from onboard.rollout.fleet_routes import FleetRoutes
from onboard.rollout.rows import Layout, Rows


class OwnLawFleet:
    """The pipelines of all vehicles with a user's own law.

    It implements :class:`onboard.rollout.batch.Controller`.

    Args:
        law: the law that the fleet file names.
        params: parameters of the N vehicles.
        start_enu_m: positions (F, N, 3) at which the vehicles hover [m].
        obstacles: static obstacles, the same for all.
        is_flown: (F, N) whether the law flies a vehicle; None: it flies all. It is not called for
            the other vehicles, and their ticks are those of Covey's law.
    """

    def __init__(
        self,
        law: OwnLaw,
        params: Sequence[pipeline.PipelineParams],
        start_enu_m: Array,
        obstacles: Sequence[Capsule] = (),
        is_flown: BoolArray | None = None,
    ) -> None:
        self._params = params
        self._obstacles = tuple(obstacles)
        self._params_rows = layouts.PARAMS.packed(params)
        self._obstacle_rows = layouts.OBSTACLE.packed(obstacles)
        self._memories = batch.hovering(params, start_enu_m)
        self._routes = FleetRoutes(len(start_enu_m), params, obstacles)

        # Covey's law is computed beside the user's law; see OwnLawRunner
        self._relaxed_shares = np.zeros(start_enu_m.shape[:2])

        if is_flown is None:
            is_flown = np.ones(start_enu_m.shape[:2], bool)
        self._is_flown = is_flown
        self._law_name = law.name
        # for each flight: the law of each vehicle
        self._runners = [[OwnLawRunner(law) for _ in params] for _ in start_enu_m]
        # number of each flight in the whole batch, before :meth:`keep` removed any
        self._numbers = list(range(len(start_enu_m)))

        # number of a flight -> name of the user's own law, and why the first vehicle that it flew
        # changed to Covey's law
        self.refusals: dict[int, str] = {}

    def step(
        self, states: Rows, goals: Rows, neighbours: Rows, is_present: BoolArray, dt_s: float
    ) -> Rows:
        """Return the ticks of all vehicles, see :class:`onboard.rollout.batch.Controller`."""
        routed_goals = self._routes.goals(states, goals, neighbours, is_present, dt_s)
        inputs = batch.PassRows(
            states=states,
            goals=routed_goals,
            neighbours=neighbours,
            is_present=is_present,
            modes=np.full(states.shape, int(ControlMode.FLYING)),
        )
        before = batch.before_own_law(
            self._memories,
            self._relaxed_shares,
            inputs,
            self._obstacle_rows,
            self._params_rows,
            dt_s,
        )
        thrusts_enu_m_s2, is_own = self._answers(inputs, before, dt_s)
        return batch.after_own_law(
            self._memories,
            self._relaxed_shares,
            before,
            thrusts_enu_m_s2,
            is_own,
            inputs,
            self._params_rows,
            dt_s,
        )

    def keep(self, flights: IntArray) -> None:
        """Keep only these flights of the batch, by index."""
        chosen = np.asarray(flights).tolist()
        self._memories = self._memories[flights]
        self._relaxed_shares = self._relaxed_shares[flights]
        self._is_flown = self._is_flown[flights]
        self._runners = [self._runners[flight] for flight in chosen]
        self._numbers = [self._numbers[flight] for flight in chosen]
        self._routes.keep(flights)

    def _answers(
        self, inputs: batch.PassRows, before: batch.BeforeOwnLaw, dt_s: float
    ) -> tuple[Array, BoolArray]:
        """Call the user's law for each vehicle that it flies.

        Returns:
            Thrusts (F, N, 3), NaN where Covey's thrust is flown, and whether the user's law still
            flies each vehicle (F, N).
        """
        thrusts_enu_m_s2 = np.full((*inputs.states.shape, 3), np.nan)
        is_own = np.zeros(inputs.states.shape, bool)
        is_usable = before.covey["output"]["status"] != INFEASIBLE
        law_inputs_of_all = self._law_inputs(inputs, before, dt_s)

        for flight, runners in enumerate(self._runners):
            for vehicle, runner in enumerate(runners):
                own_inputs = next(law_inputs_of_all)
                if runner.refusal or not self._is_flown[flight, vehicle]:
                    continue
                if is_usable[flight, vehicle]:
                    thrust = runner.answer(own_inputs)
                    if thrust is not None:
                        thrusts_enu_m_s2[flight, vehicle] = thrust
                if runner.refusal:
                    refusal = f"{self._law_name} {runner.refusal}"
                    self.refusals.setdefault(self._numbers[flight], refusal)
                is_own[flight, vehicle] = not runner.refusal
        return thrusts_enu_m_s2, is_own

    def _law_inputs(
        self, inputs: batch.PassRows, before: batch.BeforeOwnLaw, dt_s: float
    ) -> Iterator[LawInputs]:
        """Yield the inputs of the user's law of each vehicle."""
        states = layouts.STATE.values(inputs.states.ravel())
        views = layouts.OWN_LAW_VIEW.values(before.views.ravel())
        received = _values_of_each(layouts.NEIGHBOUR, inputs.neighbours, inputs.is_present)

        numbers = np.arange(before.neighbours.shape[-1])
        is_near = numbers < before.neighbour_counts[..., None]
        near = _values_of_each(layouts.LAW_NEIGHBOUR, before.neighbours, is_near)

        for m, (state, view) in enumerate(zip(states, views, strict=True)):
            yield law_inputs(
                view.own,
                near[m],
                view.baseline,
                view.predicted,
                state,
                received[m],
                self._obstacles,
                self._params[m % len(self._params)].law,
                dt_s,
            )


def _values_of_each(layout: Layout, rows: Rows, is_chosen: BoolArray) -> list[list[Any]]:
    """Return the values of the chosen rows (F, N, K) for each of the F N vehicles."""
    values = iter(layout.values(rows[is_chosen]))
    counts = is_chosen.sum(axis=-1).ravel().tolist()
    return [list(islice(values, count)) for count in counts]
