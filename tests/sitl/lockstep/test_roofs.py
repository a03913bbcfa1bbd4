"""Flights from a roof to the yard below it, and back."""

from __future__ import annotations

import math
from typing import Any

import pytest
from msgspec.structs import replace

from onboard.config.fleet import FleetConfig, Origin, fleet_from_mapping
from sitl.emulator.emulator import Environment
from sitl.physics.wind import WindSettings

_ROOF_M = 2.0
_SPOT = (-4.0, 0.0)
_YARD = (1.0, 0.0)


@pytest.fixture(scope="module")
def roof() -> FleetConfig:
    """One vehicle whose spot is on a roof."""
    return fleet_from_mapping(
        {
            "schema": 1,
            "fleet": {
                "name": "roof",
                "geofence_m": {"x": [-8.0, 8.0], "y": [-8.0, 8.0], "z": [-1.0, 5.0]},
            },
            "defaults": {
                "mass_kg": 0.5,
                "hover_thrust_frac": 0.35,
                "max_speed_m_s": 3.0,
                "max_tilt_deg": 35.0,
                "max_acceleration_m_s2": 3.0,
                "attitude_wn_rad_s": 15.0,
                "drag_1_s": 0.3,
            },
            "vehicles": {
                "mav0": {
                    "system_id": 1,
                    "start_enu_m": [*_SPOT, _ROOF_M],
                    "agent": "tcp/127.0.0.1:20000",
                    "autopilot": "udpin://127.0.0.1:30000",
                }
            },
        }
    )


@pytest.fixture(scope="module")
def outdoor_roof(roof: FleetConfig) -> FleetConfig:
    """The same vehicle, which flies by satellites."""
    origin = Origin(latitude_deg=-33.9, longitude_deg=18.4, altitude_m=50.0)
    by_satellites = replace(roof.vehicles["mav0"], mocap_required=False)
    return replace(
        roof,
        fleet=replace(roof.fleet, origin=origin),
        vehicles={"mav0": by_satellites},
    )


def goes_to(flight: Any, goal: tuple[float, float, float]) -> None:
    (result,) = flight.wait_for(flight.fleet.go_to({"mav0": goal})).values()
    assert result.is_done, result.sentence


def stands_at(flight: Any, spot: tuple[float, float], height_m: float, within_m: float) -> None:
    """The vehicle has set down gently by its agent, near a point, at this height."""
    truth = flight.state.vehicles["mav0"].truth
    *at, up_m = truth.position_enu_m
    assert truth.is_on_ground
    assert math.dist(at, spot) < within_m
    assert up_m == height_m
    assert not flight.touchdowns[-1].is_by_px4
    assert flight.touchdowns[-1].speed_m_s < 0.8


@pytest.mark.parametrize(("fleet", "within_m"), [("roof", 0.3), ("outdoor_roof", 0.9)])
def test_from_a_roof_it_lands_in_the_yard_and_again_on_the_roof(
    lockstep: Any, request: Any, fleet: str, within_m: float
) -> None:
    flight = lockstep(request.getfixturevalue(fleet), seed=0)
    flight.takeoff(3.2)
    goes_to(flight, (*_YARD, 3.2))
    flight.land()
    stands_at(flight, _YARD, 0.0, within_m)
    _, _, believed_m = flight.fleet["mav0"].position_enu_m
    assert believed_m == pytest.approx(0.0, abs=0.1)

    flight.takeoff(3.2)
    goes_to(flight, (*_SPOT, 3.2))
    flight.land()
    stands_at(flight, _SPOT, _ROOF_M, within_m)
    assert len(flight.touchdowns) == 2


@pytest.mark.parametrize("wind_m_s", [4.0, 8.0])
@pytest.mark.parametrize("roof_m", [0.5, _ROOF_M])
def test_in_wind_it_sets_down_gently_below_its_roof(
    lockstep: Any, roof: FleetConfig, roof_m: float, wind_m_s: float
) -> None:
    vehicle = replace(roof.vehicles["mav0"], start_enu_m=(*_SPOT, roof_m))
    wind = WindSettings(mean_enu_m_s=(wind_m_s, 0.0, 0.0))
    flight = lockstep(
        replace(roof, vehicles={"mav0": vehicle}), seed=1, environment=Environment(wind=wind)
    )
    flight.takeoff(roof_m + 1.2)
    goes_to(flight, (*_YARD, roof_m + 1.2))
    flight.land()
    stands_at(flight, _YARD, 0.0, 0.4)


@pytest.mark.parametrize("line", ["home mav0", "bring home mav0"])
def test_home_from_the_yard_leads_over_the_edge_of_the_roof(
    lockstep: Any, roof: Any, line: str
) -> None:
    flight = lockstep(roof, seed=0)
    flight.takeoff(3.2)
    goes_to(flight, (-1.0, 0.0, 3.2))
    goes_to(flight, (-1.0, 0.0, 0.8))
    heights_m: list[float] = []

    def look() -> None:
        *at, up_m = flight.state.vehicles["mav0"].truth.position_enu_m
        if math.dist(at, _SPOT) < 1.0:
            heights_m.append(up_m)
        if flight.simulation.emulator.autopilots[0].is_armed:
            flight.at(flight.time_s + 0.02, look)

    flight.at(flight.time_s + 0.02, look)
    (result,) = flight.order(line).values()
    assert result.is_done, result.sentence
    assert min(heights_m) > _ROOF_M - 0.02
    stands_at(flight, _SPOT, _ROOF_M, 0.3)


@pytest.mark.parametrize(
    ("begin", "goal"),
    [
        ((*_SPOT, 3.2), (-2.0, 0.0, 0.8)),  # from above the roof, onto its edge
        ((-2.2, 0.0, 0.8), (*_SPOT, 3.2)),  # into its side
    ],
)
def test_no_straight_way_through_the_roof_is_flown(
    lockstep: Any, roof: Any, begin: tuple[float, float, float], goal: tuple[float, float, float]
) -> None:
    flight = lockstep(roof, seed=0)
    flight.takeoff(3.2)
    begin_x, begin_y, _ = begin
    goes_to(flight, (begin_x, begin_y, 3.2))
    goes_to(flight, begin)
    (result,) = flight.order("move mav0 {:g} {:g} {:g}".format(*goal)).values()
    assert result.phase == "refused"
    assert "the raised ground of a take-off spot is in the way" in result.sentence


def test_a_vehicle_from_a_roof_flies_and_lands_below_it(lockstep: Any, roof: Any) -> None:
    flight = lockstep(roof, seed=0)
    flight.takeoff(3.2)
    goes_to(flight, (*_YARD, 1.0))
    flight.run(1.0)
    _, _, up_m = flight.state.vehicles["mav0"].truth.position_enu_m
    assert up_m == pytest.approx(1.0, abs=0.15)
    flight.land()
    stands_at(flight, _YARD, 0.0, 0.3)
