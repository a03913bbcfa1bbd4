"""The wind that the neighbours in the air feel.

A vehicle on the ground feels no wind, but it is blown aside at its lift-off. All fly in the same
air, so it can ask those who fly already.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable

from onboard.bus.schema import Telemetry

_FRESH_NS = 5_000_000_000  # telemetry that is older than this does not count


def wind_felt_by(telemetries: Iterable[Telemetry], now_ns: int) -> tuple[float, float]:
    """Return the velocity of the air that vehicles report, east and north [m/s].

    The median of each axis is returned, so that one wrong vehicle among many does not count. It is
    NaN if nobody knows the wind.

    Args:
        telemetries: newest telemetry of each vehicle.
        now_ns: present time.
    """
    winds = [
        telemetry.wind_enu_m_s
        for telemetry in telemetries
        if now_ns - telemetry.stamp_ns < _FRESH_NS and math.isfinite(sum(telemetry.wind_enu_m_s))
    ]
    if not winds:
        return (math.nan, math.nan)

    easts, norths = zip(*winds, strict=True)
    return (statistics.median(easts), statistics.median(norths))
