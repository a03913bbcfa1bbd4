"""Failures in lockstep are answered as docs/failsafe.md says, with the real cores and the emulated
PX4s.
"""

from __future__ import annotations

import msgspec
import pytest

from groundstation.fleet.state import GROUND_STALLED
from onboard.bus.protocol import LEASE_MS
from onboard.flight.types import FlightStep
from sitl.faults.catalogue import Fault
from sitl.lockstep.connections import BusSettings
from tests.sitl.lockstep.suite import fleet_of, mission_of


def _truth(flight, name):
    return flight.state.vehicles[name].truth


def _codes(flight, name):
    return [event.code for event in flight.events if event.vehicle == name]


def _down(flight, name):
    autopilot = flight.simulation.emulator.autopilots[flight.simulation.names.index(name)]
    return not autopilot.is_armed and _truth(flight, name).is_on_ground


def _wait_down(flight, names, timeout_s=25.0):
    return flight.until(lambda state: all(_down(flight, name) for name in names), timeout_s)


@pytest.mark.long
def test_an_agent_that_is_killed_is_silent_and_px4_lands_it_while_the_others_keep_away(
    lockstep, paper
):
    flight = lockstep(paper, seed=1)
    flight.takeoff(1.0)
    flight.agents["mav1"].kill()
    assert _wait_down(flight, ["mav1"])
    assert flight.min_separation_m > 0.8
    assert not _truth(flight, "mav0").is_on_ground
    assert "neighbour-silent" in _codes(flight, "mav0")
    assert all(result.is_done for name, result in flight.order("land mav0,mav2").items())


@pytest.mark.long
def test_a_mission_whose_agent_dies_fails_lands_everybody_and_says_who(lockstep, hop):
    flight = lockstep(hop.fleet, seed=1)
    flight.at(9.0, flight.agents["mav1"].kill)
    verdict = flight.fly(hop)
    assert verdict.exit_status == 1
    assert "mav1" in verdict.summary
    assert all(_down(flight, name) for name in ("mav0", "mav1", "mav2"))
    assert "direct_command" in _codes(flight, "mav1")


@pytest.mark.long
def test_an_agent_that_accepts_the_last_landing_and_dies_is_landed_straight_by_px4(lockstep, hop):
    flight = lockstep(hop.fleet, seed=1)
    flight.at(7.0, flight.agents["mav1"].kill)  # all others are ordered to land two seconds later
    flight.at(9.6, flight.agents["mav0"].kill)
    verdict = flight.fly(hop)
    assert all(verdict.landed.values())
    assert "direct_disarmed" in _codes(flight, "mav0")
    assert GROUND_STALLED not in _codes(flight, "ground")
    assert flight.time_s < 25.0


@pytest.mark.long
@pytest.mark.failsafe("loop stalled for long", step="flying")
def test_an_agent_that_hangs_for_a_moment_holds_and_one_that_hangs_for_long_is_landed_by_px4(
    lockstep, paper
):
    flight = lockstep(paper, seed=2)
    flight.takeoff(1.0)
    mav0 = flight.agents["mav0"]
    mav1 = flight.agents["mav1"]
    mav0.hang()
    mav1.hang()
    flight.run(0.25)
    mav0.resume()
    flight.run(1.5)
    mav1.resume()
    assert _wait_down(flight, ["mav1"])
    assert mav0.core.flight.state == "holding"
    assert not mav1.core.flight.step.is_streaming  # PX4 had taken over
    assert mav1.core.flight.reason.startswith(("PX4 left OFFBOARD", "Loop stalled for long"))
    assert flight.min_separation_m > 0.8


@pytest.mark.long
def test_without_the_ground_the_order_is_finished_and_the_vehicle_stays(lockstep, paper):
    flight = lockstep(paper, seed=3)
    flight.takeoff(1.0)
    flight.bus.partition(["ground-1"])
    before = flight.state.vehicles["mav0"].received_ns
    flight.run(4.0)
    assert flight.state.vehicles["mav0"].received_ns <= before + 50_000_000
    assert flight.agents["mav0"].core.flight.state == "flying"
    flight.bus.heal()
    flight.run(1.0)
    assert all(result.is_done for result in flight.land().values())


@pytest.mark.long
def test_the_end_of_an_order_that_its_ground_missed_is_told_when_it_is_back(lockstep, paper):
    flight = lockstep(paper, seed=3)
    flight.takeoff(1.0)
    flight.run(1.5)
    begin_s = flight.time_s
    (x, y, _) = paper.vehicles["mav0"].start_enu_m
    flight.at(begin_s + 0.3, lambda: flight.bus.partition(["ground-1"]))
    flight.at(begin_s + 5.0, flight.bus.heal)
    results = flight.wait_for(flight.fleet["mav0"].move((x, y - 0.4, 1.0)))
    assert flight.time_s > begin_s + 5.0
    assert results["mav0"].is_done
    ends = [event for event in flight.events if event.code == "order-takeoff"]
    assert len(ends) == len(paper.enabled_names)  # what was heard is not told twice


