"""What may leave for PX4.

A quaternion of zeros ends the attitude control of PX4 v1.18 until it restarts.
"""

from __future__ import annotations

import math

import pytest

from onboard.frames import Quaternion
from onboard.safety.setpoint_check import is_sendable
from onboard.types import AttitudeSetpoint

_HALF = math.radians(25.0) / 2.0


@pytest.mark.parametrize(
    "quaternion",
    [
        (0.0, 0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, 1e-30),
        (1e-200, 0.0, 0.0, 0.0),
        (0.5, 0.0, 0.0, 0.0),
        (3.0, 0.0, 0.0, 0.0),
        (math.nan, 0.0, 0.0, 0.0),
        (1.0, 0.0, 0.0, math.nan),
        (math.inf, 0.0, 0.0, 0.0),
        (math.cos(_HALF), math.sin(_HALF), 0.0, 0.0),
    ],
)
def test_no_attitude_leaves_that_is_no_rotation_or_leans_too_far(
    quaternion: Quaternion,
) -> None:
    assert not is_sendable(AttitudeSetpoint(quaternion, 0.5), 20.0)


@pytest.mark.parametrize("thrust", [math.nan, -0.01, 1.01, math.inf])
def test_no_thrust_leaves_that_px4_would_fall_with(thrust: float) -> None:
    assert not is_sendable(AttitudeSetpoint((1.0, 0.0, 0.0, 0.0), thrust), 20.0)


def test_level_at_any_heading_leaves() -> None:
    for degrees in range(0, 360, 15):
        half = math.radians(degrees) / 2.0
        assert is_sendable(AttitudeSetpoint((math.cos(half), 0.0, 0.0, math.sin(half)), 0.5), 20.0)


@pytest.mark.parametrize("thrust", [0.0, 1.0])
def test_no_thrust_and_all_of_it_leave(thrust: float) -> None:
    assert is_sendable(AttitudeSetpoint((1.0, 0.0, 0.0, 0.0), thrust), 20.0)


@pytest.mark.parametrize(("squared_length", "may_leave"), [(1.0009, True), (1.0011, False)])
def test_a_quaternion_is_a_unit_one_but_for_rounding(
    squared_length: float, may_leave: bool
) -> None:
    quaternion = (math.sqrt(squared_length), 0.0, 0.0, 0.0)
    assert is_sendable(AttitudeSetpoint(quaternion, 0.5), 20.0) is may_leave


@pytest.mark.parametrize(("tilt_deg", "may_leave"), [(20.9, True), (21.1, False), (179.0, False)])
def test_it_leans_by_the_largest_tilt_and_a_degree_of_rounding_to_any_side(
    tilt_deg: float, may_leave: bool
) -> None:
    half_rad = math.radians(tilt_deg) / 2.0
    for side_deg in (0.0, 30.0, 90.0, 200.0):
        axis = (math.cos(math.radians(side_deg)), math.sin(math.radians(side_deg)))
        quaternion = (
            math.cos(half_rad),
            math.sin(half_rad) * axis[0],
            math.sin(half_rad) * axis[1],
            0.0,
        )
        assert is_sendable(AttitudeSetpoint(quaternion, 0.5), 20.0) is may_leave
