"""What the autopilot believes about its own state: not an EKF, but an estimate that errs as PX4's does.

Each vehicle has its own local origin. Position and velocity carry correlated errors whose size and correlation time
depend on the source (satellites, external vision, nothing). External vision pulls the estimate to what it says, right
or wrong; without any source the estimate drifts away.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from sitl.rotation import Array
from sitl.vehicle import STEP_S

ESTIMATE_EVERY_STEPS = 2  # 125 Hz, the rate of PX4's estimator
_HISTORY = 64
_VISION_TIMEOUT_S = 1.0
_DRIFT_M_S = 0.15
_ATTITUDE_NOISE_RAD = math.radians(0.06)
_YAW_NOISE_RAD = math.radians(0.11)
_GYRO_NOISE_RAD_S = math.radians(0.33)
_COMPASS_STD_RAD = math.radians(2.0)


class Source(Enum):
    """What the position estimate rests on."""

    GPS = "gps"
    VISION = "vision"
    NONE = "none"


@dataclass(frozen=True, slots=True)
class ErrorLevel:
    """Standard deviations north, east, down of position [m] and velocity [m/s], and their correlation time [s]."""

    position_m: tuple[float, float, float]
    velocity_m_s: tuple[float, float, float]
    correlation_s: float


PAD = ErrorLevel((0.03, 0.03, 0.04), (0.015, 0.02, 0.02), 3.4)
GPS = ErrorLevel((0.12, 0.20, 0.21), (0.16, 0.29, 0.10), 3.4)
VISION_DEFAULT = ErrorLevel((0.039, 0.10, 0.05), (0.07, 0.17, 0.07), 1.5)
VISION_TRUSTED = ErrorLevel((0.016, 0.044, 0.02), (0.038, 0.106, 0.04), 0.68)
VISION_TUNED = ErrorLevel((0.0035, 0.010, 0.005), (0.018, 0.053, 0.02), 0.20)


def vision_level(evp_noise_m: float, tau_vel_s: float) -> ErrorLevel:
    """Error level with external vision for EKF2_EVP_NOISE and EKF2_TAU_VEL."""
    if evp_noise_m > 0.03:
        return VISION_DEFAULT
    return VISION_TUNED if tau_vel_s <= 0.05 else VISION_TRUSTED


@dataclass(frozen=True, slots=True)
class LocalEstimate:
    """One vehicle's estimate in its own local NED frame."""

    position_ned_m: tuple[float, float, float]
    velocity_ned_m_s: tuple[float, float, float]


