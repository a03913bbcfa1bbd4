"""The position controller of PX4's own modes (take-off, hold, land, return) and of position
setpoints in OFFBOARD.

A plain cascade with integral action: these modes have to fly safely and about as fast as PX4, not
exactly alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from sitl.physics import frames
from sitl.physics.frames import Array
from sitl.physics.vehicle import GRAVITY_M_S2

_POSITION_GAIN_1_S = 0.95
_VELOCITY_GAIN_1_S = (1.8, 1.8, 4.0)
_INTEGRAL_GAIN_1_S2 = (0.4, 0.4, 2.0)
_INTEGRAL_LIMIT_M_S2 = (2.0, 2.0, 8.0)
_THRUST_MIN = 0.12
_MOST_ACCELERATION_M_S2 = 20.0


def _nothing() -> Array:
    return np.full(3, math.nan)


@dataclass(frozen=True, slots=True)
class PositionGoal:
    """Goal of the position control, local NED.

    NaN leaves an axis to the next quantity: position, then velocity, then acceleration.
    """

    # position_ned_m, velocity_ned_m_s, acceleration_ned_m_s2: (3,) setpoints; where several are
    # given, the later ones are added to what the first asks
    position_ned_m: Array
    velocity_ned_m_s: Array
    yaw_rad: float  # heading; NaN keeps the present one
    acceleration_ned_m_s2: Array = field(default_factory=_nothing)
    yaw_rate_rad_s: float = math.nan  # how fast the heading turns on; NaN for not at all


@dataclass(frozen=True, slots=True)
class PositionLimits:
    """Limits from the parameters: speeds [m/s] horizontally, up and down, and the tilt [rad]."""

    speed_m_s: float
    up_m_s: float
    down_m_s: float
    tilt_rad: float


@dataclass(slots=True)
class PositionControl:
    """Memory of one vehicle's controller."""

    integral_m_s2: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])

    def reset(self) -> None:
        """Forget the integral, as when the vehicle has stood on the ground."""
        self.integral_m_s2 = [0.0, 0.0, 0.0]

    def forget_horizontal(self) -> None:
        """Forget what was learnt of wind and drag, as when the mode changes."""
        self.integral_m_s2[:2] = [0.0, 0.0]

    def step(
        self,
        goal: PositionGoal,
        position_ned_m: Array,
        velocity_ned_m_s: Array,
        dt_s: float,
        *,
        hover_thrust_frac: float,
        limits: PositionLimits,
        yaw_rad: float,
    ) -> tuple[Array, float]:
        """One step at a heading.

        Returns:
            attitude NED <- FRD (4,) and collective thrust in [0, 1].
        """
        here, speed_now = position_ned_m.tolist(), velocity_ned_m_s.tolist()
        wanted_speed = _velocity(goal, here, limits)
        feed = goal.acceleration_ned_m_s2.tolist()
        wanted = [0.0, 0.0, 0.0]
        for axis in range(3):
            if math.isfinite(wanted_speed[axis]):
                error = wanted_speed[axis] - speed_now[axis]
                limit = _INTEGRAL_LIMIT_M_S2[axis]
                learnt = self.integral_m_s2[axis] + _INTEGRAL_GAIN_1_S2[axis] * error * dt_s
                self.integral_m_s2[axis] = learnt = min(limit, max(-limit, learnt))
                wanted[axis] = _VELOCITY_GAIN_1_S[axis] * error + learnt
            if math.isfinite(feed[axis]):
                wanted[axis] += min(
                    _MOST_ACCELERATION_M_S2, max(-_MOST_ACCELERATION_M_S2, feed[axis])
                )
        # Body z is opposite to the thrust, which carries the weight and what is wanted besides.
        down = [-wanted[0], -wanted[1], max(GRAVITY_M_S2 - wanted[2], 0.2 * GRAVITY_M_S2)]
        horizontal = math.hypot(down[0], down[1])
        most = math.tan(limits.tilt_rad) * down[2]
        if horizontal > most:
            down[0] *= most / horizontal
            down[1] *= most / horizontal
        thrust = hover_thrust_frac * math.hypot(*down) / GRAVITY_M_S2
        return attitude_for(np.array(down), yaw_rad), min(1.0, max(_THRUST_MIN, thrust))


def _velocity(goal: PositionGoal, here: list[float], limits: PositionLimits) -> list[float]:
    """Velocity that position and velocity ask for together, within the limits; NaN on axes without
    either.
    """
    out = [math.nan] * 3
    for axis, (position, speed) in enumerate(
        zip(goal.position_ned_m.tolist(), goal.velocity_ned_m_s.tolist(), strict=True)
    ):
        if math.isfinite(position):
            out[axis] = _POSITION_GAIN_1_S * (position - here[axis]) + (
                speed if math.isfinite(speed) else 0.0
            )
        elif math.isfinite(speed):
            out[axis] = speed
    horizontal = math.hypot(*(c for c in out[:2] if math.isfinite(c)))
    if horizontal > limits.speed_m_s:
        out[:2] = [c * limits.speed_m_s / horizontal for c in out[:2]]
    if math.isfinite(out[2]):
        out[2] = min(max(out[2], -limits.up_m_s), limits.down_m_s)
    return out


def attitude_for(down: Array, yaw_rad: float) -> Array:
    """Attitude whose body z points along `down` (3,), at a heading."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    unit = down / np.linalg.norm(down)
    from_heading = np.array([c * unit[0] + s * unit[1], -s * unit[0] + c * unit[1], unit[2]])
    return frames.from_yaw_and_tilt(np.float64(yaw_rad), frames.tilt_from_down(from_heading))  # type: ignore[arg-type]
