"""A vehicle's satellites and corrections in words, as console and page show them. Pure."""

from __future__ import annotations

import math

from onboard.bus.schema import Telemetry
from onboard.plain_text import plain_line

_LARGEST_SHOWN_M = 9.9e6  # a larger distance is shown as this one, so that the text stays short


def satellite_words(telemetry: Telemetry) -> str:
    """Return fix, satellites, age of the corrections and their base; empty if none is reported.

    Args:
        telemetry: newest telemetry of a vehicle.
    """
    if not telemetry.fix:
        return ""
    words = [plain_line(telemetry.fix)[:20]]
    if telemetry.satellites >= 0:
        words.append(f"{telemetry.satellites} satellites")
    if math.isfinite(telemetry.corrections_age_s):
        words.append(f"corrections {telemetry.corrections_age_s:.1f} s old")
    if telemetry.base_id >= 0:
        base = f"base {telemetry.base_id}"
        if math.isfinite(telemetry.base_distance_m):
            base += f" at {distance_words(telemetry.base_distance_m)}"
        words.append(base)
    return ", ".join(words)


def distance_words(distance_m: float) -> str:
    """Return the distance to a base, in metres below a kilometre and in kilometres above.

    Args:
        distance_m: finite distance [m].
    """
    if distance_m < 1000.0:
        return f"{distance_m:.0f} m"
    return f"{min(distance_m, _LARGEST_SHOWN_M) / 1000.0:.1f} km"
