"""A fleet by visual odometry: no motion capture, no satellites, a camera on each vehicle."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.mission import Mission
from onboard.config.fleet import FleetConfig, load_fleet
from sitl.faults.catalogue import Fault

_FLEET = Path(__file__).resolve().parents[3] / "configs/fleets/sih.toml"
# what is only advised, and so not set in lockstep
_ADVISED = {"EKF2_EVP_NOISE": 0.01, "EKF2_TAU_VEL": 0.02, "EKF2_TAU_POS": 0.1}
_CROSSING_S = 10.5


@pytest.fixture
def by_vision() -> FleetConfig:
    fleet = load_fleet(_FLEET)
    vehicles = {
        name: replace(
            vehicle,
            mocap_required=False,
            px4_position="vision",
            px4_params={**vehicle.px4_params, **_ADVISED},
        )
        for name, vehicle in fleet.vehicles.items()
    }
    return replace(fleet, vehicles=vehicles)


def _crossing(fleet: FleetConfig) -> Mission:
    """Up, into the triangle across each other's ways, and down."""
    return mission_from_mapping(
        {
            "schema": 1,
            "step": [
                {"do": "takeoff", "height_m": 1.0},
                {"do": "formation", "name": "triangle", "position_enu_m": [0.0, 1.2, 1.0]},
                {"do": "land"},
            ],
            "expect": {"min_separation_m": 0.8, "arrived_within_m": 0.4, "all_landed": True},
        },
        path="crossing.toml",
        fleet=fleet,
    )


def test_a_fleet_by_visual_odometry_flies_a_mission(lockstep: Any, by_vision: FleetConfig) -> None:
    flight = lockstep(by_vision, seed=2)
    verdict = flight.fly(_crossing(by_vision))
    assert verdict.passed, verdict.sentences

    estimator = flight.simulation.emulator.estimator
    assert not any(sensors.has_gps for sensors in estimator.sensors)

    # the odometry drifts, and each PX4 follows its own
    errors_m = [flight.px4_position_error_m(name) for name in by_vision.enabled_names]
    assert 0.01 < max(errors_m) < 0.3


@pytest.mark.failsafe("own position lost", step="flying")
@pytest.mark.parametrize("lost", [("mav0",), ("mav0", "mav1", "mav2")])
@pytest.mark.parametrize("at_s", [_CROSSING_S, _CROSSING_S + 1.0, _CROSSING_S + 2.0])
def test_vehicles_whose_odometry_ends_come_down_by_dead_reckoning_and_keep_the_promise(
    lockstep: Any, by_vision: FleetConfig, lost: tuple[str, ...], at_s: float
) -> None:
    flight = lockstep(by_vision, seed=4)
    for name in lost:
        flight.inject(Fault("vision_lost", name, at_s=at_s))
    verdict = flight.fly(_crossing(by_vision))

    assert not verdict.passed
    assert all(flight.state.is_landed(name) for name in by_vision.enabled_names)
    assert flight.min_separation_m > 0.8
    said = {event.vehicle for event in flight.events if event.code == "position-lost"}
    assert said == set(lost)


@pytest.mark.failsafe("own position lost", step="flying")
@pytest.mark.parametrize("frozen", [("mav0",), ("mav0", "mav1", "mav2")])
@pytest.mark.parametrize("at_s", [_CROSSING_S, _CROSSING_S + 1.0])
def test_vehicles_whose_cameras_repeat_themselves_come_down_and_keep_the_promise(
    lockstep: Any, by_vision: FleetConfig, frozen: tuple[str, ...], at_s: float
) -> None:
    """Their PX4s believe that they stand; they flew away, by up to 30 m."""
    flight = lockstep(by_vision, seed=4)
    flight.may_land_hard = True  # the height is the camera's, too
    for name in frozen:
        flight.inject(Fault("vision_frozen", name, at_s=at_s))
    verdict = flight.fly(_crossing(by_vision))

    assert not verdict.passed
    assert flight.min_separation_m > 0.8
    for name in frozen:
        x, y, _ = flight.state.vehicles[name].truth.position_enu_m
        assert flight.state.is_landed(name)
        assert math.hypot(x, y) < 4.0
    assert all(touchdown.speed_m_s < 1.3 for touchdown in flight.touchdowns)
    said = {event.vehicle for event in flight.events if event.code == "position-lost"}
    assert "mav0" in said  # one that is nearly at its goal has little motion to miss
    assert said <= set(frozen)


