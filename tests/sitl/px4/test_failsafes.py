"""The failsafe table: every value of every parameter, the wait in Hold, what clears, and what is
said.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from sitl.px4.battery import ChargeState
from sitl.px4.failsafes import FAILSAFE_TRIGGERS, Failsafe, FailsafeAction, FailsafeInputs
from sitl.px4.journal import SAYINGS, Journal, event_id
from sitl.px4.modes import (
    BY_NUMBERS,
    MODES,
    CommandResult,
    LandedState,
    Mode,
    ModeCondition,
    SystemStatus,
    mode_of,
)
from sitl.px4.parameters import DEFAULTS, Parameters
from tests.sitl.px4.test_commander import offboard_at_height
from tests.sitl.sitl_flying import EAST_WXYZ, emulator, height_m, run_for, streamer, until

CALM = FailsafeInputs(
    has_offboard_signal=True,
    battery=ChargeState.OK,
    attitude_failed=False,
    from_home_m=(0.0, 0.0),
    ground_silent_s=0.0,
)


def decided(facts: FailsafeInputs, **values: float) -> FailsafeAction:
    """What is done at once under parameters."""
    params = Parameters()
    params.values.update(values)
    failsafe = Failsafe()
    failsafe.step(0.0, facts, params)
    return failsafe.delayed or failsafe.action


def test_each_value_of_com_obl_rc_act_has_its_action() -> None:
    for value, action in (
        (-1, FailsafeAction.POSCTL),
        (0, FailsafeAction.POSCTL),
        (1, FailsafeAction.ALTCTL),
        (2, FailsafeAction.STABILIZED),
        (3, FailsafeAction.RETURN),
        (4, FailsafeAction.LAND),
        (5, FailsafeAction.HOLD),
        (6, FailsafeAction.TERMINATE),
        (7, FailsafeAction.DISARM),
        (8, FailsafeAction.POSCTL),
    ):
        assert decided(replace(CALM, has_offboard_signal=False), COM_OBL_RC_ACT=value) is action, (
            value
        )


def test_each_value_of_com_low_bat_act_has_its_action() -> None:
    for state, value, action in (
        (ChargeState.LOW, 3, FailsafeAction.WARN),
        (ChargeState.CRITICAL, 0, FailsafeAction.WARN),
        (ChargeState.CRITICAL, 2, FailsafeAction.LAND),
        (ChargeState.CRITICAL, 3, FailsafeAction.RETURN),
        (ChargeState.EMERGENCY, 0, FailsafeAction.WARN),
        (ChargeState.EMERGENCY, 2, FailsafeAction.LAND),
        (ChargeState.EMERGENCY, 3, FailsafeAction.LAND),
    ):
        assert decided(replace(CALM, battery=state), COM_LOW_BAT_ACT=value) is action, (
            state,
            value,
        )


def test_a_patient_action_waits_in_hold_and_an_urgent_one_does_not() -> None:
    params = Parameters()
    failsafe = Failsafe()
    empty = replace(CALM, battery=ChargeState.EMERGENCY)
    assert failsafe.step(10.0, empty, params)
    assert (failsafe.action, failsafe.delayed) == (FailsafeAction.HOLD, FailsafeAction.LAND)
    assert not failsafe.step(14.9, empty, params)
    assert failsafe.step(15.1, empty, params)
    assert (failsafe.action, failsafe.delayed) == (FailsafeAction.LAND, FailsafeAction.NONE)
    lost = replace(CALM, has_offboard_signal=False)
    assert decided(lost, COM_OBL_RC_ACT=4) is FailsafeAction.LAND


def test_a_hold_waits_for_nothing_and_is_not_announced_for_some_seconds() -> None:
    params = Parameters()
    params.values.update(GF_MAX_HOR_DIST=5.0, GF_ACTION=2)
    failsafe = Failsafe()
    assert failsafe.step(0.0, replace(CALM, from_home_m=(6.0, 0.0)), params)
    assert (failsafe.action, failsafe.delayed) == (FailsafeAction.HOLD, FailsafeAction.NONE)


def test_the_most_severe_of_several_actions_is_taken() -> None:
    both = replace(CALM, has_offboard_signal=False, attitude_failed=True)
    assert decided(both, COM_OBL_RC_ACT=4) is FailsafeAction.LAND
    assert decided(both, COM_OBL_RC_ACT=4, CBRK_FLIGHTTERM=0) is FailsafeAction.TERMINATE


def test_a_fence_failsafe_ends_with_a_mode_request_and_a_signal_failsafe_with_the_signal() -> None:
    params = Parameters()
    failsafe = Failsafe()
    params.values.update(GF_MAX_HOR_DIST=5.0, GF_ACTION=3)
    failsafe.step(0.0, replace(CALM, from_home_m=(6.0, 0.0)), params)
    assert (failsafe.action, failsafe.delayed) == (FailsafeAction.HOLD, FailsafeAction.RETURN)
    failsafe.step(5.0, CALM, params)
    assert failsafe.action is FailsafeAction.RETURN
    failsafe.mode_requested()
    failsafe.step(6.0, CALM, params)
    assert failsafe.action is FailsafeAction.NONE
    failsafe.step(7.0, replace(CALM, has_offboard_signal=False), params)
    assert failsafe.is_active
    failsafe.step(8.0, CALM, params)
    assert not failsafe.is_active


def test_hold_drops_its_goal_where_it_passes_the_fence() -> None:
    emu = emulator()
    offboard_at_height(emu, 2.0)
    pilot = emu.autopilots[0]
    assert pilot.request(emu.time_s, Mode.LOITER) is CommandResult.ACCEPTED
    pilot.mode_control.hold_at(np.array([30.0, 0.0, -2.0]))
    pilot.params.values.update(GF_ACTION=2, GF_MAX_HOR_DIST=5.0)
    until(emu, lambda: pilot.failsafe.action is FailsafeAction.HOLD, 8.0)
    run_for(emu, 8.0)
    assert pilot.mode is Mode.LOITER
    assert emu.world.vehicles.states.position_ned_m[0, 0] == pytest.approx(5.0, abs=1.0)


@pytest.mark.parametrize(
    ("facts", "values", "action"),
    [
        (replace(CALM, from_home_m=(6.0, 0.0)), {"GF_ACTION": 2}, FailsafeAction.HOLD),
        (replace(CALM, ground_silent_s=99.0), {"NAV_DLL_ACT": 3}, FailsafeAction.LAND),
        (replace(CALM, battery=ChargeState.CRITICAL), {}, FailsafeAction.RETURN),
    ],
)
def test_a_user_who_requests_a_mode_during_an_action_takes_over(
    facts: FailsafeInputs, values: dict[str, float], action: FailsafeAction
) -> None:
    params = Parameters()
    params.values.update(GF_MAX_HOR_DIST=5.0, COM_LOW_BAT_ACT=3, **values)
    failsafe = Failsafe()
    failsafe.step(0.0, facts, params)
    failsafe.step(6.0, facts, params)
    assert failsafe.action is action
    failsafe.mode_requested()
    for time_s in (6.0, 20.0):
        failsafe.step(time_s, facts, params)
        assert failsafe.action is FailsafeAction.WARN

    # A further trigger ends it, after its own Hold.
    worse = replace(facts, battery=ChargeState.EMERGENCY)
    failsafe.step(21.0, worse, params)
    assert failsafe.action is FailsafeAction.HOLD
    failsafe.step(27.0, worse, params)
    assert failsafe.action is FailsafeAction.LAND

    # So does the end of all triggers.
    failsafe.mode_requested()
    failsafe.step(28.0, CALM, params)
    assert failsafe.action is FailsafeAction.NONE
    failsafe.step(29.0, facts, params)
    assert failsafe.action is FailsafeAction.HOLD


@pytest.mark.parametrize(
    ("mode", "exceptions", "is_lost"),
    [
        (Mode.LAND, 0, False),
        (Mode.LOITER, 0, True),
        (Mode.LOITER, 2, False),
        (Mode.TAKEOFF, 2, False),
        (Mode.OFFBOARD, 2, True),
        (Mode.OFFBOARD, 4, False),
        (Mode.MISSION, 1, False),
        (Mode.RTL, 7, True),
    ],
)
def test_a_lost_ground_station_does_not_matter_to_a_landing_and_to_the_modes_of_com_dll_except(
    mode: Mode, exceptions: int, is_lost: bool
) -> None:
    lost = replace(CALM, ground_silent_s=99.0, requested_mode=mode)
    action = decided(lost, NAV_DLL_ACT=3, COM_DLL_EXCEPT=exceptions)
    assert (action is FailsafeAction.LAND) is is_lost


@pytest.mark.parametrize(
    ("mode", "action"),
    [
        (Mode.LAND, FailsafeAction.WARN),
        (Mode.RTL, FailsafeAction.WARN),
        (Mode.LOITER, FailsafeAction.RETURN),
    ],
)
def test_a_vehicle_that_lands_or_returns_already_is_only_warned_of_a_return(
    mode: Mode, action: FailsafeAction
) -> None:
    critical = replace(CALM, battery=ChargeState.CRITICAL, requested_mode=mode)
    assert decided(critical, COM_LOW_BAT_ACT=3) is action


def test_a_waiting_return_does_not_delay_the_termination_of_a_landing() -> None:
    both = replace(
        CALM, battery=ChargeState.CRITICAL, attitude_failed=True, requested_mode=Mode.LAND
    )
    params = Parameters()
    params.values.update(COM_LOW_BAT_ACT=3, CBRK_FLIGHTTERM=0)
    failsafe = Failsafe()
    failsafe.step(0.0, both, params)
    assert failsafe.action is FailsafeAction.TERMINATE


def test_a_mode_requested_before_an_action_takes_nothing_over() -> None:
    failsafe = Failsafe()
    failsafe.mode_requested()
    failsafe.step(0.0, replace(CALM, battery=ChargeState.EMERGENCY), Parameters())
    assert failsafe.action is FailsafeAction.HOLD


def test_setpoints_lost_after_a_user_took_over_have_their_action() -> None:
    params = Parameters()
    params.values.update(COM_LOW_BAT_ACT=3, COM_OBL_RC_ACT=0)
    failsafe = Failsafe()
    critical = replace(CALM, battery=ChargeState.CRITICAL)
    failsafe.step(0.0, critical, params)
    failsafe.mode_requested()
    failsafe.step(1.0, replace(critical, has_offboard_signal=False), params)
    assert failsafe.action is FailsafeAction.POSCTL
    failsafe.step(2.0, critical, params)
    assert failsafe.action is FailsafeAction.WARN


def test_a_vehicle_that_holds_beyond_its_fence_is_flown_home_by_a_request() -> None:
    emu = emulator()
    offboard_at_height(emu, 2.0)
    pilot = emu.autopilots[0]
    assert pilot.request(emu.time_s, Mode.LOITER) is CommandResult.ACCEPTED
    pilot.mode_control.hold_at(np.array([30.0, 0.0, -2.0]))
    pilot.params.values.update(GF_ACTION=2, GF_MAX_HOR_DIST=2.0)
    until(emu, lambda: pilot.failsafe.action is FailsafeAction.HOLD, 8.0)
    run_for(emu, 2.0)
    assert pilot.system_status(emu.time_s) is SystemStatus.CRITICAL
    assert pilot.request(emu.time_s, Mode.RTL) is CommandResult.ACCEPTED
    run_for(emu, 1.0)
    assert pilot.mode is Mode.RTL
    assert pilot.system_status(emu.time_s) is SystemStatus.ACTIVE


@pytest.mark.parametrize(
    ("name", "inside_m", "outside_m"),
    [
        ("GF_MAX_HOR_DIST", (4.9, 9.0), (5.1, 0.0)),
        ("GF_MAX_VER_DIST", (9.0, 4.9), (0.0, 5.1)),
    ],
)
def test_each_limit_of_the_fence_counts_and_none_at_zero(
    name: str, inside_m: tuple[float, float], outside_m: tuple[float, float]
) -> None:
    limit = {name: 5.0, "GF_ACTION": 5}
    inside = replace(CALM, from_home_m=inside_m)
    outside = replace(CALM, from_home_m=outside_m)
    assert decided(inside, **limit) is FailsafeAction.NONE
    assert decided(outside, **limit) is FailsafeAction.LAND
    assert decided(outside, **{**limit, name: 0.0}) is FailsafeAction.NONE


def test_a_flight_that_is_too_long_ends_by_returning_after_the_hold() -> None:
    late = replace(CALM, flown_s=301.0)
    assert decided(late) is FailsafeAction.NONE
    assert decided(late, COM_FLT_TIME_MAX=0) is FailsafeAction.NONE
    assert decided(late, COM_FLT_TIME_MAX=302) is FailsafeAction.NONE
    assert decided(late, COM_FLT_TIME_MAX=300) is FailsafeAction.RETURN


def test_a_battery_that_lasts_less_long_than_the_way_home_returns_by_com_fltt_low_act() -> None:
    """100 s of margin, and 1.1 times 4 m down at 0.7 m/s."""
    for left_s, value, action in (
        (107.0, 3, FailsafeAction.NONE),
        (106.0, 0, FailsafeAction.NONE),
        (106.0, 1, FailsafeAction.WARN),
        (106.0, 3, FailsafeAction.RETURN),
        (math.inf, 3, FailsafeAction.NONE),
    ):
        facts = replace(CALM, from_home_m=(1.0, 4.0), battery_left_s=left_s)
        assert decided(facts, COM_FLTT_LOW_ACT=value) is action, (left_s, value)


def test_each_value_of_com_wind_max_act_has_its_action() -> None:
    windy = replace(CALM, wind_m_s=6.0)
    assert decided(windy, COM_WIND_MAX_ACT=3) is FailsafeAction.NONE
    assert decided(windy, COM_WIND_MAX=7.0, COM_WIND_MAX_ACT=3) is FailsafeAction.NONE
    for value, action in (
        (0, FailsafeAction.NONE),
        (1, FailsafeAction.WARN),
        (2, FailsafeAction.HOLD),
        (3, FailsafeAction.RETURN),
        (4, FailsafeAction.TERMINATE),
        (5, FailsafeAction.LAND),
    ):
        assert decided(windy, COM_WIND_MAX=5.0, COM_WIND_MAX_ACT=value) is action, value


@pytest.mark.parametrize(
    "params",
    [
        {"COM_FLT_TIME_MAX": 3},
        {"COM_FLTT_LOW_ACT": 3, "BAT1_CAPACITY": 2000.0},
        {"COM_WIND_MAX": 3.0, "COM_WIND_MAX_ACT": 3, "EKF2_DRAG_CTRL": 1},
    ],
    ids=lambda params: next(iter(params)),
)
def test_px4_leaves_offboard_although_setpoints_flow(params: dict[str, float]) -> None:
    emu = emulator()
    emu.world.vehicles.air_ned_m_s[:, 0] = 4.0
    pilot = emu.autopilots[0]
    offboard_at_height(emu, 2.0, loss_action=4)
    assert pilot.mode is Mode.OFFBOARD
    run_for(emu, 3.0, streamer(emu, 0.49))
    assert pilot.mode is Mode.OFFBOARD

    pilot.params.values.update(params)
    run_for(emu, 0.2, streamer(emu, 0.49))
    assert pilot.mode is Mode.LOITER
    assert pilot.is_failsafe
    run_for(emu, 5.2, streamer(emu, 0.49))
    assert pilot.mode is Mode.RTL


def test_every_row_names_parameters_that_exist_and_modes_that_are_distinct() -> None:
    assert all(
        row.parameter is None or row.parameter in DEFAULTS["1.18"] for row in FAILSAFE_TRIGGERS
    )
    assert len({row.name for row in FAILSAFE_TRIGGERS}) == len(FAILSAFE_TRIGGERS)
    assert set(BY_NUMBERS.values()) == {mode for mode, row in MODES.items() if row.is_selectable}


@pytest.mark.parametrize("name", ["MPC_Z_V_AUTO_UP", "MPC_XY_CRUISE", "MPC_LAND_SPEED"])
@pytest.mark.parametrize("speed_m_s", [0.0, -1.0])
def test_a_return_at_no_speed_takes_longer_than_a_battery(name: str, speed_m_s: float) -> None:
    params = Parameters()
    params.values.update({name: speed_m_s, "COM_FLTT_LOW_ACT": 3})
    failsafe = Failsafe()
    failsafe.step(0.0, replace(CALM, from_home_m=(20.0, 5.0), battery_left_s=3600.0), params)
    assert failsafe.present == {"battery short of home"}


@pytest.mark.parametrize(("action", "is_armed"), [(6, True), (7, False)])
def test_termination_and_disarming_stop_the_motors_in_the_air(action: int, is_armed: bool) -> None:
    emu = emulator()
    offboard_at_height(emu, 2.0, loss_action=action)
    run_for(emu, 1.3)
    pilot = emu.autopilots[0]
    assert pilot.is_armed is is_armed
    assert not pilot.actuation.motors_on
    until(emu, lambda: height_m(emu) == 0.0, 3.0)
    until(emu, lambda: not pilot.is_armed, 8.0)


def test_a_flight_is_terminated_on_command_only_while_armed() -> None:
    emu = emulator()
    run_for(emu, 5.0)
    pilot = emu.autopilots[0]
    assert pilot.request_termination(emu.time_s) is CommandResult.DENIED
    offboard_at_height(emu, 1.0, warm_up_s=0.1)
    assert pilot.request_termination(emu.time_s) is CommandResult.ACCEPTED
    assert pilot.mode is Mode.TERMINATION
    run_for(emu, 0.5, streamer(emu, 0.9))
    assert not pilot.actuation.motors_on  # setpoints do not bring it back


@pytest.mark.parametrize("is_by_failsafe", [False, True])
def test_no_mode_request_starts_the_motors_of_a_terminated_flight(is_by_failsafe: bool) -> None:
    emu = emulator()
    offboard_at_height(emu, 3.0, loss_action=6)
    px4 = emu.autopilots[0]
    if is_by_failsafe:
        run_for(emu, 1.2)
    else:
        px4.request_termination(emu.time_s)
    assert px4.mode is Mode.TERMINATION

    for mode in (Mode.LAND, Mode.LOITER, Mode.OFFBOARD, Mode.STABILIZED):
        assert px4.request(emu.time_s, mode) is CommandResult.TEMPORARILY_REJECTED, mode
        run_for(emu, 0.04)
        assert px4.mode is Mode.TERMINATION
        assert not px4.actuation.motors_on


def test_a_flight_terminated_without_setpoints_stays_terminated_when_they_come_back() -> None:
    emu = emulator()
    offboard_at_height(emu, 5.0, loss_action=6)
    run_for(emu, 1.1)
    px4 = emu.autopilots[0]
    assert px4.mode is Mode.TERMINATION

    run_for(emu, 0.3, streamer(emu, 0.9))
    assert px4.mode is Mode.TERMINATION
    assert not px4.actuation.motors_on


@pytest.mark.parametrize("px4", ["1.16", "1.18"])
def test_a_terminated_flight_shows_so_in_its_heartbeat(px4: str) -> None:
    emu = emulator(px4=px4)
    offboard_at_height(emu, 2.0, loss_action=6)
    pilot = emu.autopilots[0]
    until(emu, lambda: pilot.mode is Mode.TERMINATION, 3.0)
    assert pilot.system_status(emu.time_s) == 8  # MAV_STATE_FLIGHT_TERMINATION
    until(emu, lambda: not pilot.is_armed, 12.0)
    assert pilot.system_status(emu.time_s) == 8


def test_after_a_termination_by_a_failsafe_only_a_restart_lets_it_be_armed_again() -> None:
    emu = emulator()
    offboard_at_height(emu, 2.0, loss_action=6)
    px4 = emu.autopilots[0]
    until(emu, lambda: not px4.is_armed, 12.0)
    assert px4.request(emu.time_s, Mode.LOITER) is CommandResult.ACCEPTED
    run_for(emu, 0.5)
    assert px4.mode is Mode.TERMINATION
    assert "this mode cannot be armed in" in px4.arming_obstacles(emu.time_s)
    assert px4.request_arm(emu.time_s, True, 0.0) is CommandResult.TEMPORARILY_REJECTED

    emu.reboot(0)
    run_for(emu, 5.0)
    px4 = emu.autopilots[0]
    assert px4.request(emu.time_s, Mode.LOITER) is CommandResult.ACCEPTED
    assert px4.request_arm(emu.time_s, True, 0.0) is CommandResult.ACCEPTED


def test_a_tilt_beyond_sixty_degrees_is_reported_and_flown_on() -> None:
    emu = emulator(px4="1.16")
    offboard_at_height(emu, 8.0)
    pilot = emu.autopilots[0]
    half = math.radians(35.0)
    tilted = [math.cos(half), math.sin(half), 0.0, 0.0]
    yaw_w = EAST_WXYZ[0]
    yaw_z = EAST_WXYZ[3]
    rolled = [yaw_w * tilted[0], yaw_w * tilted[1], yaw_z * tilted[1], yaw_z * tilted[0]]
    until(emu, lambda: bool(pilot.failsafe.present), 3.0, streamer(emu, 0.9, rolled))
    said = [text.text for text in pilot.journal.texts.newest[-2:]]
    assert said == ["Preflight Fail: Attitude failure (roll)", "Failsafe activated\t"]
    assert pilot.mode is Mode.OFFBOARD
    assert pilot.system_status(emu.time_s) is SystemStatus.ACTIVE


def test_setpoints_that_come_back_after_a_landing_take_off_again_if_still_armed() -> None:
    emu = emulator()
    offboard_at_height(emu, 1.0, loss_action=4)
    pilot = emu.autopilots[0]
    until(emu, lambda: pilot.landed is LandedState.ON_GROUND, 20.0)
    assert pilot.is_armed
    until(emu, lambda: height_m(emu) > 0.3, 4.0, streamer(emu, 0.6))
    assert pilot.mode is Mode.OFFBOARD


def test_lost_setpoints_on_the_ground_leave_the_vehicle_armed_in_posctl() -> None:
    emu = emulator()
    run_for(emu, 5.0, streamer(emu, 0.0))
    pilot = emu.autopilots[0]
    pilot.request(emu.time_s, Mode.OFFBOARD)
    assert pilot.request_arm(emu.time_s, True, 0.0) is CommandResult.ACCEPTED
    run_for(emu, 6.0)
    assert pilot.is_armed
    assert pilot.mode is Mode.POSCTL
    assert pilot.base_mode(emu.time_s) == 209


@pytest.mark.parametrize("mode", [Mode.LAND, Mode.RTL])
def test_a_mode_that_only_ends_flights_refuses_arming(mode: Mode) -> None:
    emu = emulator()
    run_for(emu, 5.0)
    pilot = emu.autopilots[0]
    assert pilot.request(emu.time_s, mode) is CommandResult.ACCEPTED
    assert pilot.request_arm(emu.time_s, True, 0.0) is CommandResult.TEMPORARILY_REJECTED
    # force is for disarming
    assert pilot.request_arm(emu.time_s, True, 21196.0) is CommandResult.TEMPORARILY_REJECTED


def test_a_ground_station_is_needed_only_if_its_loss_would_matter() -> None:
    emu = emulator()
    run_for(emu, 5.0)
    pilot = emu.autopilots[0]
    pilot.params.values["NAV_DLL_ACT"] = 2
    assert pilot.arming_obstacles(emu.time_s) == ["no connection to the ground station"]
    pilot.ground_time_s = emu.time_s
    assert pilot.arming_obstacles(emu.time_s) == []


def test_the_numbers_of_px4_name_its_modes() -> None:
    assert mode_of(1, 6, 0) is Mode.OFFBOARD
    assert mode_of(1, 4, 3) is Mode.LOITER
    assert mode_of(1, 4, 0) is Mode.MISSION
    assert mode_of(0, 6, 0) is None
    assert mode_of(192, 0, 0) is Mode.MANUAL
    assert mode_of(208, 0, 0) is Mode.STABILIZED
    assert mode_of(216, 0, 0) is Mode.POSCTL
    assert mode_of(220, 0, 0) is Mode.MISSION
    assert mode_of(1, 9, 0) is None
    assert MODES[Mode.LOITER].custom_mode == 50593792
    assert MODES[Mode.OFFBOARD].custom_mode == 393216
    assert ModeCondition.ARMING in MODES[Mode.LAND].needs


def test_the_journal_forgets_the_old_but_not_how_much_there_was() -> None:
    journal = Journal()
    for second in range(1000):
        journal.say(float(second), "takeoff")
    assert journal.texts.count == journal.events.count == 1000
    assert len(journal.texts.newest) <= 200
    assert [event.sequence for event in journal.events.since(997)] == [998, 999, 1000]
    assert journal.texts.since(998)[-1].time_s == 999.0


def test_events_have_the_numbers_that_follow_from_their_names() -> None:
    # FNV-1a of "commander_arm_denied_resolve_failures" by an independent loop over its bytes.
    value = 2166136261
    for character in "commander_arm_denied_resolve_failures":
        value = (value ^ ord(character)) * 16777619 % 2**32
    assert event_id("commander_arm_denied_resolve_failures") == (1 << 24) + value % 2**24
    numbers = [event_id(saying.event) for saying in SAYINGS.values() if saying.event]
    assert len(set(numbers)) == len(numbers)