class Estimator:
    """Estimates of all vehicles; rows as in the world.

    Args:
        start_ned_m: (n, 3) true start positions: each is the origin of its vehicle's local frame.
        seed: of all errors.
    """

    def __init__(self, start_ned_m: Array, *, seed: int) -> None:
        n = start_ned_m.shape[0]
        self._rng = np.random.default_rng([seed, 2])
        self._origin = np.array(start_ned_m, dtype=np.float64)
        # The filter starts before the vehicle rests: height on the ground is not exactly zero.
        self.offset_ned_m = np.zeros((n, 3))
        self.offset_ned_m[:, 2] = self._rng.uniform(-0.2, 0.2, n)
        self._error_position = np.zeros((n, 3))
        self._error_velocity = np.zeros((n, 3))
        self._level_position = np.zeros((n, 3))
        self._level_velocity = np.zeros((n, 3))
        self._correlation_s = np.full(n, PAD.correlation_s)
        self._drift_m_s = self._rng.normal(0.0, _DRIFT_M_S, (n, 3)) * np.array([1.0, 1.0, 0.3])
        self._compass_rad = np.clip(self._rng.normal(0.0, _COMPASS_STD_RAD, n), -0.07, 0.07)
        self.yaw_error_rad = self._compass_rad.copy()
        self._vision_time_s = np.full(n, -math.inf)
        self._vision_frame: list[Array | None] = [None] * n
        self._history = np.zeros((_HISTORY, n, 3))
        self._history_index = 0
        self.source = [Source.GPS] * n
        self.has_gps = [True] * n
        self.uses_vision_yaw = [True] * n
        self.vision_levels = [VISION_DEFAULT] * n
        self._position = self._origin * 0.0
        self._velocity = np.zeros((n, 3))

    def step(self, time_s: float, position_ned_m: Array, velocity_ned_m_s: Array, on_ground: NDArray[np.bool_]) -> None:
        """Advance the errors by one estimator period and form the estimates from the true motion."""
        dt_s = ESTIMATE_EVERY_STEPS * STEP_S
        rests = on_ground.tolist()
        for i, is_resting in enumerate(rests):
            fresh = time_s - self._vision_time_s[i] < _VISION_TIMEOUT_S
            source = Source.VISION if fresh else Source.GPS if self.has_gps[i] else Source.NONE
            if source is not self.source[i] and source is not Source.VISION:
                self._vision_frame[i] = None
            self.source[i] = source
            level = self.vision_levels[i] if source is Source.VISION else PAD if is_resting else GPS
            blend = dt_s / 0.5
            self._level_position[i] += blend * (np.array(level.position_m) - self._level_position[i])
            self._level_velocity[i] += blend * (np.array(level.velocity_m_s) - self._level_velocity[i])
            self._correlation_s[i] = level.correlation_s
            yaw_goal = 0.0 if source is Source.VISION and self.uses_vision_yaw[i] else self._compass_rad[i]
            self.yaw_error_rad[i] += dt_s / 0.5 * (yaw_goal - self.yaw_error_rad[i])
            if source is Source.NONE and not is_resting:
                self.offset_ned_m[i] += dt_s * self._drift_m_s[i]
        keep = np.exp(-dt_s / self._correlation_s)[:, None]
        spread = np.sqrt(1.0 - keep**2)
        n = keep.shape[0]
        self._error_position = keep * self._error_position + spread * self._rng.standard_normal((n, 3))
        self._error_velocity = keep * self._error_velocity + spread * self._rng.standard_normal((n, 3))
        base = position_ned_m - self._origin + self.offset_ned_m
        self._history_index = (self._history_index + 1) % _HISTORY
        self._history[self._history_index] = base
        self._position = base + self._level_position * self._error_position
        self._velocity = velocity_ned_m_s + self._level_velocity * self._error_velocity

    def fuse_vision(self, index: int, time_s: float, position_ned_m: Array, *, delay_s: float) -> None:
        """Take one external position of a vehicle, in the frame of its sender.

        While satellites give the frame, vision only steadies the estimate (PX4 then estimates the offset between both);
        without them the estimate follows vision, jumps included: sideways at once, in height within seconds.
        """
        if not np.all(np.isfinite(position_ned_m)):
            return
        back = min(_HISTORY - 1, max(0, round(delay_s / (ESTIMATE_EVERY_STEPS * STEP_S))))
        believed = self._history[(self._history_index - back) % _HISTORY, index]
        is_first = time_s - self._vision_time_s[index] >= _VISION_TIMEOUT_S
        self._vision_time_s[index] = time_s
        if self.has_gps[index]:
            frame = self._vision_frame[index]
            if frame is None:
                frame = self._vision_frame[index] = believed - position_ned_m
            position_ned_m = position_ned_m + frame
        error = position_ned_m - believed
        gain = np.array([0.2, 0.2, 0.2])
        if is_first or math.hypot(error[0], error[1]) > 1.0:
            gain[:2] = 1.0
        if is_first:
            gain[2] = 1.0
        elif abs(error[2]) > 0.5:
            gain[2] = 0.01
        correction = gain * error
        self.offset_ned_m[index] += correction
        self._history[:, index] += correction

    def local(self, index: int) -> LocalEstimate:
        """The newest estimate of one vehicle."""
        x, y, z = self._position[index].tolist()
        vx, vy, vz = self._velocity[index].tolist()
        return LocalEstimate((x, y, z), (vx, vy, vz))

    def local_from_world(self, index: int, position_ned_m: Array) -> Array:
        """A world position in the local frame that the vehicle believes in (for its own origin only)."""
        return np.asarray(position_ned_m - self._origin[index] + self.offset_ned_m[index])

    def attitude_noise(self) -> tuple[float, float, float]:
        """Errors of roll, pitch and yaw of one sample [rad]."""
        a, b, c = self._rng.standard_normal(3).tolist()
        return _ATTITUDE_NOISE_RAD * a, _ATTITUDE_NOISE_RAD * b, _YAW_NOISE_RAD * c

    def gyro_noise(self) -> tuple[float, float, float]:
        """Errors of the three body rates of one sample [rad/s]."""
        a, b, c = (_GYRO_NOISE_RAD_S * self._rng.standard_normal(3)).tolist()
        return a, b, c
