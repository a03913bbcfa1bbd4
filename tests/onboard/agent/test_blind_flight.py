"""Poses that are lost in flight: the vehicle brakes and sinks by dead reckoning, under the law, and
lands by itself.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from onboard import agent_commands
from onboard.autopilot import Landed
from onboard.flight.state_machine import begin_failsafe
from onboard.flight.types import FlightStep, FlightView
from onboard.safety.failsafe_table import Action
from tests.onboard.agent.rig import Rig, hovering_rig, ready_rig


def lost(after_s: float = 1.0) -> Rig:
    """A vehicle on its way at a metre per second whose poses have just stopped."""
    rig = hovering_rig()
    rig.order("move", order_id="away", position_enu_m=(3.0, 0.0, 1.0))
    rig.run(after_s)
    rig.has_mocap = False
    return rig


def test_it_brakes_sinks_and_lands_by_itself_and_the_accuracy_it_tells_grows_slowly() -> None:
    rig = lost()
    assert rig.state is not None
    std_m = rig.state.position_std_m
    lost_ns = rig.now_ns
    lost_m = rig.position.copy()
    rig.run(0.3)
    assert rig.core.flight.step is FlightStep.COASTING
    rig.run(0.5)
    assert rig.core.flight.step is FlightStep.SINKING
    assert rig.state.is_valid
    assert rig.state.is_cooperative
    assert rig.state.position_std_m == pytest.approx(std_m + 0.05 * 0.6, abs=0.002)
    assert np.linalg.norm(np.array(rig.state.position_enu_m) - rig.position) < 0.05
    assert rig.velocity[2] > -1.1
    rig.until("landed")
    assert rig.now_ns - lost_ns < 9_000_000_000
    assert rig.count(agent_commands.Px4Land) == 0
    assert np.hypot(*(rig.position - lost_m)[:2]) < 0.8


def test_poses_that_are_back_within_0_6_s_let_the_order_go_on() -> None:
    rig = lost()
    rig.run(0.56)
    assert rig.core.flight.step is FlightStep.COASTING
    rig.has_mocap = True
    rig.run(1.0)
    assert rig.position[2] > 0.5
    rig.run(9.0)
    assert rig.position == pytest.approx([3.0, 0.0, 1.0], abs=0.15)
    assert rig.outcomes()["away"] == "done"


@pytest.mark.parametrize("step", [FlightStep.CLIMB, FlightStep.ARRIVED])
def test_a_short_loss_in_a_climb_or_in_hover_ends_where_it_was_going_to_be(
    step: FlightStep,
) -> None:
    rig = ready_rig()
    rig.order("takeoff", height_m=1.0)
    while rig.core.flight.step is not step:
        rig.step()
    rig.has_mocap = False
    rig.run(0.5)
    rig.has_mocap = True
    rig.run(4.0)
    assert rig.position == pytest.approx([0.0, 0.0, 1.0], abs=0.2)
    assert rig.outcomes() == {"o0": "done"}


def test_what_asks_for_a_hold_meanwhile_ends_the_order() -> None:
    rig = lost()
    rig.run(0.3)
    x, y, z = rig.position.tolist()
    view = FlightView(
        now_ns=rig.now_ns,
        position_enu_m=(x, y, z),
        velocity_enu_m_s=(0.0, 0.0, 0.0),
        has_position=True,
        snapshot=rig.snapshot,
        is_dead_reckoned=True,
    )
    begin_failsafe(rig.core.flight, view, Action.HOLD, "Bus lost: holding.")
    rig.run(0.2)
    rig.has_mocap = True
    rig.run(1.0)
    assert rig.core.flight.state == "holding"
    assert rig.outcomes()["away"] == "failed"


@pytest.mark.parametrize("back_s", [0.8, 1.5, 2.5, 6.5])
def test_poses_that_are_back_later_do_not_end_the_landing_nor_hand_it_to_px4(back_s: float) -> None:
    rig = lost()
    rig.run(back_s)
    rig.has_mocap = True
    rig.until("landed")
    assert rig.count(agent_commands.Px4Land) == 0


@pytest.mark.parametrize("back_s", [1.0, 1.5, 2.0, 2.5])
def test_an_old_pose_with_a_new_stamp_after_the_outage_neither_lifts_nor_throttles_it(
    back_s: float,
) -> None:
    rig = lost()
    x, y, z = rig.position.tolist()
    rig.run(back_s)
    rig.pose(position_enu_m=(x, y, z), stamp_ns=rig.now_ns)
    rig.has_mocap = True
    highest_m = rig.position[2]
    throttle_frac = 0.0
    for _ in range(200):
        rig.step()
        assert rig.position[2] < highest_m + 0.05
        stands = rig.core.flight.step is FlightStep.CONTACT
        if stands and rig.setpoint is not None:
            throttle_frac = max(throttle_frac, rig.setpoint.thrust_frac)
    assert rig.count(agent_commands.Px4Land) == 0
    assert throttle_frac == 0.0
    assert np.linalg.norm(np.array(rig.core.own.position_enu_m) - rig.position) < 0.05


def test_px4s_height_that_is_wrong_by_a_third_of_a_metre_cuts_no_thrust_in_the_air() -> None:
    for error_m in (-0.35, 0.35):
        rig = lost()
        rig.height_error_m = error_m
        speed_m_s = 0.0
        while rig.core.flight.step is not FlightStep.CONTACT:
            speed_m_s = min(speed_m_s, float(rig.velocity[2]))
            rig.step()
        assert rig.position[2] < 0.01
        assert -1.2 < speed_m_s < -0.5


def test_in_a_landing_it_goes_on_sinking_and_an_order_to_land_changes_nothing() -> None:
    rig = lost()
    rig.order("land")
    rig.run(0.3)
    assert rig.core.flight.step is FlightStep.SINKING
    assert not rig.order("hold").is_accepted
    answer = rig.order("move", position_enu_m=(1.0, 0.0, 1.0))
    assert not answer.is_accepted
    assert "is landing (descent without poses)" in answer.reason
    assert rig.order("land", order_id="down").is_accepted
    rig.until("landed")
    assert rig.outcomes()["down"] == "done"


def test_px4_lands_what_is_still_in_the_air_after_six_seconds() -> None:
    rig = lost()
    there = rig.position.copy()

    def keep_up() -> None:  # a strong updraft
        rig.position = there.copy()
        rig.velocity = rig.velocity * 0.0

    rig.after_move = keep_up
    rig.run(5.9)
    assert rig.count(agent_commands.Px4Land) == 0
    rig.run(0.3)
    assert rig.count(agent_commands.Px4Land) == 1
    rig.run(1.0)
    assert rig.state is not None
    assert rig.state.is_valid  # where PX4's own motion has led since
    assert not rig.state.is_cooperative


def test_on_the_ground_the_thrust_stays_off_and_nothing_is_handed_to_px4() -> None:
    rig = lost()
    rig.sees_ground = False  # nor does PX4 see it
    while rig.core.flight.step is not FlightStep.CONTACT:
        rig.step()
    contact_ns = rig.now_ns
    rig.run(3.0)
    setpoints = [
        command.setpoint
        for t, command in rig.sent
        if isinstance(command, agent_commands.SendAttitude) and t > contact_ns
    ]
    assert len(setpoints) > 140
    assert {setpoint.thrust_frac for setpoint in setpoints} == {0.0}
    assert rig.count(agent_commands.Px4Land) == 0


def test_px4s_height_that_comes_back_up_on_the_ground_is_no_landing_that_rises() -> None:
    rig = lost()
    rig.sees_ground = False
    while rig.core.flight.step is not FlightStep.CONTACT:
        rig.step()
    heights_m = iter(np.linspace(rig.position[2], rig.position[2] + 0.8, 75))

    def drift() -> None:  # its estimator corrects what it took the touch-down for
        rig.position[2] = next(heights_m, rig.position[2])
        rig.velocity[2] = 0.0

    rig.after_move = drift
    rig.run(2.5)
    assert rig.core.flight.step is FlightStep.CONTACT
    assert rig.count(agent_commands.Px4Land) == 0


def test_a_start_whose_poses_stop_at_lift_off_ends_on_the_ground() -> None:
    rig = ready_rig()
    rig.order("takeoff", height_m=1.0)
    while rig.core.flight.step is not FlightStep.LIFTOFF:
        rig.step()
    rig.has_mocap = False
    rig.until("landed")
    assert rig.position[2] < 0.01
    assert rig.count(agent_commands.Px4Land) == 0


def test_poses_that_stop_for_a_moment_at_lift_off_are_the_reason_of_the_landing() -> None:
    rig = ready_rig()
    rig.order("takeoff", height_m=1.0, order_id="up")
    while rig.core.flight.step is not FlightStep.LIFTOFF:
        rig.step()
    rig.has_mocap = False
    rig.run(0.3)
    rig.has_mocap = True
    rig.until("landed")
    told = [event.sentence for event in rig.events]
    assert told.count("Its position was lost at the lift-off: landing.") == 2  # event, and end
    assert rig.outcomes()["up"] == "failed"


def test_from_the_first_moment_that_it_seems_to_stand_it_says_that_it_does_not_move() -> None:
    rig = lost()
    while rig.position[2] > rig.floor_m:
        rig.step()
    touched_ns = rig.now_ns

    leaning = (math.cos(0.2), 0.0, math.sin(0.2), 0.0)  # as with a leg on a stone

    def lean() -> None:
        rig.snapshot = replace(rig.snapshot, quaternion_enu_flu_wxyz=leaning)

    rig.after_move = lean
    rig.run(0.12)
    assert rig.state is not None
    said_m = np.array(rig.state.position_enu_m[:2])
    rig.until("landed")
    assert rig.now_ns - touched_ns > 250_000_000
    assert np.linalg.norm(np.array(rig.state.position_enu_m[:2]) - said_m) < 0.01


def test_motors_that_stop_in_a_descent_without_poses_are_said_and_are_no_landing() -> None:
    rig = lost()
    while rig.core.flight.step is not FlightStep.SINKING:
        rig.step()
    rig.is_armed = False
    rig.until("failed", 2.0)
    critical = [event.code for event in rig.events if event.severity == "critical"]
    assert "disarmed-in-flight" in critical
    rig.until("landed")
    assert "fell" in rig.order("land").reason


def test_px4_that_disarms_after_a_while_on_the_ground_ends_a_descent_without_poses() -> None:
    rig = lost()
    assert rig.order("land", order_id="down").is_accepted
    while rig.core.flight.step is not FlightStep.SINKING:
        rig.step()
    rig.height_error_m = 1.0  # so it does not know that it has come down
    while rig.position[2] > 0.0:
        rig.step()
    rig.landed_report = Landed.ON_GROUND
    rig.run(1.6)
    assert rig.core.flight.step is FlightStep.SINKING
    rig.is_armed = False
    rig.until("landed", 1.5)
    assert rig.outcomes()["down"] == "done"
