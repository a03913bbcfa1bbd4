"""The hover check: a gust delays the crossing, a wind above the limit refuses it."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import pytest

from groundstation.fleet.state import FleetState, VehicleView
from groundstation.missions.hover_check import WindTooStrong, hover_check
from tests.groundstation.conftest import telemetry

LIMIT_M_S = 3.0


def _told(*winds_m_s: float) -> Callable[[], FleetState]:
    """Return what the ground knows at each look; the last wind stays."""
    states = []
    for wind_m_s in winds_m_s:
        message = telemetry(wind_enu_m_s=(wind_m_s, 0.0), max_wind_m_s=LIMIT_M_S)
        states.append(FleetState({"mav0": VehicleView("mav0", message, 0)}))

    looks = itertools.chain(states, itertools.repeat(states[-1]))
    return lambda: next(looks)


async def test_a_gust_delays_the_crossing_until_the_wind_is_within_the_limit() -> None:
    said: list[str] = []
    await hover_check(_told(3.4, 3.2, 2.9), ["mav0"], said.append)
    assert "mav0 feels a wind of 3.4 m/s, its limit is 3.0 m/s" in said[0]
    assert "looking for a calmer moment" in said[0]
    assert said[1] == "mav0 feels a wind of 2.9 m/s, its limit is 3.0 m/s (max_wind_m_s)."


async def test_a_wind_that_no_gust_of_the_limit_explains_is_refused_at_once() -> None:
    said: list[str] = []
    looks = _told(4.0, 1.0)
    with pytest.raises(WindTooStrong, match=r"a wind of 4\.0 m/s.*nobody sets out"):
        await hover_check(looks, ["mav0"], said.append)
    assert said == []


async def test_a_wind_that_is_little_or_not_known_is_not_mentioned() -> None:
    said: list[str] = []
    await hover_check(_told(1.0), ["mav0"], said.append)
    await hover_check(_told(float("nan")), ["mav0"], said.append)
    assert said == []
