"""Descent without poses: quick, slow where the ground may be, and above nobody."""

from __future__ import annotations

import math

import pytest

from onboard.avoidance.heights import Climb, sink_limit_m_s
from onboard.avoidance.prediction import Motion
from onboard.config.fleet import load_fleet
from onboard.control import sinking, trajectory
from onboard.control.pipeline import pipeline_params
from onboard.types import Goal, Neighbour
from onboard.vectors import ZERO_3, Vec3

DT_S = 0.02
PARAMS = sinking.sinking_params(1.5, 0.49, has_mocap=True)


def descent(height_m: float, velocity: Vec3, limit_m_s: float = math.inf, seconds: float = 5.0):
    """Yield height and velocity of a vehicle that follows the setpoint of its speed at once."""
    position = Vec3(0.0, 0.0, height_m)
    leg = trajectory.initial(position)
    goal = Goal(ZERO_3, 0.0, 1)
    for _ in range(round(seconds / DT_S)):
        ahead = Motion(position, velocity)
        leg, setpoint = sinking.step(leg, ahead, goal, PARAMS, limit_m_s, DT_S)
        change = setpoint.velocity_enu_m_s.z - velocity.z
        most = PARAMS.vertical_m_s2 * DT_S
        z = velocity.z + min(max(change, -most), most)
        velocity = Vec3(setpoint.velocity_enu_m_s.x, setpoint.velocity_enu_m_s.y, z)
        position = Vec3(
            position.x + DT_S * velocity.x,
            position.y + DT_S * velocity.y,
            position.z + DT_S * velocity.z,
        )
        yield position, velocity


@pytest.mark.parametrize("height_m", [0.5, 1.0, 2.5, 5.0])
def test_it_is_slow_wherever_the_ground_may_be_and_lasts_as_long_as_is_said(
    height_m: float,
) -> None:
    flown = list(descent(height_m, ZERO_3))
    low = [v.z for p, v in flown if p.z < sinking.SLOW_BELOW_M]
    assert min(low) > -1.1 * sinking.SLOW_M_S
    down_s = DT_S * sum(p.z > 0.0 for p, _ in flown)
    assert down_s == pytest.approx(sinking.sinking_s(height_m, PARAMS), abs=0.1)


def test_from_two_and_a_half_metres_it_is_down_in_little_more_than_two_seconds() -> None:
    weak = sinking.sinking_params(1.5, 0.75, has_mocap=True)
    assert sinking.sinking_s(2.5, PARAMS) < 2.1
    assert sinking.sinking_s(2.5, weak) < 2.5


def test_by_satellites_it_is_slow_from_higher_up() -> None:
    by_satellites = sinking.sinking_params(1.5, 0.49, has_mocap=False)
    assert sinking.sink_speed_m_s(1.2, by_satellites) == sinking.SLOW_M_S
    assert sinking.sink_speed_m_s(1.2, PARAMS) > 1.5


def test_it_brakes_straight_and_does_not_come_back() -> None:
    flown = list(descent(3.0, Vec3(0.8, 0.6, 0.0)))
    speeds = [math.hypot(v.x, v.y) for _, v in flown]
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[round(0.5 / DT_S)] < 1e-6
    assert math.hypot(flown[-1][0].x, flown[-1][0].y) < 0.25


def test_it_sinks_no_faster_than_those_below_let_it() -> None:
    heights = [p.z for p, _ in descent(2.5, ZERO_3, limit_m_s=0.0)]
    assert min(heights) == pytest.approx(2.5, abs=1e-6)


def test_the_leg_after_it_continues_its_motion() -> None:
    leg = trajectory.initial(Vec3(0.0, 0.0, 2.0))
    ahead = Motion(Vec3(0.0, 0.0, 2.0), Vec3(1.0, 0.0, -1.5))
    leg, told = sinking.step(leg, ahead, Goal(ZERO_3, 0.0, 1), PARAMS, math.inf, DT_S)
    now = trajectory.setpoint(leg)
    assert now.position_enu_m == pytest.approx(told.position_enu_m)
    assert now.velocity_enu_m_s == pytest.approx(told.velocity_enu_m_s)


@pytest.mark.parametrize(
    ("gap_m", "below_m_s", "limit_m_s"),
    [
        (1.2, 0.0, 0.0),  # it stays up
        (1.2, -0.8, 0.8),  # it follows
        (1.7, 0.0, 1.0),  # it can still stop 1.2 m above the other
        (-0.1, 0.0, math.inf),  # the other is above
    ],
)
def test_above_another_it_sinks_only_as_far_as_it_can_stop(
    gap_m: float, below_m_s: float, limit_m_s: float
) -> None:
    spacing = pipeline_params(load_fleet("configs/fleets/above.toml"), "mav0").law.spacing
    at = Vec3(0.0, 0.0, 1.0)
    moves = Vec3(0.0, 0.0, below_m_s)
    other = Neighbour(
        position_enu_m=at,
        velocity_enu_m_s=moves,
        acceleration_enu_m_s2=ZERO_3,
        predicted_position_enu_m=at,
        predicted_velocity_enu_m_s=moves,
        commanded_acceleration_enu_m_s2=ZERO_3,
        intent_enu_m_s=moves,
        age_s=0.0,
        lead_time_s=0.0,
        position_std_m=0.0,
        velocity_std_m_s=0.0,
        crowd_count=0.0,
        is_cooperative=True,
        is_paper_obstacle=False,
        table_index=0,
        radius_m=0.0,
    )
    height_m = 1.0 + gap_m
    own = Climb(
        height_m=height_m,
        ahead_m=height_m,
        velocity_m_s=0.0,
        intended_climb_m=-2.0,
        position_std_m=0.0,
    )
    assert sink_limit_m_s(own, other, 0.0, spacing) == pytest.approx(limit_m_s, abs=1e-6)
