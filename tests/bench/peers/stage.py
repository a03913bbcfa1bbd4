"""Between the law's inputs and a peer: one vehicle's encounter, and its answer under the same limits as the law's."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from onboard.avoidance import interface, oist, pairs
from onboard.avoidance.params import OFF, LawParams
from onboard.types import LawOutput, LawStatus, Thrust
from onboard.vectors import Vec3
from tests.bench.peers.encounter import Array, Encounter, Step

LawStep = Callable[..., tuple[oist.LawMemory, LawOutput]]


def encounter_of(baseline: interface.Baseline, own: pairs.Own, found: pairs.Pairs, speed_m_s: float) -> Encounter:
    """One vehicle with its nearest neighbours as the law would have them; there must be one at least."""
    x, y, _ = baseline.thrust.thrust_enu_m_s2
    return Encounter(
        wanted_m_s2=np.array([[x, y]]),
        velocity_m_s=np.array([own.velocity_m_s]),
        gap_m=np.array([[pair.e for pair in found.pairs]]),
        closing_m_s=np.array([[pair.w for pair in found.pairs]]),
        is_on=np.ones((1, len(found.pairs)), bool),
        reach_m_s2=np.array([own.radius_m_s2]),
        d_m=np.array([[pair.d_m for pair in found.pairs]]),
        speed_m_s=speed_m_s,
    )


def law_of(step: Step, values: Mapping[str, float], speed_m_s: float) -> LawStep:
    """A peer with the signature of ``oist.step``; its answer passes the law's own limits, memory and output."""
    original = oist.step

    def law_step(
        memory: Any, baseline: Any, predicted: Any, state: Any, neighbours: Any, obstacles: Any, params: LawParams,
        dt_s: float,
    ) -> tuple[oist.LawMemory, LawOutput]:  # fmt: skip
        own = interface.own_at(baseline, predicted, state, params)
        found = pairs.nearest_pairs(own, neighbours, params)
        x, y, z = baseline.thrust.thrust_enu_m_s2
        answer: Array = np.array([x, y])
        if found.pairs:
            answer = step(encounter_of(baseline, own, found, speed_m_s), values)[0]
        changed = baseline._replace(thrust=Thrust(Vec3(float(answer[0]), float(answer[1]), z)))
        off = params._replace(law=OFF)
        memory, output = original(memory, changed, predicted, state, neighbours, obstacles, off, dt_s)
        command = output.commanded_acceleration_enu_m_s2
        change = float(np.hypot(command.x - x, command.y - y))
        is_changed = change > 1e-9 and output.status == LawStatus.INACTIVE
        status = int(LawStatus.SATURATED) if is_changed else output.status
        return memory, output._replace(intervention_m_s2=change, status=status)

    return law_step


@contextmanager
def in_place_of_the_law(step: LawStep) -> Iterator[None]:
    """Let the interpreted pipeline call ``step`` where it calls ``oist.step`` otherwise."""
    original = oist.step
    oist.step = step
    try:
        yield
    finally:
        oist.step = original
