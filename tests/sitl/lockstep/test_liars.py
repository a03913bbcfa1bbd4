"""A vehicle with a valid key that lies about itself, and avoids nobody: the others do not believe
it and keep away.
"""

from __future__ import annotations

import pytest

from onboard.control.pipeline import pipeline_params
from onboard.neighbours.plausibility import PlausibilityMonitor
from onboard.safety.failsafe_table import Condition
from sitl.lockstep.campaign.breaking import LIES
from sitl.lockstep.campaign.injections import INJECTIONS


def _crossing(lockstep, paper, lie: str):
    """Let mav1 lie while mav0 is sent across the place where it really is."""
    flight = lockstep(paper, seed=3)
    flight.takeoff(1.0)
    flight.order("move mav1 0.0 -0.6 1.0")
    flight.agents["mav1"].core.control.params = pipeline_params(paper.with_law("off"), "mav1")
    next(one for one in INJECTIONS if one.name == f"one lies: {lie}").inject(flight, "mav1")
    flight.run(1.0)
    flight.client.submit_now("move mav0 0.5 0.35 1.0")
    flight.run(4.0)
    return flight


@pytest.mark.failsafe("neighbour's word cannot be true", step="flying")
@pytest.mark.long
@pytest.mark.parametrize("lie", LIES)
def test_a_liar_is_named_and_kept_off(lockstep, paper, lie: str) -> None:
    flight = _crossing(lockstep, paper, lie)
    assert flight.min_separation_m > paper.fleet.safety_distance_m
    assert Condition.NEIGHBOUR_IMPLAUSIBLE in flight.agents["mav0"].core.failsafes.conditions
    told = [event.sentence for event in flight.events if event.code == "neighbour-implausible"]
    assert told
    assert all("(mav1 says" in sentence for sentence in told)
    assert "neighbour's word cannot be true" in flight.state.vehicles["mav0"].telemetry.conditions


@pytest.mark.long
def test_without_that_check_the_same_lie_ends_in_a_collision(lockstep, paper, monkeypatch) -> None:
    monkeypatch.setattr(PlausibilityMonitor, "update", lambda *_: None)
    flight = _crossing(lockstep, paper, "a metre beside")
    assert flight.min_separation_m < paper.fleet.body_diameter_m
