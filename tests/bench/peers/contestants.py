"""Contestants: Covey's law, the same without one of its ideas, the paper's ring, or a peer in the law's place.

The pipeline around the law, from the estimate to the attitude, is the product's own for all of them.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.avoidance import oist
from onboard.control import pipeline
from onboard.control.pipeline import PipelineParams
from onboard.rollout import batch
from onboard.rollout.rows import Rows
from onboard.vectors import Vec3
from tests.bench.peers import stage
from tests.bench.peers.encounter import Step
from tests.bench.peers.methods import METHODS, Method

_UNTIMED_CALLS = 5  # memory that is allocated or cached on first use is none of the method's cost


def same(values: Any) -> Any:
    """Nothing changed."""
    return values


@dataclass(frozen=True, slots=True)
class Contestant:
    """A law, or a peer in its place."""

    title: str
    law: str = "covey"  # the product's law whose parameters are taken
    sets: tuple[str, ...] = ()  # values of the fleet file, as ``covey simulate --set`` takes them
    change: Callable[[PipelineParams], PipelineParams] = same  # of the parameters after that
    step: Step | None = None  # a peer in the law's place
    values: Mapping[str, float] = field(default_factory=dict)  # of the peer
    hear: Callable[[Rows], Rows] = same  # of the neighbours' messages

    def controller(self, params: Sequence[PipelineParams], start_enu_m: Array) -> batch.Controller:
        """Return the control of a batch with this contestant in the law's place, compiled where that is possible."""
        if self.step is not None:
            return self.interpreted(params, start_enu_m)
        return HearingPipeline([self.change(own) for own in params], start_enu_m, self.hear)

    def interpreted(self, params: Sequence[PipelineParams], start_enu_m: Array) -> TimedPipeline:
        """Return the same control, interpreted, with a stop-watch around the law."""
        changed = [self.change(own) for own in params]
        return TimedPipeline(changed, start_enu_m, self.law_step(changed), self.hear)

    def law_step(self, params: Sequence[PipelineParams]) -> stage.LawStep:
        """Return what the pipeline of one vehicle is to call as ``oist.step``."""
        if self.step is None:
            return oist.step
        return stage.law_of(self.step, self.values, max(own.pursuit_speed_m_s for own in params))


class HearingPipeline(batch.FleetPipeline):
    """The product's pipelines, compiled, with other messages."""

    def __init__(self, params: Sequence[PipelineParams], start_enu_m: Array, hear: Callable[[Rows], Rows]) -> None:
        super().__init__(params, start_enu_m)
        self._hear = hear

    def step(self, states: Rows, goals: Rows, neighbours: Rows, is_present: BoolArray, dt_s: float) -> Rows:
        """Return the ticks of all vehicles."""
        return super().step(states, goals, self._hear(neighbours), is_present, dt_s)


class TimedPipeline:
    """Everybody's pipeline, interpreted vehicle by vehicle, with a stop-watch (of CPU time) around the law.

    Args:
        params: N of them. start_enu_m: (F, N, 3). law_step: in place of ``oist.step``. hear: of the neighbours.
    """

    def __init__(
        self,
        params: Sequence[PipelineParams],
        start_enu_m: Array,
        law_step: stage.LawStep,
        hear: Callable[[Rows], Rows],
    ) -> None:
        self._params, self._law_step, self._hear = params, law_step, hear
        self._memories = [
            [pipeline.initial(own, Vec3(*spot)) for own, spot in zip(params, flight, strict=True)]
            for flight in start_enu_m.tolist()
        ]
        self.busy_s, self.timed_calls = 0.0, -_UNTIMED_CALLS

    def step(self, states: Rows, goals: Rows, neighbours: Rows, is_present: BoolArray, dt_s: float) -> Rows:
        """Return the ticks of all vehicles, as rows like the compiled pipeline's."""
        shape = states.shape
        given = zip(batch.STATE.values(states.ravel()), batch.GOAL.values(goals.ravel()), strict=True)
        near = self._hear(neighbours).reshape(states.size, -1)
        present = is_present.reshape(states.size, -1)
        ticks = []
        with stage.in_place_of_the_law(self._timed):
            for m, (state, goal) in enumerate(given):
                flight, vehicle = divmod(m, shape[1])
                around = batch.NEIGHBOUR.values(near[m][present[m]])
                memory, own = self._memories[flight][vehicle], self._params[vehicle]
                memory, tick = pipeline.step(memory, state, goal, around, (), pipeline.Phase.FLYING, own, dt_s)
                self._memories[flight][vehicle] = memory
                ticks.append(tick)
        return batch.TICK.packed(ticks).reshape(shape)

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""
        self._memories = [self._memories[flight] for flight in np.asarray(flights).tolist()]

    def _timed(self, *inputs: Any) -> Any:
        begun = time.thread_time()
        result = self._law_step(*inputs)
        self.timed_calls += 1
        if self.timed_calls > 0:
            self.busy_s += time.thread_time() - begun
        return result


def peer(method: Method, values: Mapping[str, float] | None = None) -> Contestant:
    """A method of other people with its chosen values, or others to be tried."""
    return Contestant(method.title, step=method.step, values=method.chosen if values is None else values)


def combinations(grid: Mapping[str, Sequence[float]]) -> list[dict[str, float]]:
    """Every combination of a grid."""
    return [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]


RING_GRID = {"kappa": (1.0, 2.0, 4.0), "v_perp_m_s": (0.1, 0.4)}
RING_CHOSEN = {"kappa": 2.0, "v_perp_m_s": 0.1}


def ring(values: Mapping[str, float] = RING_CHOSEN) -> Contestant:
    """The paper's law as printed: each avoids the next one. ``kappa`` is kappa_1 and kappa_2."""
    kappa, v_perp = values["kappa"], values["v_perp_m_s"]
    changed = {"force_ring": "true", "kappa_1_1_s": kappa, "kappa_2_1_s": kappa, "v_perp_m_s": v_perp}

    def with_margin(params: PipelineParams) -> PipelineParams:  # d_inf is the design distance, as for everybody
        spacing = params.law.spacing
        d_design_m = spacing.safety_distance_m + spacing.margin_m
        return params._replace(law=params.law._replace(paper=params.law.paper._replace(d_inf_m=d_design_m)))

    sets = tuple(f"law.paper_{key}={value}" for key, value in changed.items())
    return Contestant("the paper's ring", law="paper", sets=sets, change=with_margin, values=values)


COVEY = Contestant("Covey")
PEERS = {"covey": COVEY, "off": peer(METHODS["off"]), "ring": ring()} | {
    name: peer(method) for name, method in METHODS.items() if name != "off"
}
