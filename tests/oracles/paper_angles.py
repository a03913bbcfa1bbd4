"""The paper's equation (2): roll, pitch and thrust of a thrust vector."""

from __future__ import annotations

import math


def euler_from_thrust(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Roll and pitch [rad] and |F| of a thrust in x forward, y RIGHT, z up; from ENU/FLU at yaw 0
    negate y.

    The angles are right-handed about x forward and y right.
    """
    return math.atan2(y, z), math.atan2(-x, math.hypot(y, z)), math.sqrt(x * x + y * y + z * z)
