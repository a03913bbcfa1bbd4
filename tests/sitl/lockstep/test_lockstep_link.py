"""The typed link: what a client would see on the wire, in the fleet's axes."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest

from onboard.agent_inputs import ParamsRead
from onboard.config.earth import Origin, east_north_m
from onboard.config.fleet import FleetConfig, load_fleet
from onboard.frames import enu_flu_from_ned_frd
from onboard.px4.required_params import required_params
from sitl.lockstep.simulation import Simulation
from sitl.mavlink.view import View, measured_attitude
from sitl.px4.modes import Mode
from tests.oracles.rotation import quaternion_from_yaw, quaternion_multiply
from tests.sitl.lockstep.conftest import ROOT

PX4_SITL = ROOT / "configs" / "fleets" / "px4-sitl.toml"


def test_turns_in_floats_are_those_of_the_frames() -> None:
    rng = np.random.default_rng(0)
    for _ in range(30):
        q = rng.normal(size=4)
        q /= np.linalg.norm(q)
        yaw = rng.normal()
        half = 0.01 * rng.normal(size=3)
        faced = quaternion_multiply(quaternion_from_yaw(yaw), q.tolist())
        turned = quaternion_multiply(faced, (1.0, half[0], half[1], half[2]))
        w, x, y, z = np.array(list(turned)) / math.hypot(*turned)
        expected = enu_flu_from_ned_frd((w, x, y, z))
        measured = enu_flu_from_ned_frd(measured_attitude(q.tolist(), yaw, half.tolist()))
        np.testing.assert_allclose(measured, expected, atol=1e-12)


@pytest.fixture
def simulation(paper) -> Simulation:
    return Simulation(paper, seed=1)


def _run(simulation: Simulation, seconds: float) -> None:
    for _ in range(round(seconds / 0.004)):
        simulation.step()


def test_armed_and_mode_are_told_once_a_second_and_attitude_fifty_times(simulation) -> None:
    one = simulation.links.links[0]
    beats = set()
    attitudes = set()
    positions = set()
    for _ in range(1000):
        simulation.step()
        snapshot = one.snapshot()
        beats.add(snapshot.heartbeat_ns)
        attitudes.add(snapshot.attitude_ns)
        positions.add(snapshot.local_position_ns)
    # the first comes at the start, the second at a moment of this PX4's own
    _, *regular_ns = sorted(beats - {0})
    assert len(regular_ns) >= 3
    assert set(np.diff(regular_ns).tolist()) == {1_000_000_000}
    assert len(attitudes - {0}) == pytest.approx(200, abs=2)
    assert len(positions - {0}) == pytest.approx(40, abs=1)  # the motion capture leads
    assert snapshot.system_id == 1
    assert snapshot.mode == "HOLD"


def test_a_command_is_answered_by_telemetry_only_and_arming_is_refused_without_setpoints(
    simulation,
) -> None:
    _run(simulation, 6.0)
    one = simulation.links.links[0]
    one.set_offboard()
    one.arm()
    _run(simulation, 1.5)
    assert one.snapshot().mode == "OFFBOARD"
    assert not one.snapshot().is_armed


def test_a_terminated_flight_shows_the_mode_that_this_version_of_px4_shows(paper) -> None:
    for px4, shown in (("1.17", "MANUAL"), ("1.18", "OFFBOARD")):
        changes = {"px4_version": px4}
        vehicles = {
            name: msgspec.structs.replace(vehicle, **changes)
            for name, vehicle in paper.vehicles.items()
        }
        simulation = Simulation(msgspec.structs.replace(paper, vehicles=vehicles), seed=1)
        autopilot = simulation.emulator.autopilots[0]
        autopilot.requested_mode = Mode.OFFBOARD
        autopilot.mode = Mode.TERMINATION
        assert simulation.links.heartbeat(0)["mode"] == shown, px4


def test_connecting_applies_the_fleets_parameters_and_finds_none_wrong(simulation, paper) -> None:
    one = simulation.links.links[1]
    assert one.connect() == ParamsRead((), 0.5)
    values = simulation.emulator.autopilots[1].params.values
    required = required_params(paper, paper.vehicles["mav1"], (1, 17))
    assert [name for name, demand in required.items() if not demand.is_met(values[name])] == []


def test_a_silent_link_leaves_the_snapshot_as_it_was(simulation) -> None:
    from sitl.faults.catalogue import Fault

    _run(simulation, 1.0)
    simulation.inject(
        Fault(
            "link_loss",
            "mav0",
            at_s=simulation.time_s,
            parameters={"share": 1.0, "direction": "out"},
        )
    )
    _run(simulation, 0.1)
    before = simulation.links.links[0].snapshot()
    _run(simulation, 1.0)
    assert simulation.links.links[0].snapshot().last_packet_ns == before.last_packet_ns
    assert simulation.links.links[1].snapshot().last_packet_ns > before.last_packet_ns


def elsewhere(fleet: FleetConfig) -> FleetConfig:
    """Return a fleet whose origin is in Sydney."""
    sydney = Origin(latitude_deg=-33.86, longitude_deg=151.21, altitude_m=20.0)
    return msgspec.structs.replace(fleet, fleet=msgspec.structs.replace(fleet.fleet, origin=sydney))


def test_vehicles_start_where_the_fleets_origin_is_on_earth() -> None:
    fleet = elsewhere(load_fleet(PX4_SITL))
    simulation = Simulation(fleet, seed=1)
    emulator = simulation.emulator
    origin = fleet.fleet.origin
    assert isinstance(origin, Origin)

    for index, name in enumerate(simulation.names):
        latitude_deg, longitude_deg, altitude_m = View(emulator, index).to_global((0.0, 0.0, 0.0))
        spot_m = east_north_m(origin, latitude_deg, longitude_deg)
        assert spot_m == pytest.approx(fleet.vehicles[name].start_enu_m[:2], abs=1e-3)
        assert altitude_m == 20.0
        assert emulator.autopilots[index].params["SIH_LOC_LAT0"] == -33.86


@pytest.mark.long
def test_a_fleet_by_satellites_is_ready_wherever_on_earth_it_stands(lockstep: Any) -> None:
    flight = lockstep(elsewhere(load_fleet(PX4_SITL)), seed=1)
    flight.ready(30.0)
