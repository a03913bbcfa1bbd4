"""The position controller of PX4's own modes and of position setpoints in OFFBOARD.

It is a cascade: position to velocity, velocity with integral action to acceleration, acceleration
to attitude and thrust. Take-off, hold, landing and return are safe and about as fast as in PX4, but
not identical.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from sitl.physics import frames
from sitl.physics.frames import Array
from sitl.physics.vehicle import GRAVITY_M_S2

_POSITION_GAIN_1_S = 0.95

_DOWN = 2  # index of the vertical axis

# For north, east, down.
_VELOCITY_GAIN_1_S = (1.8, 1.8, 4.0)
_INTEGRAL_GAIN_1_S2 = (0.4, 0.4, 2.0)
_VERTICAL_INTEGRAL_LIMIT_M_S2 = GRAVITY_M_S2
_UNWIND_GAIN = 2.0 / _VELOCITY_GAIN_1_S[0]  # gain of PX4's tracking anti-windup [s]

_THRUST_MIN = 0.12  # MPC_THR_MIN
_MIN_LIFT = 0.2  # minimum lift in units of the weight, because the tilt is undefined without lift
_MAX_ACCELERATION_M_S2 = 20.0  # largest acceleration that a setpoint adds, per axis


def _unset() -> Array:
    return np.full(3, math.nan)


@dataclass(frozen=True, slots=True)
class PositionGoal:
    """Goal of the position control, local NED.

    The first of position, velocity and acceleration that is not NaN controls an axis. Those after
    it are added as feedforward.
    """

    position_ned_m: Array  # (3,)
    velocity_ned_m_s: Array  # (3,)
    yaw_rad: float  # heading; NaN keeps the present one
    acceleration_ned_m_s2: Array = field(default_factory=_unset)  # (3,)
    yaw_rate_rad_s: float = math.nan  # rate at which the heading turns; NaN: it does not turn


@dataclass(frozen=True, slots=True)
class PositionLimits:
    """Limits from the parameters."""

    speed_m_s: float  # horizontal
    up_m_s: float
    down_m_s: float
    tilt_rad: float


@dataclass(slots=True)
class PositionControl:
    """State of one vehicle's controller."""

    integral_m_s2: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])

    def reset(self) -> None:
        """Reset the integral, as PX4 does on the ground."""
        self.integral_m_s2 = [0.0, 0.0, 0.0]

    def forget_horizontal(self) -> None:
        """Reset the horizontal integral, as PX4 does in a new mode. It balances wind and drag."""
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
        """Advance the controller by one step.

        The horizontal integral has no limit of its own, as in PX4, because it has to balance the
        drag. What the tilt cannot give unwinds it.

        Args:
            goal: goal to fly to.
            position_ned_m: estimated position (3,).
            velocity_ned_m_s: estimated velocity (3,).
            dt_s: time since the last step.
            hover_thrust_frac: thrust that carries the weight.
            limits: limits of speed and tilt.
            yaw_rad: heading of the returned attitude; that of the goal is not used here.

        Returns:
            attitude NED <- FRD (4,) and collective thrust in [0, 1].
        """
        velocity_setpoint_m_s = _velocity_setpoint(goal, position_ned_m.tolist(), limits)
        acceleration_m_s2 = self._acceleration(
            velocity_setpoint_m_s,
            velocity_ned_m_s.tolist(),
            goal.acceleration_ned_m_s2.tolist(),
            dt_s,
        )

        # Body z is opposite to the thrust, which balances the weight and accelerates the vehicle.
        north_m_s2, east_m_s2, down_m_s2 = acceleration_m_s2
        lift_m_s2 = max(GRAVITY_M_S2 - down_m_s2, _MIN_LIFT * GRAVITY_M_S2)

        # Limit the tilt by reducing the horizontal acceleration, never the lift.
        horizontal_m_s2 = math.hypot(north_m_s2, east_m_s2)
        most_m_s2 = math.tan(limits.tilt_rad) * lift_m_s2
        share = 1.0
        if horizontal_m_s2 > most_m_s2:
            share = most_m_s2 / horizontal_m_s2
            unwind_m_s = _UNWIND_GAIN * (1.0 - share)
            self._integrate(0, -unwind_m_s * north_m_s2, dt_s)
            self._integrate(1, -unwind_m_s * east_m_s2, dt_s)
        body_z_m_s2 = (-share * north_m_s2, -share * east_m_s2, lift_m_s2)

        thrust_frac = hover_thrust_frac * math.hypot(*body_z_m_s2) / GRAVITY_M_S2
        attitude = attitude_for(np.array(body_z_m_s2), yaw_rad)
        return attitude, min(1.0, max(_THRUST_MIN, thrust_frac))

    def _acceleration(
        self,
        setpoint_m_s: list[float],
        velocity_m_s: list[float],
        feedforward_m_s2: list[float],
        dt_s: float,
    ) -> list[float]:
        """Return the acceleration that follows the velocity setpoint, NED [m/s^2]."""
        acceleration_m_s2 = [0.0, 0.0, 0.0]

        for axis in range(3):
            if math.isfinite(setpoint_m_s[axis]):
                error_m_s = setpoint_m_s[axis] - velocity_m_s[axis]
                self._integrate(axis, error_m_s, dt_s)
                acceleration_m_s2[axis] = (
                    _VELOCITY_GAIN_1_S[axis] * error_m_s + self.integral_m_s2[axis]
                )

            if math.isfinite(feedforward_m_s2[axis]):
                most_m_s2 = _MAX_ACCELERATION_M_S2
                acceleration_m_s2[axis] += min(most_m_s2, max(-most_m_s2, feedforward_m_s2[axis]))

        return acceleration_m_s2

    def _integrate(self, axis: int, error_m_s: float, dt_s: float) -> None:
        """Add an error of the velocity to the integral of an axis."""
        integral_m_s2 = self.integral_m_s2[axis] + _INTEGRAL_GAIN_1_S2[axis] * error_m_s * dt_s
        if axis == _DOWN:
            limit_m_s2 = _VERTICAL_INTEGRAL_LIMIT_M_S2
            integral_m_s2 = min(limit_m_s2, max(-limit_m_s2, integral_m_s2))
        self.integral_m_s2[axis] = integral_m_s2


