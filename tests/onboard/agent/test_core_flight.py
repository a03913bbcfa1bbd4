"""A whole flight of the core in virtual time: what it asks of PX4, and what it believes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from onboard import agent_commands, agent_inputs
from onboard.agent.core import AgentCore
from onboard.autopilot import Landed
from onboard.estimation import wind
from onboard.flight.types import FlightStep
from tests.onboard.agent.rig import Rig, fleet, hovering_rig, ready_rig


def test_a_flight_from_the_ground_to_the_ground_ends_every_order_as_done() -> None:
    rig = hovering_rig()
    assert rig.position[2] == pytest.approx(1.0, abs=0.1)
    assert rig.order("move", position_enu_m=(1.0, -1.0, 1.2)).is_accepted
    rig.run(8.0)
    assert rig.position == pytest.approx([1.0, -1.0, 1.2], abs=0.05)
    assert rig.order("land").is_accepted
    rig.until("landed")
    rig.run(0.1)
    assert not rig.is_armed
    assert list(rig.outcomes().values()) == ["done", "done", "done"]
    assert rig.telemetry is not None
    assert rig.telemetry.state == "landed"


def test_a_push_at_the_ground_is_not_told_to_the_others_as_a_motion_that_goes_on() -> None:
    rig = hovering_rig()
    told_m_s2: dict[bool, float] = {True: 0.0, False: 0.0}

    def push_and_listen() -> None:
        rig.velocity[0] += 0.06  # 3 m/s^2, as of a wind on a vehicle whose feet are on the ground
        assert rig.state is not None
        if rig.core.flight.state != "landing":
            return
        is_at_ground = rig.position[2] < 0.05
        east_m_s2 = abs(rig.state.acceleration_enu_m_s2[0])
        told_m_s2[is_at_ground] = max(told_m_s2[is_at_ground], east_m_s2)

    assert rig.order("land").is_accepted
    rig.after_move = push_and_listen
    rig.run(6.0)
    assert told_m_s2[False] > 0.5
    assert told_m_s2[True] == 0.0  # while it lands


def test_wind_does_not_carry_a_landing_vehicle_along_the_ground() -> None:
    rig = hovering_rig()
    sent_frac: dict[bool, list[float]] = {True: [], False: []}

    def blow_and_listen() -> None:
        rig.velocity[0] += 0.02 * 3.0  # 3 m/s^2: a tilt of 17 degrees
        if rig.core.flight.step is FlightStep.DESCENT and rig.setpoint is not None:
            may_touch = rig.position[2] < 0.05
            sent_frac[may_touch].append(rig.setpoint.thrust_frac)

    rig.after_move = blow_and_listen
    assert rig.order("land").is_accepted
    rig.until("landed")
    hover_frac = rig.core.control.hover_frac
    assert max(sent_frac[False]) > 0.99 * hover_frac
    assert max(sent_frac[True]) < 0.98 * hover_frac  # on level feet it does not lift off


def test_a_vehicle_that_hovered_with_too_much_throttle_does_not_take_off_again() -> None:
    rig = hovering_rig()

    def weigh_down() -> None:
        if rig.position[2] > 0.05:
            rig.velocity[2] -= 0.02 * 3.0

    rig.after_move = weigh_down
    rig.run(15.0)
    assert rig.order("land").is_accepted
    rig.until("landed")
    rig.run(2.0)
    refusal = rig.order("takeoff", height_m=1.0)
    assert not refusal.is_accepted
    assert "It hovered at 0.60 of its throttle, the fleet file says 0.50" in refusal.reason


def test_a_battery_that_px4_no_longer_reports_is_shown_as_unknown_and_not_at_its_last_level() -> (
    None
):
    rig = Rig()
    rig.run(2.0)
    assert rig.telemetry is not None
    assert rig.telemetry.battery_frac == rig.battery_frac
    rig.sends_battery = False
    rig.run(4.0)
    assert rig.telemetry.battery_frac == rig.battery_frac
    rig.run(2.0)
    assert math.isnan(rig.telemetry.battery_frac)
    assert math.isnan(rig.telemetry.battery_voltage_v)
    rig.sends_battery = True
    rig.run(0.5)
    assert rig.telemetry.battery_frac == rig.battery_frac


def test_it_arms_only_after_a_heartbeat_has_said_offboard() -> None:
    rig = ready_rig()
    rig.accepts_offboard = False
    rig.order("takeoff", height_m=1.0)
    rig.run(2.0)
    assert rig.count(agent_commands.SetOffboard) >= 1
    assert rig.count(agent_commands.Arm) == 0
    rig.mode = "OFFBOARD"
    asked_ns = rig.now_ns
    rig.run(1.1)
    assert rig.count(agent_commands.Arm, asked_ns) >= 1


def test_there_is_no_thrust_before_a_heartbeat_has_said_armed() -> None:
    rig = ready_rig()
    rig.accepts_arm = False
    rig.order("takeoff", height_m=1.0)
    rig.run(4.0)
    setpoints = [
        command.setpoint
        for _, command in rig.sent
        if isinstance(command, agent_commands.SendAttitude)
    ]
    assert len(setpoints) > 100
    assert max(float(setpoint.thrust_frac) for setpoint in setpoints) == 0.0


@pytest.mark.parametrize(
    ("switch", "word"), [("accepts_offboard", "OFFBOARD"), ("accepts_arm", "arm")]
)
def test_a_px4_that_accepts_and_does_nothing_fails_the_order_in_words(
    switch: str, word: str
) -> None:
    rig = ready_rig()
    setattr(rig, switch, False)
    reply = rig.order("takeoff", height_m=1.0)
    assert reply.is_accepted
    rig.run(12.0)
    assert rig.outcomes()[reply.order_id] == "failed"
    assert any(word in event.sentence for event in rig.events)
    assert rig.position[2] == 0.0
    silent_since_ns = rig.now_ns - 1_000_000_000
    assert rig.count(agent_commands.SendAttitude, silent_since_ns) == 0


def test_no_setpoint_leaves_before_an_order_or_after_the_landing() -> None:
    rig = Rig()
    rig.run(3.0)
    assert rig.count(agent_commands.SendAttitude) == 0
    rig.fly()
    rig.order("land")
    rig.until("landed")
    landed_ns = rig.now_ns
    rig.run(2.0)
    assert rig.count(agent_commands.SendAttitude, landed_ns) == 0


@pytest.mark.parametrize("error_deg", [-120.0, -20.0, 35.0, 170.0])
def test_a_wrong_heading_of_px4_is_taken_out_by_the_mocap(error_deg: float) -> None:
    rig = Rig(
        # PX4 keeps to its compass
        AgentCore(fleet(px4_params={"EKF2_EV_CTRL": 7}), "mav0", boot_id=7),
        heading_error_rad=math.radians(error_deg),
    )
    rig.fly()
    rig.order("move", position_enu_m=(1.5, 1.0, 1.0))
    furthest = 0.0
    for _ in range(400):
        rig.step()
        # off the straight line from (0, 0) to (1.5, 1): a wrong sign of the correction leaves it at
        # once
        furthest = max(
            furthest, abs(1.0 * rig.position[0] - 1.5 * rig.position[1]) / math.hypot(1.0, 1.5)
        )
    assert rig.position[:2] == pytest.approx([1.5, 1.0], abs=0.06)
    assert furthest < 0.1


def test_a_new_order_supersedes_the_one_in_progress() -> None:
    rig = hovering_rig()
    first = rig.order("move", position_enu_m=(2.0, 0.0, 1.0))
    rig.run(0.5)
    second = rig.order("hold")
    assert rig.outcomes()[first.order_id] == "superseded"
    assert second.order_id not in rig.outcomes()  # not before it has come to rest
    rig.run(3.0)
    assert rig.outcomes()[second.order_id] == "done"
    assert np.linalg.norm(rig.velocity) < 0.02
    assert rig.core.flight.state == "holding"


def test_the_same_order_sent_twice_begins_once_and_is_answered_twice() -> None:
    rig = hovering_rig()
    first = rig.order("move", order_id="same", position_enu_m=(1.0, 0.0, 1.0))
    rig.run(10.0)
    assert rig.order("move", order_id="same", position_enu_m=(1.0, 0.0, 1.0)) == first
    assert rig.core.flight.order is None


def test_armed_on_the_ground_it_waits_and_says_when_px4_disarms_by_itself() -> None:
    rig = ready_rig()
    rig.order("arm")
    rig.until("armed")
    rig.is_armed = False
    rig.until("ready", 3.0)
    assert any(event.code == "auto-disarmed" for event in rig.events)


@pytest.mark.failsafe("agent asked to stop", step="flying")
def test_asked_to_stop_in_the_air_it_lands_first_and_then_ends() -> None:
    rig = hovering_rig()
    rig.core.handle(agent_inputs.ShutdownRequested(), rig.now_ns)
    rig.run(1.0)
    assert rig.core.flight.state == "landing"
    assert rig.count(agent_commands.Exit) == 0
    rig.until("landed")
    rig.run(0.1)
    assert rig.count(agent_commands.Exit) >= 1


def test_asked_to_stop_on_the_ground_it_ends_at_once() -> None:
    rig = Rig()
    rig.run(0.5)
    rig.core.handle(agent_inputs.ShutdownRequested(), rig.now_ns)
    rig.step()
    assert rig.count(agent_commands.Exit) == 1


def _lose_disarming(rig: Rig, for_s: float) -> None:
    """Lose each request to disarm on its way to PX4, for that long from now on."""
    since_ns = rig.now_ns
    take = rig.take

    def without_early_disarming(commands: list[agent_commands.Command]) -> None:
        is_early = rig.now_ns - since_ns <= 1e9 * for_s
        take([c for c in commands if not (is_early and isinstance(c, agent_commands.Disarm))])

    rig.take = without_early_disarming  # type: ignore[method-assign]


def test_asked_to_stop_when_armed_it_ends_after_px4_says_that_it_is_disarmed() -> None:
    rig = ready_rig()
    rig.order("arm")
    rig.until("armed")
    rig.core.handle(agent_inputs.ShutdownRequested(), rig.now_ns)
    _lose_disarming(rig, for_s=1.0)
    rig.run(1.0)
    assert rig.is_armed
    assert rig.count(agent_commands.Exit) == 0

    rig.run(2.5)
    assert not rig.is_armed
    assert rig.count(agent_commands.Exit) >= 1


def test_asked_to_stop_it_does_not_wait_long_for_a_px4_that_stays_armed() -> None:
    rig = ready_rig()
    rig.order("arm")
    rig.until("armed")
    rig.has_autopilot = False
    rig.core.handle(agent_inputs.ShutdownRequested(), rig.now_ns)
    rig.run(4.9)
    assert rig.count(agent_commands.Exit) == 0
    rig.run(0.2)
    assert rig.count(agent_commands.Exit) >= 1


def test_a_kill_in_the_air_is_a_critical_event_with_author_and_node_on_the_ground_it_is_none() -> (
    None
):
    rig = Rig()
    rig.run(3.0)
    rig.order("kill")
    rig.run(1.5)
    assert not [event for event in rig.events if event.code == "killed"]
    rig = hovering_rig()
    rig.order("kill", node="ground-17-ab")
    (event,) = [event for event in rig.events if event.code == "killed"]
    assert (event.severity, event.sentence) == (
        "critical",
        "Killed in the air by order of tester (from ground-17-ab).",
    )


def test_kill_is_repeated_until_px4_is_disarmed() -> None:
    rig = hovering_rig()
    rig.order("kill")
    assert rig.count(agent_commands.Kill) == 1
    rig.run(1.5)
    assert not rig.is_armed
    assert "done" in rig.outcomes().values()
    assert rig.core.flight.state in ("failed", "landed")


@pytest.mark.parametrize("after_s", [0.0, 0.2])
def test_an_order_to_land_what_falls_by_a_kill_fails_and_says_so(after_s: float) -> None:
    rig = hovering_rig()
    rig.order("kill")
    rig.run(after_s)
    reply = rig.order("land", order_id="land-it")
    assert reply.is_accepted
    assert reply.reason.startswith("Killed by order of tester. It falls;")

    rig.run(1.5)
    assert rig.outcomes()["land-it"] == "failed"
    (ended,) = [event for event in rig.events if event.order_id == "land-it"]
    assert ended.sentence.endswith("Its motors have stopped and it falls: no order can land it.")
    assert rig.core.flight.reason == "Killed by order of tester."


def test_an_order_to_land_after_a_kill_that_px4_has_not_heard_lands_the_vehicle() -> None:
    rig = hovering_rig()
    rig.hears_kill = False
    rig.order("kill")
    rig.run(0.2)
    rig.order("land", order_id="land-it")
    rig.until("landed")
    assert rig.outcomes()["land-it"] == "done"
    assert rig.core.flight.reason == "ordered"


def test_an_agent_started_while_the_vehicle_flies_stays_silent_and_says_so() -> None:
    rig = Rig(AgentCore(fleet(), "mav0", boot_id=8))
    rig.is_armed = True
    rig.mode = "OFFBOARD"
    rig.has_flown = True
    rig.position = np.array([0.0, 0.0, 1.0])
    rig.step()
    assert rig.snapshot.landed is Landed.IN_AIR
    rig.run(0.3)
    assert rig.core.flight.state == "failed"
    assert "order land or kill" in rig.core.flight.reason
    assert rig.count(agent_commands.SendAttitude) == 0

    # PX4 has landed it: nobody shall be told to land or to kill it any more
    rig.position = np.array([0.0, 0.0, 0.0])
    rig.is_armed = False
    rig.until("landed")
    assert rig.core.flight.reason == "It came down without this agent."


def test_the_state_message_says_cooperative_only_while_the_law_flies() -> None:
    rig = ready_rig()
    assert rig.state is not None
    assert not rig.state.is_cooperative
    assert not rig.state.is_airborne
    rig.fly()
    assert rig.state.is_cooperative
    assert rig.state.is_airborne
    assert rig.state.is_valid


@pytest.mark.parametrize(
    ("in_air", "kind"), [(False, "locate"), (True, "locate"), (True, "identify")]
)
def test_locate_plays_a_tune_and_changes_nothing_else_also_by_its_former_name(
    in_air: bool, kind: Any
) -> None:
    rig = ready_rig()
    if in_air:
        rig.order("takeoff", height_m=1.0)
        rig.until("flying")
    before = (rig.core.flight.state, rig.core.flight.step, rig.core.flight.order)
    reply = rig.order(kind)
    assert reply.is_accepted
    assert rig.count(agent_commands.PlayTune) == 1
    assert rig.outcomes()[reply.order_id] == "done"
    assert (rig.core.flight.state, rig.core.flight.step, rig.core.flight.order) == before
    assert any("does not confirm" in event.sentence for event in rig.events)


@pytest.mark.long
def test_a_move_that_never_arrives_times_out_says_how_far_it_was_and_holds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # what holds it looks like a gust, for which it would land
    monkeypatch.setattr(wind, "step", lambda memory, *_: memory)
    rig = hovering_rig()
    order = rig.order("move", position_enu_m=(2.0, 0.0, 1.0))

    def stuck() -> None:
        rig.position[0] = 0.0
        rig.velocity[0] = 0.0

    rig.after_move = stuck
    # whoever is held by something flies slowly, for which the time limit grows
    while order.order_id not in rig.outcomes() and rig.now_ns < 300 * 10**9:
        rig.run(1.0)
    assert rig.outcomes()[order.order_id] == "timed out"
    (sentence,) = [event.sentence for event in rig.events if event.order_id == order.order_id]
    assert "1.99 m" in sentence or "2.0" in sentence
    assert "to go" in sentence
    assert rig.core.flight.state == "holding"


def test_every_move_and_landing_has_a_time_limit_that_grows_with_its_way() -> None:
    rig = hovering_rig()
    limits = []
    for fields in (
        {"position_enu_m": (0.5, 0.0, 1.0)},
        {"position_enu_m": (3.5, 0.0, 1.0)},
        {"duration_s": 60.0},
    ):
        rig.order("move", **{"position_enu_m": (1.0, 0.0, 1.0), **fields})
        limits.append((rig.core.flight.deadline_ns - rig.now_ns) * 1e-9)
    assert 30.0 < limits[0] < limits[1] < limits[2]
    assert limits[2] >= 180.0
    rig.order("land")
    assert 20.0 < (rig.core.flight.deadline_ns - rig.now_ns) * 1e-9 < 40.0


def test_a_landing_that_does_not_come_down_is_handed_to_px4() -> None:
    rig = hovering_rig()
    order = rig.order("land")

    def hanging() -> None:
        rig.position[2] = 1.0
        rig.velocity[2] = 0.0

    rig.after_move = hanging
    rig.run((rig.core.flight.deadline_ns - rig.now_ns) * 1e-9 + 0.5)
    assert rig.count(agent_commands.Px4Land) >= 1
    assert rig.outcomes()[order.order_id] == "timed out"
    rig.after_move = lambda: None
    rig.until("landed")


def test_a_failsafes_disarming_is_asked_for_until_px4_says_that_it_is_disarmed() -> None:
    rig = ready_rig()
    rig.order("arm")
    rig.until("armed")
    rig.core.handle(agent_inputs.ShutdownRequested(), rig.now_ns)
    _lose_disarming(rig, for_s=3.0)
    rig.run(6.0)
    assert not rig.is_armed
    asked = [when for when, command in rig.sent if isinstance(command, agent_commands.Disarm)]
    assert asked
    assert not any(when > asked[-1] + 2 * 10**9 for when in asked)


@pytest.mark.failsafe("PX4 disarmed in flight", step="flying")
def test_a_kill_switch_in_flight_ends_the_flight_and_is_never_undone() -> None:
    rig = hovering_rig()
    rig.is_armed = False
    rig.run(1.2)
    told_ns = rig.now_ns
    rig.run(3.0)
    assert (
        rig.count(agent_commands.Arm, told_ns)
        == rig.count(agent_commands.SendAttitude, told_ns)
        == 0
    )
    assert "disarmed in flight" in rig.core.flight.reason
    assert rig.core.flight.state in ("failed", "landed")


def test_a_pilot_who_takes_the_vehicle_from_px4s_landing_is_not_fought() -> None:
    rig = hovering_rig()
    for _ in range(30):
        rig.core.handle(agent_inputs.TickFailed("broken"), rig.now_ns)
        rig.step()
    assert rig.mode == "LAND"
    rig.run(1.1)  # a heartbeat has told it
    rig.position[2] = max(rig.position[2], 0.8)
    rig.mode = "POSCTL"
    rig.run(1.1)
    told_ns = rig.now_ns
    rig.run(2.5)
    assert rig.count(agent_commands.Px4Land, told_ns) == 0
    assert "POSCTL" in rig.core.flight.reason


def test_a_strong_wind_carries_a_vehicle_that_lifts_off_by_less_than_a_metre() -> None:
    rig = ready_rig()

    def blow() -> None:
        if rig.position[2] > 0.0:
            rig.velocity += np.array([0.02 * 3.0, 0.0, 0.0])

    rig.after_move = blow
    rig.order("takeoff", height_m=1.0)
    farthest_m = 0.0
    for _ in range(320):
        rig.step()
        farthest_m = max(farthest_m, abs(float(rig.position[0])))
    assert rig.core.flight.state == "flying"
    assert 0.3 < farthest_m < 0.9


def test_a_vehicle_that_is_not_seen_to_lift_off_though_px4_flies_it_is_landed_by_px4() -> None:
    """The markers lie on the ground, for instance; a vehicle whose motors stop then falls."""
    rig = Rig()
    rig.run(2.5)
    order = rig.order("takeoff", height_m=1.0)
    original = rig.pose
    rig.pose = lambda **changes: original(  # type: ignore[method-assign]
        **{"position_enu_m": (0.0, 0.0, 1e-4 * (rig.tick_count % 7)), **changes}
    )
    rig.run(8.0)
    assert rig.outcomes()[order.order_id] == "failed"
    assert rig.count(agent_commands.Px4Land) >= 1
    assert rig.core.flight.step is FlightStep.PX4_LANDING
