"""Errors of PX4's estimate, measured on its simulator, and random processes that reproduce them.

The velocity error is an Ornstein-Uhlenbeck process, e_v' = -e_v / tau + noise. The position error
integrates the velocity error, and measurements pull the position error back: e_p' = e_v - e_p / T.
T follows from the three measured numbers, since the variance of e_p is then
sigma_v^2 T^2 tau / (T + tau).

With a wrong heading, the filter integrates rotated accelerations, and satellites pull its estimate
back. The velocity error therefore grows by the difference between the rotated and the true
acceleration, and decays with the same tau and T. The estimated velocity shows little of the wrong
heading.

All these errors are slow, like those of a filter. This matters, because the separation that an
error costs depends more on its correlation time than on its size.

All processes run with unit variance and are multiplied by their present sizes, which change
smoothly when the source of the estimate changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from sitl.physics.frames import Array
from sitl.physics.jit import Record, Records, compiled

ERRORS = np.dtype(
    [
        # Processes of unit variance.
        ("unit_velocity", "f8", 3),
        ("unit_position", "f8", 3),
        # Present sizes [m, m/s, m].
        ("std_position", "f8", 3),
        ("std_velocity", "f8", 3),
        ("bias", "f8", 3),
        # Sizes that the present sizes approach.
        ("std_position_goal", "f8", 3),
        ("std_velocity_goal", "f8", 3),
        ("bias_goal", "f8", 3),
        # Couplings of the unit processes: sigma_v / sigma_p and 1 / T [1/s].
        ("ratio", "f8", 3),
        ("pull", "f8", 3),
        # Correlation of the velocity error over a step.
        ("keep", "f8"),
        # Offset of the local position from the true motion since the start [m].
        ("offset", "f8", 3),
        # Velocity and acceleration of the drift in dead reckoning [m/s, m/s^2].
        ("drift_velocity", "f8", 3),
        ("drift_acceleration", "f8", 3),
        # Turn about north and east that takes the estimated attitude to the true one, and the value
        # up to which it grows in dead reckoning [rad].
        ("tilt_error", "f8", 2),
        ("tilt_error_most", "f8", 2),
        # True horizontal velocity of the last step, and the errors of velocity and position that a
        # wrong heading has caused [m/s, m].
        ("last_velocity", "f8", 2),
        ("turned_velocity", "f8", 2),
        ("turned_position", "f8", 2),
        # True motion plus offset [m].
        ("base", "f8", 3),
        # Estimates [m, m/s].
        ("position", "f8", 3),
        ("velocity", "f8", 3),
        # Error of the compass: unit process, smoothed process, size and mean [rad].
        ("yaw_unit", "f8"),
        ("yaw_smooth", "f8"),
        ("yaw_std", "f8"),
        ("yaw_mean", "f8"),
        # Share of the compass in the heading, and its target value.
        ("yaw_share", "f8"),
        ("yaw_share_goal", "f8"),
        # Error of the heading by vision, and of the estimated heading [rad].
        ("vision_yaw", "f8"),
        ("yaw_error", "f8"),
        ("is_drifting", "?"),
        ("is_flying", "?"),
        ("has_satellites", "?"),
    ],
    align=True,
)

# The error of the compass is white noise through two lags with this time constant, which was not
# measured. The error changes only in flight, and smoothly, like the heading of a filter that
# integrates a gyro.
YAW_CORRELATION_S = 6.0
# With satellites PX4 corrects its heading in flight. The mean error decays at a rate of this
# [s^3/m^2] times the square of the horizontal acceleration. PX4s in simulation had 0.13 to 0.91.
YAW_FOUND_S3_M2 = 0.1
BLEND_S = 0.5  # time constant of the change from one error level to another
# The same for the position by satellites. Three PX4s in simulation erred by 0.08 m vertically at
# most 0.5 s after they had left the ground, by 0.2 m after 1 s, and by 0.6 m after 3 s.
BLEND_SATELLITES_S = 2.5

# Time constants north, east and down with which the velocity error of dead reckoning is damped. The
# vertical error stops growing soon, so the height stays at a wrong level.
DRIFT_DAMPING_S = (4.0, 4.0, 0.5)
# The attitude error starts at a quarter of its largest value and reaches that value after 3.5 s.
TILT_ERROR_AT_FIRST = 0.25
TILT_ERROR_GROWTH_S = 3.5 / math.log(4.0)

# Largest values of EKF2_EVP_NOISE and EKF2_TAU_VEL for which PX4 counts as tuned to vision.
_TRUSTED_NOISE_M = 0.03
_TUNED_TAU_S = 0.05

_ROOT_TWO = math.sqrt(2.0)


class Source(Enum):
    """Source of the position estimate."""

    GPS = "gps"
    VISION = "vision"
    NONE = "none"


@dataclass(frozen=True, slots=True)
class ErrorLevel:
    """Size and speed of the errors north, east and down."""

    position_m: tuple[float, float, float]  # standard deviation
    velocity_m_s: tuple[float, float, float]  # standard deviation
    correlation_s: float  # tau of the velocity error
    # Standard deviation over vehicles of a constant error of the position.
    bias_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def pull_s(self) -> tuple[float, float, float]:
        """Time constant T with which measurements pull the position error back, per axis [s].

        It solves sigma_p^2 = sigma_v^2 T^2 tau / (T + tau) for T, with r = (sigma_p / sigma_v)^2.
        """
        tau = self.correlation_s
        pull_s: list[float] = []
        for std_position_m, std_velocity_m_s in zip(
            self.position_m, self.velocity_m_s, strict=True
        ):
            r = (std_position_m / std_velocity_m_s) ** 2
            pull_s.append((r + math.sqrt(r * r + 4.0 * tau * tau * r)) / (2.0 * tau))

        north_s, east_s, down_s = pull_s
        return north_s, east_s, down_s


RESTING = ErrorLevel(
    position_m=(0.03, 0.03, 0.04),
    velocity_m_s=(0.015, 0.02, 0.02),
    correlation_s=3.4,
)
RESTING_WITH_VISION = ErrorLevel(
    position_m=(0.0025, 0.0025, 0.0025),
    velocity_m_s=(0.014, 0.014, 0.014),
    correlation_s=0.68,
)
GPS = ErrorLevel(
    position_m=(0.12, 0.20, 0.21),
    velocity_m_s=(0.16, 0.29, 0.10),
    correlation_s=3.4,
    bias_m=(0.09, 0.14, 0.18),
)
# Satellites with corrections, not measured. PX4's filter smooths the positions of the receiver, so
# a change by a metre with another fix takes time.
RTK_FLOAT = ErrorLevel(
    position_m=(0.06, 0.06, 0.10),
    velocity_m_s=(0.08, 0.12, 0.06),
    correlation_s=3.4,
    bias_m=(0.10, 0.10, 0.15),
)
RTK_FIXED = ErrorLevel(
    position_m=(0.010, 0.010, 0.018),
    velocity_m_s=(0.03, 0.03, 0.03),
    correlation_s=1.5,
    bias_m=(0.005, 0.005, 0.010),
)
# A vehicle in flight without vision. The horizontal errors come in addition to the drift. The
# height is that of the barometer, which PX4 compared with vision until vision was lost.
RECKONING = ErrorLevel(
    position_m=(0.12, 0.20, 0.04),
    velocity_m_s=(0.16, 0.29, 0.07),
    correlation_s=3.4,
    bias_m=(0.09, 0.14, 0.0),
)
VISION_DEFAULT = ErrorLevel(
    position_m=(0.039, 0.10, 0.05),
    velocity_m_s=(0.07, 0.17, 0.07),
    correlation_s=1.5,
)
VISION_TRUSTED = ErrorLevel(
    position_m=(0.016, 0.044, 0.02),
    velocity_m_s=(0.038, 0.106, 0.04),
    correlation_s=0.68,
)
VISION_TUNED = ErrorLevel(
    position_m=(0.0035, 0.010, 0.005),
    velocity_m_s=(0.018, 0.053, 0.02),
    correlation_s=0.20,
)
VISION_TUNED_WITH_VELOCITY = ErrorLevel(
    position_m=(0.003, 0.006, 0.004),
    velocity_m_s=(0.018, 0.039, 0.02),
    correlation_s=0.09,
)


def vision_level(evp_noise_m: float, tau_vel_s: float, *, has_velocity: bool = False) -> ErrorLevel:
    """Return the error level with external vision.

    Args:
        evp_noise_m: EKF2_EVP_NOISE.
        tau_vel_s: EKF2_TAU_VEL.
        has_velocity: whether ODOMETRY contains a velocity, which improves only the estimate of a
            tuned filter, as measured.
    """
    if evp_noise_m > _TRUSTED_NOISE_M:
        return VISION_DEFAULT
    if tau_vel_s > _TUNED_TAU_S:
        return VISION_TRUSTED
    if has_velocity:
        return VISION_TUNED_WITH_VELOCITY
    return VISION_TUNED


def set_level(error: Record, level: ErrorLevel, bias_draw: Array, dt_s: float) -> None:
    """Let the errors of one vehicle approach a level.

    Args:
        error: record ERRORS of the vehicle, updated.
        level: the level to approach.
        bias_draw: standard normal numbers (3,) that scale the constant error.
        dt_s: length of a step.
    """
    error["std_position_goal"] = level.position_m
    error["std_velocity_goal"] = level.velocity_m_s
    error["bias_goal"] = bias_draw * level.bias_m
    error["pull"] = 1.0 / np.array(level.pull_s)
    error["ratio"] = np.array(level.velocity_m_s) / np.array(level.position_m)
    error["keep"] = math.exp(-dt_s / level.correlation_s)


@compiled
def _advance_motion(e: Record, draws: Array, dt_s: float, position: Array, velocity: Array) -> None:
    """Advance the errors of position and velocity of one vehicle, and form its estimates."""
    blend = dt_s / BLEND_S
    position_blend = blend
    if e.has_satellites:
        position_blend = dt_s / BLEND_SATELLITES_S
    spread = math.sqrt(1.0 - e.keep * e.keep)  # with it the variance of the unit process stays 1

    for k in range(3):
        # The unit processes.
        unit = e.keep * e.unit_velocity[k] + spread * draws[k]
        e.unit_velocity[k] = unit
        e.unit_position[k] += dt_s * (e.ratio[k] * unit - e.pull[k] * e.unit_position[k])

        # The sizes of the errors.
        e.std_position[k] += position_blend * (e.std_position_goal[k] - e.std_position[k])
        e.std_velocity[k] += blend * (e.std_velocity_goal[k] - e.std_velocity[k])
        e.bias[k] += position_blend * (e.bias_goal[k] - e.bias[k])

        # The drift in dead reckoning. On the ground its velocity does not change.
        drift = 0.0
        if e.is_drifting:
            drift = e.drift_velocity[k]
            if e.is_flying:
                drift += dt_s * e.drift_acceleration[k]
                drift -= dt_s / DRIFT_DAMPING_S[k] * drift
        e.drift_velocity[k] = drift
        e.offset[k] += dt_s * drift

        # The estimates.
        e.base[k] = position[k] + e.offset[k]
        e.position[k] = e.base[k] + e.bias[k] + e.std_position[k] * e.unit_position[k]
        e.velocity[k] = velocity[k] + drift + e.std_velocity[k] * unit


@compiled
def _advance_turn(e: Record, dt_s: float, velocity: Array) -> None:
    """Advance the errors of velocity and position that a wrong heading causes."""
    # The true velocity change, and below it the same change rotated by the wrong heading.
    north = velocity[0] - e.last_velocity[0]
    east = velocity[1] - e.last_velocity[1]
    e.last_velocity[0] = velocity[0]
    e.last_velocity[1] = velocity[1]
    if not (e.is_flying and e.has_satellites):
        north = 0.0
        east = 0.0
    turned_north = math.cos(e.yaw_error) * north - math.sin(e.yaw_error) * east
    turned_east = math.sin(e.yaw_error) * north + math.cos(e.yaw_error) * east

    e.turned_velocity[0] = e.keep * e.turned_velocity[0] + turned_north - north
    e.turned_velocity[1] = e.keep * e.turned_velocity[1] + turned_east - east
    for k in range(2):
        pulled = e.pull[k] * e.turned_position[k]
        e.turned_position[k] += dt_s * (e.turned_velocity[k] - pulled)
        e.velocity[k] += e.turned_velocity[k]
        e.position[k] += e.turned_position[k]

    # The vehicle's motion reveals its heading error.
    acceleration_squared = (north * north + east * east) / (dt_s * dt_s)
    e.yaw_mean -= min(1.0, dt_s * YAW_FOUND_S3_M2 * acceleration_squared) * e.yaw_mean


@compiled
def _advance_tilt(e: Record, dt_s: float) -> None:
    """Advance the error of the attitude in dead reckoning."""
    for k in range(2):
        if not e.is_drifting:
            e.tilt_error[k] -= dt_s / BLEND_S * e.tilt_error[k]
        elif e.is_flying and abs(e.tilt_error[k]) < abs(e.tilt_error_most[k]):
            e.tilt_error[k] += dt_s / TILT_ERROR_GROWTH_S * e.tilt_error[k]


@compiled
def _advance_heading(e: Record, draw: float, dt_s: float, yaw_keep: float) -> None:
    """Advance the error of the heading, by the compass or by vision."""
    # The error of the compass changes in flight only.
    lag = 0.0
    if e.is_flying:
        lag = 1.0 - yaw_keep

    e.yaw_smooth += lag * (_ROOT_TWO * e.yaw_unit - e.yaw_smooth)
    spread = math.sqrt(1.0 - (1.0 - lag) * (1.0 - lag))
    e.yaw_unit = (1.0 - lag) * e.yaw_unit + spread * draw

    e.yaw_share += dt_s / BLEND_S * (e.yaw_share_goal - e.yaw_share)
    compass = e.yaw_mean + e.yaw_std * e.yaw_smooth
    e.yaw_error = e.yaw_share * compass + (1.0 - e.yaw_share) * e.vision_yaw


@compiled
def advance(
    errors: Records, draws: Array, dt_s: float, position: Array, velocity: Array, yaw_keep: float
) -> None:
    """Advance all errors by `dt_s` and form the estimates from the true motion.

    Args:
        errors: records ERRORS (n,), updated.
        draws: standard normal numbers (n, 4).
        dt_s: time since the last step.
        position: true positions (n, 3), NED, relative to the origins of the local frames.
        velocity: true velocities (n, 3), NED.
        yaw_keep: share of the compass error that a lag keeps over a step.
    """
    for i in range(errors.shape[0]):
        _advance_motion(errors[i], draws[i], dt_s, position[i], velocity[i])
        _advance_turn(errors[i], dt_s, velocity[i])
        _advance_tilt(errors[i], dt_s)
        _advance_heading(errors[i], draws[i, 3], dt_s, yaw_keep)
