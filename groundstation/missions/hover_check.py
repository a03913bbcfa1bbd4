"""The hover check of a mission: after a take-off and before anybody sets out, is the wind too much?

Nobody knows the wind on the ground. A vehicle that hovers does: it leans against it. What it tells
is a mean over two seconds, which gusts move, and a limit is one of the mean wind. So a wind above
the limit that gusts explain is looked at for ten seconds more, and the fleet sets out as soon as it
is within the limit. A wind that no gusts of the limit explain is refused at once.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from groundstation.fleet.state import FleetState
from onboard.config.wind_limit import GUSTY

_WORTH_SAYING_SHARE = 0.8  # of the limit
_LOOK_S = 0.2  # from one look to the next
_LOOKS = 50


class WindTooStrong(RuntimeError):
    """The wind is above the limit of a vehicle that hovers: the mission does not go on."""


@dataclass(frozen=True, slots=True)
class _Strongest:
    """The wind that takes most of the limit of its vehicle."""

    share: float = 0.0  # of the limit
    words: str = ""


async def hover_check(
    state_of_now: Callable[[], FleetState],
    names: Iterable[str],
    say: Callable[[str], None],
) -> None:
    """Wait until the wind is within the limit of all vehicles that hover.

    Args:
        state_of_now: returns the fleet with its newest telemetry.
        names: names of the vehicles that hover.
        say: called with each line about the wind.

    Raises:
        WindTooStrong: it is above the limit of one of them, and stays there.
    """
    hovering = list(names)
    strongest = _strongest(state_of_now(), hovering)
    if 1.0 < strongest.share <= GUSTY:
        say(f"{strongest.words}: looking for a calmer moment before anybody sets out.")

    for _ in range(_LOOKS):
        if not 1.0 < strongest.share <= GUSTY:
            break
        await asyncio.sleep(_LOOK_S)
        strongest = _strongest(state_of_now(), hovering)

    if strongest.share > 1.0:
        raise WindTooStrong(
            f"{strongest.words}: nobody sets out. Wait for less wind, or fly a vehicle that can "
            "lean more."
        )
    if strongest.share > _WORTH_SAYING_SHARE:
        say(f"{strongest.words}.")


def _strongest(state: FleetState, names: Iterable[str]) -> _Strongest:
    strongest = _Strongest()
    for name in names:
        telemetry = state.vehicles[name].telemetry
        if telemetry is None:
            continue

        # what is not known is NaN, and no comparison holds
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
