"""Errors of PX4's estimate, as measured on its simulator, and the random processes that reproduce
them.

The velocity error is an Ornstein-Uhlenbeck process, e_v' = -e_v / tau + noise. The position error
integrates it and is pulled back by the measurements, e_p' = e_v - e_p / T; T follows from the three
measured numbers, since the variance of e_p is then sigma_v^2 T^2 tau / (T + tau). So both errors
belong together, as a filter's do, and are slow: the correlation time, not the size, decides what an
error costs in separation.
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
        ("unit_velocity", "f8", 3),  # unit processes
        ("unit_position", "f8", 3),
        ("std_position", "f8", 3),  # present sizes, and those that they approach
        ("std_velocity", "f8", 3),
        ("bias", "f8", 3),
        ("std_position_goal", "f8", 3),
        ("std_velocity_goal", "f8", 3),
        ("bias_goal", "f8", 3),
        ("ratio", "f8", 3),  # couplings of the unit processes
        ("pull", "f8", 3),
        ("keep", "f8"),  # correlation of the velocity error over a step
        ("offset", "f8", 3),  # of the local frame
        ("drift_velocity", "f8", 3),  # of dead reckoning
        ("drift_acceleration", "f8", 3),
        (
            "tilt_error",
            "f8",
            2,
        ),  # error of the attitude: true turned by this about north and east [rad]
        ("tilt_error_most", "f8", 2),  # up to which it grows while nothing aids the filter
        ("base", "f8", 3),  # position without errors but those of the frame
        ("position", "f8", 3),  # results
        ("velocity", "f8", 3),
        ("yaw_unit", "f8"),  # error of the compass: unit process, smoothed, its size and mean
        ("yaw_smooth", "f8"),
        ("yaw_std", "f8"),
        ("yaw_mean", "f8"),
        ("yaw_share", "f8"),  # part of it that counts, and the part that this approaches
        ("yaw_share_goal", "f8"),
        ("vision_yaw", "f8"),  # error of the vision's heading
        ("yaw_error", "f8"),  # result
        ("is_drifting", "?"),
        ("is_flying", "?"),
    ],
    align=True,
)

# Not measured. The error wanders in flight only, and smoothly, as the heading of a filter that
# integrates a gyro does: white noise through two such lags.
YAW_CORRELATION_S = 6.0
BLEND_S = 0.5  # in which one kind of error gives way to another
# Dead reckoning: the velocity's error, growing at first, is damped; that of height ends soon, at
# another level. The attitude's begins with a quarter of its largest value, which it reaches after
# 3.5 s.
DRIFT_DAMPING_S = (4.0, 4.0, 0.5)
TILT_ERROR_AT_FIRST, TILT_ERROR_GROWTH_S = 0.25, 3.5 / math.log(4.0)
_ROOT_TWO = math.sqrt(2.0)


class Source(Enum):
    """Source of the position estimate."""

    GPS = "gps"
    VISION = "vision"
    NONE = "none"


@dataclass(frozen=True, slots=True)
class ErrorLevel:
    """Size and speed of the errors north, east and down."""

    position_m: tuple[float, float, float]  # standard deviations
    velocity_m_s: tuple[float, float, float]
    correlation_s: float  # of the velocity error
    # standard deviation, over vehicles, of a constant error
    bias_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def pull_s(self) -> tuple[float, float, float]:
        """Time T in which measurements pull the position error back, per axis [s]."""
        tau = self.correlation_s
        ratios = [(p / v) ** 2 for p, v in zip(self.position_m, self.velocity_m_s, strict=True)]
        x, y, z = ((r + math.sqrt(r * r + 4.0 * tau * tau * r)) / (2.0 * tau) for r in ratios)
        return x, y, z


RESTING = ErrorLevel((0.03, 0.03, 0.04), (0.015, 0.02, 0.02), 3.4)
RESTING_WITH_VISION = ErrorLevel((0.0025, 0.0025, 0.0025), (0.014, 0.014, 0.014), 0.68)
GPS = ErrorLevel((0.12, 0.20, 0.21), (0.16, 0.29, 0.10), 3.4, (0.09, 0.14, 0.18))
VISION_DEFAULT = ErrorLevel((0.039, 0.10, 0.05), (0.07, 0.17, 0.07), 1.5)
VISION_TRUSTED = ErrorLevel((0.016, 0.044, 0.02), (0.038, 0.106, 0.04), 0.68)
VISION_TUNED = ErrorLevel((0.0035, 0.010, 0.005), (0.018, 0.053, 0.02), 0.20)
VISION_TUNED_WITH_VELOCITY = ErrorLevel((0.003, 0.006, 0.004), (0.018, 0.039, 0.02), 0.09)


def vision_level(evp_noise_m: float, tau_vel_s: float, *, has_velocity: bool = False) -> ErrorLevel:
    """Error level with external vision for EKF2_EVP_NOISE, EKF2_TAU_VEL and a velocity in ODOMETRY.

    The velocity helps only a filter that is tuned already, as measured.
    """
    if evp_noise_m > 0.03:
        return VISION_DEFAULT
    if tau_vel_s > 0.05:
        return VISION_TRUSTED
    return VISION_TUNED_WITH_VELOCITY if has_velocity else VISION_TUNED


def set_level(error: Record, level: ErrorLevel, bias_draw: Array, dt_s: float) -> None:
    """Aim one vehicle's processes at a level; `bias_draw` (3,) standard normal scales the bias."""
    error["std_position_goal"] = level.position_m
    error["std_velocity_goal"] = level.velocity_m_s
    error["bias_goal"] = bias_draw * level.bias_m
    error["pull"] = 1.0 / np.array(level.pull_s)
    error["ratio"] = np.array(level.velocity_m_s) / np.array(level.position_m)
    error["keep"] = math.exp(-dt_s / level.correlation_s)


