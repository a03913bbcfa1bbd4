"""Faults of the bus and of agents as steps of a mission, by the API, and by the fixture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.missions import conditions
from sitl.faults.catalogue import Fault

PAPER = Path(__file__).resolve().parents[3] / "configs/fleets/paper.toml"


@pytest.mark.long
def test_faults_of_bus_and_agents_are_steps_of_a_mission(lockstep: Any) -> None:
    flight = lockstep(PAPER, seed=3)
    steps = [
        {"do": "takeoff"},
        {
            "do": "fault",
            "name": "bus_loss",
            "vehicles": "mav0",
            "parameters": {"share": 0.2},
            "duration_s": 2.0,
        },
        {
            "do": "fault",
            "name": "bus_cut",
            "vehicles": "mav1",
            "parameters": {"others": "vehicles"},
            "duration_s": 0.5,
        },
        {"do": "fault", "name": "agent_hang", "vehicles": "mav2", "duration_s": 0.1},
        {"do": "wait", "duration_s": 3.0},
        {"do": "land"},
    ]
    data = {"schema": 1, "step": steps, "expect": {"all_landed": True, "min_separation_m": 0.8}}
    verdict = flight.fly(mission_from_mapping(data, path="faults.toml", fleet=flight.config))
    assert verdict.passed, verdict.summary
    assert sum("Fault ordered" in event.sentence for event in flight.events) == 3


@pytest.mark.long
def test_an_agent_that_dies_is_a_reason_to_react(lockstep: Any) -> None:
    flight = lockstep(PAPER, seed=3)
    flight.takeoff(1.0)
    fleet = flight.fleet

    async def mission() -> None:
        async with fleet.reacting(
            conditions.fails("mav1"), lambda: fleet.land("mav0,mav2"), ends=True
        ):
            await fleet.fault("agent_dead", "mav1", after_s=0.5)
            await fleet.wait(60.0)

    flight.wait_for(mission())
    assert flight.time_s < 40.0
    assert flight.min_separation_m > 0.8
    assert flight.state.vehicles["mav0"].truth.is_on_ground
    flight.inject(Fault("agent_dead", "mav2", at_s=flight.time_s, duration_s=1.0))
    flight.run(0.5)
    assert not flight.agents["mav2"].is_running
    flight.run(1.0)
    assert flight.agents["mav2"].is_running
