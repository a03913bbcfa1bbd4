"""Numbers that PX4 cannot mean are found before anything uses them."""

from __future__ import annotations

import math

import pytest
from msgspec.structs import replace

from onboard.autopilot import Snapshot
from onboard.safety.snapshot_check import nonsense

RIGHT = replace(
    Snapshot(),
    quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
    position_local_ned_m=(3.0, -4.0, -1.0),
    velocity_local_ned_m_s=(0.3, 0.4, 0.0),
)


@pytest.mark.parametrize("length", [0.96, 1.0, 1.04])
def test_possible_numbers_are_no_nonsense(length: float) -> None:
    assert nonsense(replace(RIGHT, quaternion_enu_flu_wxyz=(length, 0.0, 0.0, 0.0))) == ""
    assert nonsense(replace(RIGHT, position_local_ned_m=(99_999.0, 0.0, 0.0))) == ""
    assert nonsense(replace(RIGHT, velocity_local_ned_m_s=(0.0, 0.0, 999.0))) == ""


@pytest.mark.parametrize("length", [0.0, 0.94, 1.06, math.nan, math.inf])
def test_an_attitude_is_a_rotation(length: float) -> None:
    found = nonsense(replace(RIGHT, quaternion_enu_flu_wxyz=(0.0, 0.0, 0.0, length)))
    assert found == (
        f"PX4 sends an attitude that is no rotation (its quaternion has the length {length:.3g})."
    )


def test_a_place_beyond_the_horizon_and_a_speed_of_a_bullet_are_named() -> None:
    far = replace(RIGHT, position_local_ned_m=(0.0, 5_335_000.0, 0.0))
    assert nonsense(far) == "PX4 says that it is 5335 km from its origin."
    assert "km from its origin" in nonsense(replace(RIGHT, position_local_ned_m=(1e5, 0.0, 0.0)))
    assert "nan km" in nonsense(replace(RIGHT, position_local_ned_m=(0.0, math.nan, 0.0)))

    fast = replace(RIGHT, velocity_local_ned_m_s=(0.0, 0.0, 1200.0))
    assert nonsense(fast) == "PX4 says that it moves with 1200 m/s."
    assert "moves with" in nonsense(replace(RIGHT, velocity_local_ned_m_s=(1e3, 0.0, 0.0)))
    assert "moves with" in nonsense(replace(RIGHT, velocity_local_ned_m_s=(0.0, math.nan, 0.0)))
