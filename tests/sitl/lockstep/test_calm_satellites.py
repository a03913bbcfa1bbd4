"""Vehicles by satellites in calm air, with the law of a fleet file that says nothing about it."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from onboard.config.fleet import FleetConfig, Origin
from onboard.config.law import LawConfig


@pytest.fixture
def by_satellites(paper: FleetConfig) -> FleetConfig:
    """Two heavy vehicles with a slow attitude, 6 m apart."""
    slow = {
        "mass_kg": 4.0,
        "hover_thrust_frac": 0.6,
        "attitude_wn_rad_s": 8.0,
        "attitude_delay_s": 0.06,
        "drag_1_s": 0.3,
        "mocap_required": False,
    }
    vehicles = {
        name: replace(paper.vehicles[name], start_enu_m=(6.0 * index, 0.0, 0.0), **slow)
        for index, name in enumerate(["mav0", "mav1"])
    }
    field = replace(
        paper.fleet,
        origin=Origin(latitude_deg=47.0, longitude_deg=8.0, altitude_m=400.0),
        geofence_m=replace(
            paper.fleet.geofence_m, x=(-30.0, 30.0), y=(-30.0, 30.0), z=(-2.0, 15.0)
        ),
    )
    return replace(paper, fleet=field, law=LawConfig(), vehicles=vehicles, formations={})


def test_a_vehicle_with_little_lift_reserve_notices_the_ground(
    lockstep, by_satellites: FleetConfig
) -> None:
    heavy = replace(by_satellites.vehicles["mav0"], hover_thrust_frac=0.8)
    fleet = replace(by_satellites, vehicles={"mav0": heavy})
    with lockstep(fleet, seed=3) as flight:
        flight.takeoff(2.0)
        ordered_s = flight.time_s
        (result,) = flight.wait_for(flight.client.order("land mav0", 60.0)).values()
        assert result.is_done
        assert flight.time_s - ordered_s < 15.0


@pytest.mark.parametrize("seed", [3, *(pytest.param(s, marks=pytest.mark.long) for s in (1, 2, 4))])
def test_they_take_off_and_hover_without_a_failsafe(
    lockstep, by_satellites: FleetConfig, seed: int
) -> None:
    with lockstep(by_satellites, seed=seed) as flight:
        flight.takeoff(2.0)
        flight.run(20.0)
        assert [event for event in flight.events if event.severity == "critical"] == []
