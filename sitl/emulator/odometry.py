"""Visual odometry: the poses that a camera and its computer on a vehicle send to its PX4.

The frame of a camera begins where the vehicle stands at the start. In the air the odometry drifts,
because it adds up small motions; each pose has noise as well.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sitl.physics.frames import Array
from sitl.physics.random_streams import Stream

PERIOD_S = 0.04

Mask = NDArray[np.bool_]

_NOISE_M = 0.01  # standard deviation of each coordinate of a pose
_YAW_NOISE_RAD = math.radians(0.2)
# Random walks: standard deviations after a second in the air.
_DRIFT_M = 0.01
_YAW_DRIFT_RAD = math.radians(0.1)


class VisualOdometry:
    """The cameras of some vehicles.

    Args:
        start_ned_m: positions (n, 3) at which the frames begin.
        seed: seed of noise and drift.
    """

    def __init__(self, start_ned_m: Array, *, seed: int = 0) -> None:
        self._start_ned_m = start_ned_m.copy()
        self._drift = np.zeros((len(start_ned_m), 4))  # of position and heading
        self._rng = np.random.default_rng([seed, Stream.ODOMETRY])

    def poses(self, position_ned_m: Array, yaw_rad: Array, is_on_ground: Mask) -> Array:
        """Return the next position and heading of each vehicle (n, 4), in its camera's frame.

        Call it every PERIOD_S.

        Args:
            position_ned_m: true positions (n, 3).
            yaw_rad: true headings (n,).
            is_on_ground: whether each vehicle stands on the ground (n,).
        """
        count = len(yaw_rad)
        step_std = math.sqrt(PERIOD_S) * np.array([_DRIFT_M, _DRIFT_M, _DRIFT_M, _YAW_DRIFT_RAD])
        steps = step_std * self._rng.standard_normal((count, 4))
        self._drift += np.where(is_on_ground[:, None], 0.0, steps)

        noise_std = np.array([_NOISE_M, _NOISE_M, _NOISE_M, _YAW_NOISE_RAD])
        poses: Array = self._drift + noise_std * self._rng.standard_normal((count, 4))
        poses[:, :3] += position_ned_m - self._start_ned_m
        poses[:, 3] += yaw_rad
        return poses
