"""Many vehicles in flight by a law of somebody's own: interpreted, vehicle by vehicle."""

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
from onboard.rollout.rows import Rows
from onboard.vectors import Vec3


class OwnLawFleet:
    """The pipelines of all vehicles with that law: a :class:`onboard.rollout.batch.Controller`.

    Args:
        law: that the fleet file names.
        params: N of them.
        start_enu_m: (F, N, 3), where the vehicles hover [m].
        obstacles: the same for all.
    """

    def __init__(
        self,
        law: OwnLaw,
        params: Sequence[pipeline.PipelineParams],
        start_enu_m: Array,
        obstacles: Sequence[Capsule] = (),
    ) -> None:
        self._params, self._obstacles = params, tuple(obstacles)
        self._flights = [
            [
                (OwnLawRunner(law), pipeline.initial(own, Vec3(*spot)))
                for own, spot in zip(params, spots, strict=True)
            ]
            for spots in start_enu_m.tolist()
        ]
        self._numbers = list(range(len(self._flights)))
        # number of a flight -> why its first vehicle went on by Covey's law
        self.refusals: dict[int, str] = {}

    def step(
        self, states: Rows, goals: Rows, neighbours: Rows, is_present: BoolArray, dt_s: float
    ) -> Rows:
        """Return the ticks of all vehicles, see :class:`onboard.rollout.batch.Controller`."""
        count = len(self._params)
        own = zip(batch.STATE.values(states.ravel()), batch.GOAL.values(goals.ravel()), strict=True)
        near = neighbours.reshape(states.size, -1)
        present = is_present.reshape(states.size, -1)
        ticks = []
        for m, (state, goal) in enumerate(own):
            flight, vehicle = divmod(m, count)
            around = batch.NEIGHBOUR.values(near[m][present[m]])
            law, memory = self._flights[flight][vehicle]
            memory, tick = pipeline.step(
                memory,
                state,
                goal,
                around,
                self._obstacles,
                ControlMode.FLYING,
                self._params[vehicle],
                dt_s,
                law_step=law.step,
            )
            self._flights[flight][vehicle] = law, memory
            ticks.append(tick)
            if law.refusal:
                self.refusals.setdefault(self._numbers[flight], law.refusal)
        return batch.TICK.packed(ticks).reshape(states.shape)

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""
        chosen = np.asarray(flights).tolist()
        self._flights = [self._flights[flight] for flight in chosen]
        self._numbers = [self._numbers[flight] for flight in chosen]
