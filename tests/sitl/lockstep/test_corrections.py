"""Flights with RTK corrections: what ends them, and a base that says another place."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import pytest

from onboard.bus.schema import Telemetry
from onboard.config.fleet import CorrectionsConfig, FleetConfig, load_fleet
from onboard.corrections.base_watch import FINE, BaseWatch
from sitl.faults.catalogue import Fault
from sitl.lockstep.flight import Lockstep

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def outdoors() -> FleetConfig:
    """Three vehicles by satellites, of which nobody takes off without an RTK fix."""
    fleet = load_fleet(ROOT / "configs" / "fleets" / "px4-sitl.toml")
    corrections = CorrectionsConfig(source="mock", fix="rtk_fixed")
    return msgspec.structs.replace(fleet, corrections=corrections)


def telemetry(flight: Lockstep, vehicle: str) -> Telemetry:
    last = flight.state.vehicles[vehicle].telemetry
    assert last is not None
    return last


def fixes(flight: Lockstep) -> list[str]:
    return [telemetry(flight, name).fix for name in flight.state.vehicles]


def codes(flight: Lockstep, vehicle: str) -> set[str]:
    return {event.code for event in flight.events if event.vehicle == vehicle}


def off_m(flight: Lockstep, vehicle: str) -> float:
    """How far a vehicle is from where it believes to be, horizontally."""
    truth = flight.state.vehicles[vehicle].truth
    assert truth is not None
    believed_enu_m = telemetry(flight, vehicle).position_enu_m
    return math.dist(truth.position_enu_m[:2], believed_enu_m[:2])


def test_nobody_takes_off_before_the_fix_and_with_it_vehicles_are_where_they_believe(
    lockstep, outdoors
):
    flight = lockstep(outdoors, seed=1)
    flight.run(5.0)
    assert fixes(flight) == ["RTK float"] * 3
    for name in flight.state.vehicles:
        assert "demands RTK fixed" in telemetry(flight, name).not_ready[0]
    flight.takeoff(1.5)
    assert fixes(flight) == ["RTK fixed"] * 3
    flight.run(3.0)
    assert max(off_m(flight, name) for name in flight.state.vehicles) < 0.15
    flight.land()


def test_corrections_that_end_slow_a_vehicle_and_hold_it_when_its_position_is_coarse(
    lockstep, outdoors
):
    flight = lockstep(outdoors, seed=2)
    flight.takeoff(1.5)
    flight.inject(Fault("corrections_lost", "mav1", flight.time_s))
    assert flight.until(lambda _: "fix-fell-back" in codes(flight, "mav1"), 8.0)
    told = telemetry(flight, "mav1")
    assert (told.state, told.action) == ("flying", "flying slowly")
    assert flight.until(lambda _: telemetry(flight, "mav1").state == "holding", 12.0)
    assert "fix-coarse" in codes(flight, "mav1")
    for name in ("mav0", "mav2"):
        assert telemetry(flight, name).state == "flying"
        assert "fix-fell-back" not in codes(flight, name)
    flight.land()


def test_with_a_tenth_of_all_datagrams_lost_no_frame_is_mixed_and_the_fix_stays(lockstep, outdoors):
    flight = lockstep(outdoors, seed=3)
    for name in flight.state.vehicles:
        parameters: dict[str, float | str] = {"link": "companion", "direction": "in", "share": 0.1}
        flight.inject(Fault("link_loss", name, 0.0, parameters=parameters))
    flight.takeoff(1.5)
    flight.run(20.0)
    receivers = flight.simulation.emulator.receivers
    assert fixes(flight) == ["RTK fixed"] * 3
    for receiver in receivers:
        assert receiver.bad_frames == 0
        assert receiver.frames > 40
    flight.land()


@pytest.mark.parametrize("is_believed", [False, True])
def test_a_base_that_says_another_place_moves_nobody_who_does_not_believe_it(
    lockstep, outdoors, monkeypatch, is_believed
):
    """Whoever believes it flies away by as much: that is what the judgement of a base prevents."""
    if is_believed:
        monkeypatch.setattr(BaseWatch, "_judge", lambda *_, **__: FINE)
    flight = lockstep(outdoors, seed=4)
    flight.takeoff(1.5)
    flight.inject(Fault("base_moved", "mav0", flight.time_s, parameters={"east_m": 2.5}))
    flight.run(14.0)  # a jump of PX4's position is given back with 0.2 m/s

    for name in flight.state.vehicles:
        if is_believed:
            assert off_m(flight, name) > 2.0
        else:
            assert off_m(flight, name) < 0.3
            assert "base-fault" in codes(flight, name)
    if is_believed:
        flight.may_land_hard = True
        return
    flight.land()
