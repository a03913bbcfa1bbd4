"""The emulated PX4 flown by a pilot's sticks, in each of his modes."""

from __future__ import annotations

import math

import pytest

from sitl.px4.modes import CommandResult, LandedState, Mode
from sitl.px4.sticks import CENTRED, Axes
from tests.sitl.px4.test_commander import offboard_at_height
from tests.sitl.sitl_flying import emulator, run_for, until

PILOTS = (Mode.POSCTL, Mode.ALTCTL, Mode.STABILIZED)


def _taken(mode: Mode, sticks: Axes):
    emu = emulator()
    offboard_at_height(emu, 3.0)
    px4 = emu.autopilots[0]
    px4.take_sticks(emu.time_s, sticks)
    px4.held_sticks = sticks
    assert px4.request(emu.time_s, mode) is CommandResult.ACCEPTED
    return emu


def _height_m(emu) -> float:
    return -float(emu.world.vehicles.states.position_ned_m[0, 2])


@pytest.mark.parametrize("mode", PILOTS)
def test_sticks_in_their_middle_hold_the_height(mode: Mode) -> None:
    emu = _taken(mode, CENTRED)
    before_m = _height_m(emu)
    run_for(emu, 6.0)
    assert emu.autopilots[0].mode is mode
    # STABILIZED has no height control: the throttle's middle carries the weight, no more
    most_m = 2.0 if mode is Mode.STABILIZED else 0.8
    assert abs(_height_m(emu) - before_m) < most_m


@pytest.mark.parametrize("mode", PILOTS)
def test_without_sticks_it_sinks(mode: Mode) -> None:
    emu = _taken(mode, CENTRED)
    emu.autopilots[0].held_sticks = None
    before_m = _height_m(emu)
    run_for(emu, 3.0)
    assert _height_m(emu) < before_m - 1.0


@pytest.mark.parametrize("mode", PILOTS)
def test_a_stick_forward_flies_forward(mode: Mode) -> None:
    emu = _taken(mode, (0.3, 0.0, 0.5, 0.0))
    begin = emu.world.vehicles.states.position_ned_m[0].copy()
    yaw_rad = emu.believed_yaw_rad(0)
    run_for(emu, 2.0)
    north, east, _ = emu.world.vehicles.states.position_ned_m[0] - begin
    assert north * math.cos(yaw_rad) + east * math.sin(yaw_rad) > 0.5


@pytest.mark.parametrize("mode", [*PILOTS, Mode.MANUAL])
def test_the_yaw_stick_turns_at_the_rate_of_its_parameter_and_the_heading_stays(mode: Mode) -> None:
    emu = _taken(mode, CENTRED)
    px4 = emu.autopilots[0]
    px4.params.values["MPC_MAN_Y_MAX"] = 60.0
    before_rad = emu.believed_yaw_rad(0)
    px4.held_sticks = (0.0, 0.0, 0.5, 0.05)  # counts as centred
    run_for(emu, 1.0)
    assert emu.believed_yaw_rad(0) == pytest.approx(before_rad, abs=0.1)

    px4.held_sticks = (0.0, 0.0, 0.5, 0.5)
    run_for(emu, 2.0)
    px4.held_sticks = CENTRED
    run_for(emu, 3.0)
    turned_rad = math.remainder(emu.believed_yaw_rad(0) - before_rad, 2.0 * math.pi)
    assert turned_rad == pytest.approx(math.radians(60.0), abs=0.15)


def test_a_vehicle_whose_pilot_falls_silent_keeps_the_heading_that_he_has_turned_to() -> None:
    emu = _taken(Mode.ALTCTL, (0.0, 0.0, 0.5, 1.0))
    px4 = emu.autopilots[0]
    run_for(emu, 0.5)
    px4.held_sticks = CENTRED
    run_for(emu, 3.0)
    before_rad = emu.believed_yaw_rad(0)
    px4.held_sticks = None
    run_for(emu, 2.0)
    assert emu.believed_yaw_rad(0) == pytest.approx(before_rad, abs=0.2)


def test_full_sticks_fly_faster_than_px4_cruises_by_itself() -> None:
    emu = _taken(Mode.POSCTL, (1.0, 0.0, 0.5, 0.0))
    run_for(emu, 4.0)
    north_m_s, east_m_s, _ = emu.world.vehicles.states.velocity_ned_m_s[0].tolist()
    cruise_m_s = emu.autopilots[0].params["MPC_XY_CRUISE"]
    assert math.hypot(north_m_s, east_m_s) > cruise_m_s + 1.0


@pytest.mark.parametrize("mode", [*PILOTS, Mode.MANUAL])
def test_a_high_throttle_takes_off_and_no_throttle_lands(mode: Mode) -> None:
    emu = emulator()
    run_for(emu, 5.0)
    px4 = emu.autopilots[0]
    px4.request(emu.time_s, mode)
    px4.held_sticks = (0.0, 0.0, 0.0, 0.0)
    run_for(emu, 0.1)
    assert px4.request_arm(emu.time_s, True, 0.0) is CommandResult.ACCEPTED

    run_for(emu, 2.0)
    assert _height_m(emu) == pytest.approx(0.0, abs=0.01)
    assert px4.landed is LandedState.ON_GROUND

    px4.held_sticks = (0.0, 0.0, 0.8, 0.0)
    until(emu, lambda: _height_m(emu) > 1.0, 5.0)
    assert px4.landed is LandedState.IN_AIR

    px4.held_sticks = (0.0, 0.0, 0.2, 0.0)
    until(emu, lambda: not px4.is_armed, 20.0)
    assert _height_m(emu) == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("throttle", [-1.0, 2.0])
def test_no_throttle_commands_a_thrust_beyond_its_range(throttle: float) -> None:
    emu = _taken(Mode.STABILIZED, (0.0, 0.0, throttle, 0.0))
    run_for(emu, 0.1)
    assert 0.0 <= emu.autopilots[0].actuation.thrust_frac <= 1.0
