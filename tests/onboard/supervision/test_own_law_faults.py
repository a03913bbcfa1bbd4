"""What a vehicle does decides, too, whether a user's law goes on flying it."""

from __future__ import annotations

from pathlib import Path

import pytest

from onboard.config.fleet import load_fleet
from onboard.safety.failsafe_table import Condition
from onboard.safety.geofence import FenceBox, fence_of
from onboard.supervision.own_law_faults import fault_of_law

_PAPER = Path(__file__).parents[3] / "configs/fleets/paper.toml"


@pytest.fixture(scope="module")
def fence() -> FenceBox:
    fleet = load_fleet(_PAPER)
    return fence_of(fleet.fleet.geofence_m, fleet.vehicles["mav0"])


@pytest.mark.parametrize(
    ("condition", "words"),
    [
        (Condition.FENCE_BREACH, "cross the geofence"),
        (Condition.FENCE_BREACH_LONG, "cross the geofence"),
        (Condition.SEPARATION_BREACHED, "nearer"),
        (Condition.WIND_ABOVE, ""),
    ],
)
def test_a_law_is_at_fault_for_what_it_should_prevent(
    fence: FenceBox, condition: Condition, words: str
) -> None:
    fault = fault_of_law({condition}, fence, height_m=1.0, climb_m_s=0.0, below_m=0.0)
    assert words in fault
    assert bool(fault) == bool(words)


@pytest.mark.parametrize(
    ("height_m", "climb_m_s", "below_m", "is_at_fault"),
    [
        (1.0, -0.5, 0.5, False),
        (1.0, -2.5, 0.5, True),
        (1.0, -2.5, 0.1, False),  # it sinks as it was told
        (0.2, -0.2, 0.0, False),
        (0.3, 1.0, 0.5, False),
    ],
)
def test_a_law_that_sinks_is_refused_while_another_can_still_stop(
    fence: FenceBox, height_m: float, climb_m_s: float, below_m: float, is_at_fault: bool
) -> None:
    fault = fault_of_law((), fence, height_m=height_m, climb_m_s=climb_m_s, below_m=below_m)
    assert bool(fault) == is_at_fault
