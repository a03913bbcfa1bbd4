"""A mission has not passed when a vehicle went down that it had told to fly."""

from __future__ import annotations

from typing import Any

import pytest

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.mission import Mission
from onboard.config.fleet import FleetConfig
from sitl.faults.catalogue import Fault

DOWN = {"do": "land"}
OTHERS_DOWN = {"do": "land", "vehicles": "mav0,mav2"}


def waiting(fleet: FleetConfig, last: dict[str, Any], **keys: Any) -> Mission:
    """Return a mission that takes off, waits and lands."""
    steps = [{"do": "takeoff"}, {"do": "wait", "duration_s": 12.0}, last]
    data = {"schema": 1, "step": steps, **keys}
    return mission_from_mapping(data, path="waiting.toml", fleet=fleet)


@pytest.mark.long
@pytest.mark.parametrize("last", [OTHERS_DOWN, DOWN], ids=["others land", "all land"])
def test_a_vehicle_that_its_battery_lands_in_a_wait_is_named_with_the_cause(
    lockstep: Any, paper: FleetConfig, last: dict[str, Any]
) -> None:
    flight = lockstep(paper, seed=1)
    fault = Fault("battery_cell", "mav1", at_s=10.0, parameters={"drop_pct": 80.0})
    flight.inject(fault)
    mission = waiting(paper, last)

    verdict = flight.fly(mission)

    assert not verdict.passed
    assert "mav1 is down, though its last finished order was 'takeoff" in verdict.summary
    assert "Battery falling fast: landing." in verdict.summary


@pytest.mark.long
def test_a_mission_that_goes_on_without_a_vehicle_names_it_and_passes(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=1)
    flight.inject(Fault("battery_cell", "mav1", at_s=10.0, parameters={"drop_pct": 80.0}))
    mission = waiting(paper, DOWN, on_failure={"do": "go_on"})

    verdict = flight.fly(mission)

    assert verdict.exit_status == 0, verdict.summary
    said = [event.sentence for event in flight.events if event.code == "mission"]
    assert any("mav1 is down, though its last finished order was" in sentence for sentence in said)


@pytest.mark.long
def test_a_vehicle_that_is_killed_in_a_wait_is_named(lockstep: Any, paper: FleetConfig) -> None:
    flight = lockstep(paper, seed=1)
    flight.at(12.0, lambda: flight.client.send(flight.client.plan("kill mav1")))

    verdict = flight.fly(waiting(paper, OTHERS_DOWN))

    assert verdict.exit_status == 1, verdict.summary
    assert "mav1 is down, though its last finished order was 'takeoff" in verdict.summary
