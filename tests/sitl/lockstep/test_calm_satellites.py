"""Vehicles by satellites in calm air, with the law of a fleet file that says nothing about it."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from onboard.config.fleet import FleetConfig, Origin
from onboard.config.law import LawConfig
from onboard.flight.types import FlightStep
from sitl.emulator.emulator import Environment
from sitl.physics.wind import WindSettings


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


@pytest.mark.parametrize(
    ("hover_thrust_frac", "has_mocap", "wind_m_s", "until_s"),
    [(0.85, False, 0.0, 10.0), (0.84, True, 0.0, 10.0), (0.8, False, 3.0, 9.0)],
)
def test_a_climb_that_turns_into_a_landing_does_not_end_in_the_air(
    lockstep,
    by_satellites: FleetConfig,
    hover_thrust_frac: float,
    has_mocap: bool,
    wind_m_s: float,
    until_s: float,
) -> None:
    heavy = replace(
        by_satellites.vehicles["mav0"],
        hover_thrust_frac=hover_thrust_frac,
        mocap_required=has_mocap,
    )
    fleet = replace(by_satellites, vehicles={"mav0": heavy})
    gusty = Environment(WindSettings((wind_m_s, 0.0, 0.0), wind_m_s / 3.0))
    with lockstep(fleet, seed=1, environment=gusty) as flight:
        flight.ready()
        flight.start_soon(flight.client.order("takeoff mav0 8", 60.0))
        flight.run(until_s)  # it climbs, at a height of 2 to 3 m
        flight.start_soon(flight.client.order("land mav0", 60.0))

        contacts_m = []
        for _ in range(800):
            flight.run(0.02)
            if flight.agents["mav0"].core.flight.step is FlightStep.CONTACT:
                truth = flight.state.vehicles["mav0"].truth
                contacts_m.append(truth.position_enu_m[2])

        assert flight.agents["mav0"].core.flight.step is FlightStep.LANDED
        assert max(contacts_m) < 0.2
        assert max(touchdown.speed_m_s for touchdown in flight.touchdowns) < 0.8


@pytest.mark.parametrize("seed", [3, *(pytest.param(s, marks=pytest.mark.long) for s in (1, 2, 4))])
def test_they_take_off_and_hover_without_a_failsafe(
    lockstep, by_satellites: FleetConfig, seed: int
) -> None:
    with lockstep(by_satellites, seed=seed) as flight:
        flight.takeoff(2.0)
        flight.run(20.0)
        assert [event for event in flight.events if event.severity == "critical"] == []
