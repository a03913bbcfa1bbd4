"""Faults in missions: for simulated flights only, and nonsense stops before anybody takes off."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any, cast

import pytest

from groundstation.cli import main
from groundstation.client.client import FleetClient
from groundstation.client.fault_orders import FaultRefused
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.steps import FaultStep
from groundstation.missions.api import Fleet
from groundstation.missions.runner import MissionRun
from onboard.bus.protocol import Bus
from onboard.bus.schema import FaultOrder, OrderReply
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from sitl.lockstep.flight import Lockstep
from tests.groundstation.conftest import FakeBus

FLEET = "configs/fleets/paper.toml"
FAULT = {
    "do": "fault",
    "vehicles": "mav1",
    "name": "motor_dead",
    "parameters": {"motor": 2},
    "after_s": 1.0,
}


def mission(fleet: FleetConfig, *steps: dict[str, Any]) -> Any:
    return mission_from_mapping({"schema": 1, "step": list(steps)}, path="test.toml", fleet=fleet)


@pytest.fixture
def paper() -> FleetConfig:
    return load_fleet(FLEET)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"vehicles": "mav9"}, "'step[0].vehicles'"),
        ({"name": 3}, "step[0].name"),
        ({"after_s": -1.0}, "'step[0].after_s' is -1.0"),
        ({"duration_s": float("nan")}, "'step[0].duration_s'"),
        ({"parameters": {"after_s": 3.0}}, "'after_s', which is a key of the step"),
        ({"when": 3.0}, "step[0].when"),
    ],
)
def test_a_wrong_fault_step_is_refused_with_file_and_key(
    paper: FleetConfig, changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(ConfigError) as refused:
        mission(paper, {**FAULT, **changes})
    assert words in str(refused.value)
    assert "test.toml" in str(refused.value)


def test_a_fault_step_is_read_whole(paper: FleetConfig) -> None:
    (step,) = mission(paper, {**FAULT, "duration_s": 2}).steps
    assert step == FaultStep(
        do="fault",
        vehicles="mav1",
        name="motor_dead",
        parameters={"motor": 2},
        after_s=1.0,
        duration_s=2.0,
    )


class Simulated(FakeBus):
    """A bus with an emulator that takes what it likes."""

    asked: list[FaultOrder]

    def fault(self, order: FaultOrder, *, timeout_s: float, on_reply: Any, on_end: Any) -> None:
        self.asked = [*getattr(self, "asked", []), order]
        is_known = order.fault != "explode"
        reason = f"{order.vehicle}: it happens" if is_known else "there is no fault 'explode'."
        reply = OrderReply(
            order_id=order.order_id, vehicle=order.vehicle, is_accepted=is_known, reason=reason
        )
        self._loop.call_soon(on_reply, reply)
        self._loop.call_later(0.01, on_end)


class Real(FakeBus):
    """A bus without an emulator."""

    def fault(self, order: FaultOrder, *, timeout_s: float, on_reply: Any, on_end: Any) -> None:
        self._loop.call_later(0.01, on_end)


async def test_a_real_flight_refuses_faults_in_words(paper: FleetConfig) -> None:
    client = FleetClient(paper, bus=cast(Bus, Real(paper)))
    await client.start()
    try:
        with pytest.raises(
            FaultRefused,
            match=r"mav1: no emulator answers .* Faults are for simulated flights only",
        ):
            await Fleet(client).fault("motor_dead", "mav1", motor=2)
    finally:
        await client.stop()


async def test_a_python_mission_orders_faults_of_several_vehicles(paper: FleetConfig) -> None:
    bus = Simulated(paper)
    client = FleetClient(paper, bus=cast(Bus, bus))
    await client.start()
    said: list[str] = []
    try:
        await Fleet(client, say=said.append).fault(
            "link_loss", "mav0,mav2", after_s=2.0, duration_s=1.0, share=0.5
        )
    finally:
        await client.stop()
    assert [(order.vehicle, order.fault, order.parameters) for order in bus.asked] == [
        ("mav0", "link_loss", {"share": 0.5}),
        ("mav2", "link_loss", {"share": 0.5}),
    ]
    assert all(order.after_s == 2.0 and order.duration_s == 1.0 for order in bus.asked)
    assert said[0] == "fault in 2 s: mav0: it happens"


async def test_an_impossible_fault_late_in_a_mission_stops_it_before_anybody_takes_off(
    paper: FleetConfig,
) -> None:
    bus = Simulated(paper)
    client = FleetClient(paper, bus=cast(Bus, bus))
    await client.start()
    beat = asyncio.create_task(bus.beat())
    try:
        steps = ({"do": "takeoff"}, {**FAULT, "name": "explode"}, {"do": "land"})
        verdict = await MissionRun(mission(paper, *steps), client, ready_timeout_s=2.0).run()
    finally:
        beat.cancel()
        await client.stop()
    assert not verdict.passed
    assert not bus.orders
    assert all(order.is_rehearsal for order in bus.asked)


@pytest.mark.long
def test_a_mission_breaks_a_motor_and_the_others_land(paper: FleetConfig) -> None:
    flight = Lockstep(FLEET, seed=1)
    try:
        steps = (
            {"do": "takeoff", "height_m": 1.0},
            {**FAULT, "after_s": 0.5},
            {"do": "wait", "duration_s": 3.0},
            {"do": "land", "vehicles": ["mav0", "mav2"]},
        )
        verdict = flight.fly(mission(paper, *steps))
        dead = flight.simulation.emulator.world.vehicles.states.motors_dead
    finally:
        flight.close()
    assert dead.tolist() == [False, True, False]
    assert verdict.steps[0].vehicles == dict.fromkeys(paper.enabled_names, "done")
    assert verdict.steps[-1].vehicles == {"mav0": "done", "mav2": "done"}


def test_what_a_fleet_can_suffer_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sitl", "--faults"]) == 0
    assert "motor_dead motor=..." in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--fault", "mav1 explode"], "there is no fault 'explode'"),
        (["--fault", "nonsense"], "is no fault"),
        (["--fault", "mav1 gps_loss", "--fault", "mav1 gps_loss at=3"], "contradict each other"),
        (["--wind-m-s", "3"], "write it as EAST,NORTH"),
        (["--gust-m-s", "-1"], "--gust-m-s"),
    ],
)
def test_impossible_faults_and_weather_are_refused_with_exit_status_two(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["sitl", "--fleet", str(Path(FLEET)), "--no-bus", "--no-gcs", *arguments]) == 2
    assert words in capsys.readouterr().err


def test_a_fault_that_the_emulator_does_not_know_is_wrong_input_in_lockstep_too(
    paper: FleetConfig,
) -> None:
    unknown = {**FAULT, "name": "no_such_fault", "parameters": {}}
    with Lockstep(paper) as flight:
        verdict = flight.fly(
            mission(paper, {"do": "takeoff", "height_m": 0.8}, unknown, {"do": "land"})
        )
        assert verdict.exit_status == 2
        assert "no_such_fault" in verdict.summary
        assert not flight.state.airborne_names
