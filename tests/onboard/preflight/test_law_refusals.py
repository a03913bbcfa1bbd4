"""The findings about a fleet file that refuse a take-off are ready before the first tick."""

from __future__ import annotations

import pytest

from onboard.agent.warm_up import warm_up
from onboard.config.fleet import load_fleet
from onboard.preflight import law_refusals


def test_after_the_warm_up_the_whole_fleet_needs_no_check_in_a_tick(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fleet = load_fleet("paper")
    law_refusals._cache.clear()
    assert warm_up(fleet, "mav0")

    def in_a_tick(*_: object) -> None:
        raise AssertionError("the fleet is checked in a tick")

    monkeypatch.setattr(law_refusals, "fleet_findings", in_a_tick)
    assert law_refusals.refusals_of_fleet(fleet) == ()
