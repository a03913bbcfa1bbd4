"""The last check before the wire: PX4 itself takes any setpoint, also one that makes it fall. Pure."""

from __future__ import annotations

import math

import numpy as np

from onboard.frames import body_up
from onboard.types import AttitudeSetpoint

_TILT_SLACK_DEG = 1.0


def is_sendable(setpoint: AttitudeSetpoint, max_tilt_deg: float) -> bool:
    """Whether a setpoint of one vehicle may be sent: finite, a unit quaternion, thrust in [0, 1], tilt bounded."""
    q = np.asarray(setpoint.quaternion_wxyz)
    if not (np.isfinite(q).all() and 0.0 <= float(setpoint.thrust_frac) <= 1.0):
        return False
    is_unit = abs(float(q @ q) - 1.0) < 1e-3
    return is_unit and float(body_up(q)[2]) >= math.cos(math.radians(max_tilt_deg + _TILT_SLACK_DEG))