def _velocity_setpoint(
    goal: PositionGoal, position_ned_m: list[float], limits: PositionLimits
) -> list[float]:
    """Return the velocity for the position and velocity of a goal, within the limits.

    It is NaN on the axes that have neither a position nor a velocity.
    """
    velocity_m_s = [math.nan] * 3
    goal_position_ned_m = goal.position_ned_m.tolist()
    goal_velocity_ned_m_s = goal.velocity_ned_m_s.tolist()

    for axis in range(3):
        goal_position_m = goal_position_ned_m[axis]
        goal_velocity_m_s = goal_velocity_ned_m_s[axis]

        if math.isfinite(goal_position_m):
            approach_m_s = _POSITION_GAIN_1_S * (goal_position_m - position_ned_m[axis])
            velocity_m_s[axis] = approach_m_s
            if math.isfinite(goal_velocity_m_s):
                velocity_m_s[axis] += goal_velocity_m_s
        elif math.isfinite(goal_velocity_m_s):
            velocity_m_s[axis] = goal_velocity_m_s

    horizontal_m_s = math.hypot(*(part for part in velocity_m_s[:2] if math.isfinite(part)))
    if horizontal_m_s > limits.speed_m_s:
        velocity_m_s[:2] = [part * limits.speed_m_s / horizontal_m_s for part in velocity_m_s[:2]]

    if math.isfinite(velocity_m_s[2]):
        velocity_m_s[2] = min(max(velocity_m_s[2], -limits.up_m_s), limits.down_m_s)
    return velocity_m_s


def attitude_for(down: Array, yaw_rad: float) -> Array:
    """Return the attitude (4,) whose body z points along `down` (3,), at a heading."""
    unit = down / np.linalg.norm(down)

    # The same direction in the axes ahead, right and down of a level vehicle with this heading.
    north, east, down_part = unit
    c = math.cos(yaw_rad)
    s = math.sin(yaw_rad)
    in_level_axes = np.array([c * north + s * east, -s * north + c * east, down_part])

    tilt_rad = frames.tilt_from_down(in_level_axes)
    return frames.from_yaw_and_tilt(np.float64(yaw_rad), tilt_rad)  # type: ignore[arg-type]
