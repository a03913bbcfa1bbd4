"""Contestants: Covey's law, the same without one of its ideas, the paper's ring, or a peer in the law's place.

The pipeline around the law, from the estimate to the attitude, is the product's own for all of them.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

from onboard.avoidance import oist
from onboard.control import pipeline
from onboard.control.pipeline import PipelineParams
from onboard.rollout import batch
from onboard.types import Array, Goal, LawOutput, Neighbours, State, Thrust, Tick
from tests.bench.peers import stage
from tests.bench.peers.encounter import Step
from tests.bench.peers.methods import METHODS, Method

_UNTIMED_CALLS = 5  # what is compiled or cached on first use is none of the method's cost
_STAGE = "oist"  # the name under which the pipeline knows the law's module


def same(values: Any) -> Any:
    """Nothing changed."""
    return values


@dataclass(frozen=True, slots=True)
class Contestant:
    """Controller that flies a vehicle.

    law: the product's law whose parameters are taken. sets: values of the fleet file, as ``covey simulate --set`` takes
    them. change: of the parameters after that. step, values: a peer in the law's place. hear: of what neighbours say.
    """

    title: str
    law: str = "covey"
    sets: tuple[str, ...] = ()
    change: Callable[[PipelineParams], PipelineParams] = same
    step: Step | None = None
    values: Mapping[str, float] = field(default_factory=dict)
    hear: Callable[[Neighbours], Neighbours] = same

    def controller(self, params: Sequence[PipelineParams], start_enu_m: Array) -> TimedPipeline:
        """Flies a batch with this contestant in the law's place."""
        return TimedPipeline([self.change(own) for own in params], start_enu_m, self)


class TimedPipeline(batch.FleetPipeline):
    """Everybody's pipeline with the contestant's law in it, and a stop-watch (of CPU time) around the law."""

    def __init__(self, params: Sequence[PipelineParams], start_enu_m: Array, contestant: Contestant) -> None:
        super().__init__(params, start_enu_m)
        self.contestant, self.law = contestant, _Law(contestant, max(own.pursuit_speed_m_s for own in params))

    def step(self, state: State, goal: Goal, neighbours: Neighbours, *, dt_s: float) -> Tick:
        """One tick of everybody."""
        with _in_place_of_the_law(self.law):
            return super().step(state, goal, self.contestant.hear(neighbours), dt_s=dt_s)


@contextmanager
def _in_place_of_the_law(law: _Law) -> Iterator[None]:
    """The pipeline calls ``law`` where it calls ``oist`` otherwise, and no pass that has the law compiled in."""
    whole_pass = pipeline.fused
    setattr(pipeline, _STAGE, law)
    pipeline.fused = _StageByStage  # type: ignore[assignment]
    try:
        yield
    finally:
        setattr(pipeline, _STAGE, oist)
        pipeline.fused = whole_pass


class _StageByStage:
    """In place of the module ``onboard.control.fused``: nothing is for its way."""

    @staticmethod
    def step(*_inputs: Any, **_options: Any) -> None:
        return None


class _Law:
    """The module ``onboard.avoidance.oist`` with another ``saturate``."""

    def __init__(self, contestant: Contestant, speed_m_s: float) -> None:
        self.contestant, self.speed_m_s = contestant, speed_m_s
        self.busy_s, self.vehicle_steps, self.calls = 0.0, 0, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(oist, name)

    def saturate(
        self,
        memory: oist.LawMemory,
        thrust_baseline: Thrust,
        predicted: tuple[Array, Array],
        state: State,
        neighbours: Neighbours,
        **options: Any,
    ) -> tuple[oist.LawMemory, LawOutput]:
        """As the law's own."""
        inputs = (memory, thrust_baseline, predicted, state, neighbours)
        begun = time.thread_time()
        if self.contestant.step is None:
            result = oist.saturate(*inputs, **options)
            ended = time.thread_time()
        else:
            answer = stage.answer(self.contestant.step, self.contestant.values, inputs, options, self.speed_m_s)
            ended = time.thread_time()
            result = stage.sent(answer, inputs, options)
        self.calls += 1
        if self.calls > _UNTIMED_CALLS:
            self.busy_s += ended - begun
            self.vehicle_steps += result[1].status.size
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
        return replace(params, law=replace(params.law, safety_distance_m=params.law.d_design_m))

    sets = tuple(f"law.paper_{key}={value}" for key, value in changed.items())
    return Contestant("the paper's ring", law="paper", sets=sets, change=with_margin, values=values)


COVEY = Contestant("Covey")
PEERS = {"covey": COVEY, "off": peer(METHODS["off"]), "ring": ring()} | {
    name: peer(method) for name, method in METHODS.items() if name != "off"
}
