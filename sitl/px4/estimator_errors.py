"""How wrong PX4's estimate is, as measured on its simulator, and the random processes that reproduce it.

The velocity error is an Ornstein-Uhlenbeck process, e_v' = -e_v / tau + noise. The position error integrates it and is
pulled back by the measurements, e_p' = e_v - e_p / T; T follows from the three measured numbers, since the variance of
e_p is then sigma_v^2 T^2 tau / (T + tau). So both errors belong together, as a filter's do, and are slow: the
correlation time, not the size, decides what an error costs in separation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from sitl.physics.frames import Array

# Blocks of the estimator's matrix (n, BLOCKS, 3): unit processes of velocity and position; present and aimed-at
# standard deviations and bias; couplings; offset of the local frame; speed and acceleration of dead reckoning; results.
UNIT_V, UNIT_P, STD_P, STD_V, BIAS, STD_P_GOAL, STD_V_GOAL, BIAS_GOAL = range(8)
RATIO, PULL, OFFSET, DRIFT_V, DRIFT_A, BASE, POSITION, VELOCITY = range(8, 16)
BLOCKS = 16
# Columns of its scalars (n, SCALARS): correlation of velocity over a step; unit process, smoothed process, size and
# mean of the compass's error; how much of it counts, and should; error of the vision's heading; whether the position
# drifts; whether the vehicle flies; heading error, the result.
KEEP, YAW_UNIT, YAW_SMOOTH, YAW_STD, YAW_MEAN, YAW_SHARE, YAW_SHARE_GOAL = range(7)
VISION_YAW, DRIFTS, FLIES, YAW_ERROR = range(7, 11)
SCALARS = 11

# Not measured. The error wanders in flight only, and smoothly, as the heading of a filter that integrates a gyro does:
# white noise through two such lags.
YAW_CORRELATION_S = 6.0
BLEND_S = 0.5  # in which one kind of error gives way to another


class Source(Enum):
    """What the position estimate rests on."""

    GPS = "gps"
    VISION = "vision"
    NONE = "none"


@dataclass(frozen=True, slots=True)
class ErrorLevel:
    """Standard deviations north, east, down of position [m] and velocity [m/s], their correlation time, a bias.

    Attributes:
        correlation_s: of the velocity error.
        bias_m: standard deviation, over vehicles, of a constant position error.
    """

    position_m: tuple[float, float, float]
    velocity_m_s: tuple[float, float, float]
    correlation_s: float
    bias_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def pull_s(self) -> tuple[float, float, float]:
        """Time T in which measurements pull the position error back, per axis [s]."""
        tau = self.correlation_s
        ratios = [(p / v) ** 2 for p, v in zip(self.position_m, self.velocity_m_s, strict=True)]
        x, y, z = ((r + math.sqrt(r * r + 4.0 * tau * tau * r)) / (2.0 * tau) for r in ratios)
        return x, y, z


PAD = ErrorLevel((0.03, 0.03, 0.04), (0.015, 0.02, 0.02), 3.4)
PAD_VISION = ErrorLevel((0.0025, 0.0025, 0.0025), (0.014, 0.014, 0.014), 0.68)
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


def set_level(blocks: Array, scalars: Array, row: int, level: ErrorLevel, luck: Array, dt_s: float) -> None:
    """Aim one vehicle's processes at a level; `luck` (3,) standard normal scales the bias."""
    blocks[row, STD_P_GOAL] = level.position_m
    blocks[row, STD_V_GOAL] = level.velocity_m_s
    blocks[row, BIAS_GOAL] = luck * level.bias_m
    blocks[row, PULL] = 1.0 / np.array(level.pull_s)
    blocks[row, RATIO] = np.array(level.velocity_m_s) / np.array(level.position_m)
    scalars[row, KEEP] = math.exp(-dt_s / level.correlation_s)


def advance(
    blocks: Array, scalars: Array, draws: Array, dt_s: float, position: Array, velocity: Array, yaw_keep: float
) -> None:
    """Advance all errors by `dt_s` and form the estimates from the true motion relative to the origin.

    Args:
        blocks, scalars: (n, BLOCKS, 3) and (n, SCALARS), updated.
        draws: (n, 4) standard normal numbers.
        position, velocity: (n, 3) truth, NED, position relative to the origin of the local frame.
        yaw_keep: what a lag of the compass's error keeps over a step.
    """
    keep = scalars[:, KEEP, None]
    unit = blocks[:, UNIT_V] = keep * blocks[:, UNIT_V] + np.sqrt(1.0 - keep * keep) * draws[:, :3]
    blocks[:, UNIT_P] += dt_s * (blocks[:, RATIO] * unit - blocks[:, PULL] * blocks[:, UNIT_P])
    blend = dt_s / BLEND_S
    for present, goal in ((STD_P, STD_P_GOAL), (STD_V, STD_V_GOAL), (BIAS, BIAS_GOAL)):
        blocks[:, present] += blend * (blocks[:, goal] - blocks[:, present])
    drifts = scalars[:, DRIFTS, None]
    blocks[:, DRIFT_V] = drifts * (blocks[:, DRIFT_V] + dt_s * blocks[:, DRIFT_A])
    blocks[:, OFFSET] += dt_s * blocks[:, DRIFT_V]
    blocks[:, BASE] = position + blocks[:, OFFSET]
    blocks[:, POSITION] = blocks[:, BASE] + blocks[:, BIAS] + blocks[:, STD_P] * blocks[:, UNIT_P]
    blocks[:, VELOCITY] = velocity + blocks[:, DRIFT_V] + blocks[:, STD_V] * unit
    lag = scalars[:, FLIES] * (1.0 - yaw_keep)
    scalars[:, YAW_SMOOTH] += lag * (math.sqrt(2.0) * scalars[:, YAW_UNIT] - scalars[:, YAW_SMOOTH])
    scalars[:, YAW_UNIT] = (1.0 - lag) * scalars[:, YAW_UNIT] + np.sqrt(1.0 - (1.0 - lag) ** 2) * draws[:, 3]
    scalars[:, YAW_SHARE] += blend * (scalars[:, YAW_SHARE_GOAL] - scalars[:, YAW_SHARE])
    compass = scalars[:, YAW_MEAN] + scalars[:, YAW_STD] * scalars[:, YAW_SMOOTH]
    share = scalars[:, YAW_SHARE]
    scalars[:, YAW_ERROR] = share * compass + (1.0 - share) * scalars[:, VISION_YAW]