@pytest.mark.long
@pytest.mark.failsafe("ground station lost for long", step="flying")
def test_without_the_ground_for_long_all_land_under_the_law(lockstep, paper):
    section = msgspec.structs.replace(paper.fleet, ground_lost_land_s=2.0)
    flight = lockstep(msgspec.structs.replace(paper, fleet=section), seed=8)
    flight.takeoff(1.0)
    flight.bus.partition(["ground-1"])
    flight.run(1e-3 * LEASE_MS + 2.3)
    assert {shell.core.flight.step for shell in flight.agents.values()} == {FlightStep.DESCENT}
    flight.run(8.0)
    assert {shell.core.flight.state for shell in flight.agents.values()} <= {"landed", "ready"}
    assert flight.min_separation_m > 0.8


@pytest.mark.long
def test_an_agent_cut_off_from_everybody_loses_its_position_and_lands(lockstep, paper):
    flight = lockstep(paper, seed=4)
    flight.takeoff(1.0)
    flight.bus.partition(["mav1"])
    assert _wait_down(flight, ["mav1"])
    assert flight.min_separation_m > 0.8
    assert flight.agents["mav1"].core.flight.reason.startswith("Own position lost")
    assert flight.agents["mav0"].core.flight.state == "flying"


@pytest.mark.long
@pytest.mark.failsafe("own position lost", step="flying")
def test_a_vehicle_whose_body_the_mocap_loses_lands_by_dead_reckoning(lockstep, paper):
    flight = lockstep(paper, seed=5)
    flight.may_land_hard = True  # blind, with 1.4 m/s
    flight.takeoff(1.0)
    flight.inject(Fault("mocap_lost", "mav2", at_s=flight.time_s))
    flight.run(1.0)
    assert "position-lost" in _codes(flight, "mav2")
    assert _wait_down(flight, ["mav2"])
    assert not _truth(flight, "mav0").is_on_ground


@pytest.mark.long
def test_a_px4_that_falls_silent_ends_the_setpoints_and_one_on_a_lossy_link_flies_on(
    lockstep, paper
):
    flight = lockstep(paper, seed=6)
    flight.inject(
        Fault("link_loss", "mav0", at_s=0.0, parameters={"share": 0.1, "direction": "out"})
    )
    flight.takeoff(1.0)
    flight.inject(
        Fault(
            "link_loss",
            "mav1",
            at_s=flight.time_s,
            duration_s=1.0,
            parameters={"share": 1.0, "direction": "out"},
        )
    )
    flight.run(1.0)
    assert "autopilot-silent" in _codes(flight, "mav1")
    assert flight.agents["mav1"].core.flight.state == "failed"
    assert _wait_down(flight, ["mav1"])
    assert flight.agents["mav0"].core.flight.state == "flying"


@pytest.mark.long
def test_separation_holds_on_a_bus_that_loses_delays_reorders_and_repeats(lockstep, paper):
    bus = BusSettings(delay_s=0.004, jitter_s=0.006, loss=0.2, reorder=0.1, duplicate=0.1)
    flight = lockstep(paper, seed=7, bus=bus)
    # else an order that is lost twice goes the direct way, and PX4 takes over
    for name in flight.agents:
        flight.bus.set_link("ground-1", name, BusSettings())
    verdict = flight.fly("configs/missions/paper.toml")
    assert verdict.passed, verdict.summary
    assert flight.bus.lost > 1000


@pytest.mark.long
def test_an_agent_started_again_in_flight_does_not_touch_a_vehicle_that_px4_lands(lockstep, paper):
    flight = lockstep(paper, seed=8)
    flight.takeoff(1.0)
    flight.agents["mav1"].kill()
    flight.run(1.0)
    flight.agents["mav1"].start()
    assert _wait_down(flight, ["mav1"])
    flight.run(3.0)
    assert flight.agents["mav1"].core.flight.state in ("ready", "waiting", "landed")
    assert flight.min_separation_m > 0.8


def test_a_fault_comes_at_the_tick_it_was_asked_for(lockstep, paper):
    flight = lockstep(paper)
    seen = []
    flight.at(0.5, lambda: seen.append(flight.time_s))
    flight.at(0.248, lambda: seen.append(flight.time_s))
    flight.run(1.0)
    assert seen == pytest.approx([0.248, 0.5], abs=1e-6)


@pytest.mark.long
def test_nobody_counts_on_a_vehicle_to_go_aside_that_is_about_to_touch_down(lockstep):
    # it was at 0.70 m: friction ended the way aside that the other one relied on
    flight = lockstep(fleet_of(3), seed=263)
    flight.at(
        8.76,
        lambda: flight.inject(
            Fault("battery_cell", "mav0", flight.time_s, parameters={"drop_pct": 80.0})
        ),
    )
    flight.fly(mission_of(3))
    assert "battery-low" in _codes(flight, "mav0")
    assert flight.min_separation_m > 0.85
