"""The hover check of a mission: is the wind too strong to fly on after a take-off?

A hovering vehicle tilts against the wind, and measures the wind by its tilt. It reports the mean
over two seconds, in which gusts still count. If gusts can explain a mean above the limit, this
check waits up to ten seconds until the mean is within the limit. If they cannot, the mission ends
at once.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from groundstation.fleet.state import FleetState
from onboard.config.wind_limit import GUSTY

_NOTABLE_SHARE = 0.8  # a wind above this share of its limit is told to the user
_SAMPLE_S = 0.2  # time between two samples
_SAMPLE_COUNT = 50  # these take ten seconds


class WindTooStrong(RuntimeError):
    """The wind is above the limit of a hovering vehicle, so the mission ends."""


@dataclass(frozen=True, slots=True)
class _Strongest:
    """The wind of the vehicle whose wind is strongest compared with its own limit."""

    share: float = 0.0  # wind divided by the vehicle's limit
    words: str = ""

    @property
    def may_be_a_gust(self) -> bool:
        """Whether the wind is above the limit, but may be a gust of a wind within the limit."""
        return 1.0 < self.share <= GUSTY


async def hover_check(
    state_of_now: Callable[[], FleetState],
    names: Iterable[str],
    say: Callable[[str], None],
) -> None:
    """Wait until the wind is within the limit of all vehicles that hover.

    Args:
        state_of_now: function that returns the fleet with its newest telemetry.
        names: names of the vehicles that hover.
        say: function that receives each line about the wind.

    Raises:
        WindTooStrong: the wind stays above the limit of a vehicle.
    """
    hovering = list(names)
    strongest = _strongest(state_of_now(), hovering)
    if strongest.may_be_a_gust:
        say(f"{strongest.words}: looking for a calmer moment before anybody sets out.")

    for _ in range(_SAMPLE_COUNT):
        if not strongest.may_be_a_gust:
            break
        await asyncio.sleep(_SAMPLE_S)
        strongest = _strongest(state_of_now(), hovering)

    if strongest.share > 1.0:
        raise WindTooStrong(
            f"{strongest.words}: nobody sets out. Wait for less wind, or fly a vehicle that can "
            "lean more."
        )
    if strongest.share > _NOTABLE_SHARE:
        say(f"{strongest.words}.")


def _strongest(state: FleetState, names: Iterable[str]) -> _Strongest:
    strongest = _Strongest()
    for name in names:
        telemetry = state.vehicles[name].telemetry
        if telemetry is None:
            continue

        # An unknown wind is NaN; the comparison below is then false.
        wind_m_s = math.hypot(*telemetry.wind_enu_m_s)
        share = wind_m_s / telemetry.max_wind_m_s
        if share > strongest.share:
            strongest = _Strongest(
                share=share,
                words=(
                    f"{name} feels a wind of {wind_m_s:.1f} m/s, "
                    f"its limit is {telemetry.max_wind_m_s:.1f} m/s (max_wind_m_s)"
                ),
            )
    return strongest
