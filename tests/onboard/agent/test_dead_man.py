"""Setpoints leave only for a position and attitude known now, and never again once PX4 has begun to
land.
"""

from __future__ import annotations

import itertools

import pytest

from onboard import agent_commands, agent_inputs
from onboard.safety.failsafe_table import Condition
from tests.onboard.agent.rig import DT_NS, Rig, hovering_rig

LOSS_NS = 300_000_000


def flying() -> Rig:
    rig = hovering_rig()
    rig.run(2.0)
    return rig


def setpoints(rig: Rig, since_ns: int) -> list[int]:
    return [
        stamp - since_ns
        for stamp, command in rig.sent
        if isinstance(command, agent_commands.SendAttitude) and stamp > since_ns
    ]


def test_no_setpoint_leaves_100_ms_after_px4_was_heard_last() -> None:
    rig = flying()
    rig.has_autopilot = False  # or the thread that hears it hangs
    begin_ns = rig.now_ns
    rig.run(1.0)
    assert max(setpoints(rig, begin_ns)) <= 100_000_000


def test_a_short_gap_in_what_px4_says_ends_by_itself() -> None:
    rig = flying()
    rig.has_autopilot = False
    rig.run(0.2)
    rig.has_autopilot = True
    begin_ns = rig.now_ns
    rig.run(1.0)
    assert len(setpoints(rig, begin_ns)) == 50
    assert rig.core.flight.state in ("flying", "holding")


@pytest.mark.parametrize("stall_ms", [310, 400, 700, 1100, 5000])
def test_after_a_stall_in_which_px4_began_to_land_it_is_left_to_land(stall_ms: int) -> None:
    rig = flying()
    rig.now_ns += stall_ms * 1_000_000 - DT_NS
    rig.mode = "LAND"  # COM_OF_LOSS_T is over; the next heartbeat will say so within a second
    begin_ns = rig.now_ns
    rig.run(1.5)
    assert setpoints(rig, begin_ns) == []
    assert rig.count(agent_commands.SetOffboard, begin_ns) == 0
    rig.until("landed")


@pytest.mark.parametrize("order", ["", "move"])
def test_a_ground_whose_link_a_stall_has_broken_learns_why_px4_lands(order: str) -> None:
    rig = flying()
    if order:
        assert rig.order("move", position_enu_m=(0.5, 0.0, 1.0)).is_accepted
    rig.now_ns += 1200 * 1_000_000 - DT_NS
    rig.mode = "LAND"
    rig.step()  # the links broke meanwhile: nobody hears this tick
    rig.events.clear()
    rig.core.handle(agent_inputs.NodeChanged("ground-1", False), rig.now_ns)
    rig.run(0.5)
    rig.core.handle(agent_inputs.NodeChanged("ground-1", True), rig.now_ns)

    rig.run(0.2)
    assert rig.telemetry is not None
    assert Condition.LOOP_STALLED_LONG.value in rig.telemetry.conditions
    assert "loop-stalled-long" not in [event.code for event in rig.events]

    rig.run(1.0)
    (told,) = [event for event in rig.events if event.severity == "critical"]
    assert told.sentence == "Loop stalled for long: PX4 lands."

    rig.until("landed")
    rig.run(0.2)
    assert Condition.LOOP_STALLED_LONG.value not in rig.telemetry.conditions


@pytest.mark.parametrize("gap_ms", [300, 320, 340, 360, 380, 400, 420, 440, 600])
def test_no_gap_between_setpoints_is_longer_than_px4_waits(gap_ms: int) -> None:
    rig = flying()
    rig.has_autopilot = False
    begin_ns = rig.now_ns
    rig.run(gap_ms * 1e-3)
    rig.has_autopilot = True
    rig.run(2.0)
    sent = [0, *setpoints(rig, begin_ns)]
    gaps_ns = [later - earlier for earlier, later in itertools.pairwise(sent)]
    assert max(gaps_ns) <= LOSS_NS + DT_NS
    if rig.core.flight.state not in ("flying", "holding"):
        assert any(event.severity == "critical" for event in rig.events), "the record must tell why"


def test_a_stall_that_px4_did_not_notice_ends_in_a_hold() -> None:
    rig = flying()
    rig.now_ns += 250_000_000 - DT_NS
    begin_ns = rig.now_ns
    rig.run(1.0)
    assert len(setpoints(rig, begin_ns)) >= 49
    assert rig.core.flight.state == "holding"
