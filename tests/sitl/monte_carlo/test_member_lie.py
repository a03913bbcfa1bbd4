"""Lies of one member: whom they move, whom they are judged by, and the search for the worst."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sitl.monte_carlo import batch_flight, campaign_settings, scenarios
from sitl.monte_carlo.lie_search import search
from sitl.monte_carlo.member_lie import LieKind, MemberLie, MemberLies

LIE = MemberLie(
    member=1,
    kind="lie",
    start_s=1.0,
    lasts_s=5.0,
    size_m=2.0,
    direction_rad=0.0,
    rise_s=1.0,
    swings_hz=0.0,
)


def _plan(kind: LieKind | None) -> scenarios.FlightPlan:
    plan = scenarios.plan("swap3x", 3)
    if kind is None:
        return plan
    return replace(plan, lie=LIE._replace(kind=kind))


def test_an_offset_rises_stays_and_ends_for_the_liar_only() -> None:
    lies = MemberLies([_plan("lie"), _plan(None)])
    for time_s, expected_m in ((0.9, 0.0), (1.5, 1.0), (3.0, 2.0), (6.1, 0.0)):
        offset_m, _ = lies.offsets(time_s)
        assert offset_m[0, 1, 0] == pytest.approx(expected_m, abs=0.05)
        assert not offset_m[0, [0, 2]].any()
        assert not offset_m[1].any()


@pytest.mark.long
def test_only_the_distances_of_the_others_are_judged() -> None:
    setup = campaign_settings.setup_for(law="off", changes=["delay_s=0.02"])
    honest, lying = (batch_flight.fly([_plan(kind)], setup)[0].outcome for kind in (None, "lie"))
    # without a law all fly straight: the pair of the others is farther apart than the closest one
    assert lying.min_separation_m > honest.min_separation_m


def test_who_is_spoofed_flies_elsewhere_and_who_lies_does_not() -> None:
    setup = campaign_settings.setup_for(law="off")
    ends = {}
    for kind in (None, "lie", "spoof"):
        plan = _plan(kind)
        if plan.lie is not None:
            plan = replace(plan, lie=plan.lie._replace(lasts_s=100.0))
        trace = batch_flight.fly([plan], setup, has_trace=True)[0].outcome.trace
        assert trace is not None
        ends[kind] = trace.position_enu_m[-1, 1]
    honest = ends[None]
    assert np.linalg.norm(ends["lie"] - honest) < 0.2
    assert np.linalg.norm(ends["spoof"] - honest) > 1.0


@pytest.mark.long
@pytest.mark.timeout(1200)
def test_the_search_finds_worse_than_chance_and_nobody_else_is_touched() -> None:
    report = search(campaign_settings.setup_for(), tries=1000)
    assert report.tries >= 1000
    assert min(found.others_m for found in report.worst.values()) < report.random_m
    assert report.is_right, report.lines