@pytest.mark.parametrize("lost_s", [0.7, 2.0])
def test_a_camera_that_begins_anew_elsewhere_moves_no_vehicle(
    lockstep: Any, by_vision: FleetConfig, lost_s: float
) -> None:
    flight = lockstep(by_vision, seed=5)
    begin_s = _CROSSING_S + 1.0
    flight.inject(Fault("vision_lost", "mav0", at_s=begin_s, duration_s=lost_s))
    moved = {"north_m": 0.7, "east_m": -0.9}
    back_s = begin_s + lost_s
    flight.inject(Fault("vision_jump", "mav0", at_s=back_s, parameters=moved))
    flight.fly(_crossing(by_vision))

    assert flight.min_separation_m > 0.8
    assert all(flight.state.is_landed(name) for name in by_vision.enabled_names)
    truth = flight.state.vehicles["mav0"].truth
    telemetry = flight.state.telemetry_of("mav0")
    assert math.dist(truth.position_enu_m[:2], telemetry.position_enu_m[:2]) < 0.5
    assert all(touchdown.speed_m_s < 1.0 for touchdown in flight.touchdowns)


@pytest.mark.failsafe("own position lost", step="flying")
@pytest.mark.parametrize("px4_version", ["1.16", "1.18"])
@pytest.mark.parametrize("gap_s", [0.0, 0.7])
def test_vehicles_whose_cameras_begin_anew_turned_come_down_and_keep_the_promise(
    lockstep: Any, by_vision: FleetConfig, gap_s: float, px4_version: str
) -> None:
    """PX4 keeps its own heading, or follows the camera's slowly; its position is turned at once."""
    vehicles = {
        name: replace(vehicle, px4_version=px4_version)
        for name, vehicle in by_vision.vehicles.items()
    }
    by_vision = replace(by_vision, vehicles=vehicles)
    flight = lockstep(by_vision, seed=4)
    at_s = _CROSSING_S + 1.0
    for name in by_vision.enabled_names:
        if gap_s > 0.0:
            flight.inject(Fault("vision_lost", name, at_s=at_s, duration_s=gap_s))
        turned = {"yaw_deg": 40.0}
        flight.inject(Fault("vision_turned", name, at_s=at_s + gap_s, parameters=turned))
    verdict = flight.fly(_crossing(by_vision))

    assert not verdict.passed
    assert verdict.closest.distance_m >= 0.8
    assert all(flight.state.is_landed(name) for name in by_vision.enabled_names)
    # PX4 has followed the camera's heading by now, as if all were right
    flight.run(8.0)
    reason = "Where it stands is not known"
    if px4_version == "1.18" and gap_s > 0.0:  # which refuses that heading for ever then
        reason = "PX4 does not use the heading of its camera"
    for name in by_vision.enabled_names:
        assert any(reason in one for one in flight.agents[name].core.preflight.not_ready)


@pytest.mark.failsafe("own position lost", step="flying")
def test_cameras_that_say_that_they_begin_anew_turned_are_not_believed(
    lockstep: Any, by_vision: FleetConfig
) -> None:
    """PX4 follows a new reset counter at once, with its heading, too."""
    flight = lockstep(by_vision, seed=4)
    at_s = _CROSSING_S + 1.0
    emulator = flight.simulation.emulator
    for index, name in enumerate(by_vision.enabled_names):
        flight.inject(Fault("vision_turned", name, at_s=at_s, parameters={"yaw_deg": 40.0}))
        flight.at(at_s + 0.01, partial(emulator.estimator.begin_vision_anew, index))
    verdict = flight.fly(_crossing(by_vision))

    assert not verdict.passed
    assert verdict.closest.distance_m >= 0.8
    assert all(flight.state.is_landed(name) for name in by_vision.enabled_names)


