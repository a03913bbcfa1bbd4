"""A start can be stopped at every moment by land, hold and disarm; nothing arms or lifts off
afterwards.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from onboard import agent_commands, agent_inputs
from onboard.bus.schema import OrderKind
from onboard.flight.types import FlightStep
from tests.onboard.agent.rig import Rig, hovering_rig, ready_rig

STOPS: tuple[OrderKind, ...] = ("land", "hold", "disarm")


def _in_step(step: FlightStep, start: OrderKind = "takeoff") -> Rig:
    rig = ready_rig()
    rig.order(start, order_id="start", **({"height_m": 1.0} if start == "takeoff" else {}))
    for _ in range(400):
        if rig.core.flight.step is step:
            return rig
        rig.step()
    raise AssertionError(f"{step.name} was not reached")


def _starts() -> Iterator[tuple[FlightStep, OrderKind]]:
    yield from (
        (step, "takeoff") for step in (FlightStep.TAKEOFF_OFFBOARD, FlightStep.TAKEOFF_ARMING)
    )
    yield from ((step, "arm") for step in (FlightStep.ARM_OFFBOARD, FlightStep.ARM_ARMING))


@pytest.mark.long
def test_land_hold_and_disarm_each_end_a_start_that_is_not_armed_yet() -> None:
    for step, start in _starts():
        for kind in STOPS:
            for ticks in (0, 25):
                rig = _in_step(step, start)
                rig.run(0.02 * ticks)
                reply = rig.order(kind, order_id="stop")
                assert reply.is_accepted, (step.name, kind, reply.reason)
                stopped_ns = rig.now_ns
                rig.run(3.0)
                case = step.name, kind, ticks
                assert not rig.is_armed, case
                assert not rig.has_flown, case
                assert (
                    rig.count(agent_commands.Arm, stopped_ns)
                    == rig.count(agent_commands.SetOffboard, stopped_ns)
                    == 0
                ), case
                assert rig.outcomes()["start"] == "superseded", case
                assert rig.outcomes()["stop"] == "done", case
                assert rig.core.flight.state == "ready", case


def test_an_arming_that_was_on_its_way_is_disarmed_before_the_order_to_stop_ends() -> None:
    rig = _in_step(FlightStep.TAKEOFF_ARMING)
    rig.is_armed = False
    rig.run(0.02)
    rig.order("land", order_id="stop")
    rig.is_armed = True  # PX4 executes the arming late; the first order to disarm was lost
    rig.run(1.0)
    assert "stop" not in rig.outcomes()
    rig.run(4.0)
    assert not rig.is_armed
    assert rig.outcomes()["stop"] == "done"


def test_an_arming_that_was_on_its_way_is_disarmed_after_a_failsafe_as_well() -> None:
    rig = _in_step(FlightStep.TAKEOFF_ARMING)
    rig.is_armed = False
    rig.run(0.02)
    rig.core.handle(agent_inputs.NodeChanged("ground-1", False), rig.now_ns)
    rig.run(0.12)
    assert rig.core.flight.step is FlightStep.FAILSAFE_DISARMING

    rig.take([agent_commands.RequestHeartbeat()])  # PX4 says: disarmed
    rig.run(0.02)
    rig.is_armed = True  # it executes the arming late
    rig.run(4.0)
    assert not rig.is_armed
    assert not rig.has_flown


@pytest.mark.long
def test_land_and_hold_during_lift_off_land() -> None:
    for kind in ("land", "hold"):
        for seconds in (0.0, 0.3):
            rig = _in_step(FlightStep.LIFTOFF)
            rig.run(seconds)
            if rig.core.flight.step is not FlightStep.LIFTOFF:
                continue
            assert rig.order(kind, order_id="stop").is_accepted, kind
            highest_m = 0.0
            for _ in range(600):
                rig.step()
                highest_m = max(highest_m, float(rig.position[2]))
            assert highest_m < 0.3, (kind, seconds)
            assert not rig.is_armed, (kind, seconds)
            assert rig.outcomes()["stop"] == "done", (kind, seconds)


@pytest.mark.long
@pytest.mark.parametrize("ticks", range(0, 60, 6))
def test_disarm_after_lift_off_lands_at_once_and_the_answer_says_so(ticks: int) -> None:
    rig = _in_step(FlightStep.LIFTOFF)
    for _ in range(100):
        if rig.position[2] > 0.005:
            break
        rig.step()
    rig.has_flown = True  # PX4 does not report the ground any more
    rig.run(0.02 * (1 + ticks))
    before_m = float(rig.position[2])
    reply = rig.order("disarm", order_id="stop")
    assert reply.is_accepted, before_m
    assert reply.reason == "It has left the ground: it lands at once, and is disarmed there."
    highest_m = before_m
    for _ in range(600):
        rig.step()
        highest_m = max(highest_m, float(rig.position[2]))
    assert highest_m < before_m + 0.3
    assert not rig.is_armed
    ends = [event for event in rig.events if event.order_id == "stop"]
    assert [event.order_outcome for event in ends] == ["done"]
    assert ends[0].sentence == "It had left the ground and landed at once. Landed and disarmed."


def test_disarm_acts_on_confirmed_ground_and_is_refused_in_the_air() -> None:
    rig = _in_step(FlightStep.LIFTOFF)
    assert rig.order("disarm", order_id="stop").is_accepted
    rig.run(6.0)
    assert not rig.is_armed
    assert rig.outcomes()["stop"] == "done"
    rig = hovering_rig()
    for _ in range(30):
        rig.core.handle(agent_inputs.TickFailed("broken"), rig.now_ns)
        rig.step()
    assert rig.core.flight.step is FlightStep.PX4_LANDING
    assert not rig.order("disarm").is_accepted
    rig = hovering_rig()
    assert not rig.order("disarm").is_accepted
