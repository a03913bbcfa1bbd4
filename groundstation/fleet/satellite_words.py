"""A vehicle's satellites and corrections in words, as console and page show them. Pure."""

from __future__ import annotations

import math

from onboard.bus.schema import Telemetry
from onboard.plain_text import plain_line


def satellite_words(telemetry: Telemetry) -> str:
    """Return fix, satellites, age of the corrections and their base; empty where none is told.

    Args:
        telemetry: the newest of a vehicle.
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
    """Return the distance to a base: metres below a kilometre.

    Args:
        distance_m: finite.
    """
    if distance_m < 1000.0:
        return f"{distance_m:.0f} m"
    return f"{min(distance_m, 9.9e6) / 1000.0:.1f} km"
