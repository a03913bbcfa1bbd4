"""The hover check of a mission: after a take-off and before anybody sets out, is the wind too much?

Nobody knows the wind on the ground. A vehicle that hovers does: it leans against it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from groundstation.fleet.state import FleetState

_WORTH_SAYING_SHARE = 0.8  # of the limit


class WindTooStrong(RuntimeError):
    """The wind is above the limit of a vehicle that hovers: the mission does not go on."""


def check_wind(state: FleetState, names: Iterable[str]) -> str:
    """Return what a person should know of the wind; empty while there is little.

    Args:
        state: of the fleet, with the newest telemetry.
        names: of the vehicles that hover.

    Raises:
        WindTooStrong: it is above the limit of one of them.
    """
    strongest_share = 0.0
    words = ""
    for name in names:
        telemetry = state.vehicles[name].telemetry
        if telemetry is None:
            continue

        # what is not known is NaN, and no comparison holds
        wind_m_s = math.hypot(*telemetry.wind_enu_m_s)
        share = wind_m_s / telemetry.max_wind_m_s
        if share > strongest_share:
            strongest_share = share
            words = f"{name} feels a wind of {wind_m_s:.1f} m/s"
            limit = f"its limit is {telemetry.max_wind_m_s:.1f} m/s (max_wind_m_s)"

    if strongest_share > 1.0:
        raise WindTooStrong(
            f"{words}, {limit}: nobody sets out. Wait for less wind, or fly a vehicle that can "
            "lean more."
        )
    if strongest_share > _WORTH_SAYING_SHARE:
        return f"{words}, {limit}."
    return ""
