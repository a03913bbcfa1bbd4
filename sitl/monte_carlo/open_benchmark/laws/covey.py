"""Covey's law with the interface of a user's own law.

It serves for timing, and shows that the interface passes everything that a law needs.
"""

from __future__ import annotations

from onboard.avoidance import interface, oist
from onboard.avoidance.own_law import LawInputs
from onboard.types import Thrust


def law(memory: oist.LawMemory | None, inputs: LawInputs) -> tuple[oist.LawMemory, Thrust]:
    """Return the thrust of the law that the parameters of the vehicle name."""
    baseline = interface.Baseline(
        inputs.baseline, inputs.compensation_enu_m_s2, inputs.intent_enu_m_s
    )
    if memory is None:
        memory = oist.initial()
    memory, output = oist.step(
        memory,
        baseline,
        inputs.predicted,
        inputs.state,
        inputs.received,
        inputs.obstacles,
        inputs.vehicle,
        inputs.dt_s,
    )
    return memory, output.thrust