@compiled
def _advance_motion(e: Record, draws: Array, dt_s: float, position: Array, velocity: Array) -> None:
    blend = dt_s / BLEND_S
    spread = math.sqrt(1.0 - e.keep * e.keep)
    for k in range(3):
        unit = e.keep * e.unit_velocity[k] + spread * draws[k]
        e.unit_velocity[k] = unit
        e.unit_position[k] += dt_s * (e.ratio[k] * unit - e.pull[k] * e.unit_position[k])
        e.std_position[k] += blend * (e.std_position_goal[k] - e.std_position[k])
        e.std_velocity[k] += blend * (e.std_velocity_goal[k] - e.std_velocity[k])
        e.bias[k] += blend * (e.bias_goal[k] - e.bias[k])
        drift = (
            e.drift_velocity[k] + dt_s * e.drift_acceleration[k] * e.is_flying
            if e.is_drifting
            else 0.0
        )
        drift -= dt_s / DRIFT_DAMPING_S[k] * e.is_flying * drift
        e.drift_velocity[k] = drift
        e.offset[k] += dt_s * drift
        e.base[k] = position[k] + e.offset[k]
        e.position[k] = e.base[k] + e.bias[k] + e.std_position[k] * e.unit_position[k]
        e.velocity[k] = velocity[k] + drift + e.std_velocity[k] * unit


@compiled
def _advance_lean(e: Record, dt_s: float) -> None:
    for k in range(2):
        if not e.is_drifting:
            e.tilt_error[k] -= dt_s / BLEND_S * e.tilt_error[k]
        elif e.is_flying and abs(e.tilt_error[k]) < abs(e.tilt_error_most[k]):
            e.tilt_error[k] += dt_s / TILT_ERROR_GROWTH_S * e.tilt_error[k]


@compiled
def _advance_heading(e: Record, draw: float, dt_s: float, yaw_keep: float) -> None:
    lag = 1.0 - yaw_keep if e.is_flying else 0.0
    e.yaw_smooth += lag * (_ROOT_TWO * e.yaw_unit - e.yaw_smooth)
    e.yaw_unit = (1.0 - lag) * e.yaw_unit + math.sqrt(1.0 - (1.0 - lag) * (1.0 - lag)) * draw
    e.yaw_share += dt_s / BLEND_S * (e.yaw_share_goal - e.yaw_share)
    compass = e.yaw_mean + e.yaw_std * e.yaw_smooth
    e.yaw_error = e.yaw_share * compass + (1.0 - e.yaw_share) * e.vision_yaw


@compiled
def advance(
    errors: Records, draws: Array, dt_s: float, position: Array, velocity: Array, yaw_keep: float
) -> None:
    """Advance all errors by `dt_s` and form the estimates from the true motion relative to the
    origin.

    Args:
        errors: (n,) records ERRORS, updated. draws: (n, 4) standard normal numbers.
        position, velocity: (n, 3) truth, NED, position relative to the origin of the local frame.
        yaw_keep: part of the compass's error that a lag keeps over a step.
    """
    for i in range(errors.shape[0]):
        _advance_motion(errors[i], draws[i], dt_s, position[i], velocity[i])
        _advance_lean(errors[i], dt_s)
        _advance_heading(errors[i], draws[i, 3], dt_s, yaw_keep)
