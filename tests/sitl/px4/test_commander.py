"""Arming, modes and failsafes of the emulated PX4, as measured on a real one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sitl.emulator.emulator import Emulator
from sitl.physics.vehicle import VehicleProfile
from sitl.px4.modes import CommandResult, LandedState, Mode, SystemStatus
from tests.sitl.sitl_flying import (
    ARDRONE,
    EAST_WXYZ,
    SIH,
    Client,
    emulator,
    height_m,
    run_for,
    streamer,
    until,
)


def offboard_at_height(
    emu: Emulator,
    height: float,
    hover: float = 0.49,
    *,
    loss_action: int = 0,
    warm_up_s: float = 5.0,
) -> None:
    """Arm straight into OFFBOARD and climb."""
    pilot = emu.autopilots[0]
    pilot.params.values["COM_OBL_RC_ACT"] = loss_action
    run_for(emu, warm_up_s, streamer(emu, 0.0))
    assert pilot.request(emu.time_s, Mode.OFFBOARD) is CommandResult.ACCEPTED
    assert pilot.request_arm(emu.time_s, True, 0.0) is CommandResult.ACCEPTED
    until(emu, lambda: height_m(emu) > height, 10.0, streamer(emu, 1.2 * hover))
    until(
        emu,
        lambda: emu.world.vehicles.states.velocity_ned_m_s[0, 2] > -0.1,
        10.0,
        streamer(emu, 0.97 * hover),
    )


def test_arming_is_denied_while_the_estimator_starts() -> None:
    emu = emulator()
    run_for(emu, 1.0)
    pilot = emu.autopilots[0]
    assert pilot.system_status(emu.time_s) is SystemStatus.UNINIT
    assert pilot.request_arm(emu.time_s, True, 0.0) is CommandResult.TEMPORARILY_REJECTED
    run_for(emu, 4.0)
    assert pilot.system_status(emu.time_s) is SystemStatus.STANDBY
    assert pilot.request_arm(emu.time_s, True, 0.0) is CommandResult.ACCEPTED


def test_offboard_without_setpoints_is_taken_when_disarmed_and_then_arming_is_denied() -> None:
    emu = emulator()
    run_for(emu, 5.0)
    pilot = emu.autopilots[0]
    assert pilot.request(emu.time_s, Mode.OFFBOARD) is CommandResult.ACCEPTED
    assert pilot.mode is Mode.OFFBOARD
    assert pilot.base_mode(emu.time_s) == 1
    assert pilot.system_status(emu.time_s) is SystemStatus.UNINIT
    assert pilot.request_arm(emu.time_s, True, 0.0) is CommandResult.TEMPORARILY_REJECTED
    assert pilot.journal.texts.newest[-1].text.startswith("Arming denied")


@pytest.mark.parametrize("mode", [Mode.MANUAL, Mode.ALTCTL, Mode.POSCTL, Mode.STABILIZED])
def test_a_manual_mode_is_armed_only_while_a_pilots_sticks_are_received(mode: Mode) -> None:
    emu = emulator()
    run_for(emu, 5.0)
    pilot = emu.autopilots[0]
    assert pilot.request(emu.time_s, mode) is CommandResult.ACCEPTED
    assert pilot.system_status(emu.time_s) is SystemStatus.UNINIT
    assert pilot.request_arm(emu.time_s, True, 0.0) is CommandResult.TEMPORARILY_REJECTED
    pilot.take_sticks(emu.time_s, (0.0, 0.0, 0.0, 0.0))
    assert pilot.system_status(emu.time_s) is SystemStatus.STANDBY
    assert pilot.request_arm(emu.time_s, True, 0.0) is CommandResult.ACCEPTED


@pytest.mark.parametrize(
    ("px4", "mode", "throttle", "said"),
    [
        ("1.16", Mode.MANUAL, 0.09, None),
        ("1.16", Mode.MANUAL, 0.1, "high throttle"),
        ("1.16", Mode.STABILIZED, 0.5, "high throttle"),
        ("1.18", Mode.STABILIZED, 0.5, "throttle not in safe position"),
        ("1.16", Mode.POSCTL, 0.56, None),
        ("1.16", Mode.POSCTL, 1.0, "throttle above center"),
        ("1.18", Mode.ALTCTL, 1.0, "throttle not in safe position"),
        ("1.16", Mode.LOITER, 1.0, None),
    ],
)
def test_a_raised_throttle_forbids_arming_in_the_modes_that_obey_it(
    px4: str, mode: Mode, throttle: float, said: str | None
) -> None:
    emu = emulator(px4=px4)
    run_for(emu, 5.0)
    pilot = emu.autopilots[0]
    pilot.take_sticks(emu.time_s, (0.0, 0.0, throttle, 0.0))
    pilot.request(emu.time_s, mode)
    if said is None:
        assert pilot.request_arm(emu.time_s, True, 0.0) is CommandResult.ACCEPTED
    else:
        assert pilot.request_arm(emu.time_s, True, 0.0) is CommandResult.TEMPORARILY_REJECTED
        assert pilot.journal.texts.newest[-1].text == f"Arming denied: {said}\t"


def test_a_manual_mode_without_sticks_is_rejected_in_the_air() -> None:
    emu = emulator()
    offboard_at_height(emu, 1.0)
    pilot = emu.autopilots[0]
    assert pilot.request(emu.time_s, Mode.POSCTL) is CommandResult.TEMPORARILY_REJECTED
    assert pilot.mode is Mode.OFFBOARD
    pilot.take_sticks(emu.time_s, (0.0, 0.0, 0.5, 0.0))
    assert pilot.request(emu.time_s, Mode.POSCTL) is CommandResult.ACCEPTED


def test_offboard_without_setpoints_is_rejected_in_the_air() -> None:
    emu = emulator()
    offboard_at_height(emu, 1.0)
    pilot = emu.autopilots[0]
    assert pilot.request(emu.time_s, Mode.LOITER) is CommandResult.ACCEPTED
    run_for(emu, 2.0)
    assert pilot.request(emu.time_s, Mode.OFFBOARD) is CommandResult.TEMPORARILY_REJECTED
    assert pilot.mode is Mode.LOITER


def test_a_vehicle_without_any_position_source_still_flies_attitude_offboard() -> None:
    emu = emulator()
    pilot = emu.autopilots[0]
    pilot.params.values["EKF2_GPS_CTRL"] = 0
    emu.parameters_changed(0)
    run_for(emu, 5.0)
    assert pilot.request_arm(emu.time_s, True, 0.0) is CommandResult.TEMPORARILY_REJECTED
    offboard_at_height(emu, 0.5)
    assert height_m(emu) > 0.5


def test_a_gap_shorter_than_the_loss_time_changes_nothing_and_a_longer_one_is_a_failsafe() -> None:
    emu = emulator()
    offboard_at_height(emu, 2.0, loss_action=4)
    pilot = emu.autopilots[0]
    run_for(emu, 0.8)
    assert pilot.mode is Mode.OFFBOARD
    run_for(emu, 0.1, streamer(emu, 0.49))
    took_s = until(emu, lambda: pilot.mode is not Mode.OFFBOARD, 2.0)
    assert 0.98 < took_s < 1.14
    assert pilot.mode is Mode.LAND
    assert pilot.system_status(emu.time_s) is SystemStatus.CRITICAL
    assert pilot.journal.texts.newest[-1].text == "Failsafe activated\t"


@pytest.mark.parametrize(
    ("action", "mode"),
    [(0, Mode.POSCTL), (1, Mode.ALTCTL), (3, Mode.RTL), (4, Mode.LAND), (5, Mode.LOITER)],
)
def test_each_loss_action_enters_its_mode_and_returning_setpoints_bring_offboard_back(
    action: int, mode: Mode
) -> None:
    emu = emulator()
    offboard_at_height(emu, 2.0, loss_action=action)
    pilot = emu.autopilots[0]
    run_for(emu, 1.5)
    assert pilot.mode is mode
    run_for(emu, 0.1, streamer(emu, 0.49))
    assert pilot.mode is Mode.OFFBOARD
    assert not pilot.is_failsafe


def test_the_default_loss_action_descends_blindly_lands_and_disarms() -> None:
    emu = emulator()
    offboard_at_height(emu, 2.6)
    pilot = emu.autopilots[0]
    landed_s = until(emu, lambda: pilot.landed is LandedState.ON_GROUND, 20.0)
    assert 5.0 < landed_s < 12.0
    assert until(emu, lambda: not pilot.is_armed, 5.0) == pytest.approx(2.0, abs=0.05)
    assert pilot.mode is Mode.OFFBOARD


def test_a_requested_mode_is_kept_while_setpoints_go_on() -> None:
    emu = emulator()
    offboard_at_height(emu, 1.5)
    pilot = emu.autopilots[0]
    pilot.request(emu.time_s, Mode.LOITER)
    run_for(emu, 1.0, streamer(emu, 0.49))
    assert pilot.mode is Mode.LOITER


def test_landing_by_setpoint_ends_in_auto_disarm() -> None:
    emu = emulator()
    offboard_at_height(emu, 0.3)
    pilot = emu.autopilots[0]
    until(emu, lambda: height_m(emu) == 0.0, 10.0, streamer(emu, 0.46))
    took_s = until(emu, lambda: not pilot.is_armed, 8.0, streamer(emu, 0.0))
    assert 3.8 < took_s < 4.8


@pytest.mark.parametrize("profile", [SIH, ARDRONE], ids=["sih", "ardrone"])
def test_takeoff_hold_land_and_disarm(profile: VehicleProfile) -> None:
    emu = emulator(profile=profile)
    run_for(emu, 5.0)
    pilot = emu.autopilots[0]
    assert pilot.request(emu.time_s, Mode.TAKEOFF) is CommandResult.ACCEPTED
    assert pilot.request_arm(emu.time_s, True, 0.0) is CommandResult.ACCEPTED
    detected_s = until(emu, lambda: pilot.landed is LandedState.TAKEOFF, 4.0)
    # the weak one hovers far above what PX4 begins with
    assert 1.0 < detected_s < (2.2 if profile is SIH else 3.0)
    until(emu, lambda: pilot.mode is Mode.LOITER, 10.0)
    run_for(emu, 4.0)
    assert height_m(emu) == pytest.approx(2.5, abs=0.7)
    horizontal = emu.world.vehicles.states.position_ned_m[0, :2]
    assert math.hypot(*horizontal) < 1.2
    assert pilot.request(emu.time_s, Mode.LAND) is CommandResult.ACCEPTED
    assert 7.0 < until(emu, lambda: pilot.landed is LandedState.ON_GROUND, 20.0) < 15.0
    assert until(emu, lambda: not pilot.is_armed, 5.0) == pytest.approx(2.0, abs=0.05)
    assert pilot.mode is Mode.LOITER


def test_disarming_in_the_air_is_denied_unless_forced() -> None:
    emu = emulator()
    offboard_at_height(emu, 1.0)
    pilot = emu.autopilots[0]
    assert pilot.request_arm(emu.time_s, False, 0.0) is CommandResult.TEMPORARILY_REJECTED
    assert pilot.request_arm(emu.time_s, False, 21196.0) is CommandResult.ACCEPTED
    run_for(emu, 1.5)
    assert height_m(emu) == 0.0


def test_armed_and_never_taken_off_disarms_after_ten_seconds() -> None:
    emu = emulator()
    run_for(emu, 5.0)
    pilot = emu.autopilots[0]
    pilot.request_arm(emu.time_s, True, 0.0)
    assert until(emu, lambda: not pilot.is_armed, 15.0) == pytest.approx(10.0, abs=0.1)


def test_a_critical_battery_takes_the_vehicle_out_of_offboard_though_setpoints_flow() -> None:
    emu = emulator()
    offboard_at_height(emu, 1.0)
    pilot = emu.autopilots[0]
    pilot.params.values["SIM_BAT_MIN_PCT"] = 0.0
    pilot.battery.remaining_frac = 0.075
    assert pilot.mode is Mode.OFFBOARD
    send = streamer(emu, 0.49)
    until(emu, lambda: pilot.mode is Mode.LOITER, 2.0, send)
    assert until(emu, lambda: pilot.mode is Mode.LAND, 7.0, send) == pytest.approx(5.0, abs=0.1)
    until(emu, lambda: not pilot.is_armed, 20.0, send)


def test_the_battery_stops_at_half_and_refills_after_disarming() -> None:
    emu = emulator()
    pilot = emu.autopilots[0]
    run_for(emu, 5.0)
    pilot.params.values["COM_DISARM_PRFLT"] = -1.0
    pilot.request_arm(emu.time_s, True, 0.0)
    run_for(emu, 31.0)
    assert pilot.battery.remaining_frac == 0.5
    assert pilot.battery.voltage_mv == 15300
    pilot.request_arm(emu.time_s, False, 0.0)
    run_for(emu, 4.5)
    assert pilot.battery.remaining_frac == 1.0


@pytest.mark.parametrize("thrust", [math.nan, -0.5])
def test_senseless_thrust_is_taken_as_none_and_the_vehicle_falls(thrust: float) -> None:
    emu = emulator()
    offboard_at_height(emu, 4.0)
    run_for(emu, 0.6, streamer(emu, thrust))
    assert emu.world.vehicles.states.velocity_ned_m_s[0, 2] > 2.5


def test_a_quaternion_of_any_length_means_its_direction_and_nan_drifts_slowly() -> None:
    emu = emulator()
    offboard_at_height(emu, 2.0)
    run_for(emu, 0.5, streamer(emu, 0.49, [3.0 * c for c in EAST_WXYZ]))
    tilt = emu.world.vehicles.states.tilt_rad
    assert np.all(np.abs(tilt) < 0.01)
    run_for(emu, 0.6, streamer(emu, 0.49, [math.nan] * 4))
    assert -8.0 < np.degrees(emu.world.vehicles.states.tilt_rad[0, 0]) < -1.0


def test_a_position_setpoint_is_flown_to_in_offboard() -> None:
    emu = emulator()
    client = Client(emu)
    run_for(emu, 5.0)
    pilot = emu.autopilots[0]

    def send() -> None:
        if emu.world.vehicles.steps % 10 == 0:
            client.send(
                "SET_POSITION_TARGET_LOCAL_NED",
                x=1.0,
                y=-2.0,
                z=-2.0,
                target_system=1,
                type_mask=0xDF8,
                coordinate_frame=1,
            )

    run_for(emu, 0.1, send)
    pilot.request(emu.time_s, Mode.OFFBOARD)
    assert pilot.request_arm(emu.time_s, True, 0.0) is CommandResult.ACCEPTED
    run_for(emu, 12.0, send)
    north, east, down = emu.world.vehicles.states.position_ned_m[0].tolist()
    assert math.dist((north, east, down), (1.0, -2.0, -2.0)) < 1.2


@pytest.mark.parametrize(("name", "value"), [("MPC_XY_CRUISE", -1.0), ("MPC_TILTMAX_AIR", 100.0)])
def test_a_blind_descent_needs_no_sensible_limits(name: str, value: float) -> None:
    emu = emulator()
    offboard_at_height(emu, 2.0)
    px4 = emu.autopilots[0]
    px4.params.values[name] = value
    run_for(emu, 1.5)
    assert px4.mode is Mode.POSCTL
    until(emu, lambda: px4.landed is LandedState.ON_GROUND, 30.0)
