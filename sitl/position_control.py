"""The position controller of PX4's own modes (take-off, hold, land, return) and of position setpoints in OFFBOARD.

A plain cascade with integral action: these modes have to fly safely and about as fast as PX4, not exactly alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from sitl import rotation
from sitl.rotation import Array
from sitl.vehicle import GRAVITY_M_S2

_POSITION_GAIN_1_S = 0.95
_VELOCITY_GAIN_1_S = np.array([1.8, 1.8, 4.0])
_INTEGRAL_GAIN_1_S2 = np.array([0.4, 0.4, 2.0])
_INTEGRAL_LIMIT_M_S2 = np.array([2.0, 2.0, 8.0])
_THRUST_MIN = 0.12


@dataclass(frozen=True, slots=True)
class Goal:
    """What to fly to, local NED; NaN entries of a position leave that axis to the velocity.

    Attributes:
        position_ned_m, velocity_ned_m_s: (3,) setpoints; the velocity is added to what the position asks.
        yaw_rad: heading.
    """

    position_ned_m: Array
    velocity_ned_m_s: Array
    yaw_rad: float


@dataclass(slots=True)
class PositionControl:
    """Memory of one vehicle's controller."""

    integral_m_s2: Array = field(default_factory=lambda: np.zeros(3))

    def reset(self) -> None:
        """Forget the integral, as when the vehicle has stood on the ground."""
        self.integral_m_s2 = np.zeros(3)

    def step(
        self,
        goal: Goal,
        position_ned_m: Array,
        velocity_ned_m_s: Array,
        dt_s: float,
        *,
        hover_thrust_frac: float,
        max_speed_m_s: float,
        max_up_m_s: float,
        max_down_m_s: float,
        max_tilt_rad: float,
    ) -> tuple[Array, float]:
        """One step.

        Returns:
            attitude NED <- FRD (4,) and collective thrust in [0, 1].
        """
        pull = _POSITION_GAIN_1_S * (goal.position_ned_m - position_ned_m)
        velocity = np.where(np.isfinite(pull), pull, 0.0) + goal.velocity_ned_m_s
        speed = math.hypot(velocity[0], velocity[1])
        if speed > max_speed_m_s:
            velocity[:2] *= max_speed_m_s / speed
        velocity[2] = min(max(velocity[2], -max_up_m_s), max_down_m_s)
        error = velocity - velocity_ned_m_s
        self.integral_m_s2 = np.clip(
            self.integral_m_s2 + _INTEGRAL_GAIN_1_S2 * error * dt_s, -_INTEGRAL_LIMIT_M_S2, _INTEGRAL_LIMIT_M_S2
        )
        wanted = _VELOCITY_GAIN_1_S * error + self.integral_m_s2
        # Body z is opposite to the thrust, which carries the weight and what is wanted besides.
        down = -wanted
        down[2] += GRAVITY_M_S2
        down[2] = max(down[2], 0.2 * GRAVITY_M_S2)
        horizontal = math.hypot(down[0], down[1])
        limit = math.tan(max_tilt_rad) * down[2]
        if horizontal > limit:
            down[:2] *= limit / horizontal
        thrust = hover_thrust_frac * float(np.linalg.norm(down)) / GRAVITY_M_S2
        return attitude_for(down, goal.yaw_rad), min(1.0, max(_THRUST_MIN, thrust))


def attitude_for(down: Array, yaw_rad: float) -> Array:
    """Attitude whose body z points along `down` (3,), at a heading."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    unit = down / np.linalg.norm(down)
    from_heading = np.array([c * unit[0] + s * unit[1], -s * unit[0] + c * unit[1], unit[2]])
    return rotation.from_yaw_and_tilt(np.float64(yaw_rad), rotation.tilt_from_down(from_heading))  # type: ignore[arg-type]
