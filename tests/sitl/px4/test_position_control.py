"""The position controller of PX4's own modes: the air's drag and wind are balanced."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sitl.physics.vehicle import GRAVITY_M_S2
from sitl.px4.position_control import PositionControl, PositionGoal, PositionLimits

_STEP_S = 0.01
_HOVER_THRUST_FRAC = 0.5
_DRAG_1_S = 1.0  # drag over mass
_UNSET = np.full(3, math.nan)
_HOLD = PositionGoal(position_ned_m=np.zeros(3), velocity_ned_m_s=_UNSET, yaw_rad=0.0)


class Body:
    """A point mass with drag that reaches the commanded attitude and thrust at once."""

    def __init__(self) -> None:
        self.control = PositionControl()
        self.position_ned_m = np.zeros(3)
        self.velocity_ned_m_s = np.zeros(3)

    def fly(
        self,
        goal: PositionGoal,
        duration_s: float,
        *,
        wind_ned_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0),
        tilt_deg: float = 45.0,
    ) -> None:
        limits = PositionLimits(
            speed_m_s=12.0, up_m_s=3.0, down_m_s=1.5, tilt_rad=math.radians(tilt_deg)
        )
        for _ in range(round(duration_s / _STEP_S)):
            (w, x, y, z), thrust_frac = self.control.step(
                goal,
                self.position_ned_m,
                self.velocity_ned_m_s,
                _STEP_S,
                hover_thrust_frac=_HOVER_THRUST_FRAC,
                limits=limits,
                yaw_rad=0.0,
            )
            body_z = np.array(
                (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))
            )
            acceleration_m_s2 = -thrust_frac / _HOVER_THRUST_FRAC * GRAVITY_M_S2 * body_z
            acceleration_m_s2[2] += GRAVITY_M_S2
            acceleration_m_s2 += _DRAG_1_S * (np.array(wind_ned_m_s) - self.velocity_ned_m_s)
            self.velocity_ned_m_s = self.velocity_ned_m_s + acceleration_m_s2 * _STEP_S
            self.position_ned_m = self.position_ned_m + self.velocity_ned_m_s * _STEP_S


def test_a_velocity_is_reached_against_the_drag() -> None:
    body = Body()
    goal = PositionGoal(
        position_ned_m=_UNSET, velocity_ned_m_s=np.array((5.0, -2.0, 0.0)), yaw_rad=0.0
    )

    body.fly(goal, 20.0)

    assert body.velocity_ned_m_s == pytest.approx((5.0, -2.0, 0.0), abs=0.1)


def test_a_place_is_held_in_wind() -> None:
    body = Body()

    body.fly(_HOLD, 20.0, wind_ned_m_s=(4.0, 3.0, 0.0))

    assert np.linalg.norm(body.position_ned_m) < 0.1


def test_a_vehicle_returns_from_a_wind_that_its_tilt_could_not_balance() -> None:
    body = Body()

    body.fly(_HOLD, 10.0, wind_ned_m_s=(4.0, 3.0, 0.0), tilt_deg=12.0)
    blown_m = float(np.linalg.norm(body.position_ned_m))
    body.fly(_HOLD, 30.0, tilt_deg=12.0)

    assert blown_m > 10.0
    assert np.linalg.norm(body.position_ned_m) < 0.1
