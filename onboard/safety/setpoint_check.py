"""The last check of an attitude setpoint. Pure.

PX4 accepts any setpoint, even one that makes the vehicle fall.
"""

from __future__ import annotations

import math

from onboard.types import AttitudeSetpoint

_TILT_SLACK_DEG = 1.0  # because of rounding, a tilt may exceed the fleet file's limit by this angle
_UNIT_SLACK = 1e-3  # the squared length of a unit quaternion may differ from 1 by this


def is_sendable(setpoint: AttitudeSetpoint, max_tilt_deg: float) -> bool:
    """Return whether a setpoint may be sent.

    It may be sent if all its numbers are finite, the quaternion has unit length, the thrust lies in
    [0, 1], and the tilt is within the limit.

    Args:
        setpoint: attitude setpoint for one vehicle.
        max_tilt_deg: largest tilt of that vehicle.
    """
    w, x, y, z = setpoint.quaternion_wxyz
    squared_length = w * w + x * x + y * y + z * z

    # comparisons with NaN are False, so that NaN is refused
    is_unit = abs(squared_length - 1.0) < _UNIT_SLACK
    is_thrust = 0.0 <= setpoint.thrust_frac <= 1.0
    if not (is_unit and is_thrust):
        return False

    cos_tilt = 1.0 - 2.0 * (x * x + y * y)  # third entry of the body's up, in ENU
    return cos_tilt >= math.cos(math.radians(max_tilt_deg + _TILT_SLACK_DEG))
