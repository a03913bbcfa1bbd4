"""Last check of an attitude setpoint: PX4 accepts any setpoint, also one that makes the vehicle
fall. Pure.
"""

from __future__ import annotations

import math

from onboard.types import AttitudeSetpoint

_TILT_SLACK_DEG = 1.0


def is_sendable(setpoint: AttitudeSetpoint, max_tilt_deg: float) -> bool:
    """Whether a setpoint may be sent.

    Args:
        setpoint: for one vehicle.
        max_tilt_deg: of that vehicle.
    Returns:
        True if all numbers are finite, the quaternion is a unit one, the thrust lies in [0, 1] and
        the tilt in its limit.
    """
    w, x, y, z = setpoint.quaternion_wxyz
    size = w * w + x * x + y * y + z * z
    # comparisons with NaN are false
    if not (abs(size - 1.0) < 1e-3 and 0.0 <= setpoint.thrust_frac <= 1.0):
        return False
    return 1.0 - 2.0 * (x * x + y * y) >= math.cos(math.radians(max_tilt_deg + _TILT_SLACK_DEG))
