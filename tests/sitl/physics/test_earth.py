"""Metres around a point of the Earth, as the emulator has them and as the agents have them."""

from __future__ import annotations

import pytest

from onboard.config.earth import Origin, east_north_m, latitude_longitude_deg
from sitl.physics.earth import EarthPoint, degrees_at, metres_from

ORIGINS = [
    EarthPoint(latitude_deg=47.3977, longitude_deg=8.5456, altitude_m=489.4),
    EarthPoint(latitude_deg=-33.9, longitude_deg=151.2, altitude_m=12.0),
    EarthPoint(latitude_deg=78.2, longitude_deg=15.6, altitude_m=0.0),
    EarthPoint(latitude_deg=-16.8, longitude_deg=179.99999, altitude_m=3.0),
    EarthPoint(latitude_deg=0.0, longitude_deg=0.0, altitude_m=0.0),
]
NORTH_EAST_M = [(0.0, 0.0), (12.5, -3.0), (-60.0, 80.0), (4000.0, 2500.0)]


@pytest.mark.parametrize("origin", ORIGINS)
@pytest.mark.parametrize("there_m", NORTH_EAST_M)
def test_emulator_and_agents_project_alike(
    origin: EarthPoint, there_m: tuple[float, float]
) -> None:
    north_m, east_m = there_m
    fleet = Origin(*origin)

    latitude_deg, longitude_deg = degrees_at(origin, north_m, east_m)

    seen = east_north_m(fleet, latitude_deg, longitude_deg)
    assert seen == pytest.approx((east_m, north_m), abs=1e-4)
    of_agents = latitude_longitude_deg(fleet, east_m, north_m)
    assert (latitude_deg, longitude_deg) == pytest.approx(of_agents, abs=1e-10)
    back_m = metres_from(origin, latitude_deg, longitude_deg)
    assert back_m == pytest.approx((north_m, east_m), abs=1e-6)
