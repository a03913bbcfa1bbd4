"""The last check before the wire: PX4 itself takes any setpoint, also one that makes it fall. Pure."""

from __future__ import annotations

import math

from onboard.types import AttitudeSetpoint

_TILT_SLACK_DEG = 1.0


def is_sendable(setpoint: AttitudeSetpoint, max_tilt_deg: float) -> bool:
    """Whether a setpoint of one vehicle may be sent: finite, a unit quaternion, thrust in [0, 1], tilt bounded."""
    w, x, y, z = setpoint.quaternion_wxyz
    size = w * w + x * x + y * y + z * z
    # comparisons with what is no number are false
    if not (abs(size - 1.0) < 1e-3 and 0.0 <= setpoint.thrust_frac <= 1.0):
        return False
    return 1.0 - 2.0 * (x * x + y * y) >= math.cos(math.radians(max_tilt_deg + _TILT_SLACK_DEG))
