"""Between a law's inputs and a method of somebody else: one vehicle's encounter, and its answer as
a law gives it.

Methods fly through the door for everybody's own law (docs/own-law.md). Those with their chosen
values have names there: ``covey simulate swap8 --law tests.bench.peers.laws:orca``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from onboard.avoidance.own_law import LawInputs
from onboard.types import Thrust
from sitl.monte_carlo.open_benchmark.laws.covey import law as covey_law
from tests.bench.peers.encounter import Encounter, Step

Law = Callable[[Any, LawInputs], tuple[Any, Thrust]]
covey: Law = covey_law  # Covey's own law, as anybody else's
_PURSUIT_SHARE = 1.25  # of the top speed, which the pipeline's pursuit may fly
_UNTIMED_CALLS = 5  # memory that is allocated or cached on first use is none of the method's cost


def encounter_of(inputs: LawInputs) -> Encounter:
    """One vehicle with its nearest neighbours as Covey's law would have them; there must be one at
    least.
    """
    near = inputs.neighbours
    ages_s = {one.table_index: one.age_s for one in inputs.received}
    return Encounter(
        wanted_m_s2=np.array([inputs.baseline.thrust_enu_m_s2[:2]]),
        velocity_m_s=np.array([inputs.predicted.velocity_enu_m_s[:2]]),
        gap_m=np.array([[one.e_m for one in near]]),
        closing_m_s=np.array([[one.w_m_s for one in near]]),
        is_on=np.ones((1, len(near)), bool),
        reach_m_s2=np.array([inputs.largest_m_s2]),
        d_m=np.array([[one.d_m for one in near]]),
        speed_m_s=_PURSUIT_SHARE * inputs.vehicle.max_speed_m_s,
        age_s=np.array([[ages_s[one.table_index] for one in near]]),
    )


def law_of(step: Step, values: Mapping[str, float]) -> Law:
    """A method as a law; its answer is shortened to what the vehicle can fly."""

    def law(memory: Any, inputs: LawInputs) -> tuple[Any, Thrust]:
        if not inputs.neighbours:
            return None, inputs.baseline
        x, y = step(encounter_of(inputs), values)[0]
        return None, inputs.limited(float(x), float(y))

    return law


class Timed:
    """A law with a stop-watch of processor time."""

    def __init__(self, law: Law) -> None:
        self._law = law
        self.busy_s = 0.0
        self.calls = -_UNTIMED_CALLS

    def __call__(self, memory: Any, inputs: LawInputs) -> tuple[Any, Thrust]:
        """Return the law's answer."""
        begun_s = time.thread_time()
        answer = self._law(memory, inputs)
        self.calls += 1
        if self.calls > 0:
            self.busy_s += time.thread_time() - begun_s
        return answer
