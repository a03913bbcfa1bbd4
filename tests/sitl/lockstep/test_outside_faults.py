"""Faults of the bus and of agents as steps of a mission, by the API, and by the fixture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.missions import conditions
from onboard.config.fleet import load_fleet
from sitl.faults.catalogue import Fault
from sitl.lockstep.connections import BusSettings
from sitl.lockstep.simulation import Simulation

# kinds of faults of the bus, and a check of whether the fault acts between two nodes
BUS_FAULTS = {
    "bus_cut": lambda bus, one, other: bus.is_cut(one, other),
    "bus_loss": lambda bus, one, other: bus.quality((one, other)).loss > 0.0,
}
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


AWAY = {"do": "goto", "goals": {"mav0": [-1.5, 1.0, 1.0], "mav2": [1.5, 1.0, 1.0]}}
HOME = {"do": "home", "vehicles": ["mav0", "mav2"]}
REACT = {"do": "react", "when": {"fails": True}, "steps": [AWAY], "then": [HOME]}


@pytest.mark.parametrize(
    ("step", "on_failure", "passes"),
    [
        (REACT, "land", True),
        (AWAY | {"do": "goto", "vehicles": ["mav0", "mav2"]}, "home", False),
        ({"do": "hold"}, "go_on", True),
    ],
)
def test_a_silent_vehicle_leads_to_what_the_mission_declares(
    lockstep: Any, step: dict[str, Any], on_failure: str, passes: bool
) -> None:
    flight = lockstep(PAPER, seed=3)
    fault = {"do": "fault", "name": "agent_dead", "vehicles": "mav1"}
    steps = [{"do": "takeoff"}, fault, step, {"do": "wait", "duration_s": 4.0}, HOME]
    data = {"schema": 1, "step": steps, "on_failure": {"do": on_failure}}
    verdict = flight.fly(mission_from_mapping(data, path="silent.toml", fleet=flight.config))
    assert verdict.passed == passes, verdict.summary
    assert all(verdict.landed.values())
    assert flight.min_separation_m > 0.8
    for name in ("mav0", "mav2"):
        spot_enu_m = flight.config.vehicles[name].start_enu_m
        landed_enu_m = flight.state.vehicles[name].truth.position_enu_m
        assert landed_enu_m[:2] == pytest.approx(spot_enu_m[:2], abs=0.2)


@pytest.fixture
def simulation() -> Simulation:
    """The paper's three vehicles on the ground, without a ground station."""
    return Simulation(load_fleet(PAPER), is_compiled=False)


def run_until(simulation: Simulation, time_s: float) -> None:
    """Advance to a time."""
    while simulation.time_s < time_s:
        simulation.step()


@pytest.mark.parametrize("kind", BUS_FAULTS)
def test_a_fault_of_the_bus_ends_for_an_agent_that_is_dead_at_its_end(
    simulation: Simulation, kind: str
) -> None:
    simulation.inject(Fault(kind, "mav0", at_s=0.1, duration_s=0.2))
    simulation.inject(Fault("agent_dead", "mav1", at_s=0.2, duration_s=0.2))
    run_until(simulation, 0.25)
    assert BUS_FAULTS[kind](simulation.bus, "mav0", "mav1")
    run_until(simulation, 0.5)
    assert not BUS_FAULTS[kind](simulation.bus, "mav0", "mav1")
    assert simulation.bus.is_quiet


@pytest.mark.parametrize("kind", BUS_FAULTS)
def test_a_fault_of_the_bus_acts_on_an_agent_that_starts_during_it(
    simulation: Simulation, kind: str
) -> None:
    simulation.inject(Fault("agent_dead", "mav1", at_s=0.05, duration_s=0.1))
    simulation.inject(Fault(kind, "mav0", at_s=0.1, duration_s=0.2))
    run_until(simulation, 0.2)
    assert BUS_FAULTS[kind](simulation.bus, "mav0", "mav1")
    run_until(simulation, 0.4)
    assert simulation.bus.is_quiet


@pytest.mark.parametrize("kind", BUS_FAULTS)
def test_the_end_of_a_fault_of_the_bus_leaves_that_of_another_vehicle(
    simulation: Simulation, kind: str
) -> None:
    simulation.inject(Fault(kind, "mav0", at_s=0.1, duration_s=0.1))
    simulation.inject(Fault(kind, "mav1", at_s=0.1, duration_s=0.2))
    run_until(simulation, 0.25)
    for one, other in (("mav0", "mav1"), ("mav2", "mav1")):
        assert BUS_FAULTS[kind](simulation.bus, one, other)
    assert not BUS_FAULTS[kind](simulation.bus, "mav0", "mav2")
    run_until(simulation, 0.4)
    assert simulation.bus.is_quiet


@pytest.mark.parametrize(
    ("usual", "loss", "delay_s"),
    [
        (BusSettings(delay_s=0.5), 0.1, 4.5),
        (BusSettings(loss=0.5), 0.55, 4.001),
        (BusSettings(delay_s=9.0, loss=1.0), 1.0, 10.0),  # no connection is later than 10 s
    ],
)
def test_a_fault_of_the_bus_makes_a_bad_bus_worse(
    usual: BusSettings, loss: float, delay_s: float
) -> None:
    simulation = Simulation(load_fleet(PAPER), bus=usual, is_compiled=False)
    parameters: dict[str, float | str] = {"share": 0.1, "delay_s": 4.0}
    simulation.inject(Fault("bus_loss", "mav1", at_s=0.0, parameters=parameters))
    run_until(simulation, 0.05)
    quality = simulation.bus.quality(("mav1", "mav0"))
    assert quality.loss == loss
    assert quality.delay_s == delay_s
    assert simulation.bus.quality(("mav2", "mav0")) == usual


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
