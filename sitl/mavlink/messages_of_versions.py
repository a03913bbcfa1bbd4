"""Contents of messages that only some versions of PX4 stream: ``px4/versions.toml`` says which."""

from __future__ import annotations

import math

from sitl.mavlink.messages import Values
from sitl.mavlink.view import View

_FULL_RPM = 10_000
_NOT_MEASURED, _UNKNOWN = 32767, 255


def esc_info(v: View) -> Values:
    return (
        v.boot_us,
        *(0,) * 4,
        v.boot_ms // 100 & 0xFFFF,
        *(0,) * 4,
        *(_NOT_MEASURED,) * 4,
        0,
        4,
        0,
        0b1111,
    )


def esc_status(v: View) -> Values:
    actuation = v.autopilot.actuation
    rpm = round(_FULL_RPM * actuation.thrust_frac) if actuation.motors_on else 0
    return (v.boot_us, *(rpm,) * 4, *(0.0,) * 8, 0)


def estimator_sensor_fusion_status(v: View) -> Values:
    return (*(math.nan,) * 9, *(0,) * 18)


def gnss_integrity(v: View) -> Values:
    return (*(0,) * 8, *(_UNKNOWN,) * 4)
