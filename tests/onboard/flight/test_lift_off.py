"""A take-off leaves the ground as fast to any height: near it a vehicle leans little."""

from __future__ import annotations

import pytest

from onboard.flight.types import FlightStep
from tests.onboard.agent.rig import ready_rig


def _lift_off_s(height_m: float) -> float:
    """Return how long lifting off takes on the way to a height [s]."""
    rig = ready_rig()
    rig.order("takeoff", height_m=height_m)
    for _ in range(400):
        if rig.core.flight.step is FlightStep.LIFTOFF:
            break
        rig.step()

    began_ns = rig.now_ns
    for _ in range(400):
        if rig.core.flight.step is not FlightStep.LIFTOFF:
            break
        rig.step()
    lift_off_s = 1e-9 * (rig.now_ns - began_ns)
    assert rig.core.flight.step is FlightStep.CLIMB
    rig.run(2.0)
    assert rig.core.flight.goal_position_enu_m[2] == pytest.approx(height_m)
    return lift_off_s


def test_lifting_off_takes_as_long_to_any_height() -> None:
    low_s = _lift_off_s(1.0)
    assert low_s < 1.5
    assert _lift_off_s(2.5) == pytest.approx(low_s, abs=0.1)
