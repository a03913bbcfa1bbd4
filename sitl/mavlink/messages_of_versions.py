"""Contents of messages that only some versions of PX4 stream, see `px4/versions.toml`."""

from __future__ import annotations

import math

from sitl.mavlink.messages import Values
from sitl.mavlink.view import View

_FULL_RPM = 10_000
_NOT_MEASURED = 32767
_UNKNOWN = 255


def esc_info(v: View) -> Values:
    return (
        v.boot_us,
        *[0] * 4,  # errors
        v.boot_ms // 100 & 0xFFFF,  # counter
        *[0] * 4,  # failures
        *[_NOT_MEASURED] * 4,  # temperature
        0,  # index of the first motor
        4,  # number of motors
        0,  # kind of connection
        0b1111,  # bits of the motors that are online
    )


def esc_status(v: View) -> Values:
    actuation = v.autopilot.actuation
    rpm = 0
    if actuation.motors_on:
        rpm = round(_FULL_RPM * actuation.thrust_frac)

    first_index = 0
    return (
        v.boot_us,
        *[rpm] * 4,
        *[0.0] * 8,  # voltages and currents
        first_index,
    )


def estimator_sensor_fusion_status(v: View) -> Values:
    return (
        *[math.nan] * 9,  # test ratios
        *[0] * 18,  # intended sources and active sources
    )


def gnss_integrity(v: View) -> Values:
    return (*[0] * 8, *[_UNKNOWN] * 4)