def test_a_camera_that_says_before_the_first_flight_that_it_begins_anew_turned_refuses_it(
    lockstep: Any, by_vision: FleetConfig
) -> None:
    """A process that computes the odometry is restarted while the vehicle stands on its spot."""
    flight = lockstep(by_vision, seed=4)
    flight.ready()
    flight.run(6.0)
    flight.inject(Fault("vision_turned", "mav1", at_s=0.0, parameters={"yaw_deg": 40.0}))
    index = by_vision.enabled_names.index("mav1")
    estimator = flight.simulation.emulator.estimator
    flight.at(flight.time_s + 0.01, partial(estimator.begin_vision_anew, index))
    flight.run(3.0)
    (reason,) = flight.agents["mav1"].core.preflight.not_ready
    assert "Where it stands is not known" in reason
    assert not flight.agents["mav0"].core.own.displaced_m


@pytest.mark.parametrize("px4_version", ["1.16", "1.18"])
def test_a_camera_that_turns_before_the_first_flight_refuses_it(
    lockstep: Any, by_vision: FleetConfig, px4_version: str
) -> None:
    vehicles = {
        name: replace(vehicle, px4_version=px4_version)
        for name, vehicle in by_vision.vehicles.items()
    }
    flight = lockstep(replace(by_vision, vehicles=vehicles), seed=4)
    flight.ready()
    flight.inject(Fault("vision_turned", "mav1", at_s=0.0, parameters={"yaw_deg": 40.0}))
    flight.run(12.0)
    assert flight.agents["mav1"].core.preflight.not_ready
    assert not flight.agents["mav0"].core.own.displaced_m


@pytest.mark.failsafe("own position lost", step="flying")
@pytest.mark.parametrize("east_m", [0.25, 1.0])
def test_vehicles_whose_cameras_jump_come_down_and_keep_the_promise(
    lockstep: Any, by_vision: FleetConfig, east_m: float
) -> None:
    """Jumps of 0.35 m towards each other were believed, and brought them to 0.78 m."""
    flight = lockstep(by_vision, seed=4)
    flight.may_land_hard = True
    for name, jump_m in (("mav0", east_m), ("mav1", -east_m)):
        parameters = {"east_m": jump_m, "north_m": 0.0}
        flight.inject(Fault("vision_jump", name, at_s=_CROSSING_S, parameters=parameters))
    flight.fly(_crossing(by_vision))

    assert flight.min_separation_m > 0.8
    said = {event.vehicle for event in flight.events if event.code == "position-lost"}
    assert said == {"mav0", "mav1"}


@pytest.mark.parametrize("at_s", [_CROSSING_S, _CROSSING_S + 1.0])
def test_a_vehicle_by_vision_does_not_flee_from_its_own_body_that_the_mocap_takes_for_another(
    lockstep: Any, by_vision: FleetConfig, at_s: float
) -> None:
    """It fled at 4 m/s, 12 m far, with the body that it fled from."""
    by_mocap = load_fleet(_FLEET).vehicles["mav0"]
    fleet = replace(by_vision, vehicles={**by_vision.vehicles, "mav0": by_mocap})
    flight = lockstep(fleet, seed=4)
    flight.may_land_hard = True  # mav0 lands without poses
    swapped = Fault("mocap_swapped", "mav0", at_s=at_s, parameters={"other": "mav1"})
    flight.inject(swapped)
    flight.fly(_crossing(fleet))

    assert flight.min_separation_m > 0.8
    x, y, _ = flight.state.vehicles["mav1"].truth.position_enu_m
    assert math.hypot(x, y) < 4.0
    said = {(event.vehicle, event.code) for event in flight.events}
    assert ("mav0", "mocap-swapped") in said
    assert ("mav1", "neighbour-implausible") not in said
    assert ("mav1", "fence-near") not in said
