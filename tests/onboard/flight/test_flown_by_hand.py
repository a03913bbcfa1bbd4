"""A pilot who flies by hand: who may land him, and who may not."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from onboard import agent_commands, agent_inputs
from onboard.autopilot import PILOT_MODES
from onboard.bus.schema import BY_MISSION, TO_EVERYBODY, OrderKind
from onboard.flight.types import FlightStep
from tests.onboard.agent.rig import Rig, copied, hovering_rig, ready_rig
from tests.onboard.flight.test_takeover import Held

PILOTS = ("POSCTL", "ALTCTL", "STABILIZED")
REASONS = (BY_MISSION, TO_EVERYBODY)


@functools.cache
def _holding() -> Rig:
    """A vehicle that holds at 1 m."""
    rig = Held()
    rig.fly()
    return rig


def _taken(mode: str, has_sticks: bool = True) -> Rig:
    """A pilot has taken a vehicle that held at 1 m."""
    rig = copied(_holding())
    rig.mode = mode
    rig.has_sticks = has_sticks
    rig.run(1.5)
    assert rig.core.flight.state == "failed"
    return rig


@pytest.mark.failsafe("flown by hand", step="flying")
@pytest.mark.parametrize("mode", sorted(PILOT_MODES))
def test_a_pilot_with_sticks_is_told_apart_and_shown(mode: str) -> None:
    rig = _taken(mode)
    assert rig.telemetry is not None
    assert rig.telemetry.is_flown_by_hand
    assert rig.telemetry.conditions == ("flown by hand",)
    assert rig.core.flight.reason == f"Flown by hand ({mode}): no more setpoints are sent."
    codes = [event.code for event in rig.events if event.severity == "critical"]
    assert codes == ["flown-by-hand"]


@pytest.mark.parametrize("mode", PILOTS)
@pytest.mark.parametrize("reason", REASONS)
def test_no_mission_and_no_land_all_lands_a_pilot(mode: str, reason: str) -> None:
    rig = _taken(mode)
    for _ in range(3):
        reply = rig.order("land", reason=reason)
        assert not reply.is_accepted
        assert reply.reason == "mav0 is flown by hand: `land mav0` takes it."
        rig.run(3.0)
    assert rig.count(agent_commands.Px4Land) == 0
    assert rig.mode == mode


@pytest.mark.parametrize("mode", PILOTS)
def test_a_person_who_names_the_vehicle_lands_it_at_once(mode: str) -> None:
    rig = _taken(mode)
    assert rig.order("land", order_id="named").is_accepted
    rig.run(0.1)
    assert rig.count(agent_commands.Px4Land) == 1
    rig.run(1.0)
    assert rig.core.flight.step is FlightStep.PX4_LANDING


@pytest.mark.parametrize("mode", PILOTS)
@pytest.mark.parametrize("reason", REASONS)
def test_without_sticks_it_is_landed_as_ever(mode: str, reason: str) -> None:
    rig = _taken(mode, has_sticks=False)
    assert rig.order("land", reason=reason).is_accepted
    rig.run(0.1)
    assert rig.count(agent_commands.Px4Land) == 1


@pytest.mark.parametrize("has_sticks", [False, True])
def test_hold_is_no_pilots_mode(has_sticks: bool) -> None:
    rig = _taken("HOLD", has_sticks)
    assert rig.order("land", reason=BY_MISSION).is_accepted
    rig.run(0.2)
    assert rig.count(agent_commands.Px4Land) == 1


def test_sticks_that_fall_silent_are_no_pilot_after_a_second() -> None:
    rig = _taken("POSCTL")
    rig.has_sticks = False
    rig.run(0.9)
    assert not rig.order("land", reason=BY_MISSION).is_accepted
    rig.run(0.2)
    assert rig.order("land", reason=BY_MISSION).is_accepted


@pytest.mark.parametrize("ticks", range(0, 60, 7))
def test_no_failsafe_lands_a_vehicle_that_a_pilot_has_just_taken(ticks: int) -> None:
    """The heartbeat with his mode comes once a second: PX4 is asked before it is landed."""
    rig = Held()
    rig.fly()
    rig.has_sticks = True
    rig.run(0.02 * ticks)
    rig.mode = "POSCTL"
    rig.run(0.02)
    # ticks that are not finite for half a second: PX4 is to land
    for _ in range(60):
        rig.core.handle(agent_inputs.TickFailed("broken"), rig.now_ns)
        rig.step()
    rig.run(2.0)
    assert rig.count(agent_commands.Px4Land) == 0
    assert rig.mode == "POSCTL"
    assert rig.core.flight.state == "failed"


def test_beside_sticks_that_rest_a_failsafe_still_has_px4_land() -> None:
    rig = hovering_rig()
    rig.has_sticks = True
    rig.run(1.0)
    begin_ns = rig.now_ns
    for _ in range(60):
        rig.core.handle(agent_inputs.TickFailed("broken"), rig.now_ns)
        rig.step()
    landed = [
        stamp_ns
        for stamp_ns, command in rig.sent
        if isinstance(command, agent_commands.Px4Land) and stamp_ns > begin_ns
    ]
    asked = [
        stamp_ns
        for stamp_ns, command in rig.sent
        if isinstance(command, agent_commands.RequestHeartbeat) and stamp_ns > begin_ns
    ]
    assert landed[0] - asked[0] <= 60_000_000


def test_a_pilot_takes_a_vehicle_out_of_a_landing_of_px4_that_a_failsafe_has_begun() -> None:
    rig = Held()
    rig.fly()
    for _ in range(40):
        rig.core.handle(agent_inputs.TickFailed("broken"), rig.now_ns)
        rig.step()
    assert rig.core.flight.step is FlightStep.PX4_LANDING
    begun = rig.count(agent_commands.Px4Land)
    rig.mode = "POSCTL"
    rig.has_sticks = True
    rig.run(5.0)
    assert rig.core.flight.state == "failed"
    assert rig.count(agent_commands.Px4Land) == begun


@pytest.mark.parametrize("kind", ["arm", "takeoff"])
def test_a_pilot_who_arms_while_px4_is_asked_for_offboard_keeps_his_mode(kind: OrderKind) -> None:
    rig = ready_rig()
    rig.accepts_offboard = False
    rig.has_sticks = True
    rig.run(1.0)
    rig.order(kind, order_id="start")
    rig.run(0.5)
    rig.mode = "POSCTL"
    rig.is_armed = True
    rig.run(1.1)  # until PX4's next heartbeat
    known_ns = rig.now_ns
    rig.run(5.0)
    assert rig.count(agent_commands.SetOffboard, known_ns) == 0
    assert rig.count(agent_commands.Arm) == 0
    assert rig.core.flight.reason == "Flown by hand (POSCTL): disarming."
    assert rig.outcomes()["start"] == "failed"


def test_an_agent_that_starts_beside_a_pilot_leaves_him_alone() -> None:
    rig = Held(position=np.array([0.4, -0.3, 1.2]), is_armed=True, mode="POSCTL", has_sticks=True)
    rig.has_flown = True
    rig.run(3.0)
    assert rig.telemetry is not None
    assert rig.telemetry.is_flown_by_hand
    assert not rig.order("land", reason=BY_MISSION).is_accepted
    assert "flown by hand" in rig.order("move", position_enu_m=(0.0, 0.0, 1.0)).reason
    assert rig.count(agent_commands.Px4Land) == 0
