"""Take-offs in waves: one after the other, with time between, and none after one that failed."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.missions.api import Fleet, OrderFailed
from groundstation.missions.ground import order_in_brief
from groundstation.missions.mission_orders import MissionOrders
from groundstation.missions.runner import MissionRun
from groundstation.orders.grammar import OrderError, parse
from groundstation.orders.intents import Takeoff
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from tests.groundstation.console.test_mission_orders import Worker

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def fleet() -> FleetConfig:
    """Eight vehicles."""
    return load_fleet(ROOT / "configs/fleets/eight.toml")


def starts(bus: Any) -> list[str]:
    return [name for name, order in bus.orders if order.kind == "takeoff"]


async def test_waves_start_one_after_the_other(fleet: FleetConfig, client: Any, bus: Any) -> None:
    lines: list[str] = []
    flown = Fleet(client, say=lines.append)
    results = await asyncio.wait_for(flown.takeoff(1.0, by=3, every_s=0.1), 20.0)
    assert list(results) == list(fleet.enabled_names)
    assert all(result.is_done for result in results.values())
    assert starts(bus) == list(fleet.enabled_names)
    waves = [line for line in lines if line.startswith("Wave")]
    assert len(waves) == 3
    assert waves[0].startswith(f"Wave 1 of 3: {', '.join(fleet.enabled_names[:3])}")

    stamps = [order.stamp_ns for _, order in bus.orders if order.kind == "takeoff"]
    assert stamps[3] - stamps[2] >= 100_000_000
    assert stamps[6] - stamps[5] >= 100_000_000


async def test_a_vehicle_that_fails_stops_the_later_waves(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    bad = fleet.enabled_names[4]
    bus.misbehave[bad] = "fail"
    step = {"do": "takeoff", "height_m": 1.0, "by": 3, "every_s": 0.0}
    content = {"schema": 1, "step": [step, {"do": "land"}]}
    mission = mission_from_mapping(content, path="test.toml", fleet=fleet)
    verdict = await asyncio.wait_for(MissionRun(mission, client).run(), 30.0)
    assert not verdict.passed
    assert f"because {bad} of a wave before it does not fly" in verdict.summary
    assert starts(bus) == list(fleet.enabled_names[:6])
    assert all(verdict.landed.values())


@pytest.mark.parametrize("how", ["fail", "refuse"])
async def test_a_mission_that_goes_on_without_a_vehicle_that_fails_starts_the_later_waves(
    fleet: FleetConfig, client: Any, bus: Any, how: str
) -> None:
    bad = fleet.enabled_names[4]
    bus.misbehave[bad] = how
    step = {"do": "takeoff", "height_m": 1.0, "by": 3, "every_s": 0.0}
    content = {"schema": 1, "step": [step, {"do": "land"}], "on_failure": {"do": "go_on"}}
    mission = mission_from_mapping(content, path="test.toml", fleet=fleet)
    verdict = await asyncio.wait_for(MissionRun(mission, client).run(), 30.0)
    assert verdict.passed, verdict.summary
    assert starts(bus) == list(fleet.enabled_names)


async def test_a_mission_that_goes_on_starts_the_later_waves_without_who_came_down_meanwhile(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    first = fleet.enabled_names[0]
    flown = Fleet(client)
    flown.ground.goes_on_without = True
    rising = asyncio.create_task(flown.takeoff(1.0, by=4, every_s=0.5))
    assert await client.wait_for(lambda _: len(flown.steps) == 1, 5.0)
    bus.tell(first, state="landed", is_airborne=False, is_armed=False)
    await asyncio.wait_for(rising, 20.0)
    assert starts(bus) == list(fleet.enabled_names)
    assert flown.ground.left_out == {first}


async def test_a_vehicle_that_is_left_out_between_two_waves_does_not_start(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    lines: list[str] = []
    names = fleet.enabled_names
    flown = Fleet(client, say=lines.append)
    flown.leave_out(names[7])
    rising = asyncio.create_task(flown.takeoff(1.0, names, by=2, every_s=0.1))
    assert await client.wait_for(lambda _: len(flown.steps) == 1, 5.0)
    flown.leave_out(names[3], names[4], names[5])

    results = await asyncio.wait_for(rising, 20.0)
    assert starts(bus) == [names[0], names[1], names[2], names[6], names[7]]
    assert list(results) == starts(bus)
    waves = [line for line in lines if line.startswith("Wave")]
    assert waves[1:] == [f"Wave 2 of 4: {names[2]}", f"Wave 4 of 4: {names[6]}, {names[7]}"]


async def test_a_vehicle_that_comes_down_between_two_waves_stops_the_later_ones(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    first = fleet.enabled_names[0]
    flown = Fleet(client)
    rising = asyncio.create_task(flown.takeoff(1.0, by=4, every_s=0.5))
    assert await client.wait_for(lambda state: len(state.airborne_names) == 4, 5.0)
    bus.tell(first, state="landed", is_airborne=False, is_armed=False)
    with pytest.raises(OrderFailed, match=f"because {first} of a wave before it does not fly"):
        await asyncio.wait_for(rising, 20.0)
    assert starts(bus) == list(fleet.enabled_names[:4])


async def test_a_written_take_off_in_waves_is_flown_as_a_mission(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    worker = Worker()
    orders = MissionOrders(client, worker.begin)
    intent = parse("takeoff all 1.0 by 4 every 0.1", fleet)
    assert isinstance(intent, Takeoff)
    assert str(intent).endswith(" 1 by 4 every 0.1")
    assert orders.take_off_in_waves(intent) == ""
    assert worker.task is not None
    verdict = await asyncio.wait_for(worker.task, 20.0)
    assert verdict.passed, verdict.summary
    assert starts(bus) == list(fleet.enabled_names)
    assert len(client.state.airborne_names) == 8

    with pytest.raises(OrderError, match="takes its time"):
        client.submit_now("takeoff all 1.0 by 4")


@pytest.mark.parametrize(
    ("height_m", "words"),
    [(0.1, "a take-off to 0.1 m does not leave the ground"), (99.0, "of 99 m is above 3.5 m")],
)
async def test_a_written_take_off_in_waves_to_a_wrong_height_is_refused_in_a_sentence(
    fleet: FleetConfig, client: Any, height_m: float, words: str
) -> None:
    orders = MissionOrders(client, Worker().begin)
    intent = parse(f"takeoff all {height_m} by 4", fleet)
    assert isinstance(intent, Takeoff)
    assert words in orders.take_off_in_waves(intent)


@pytest.mark.parametrize("words", ["by 0", "by 2.5", "by -1", "by x", "by 3 every -1", "every 700"])
def test_waves_that_make_no_sense_are_refused(fleet: FleetConfig, words: str) -> None:
    with pytest.raises(OrderError, match=r"is no (number of vehicles|time between)"):
        parse(f"takeoff all 1.0 {words}", fleet)
    content = {"schema": 1, "step": [{"do": "takeoff", "by": -1}]}
    with pytest.raises(ConfigError, match="by"):
        mission_from_mapping(content, path="test.toml", fleet=fleet)


def test_the_course_of_a_mission_counts_every_wave(fleet: FleetConfig) -> None:
    def takes_s(**keys: Any) -> float:
        content = {"schema": 1, "step": [{"do": "takeoff", **keys}]}
        mission = mission_from_mapping(content, path="test.toml", fleet=fleet)
        return sum(step.expected_s for step in mission.course())

    assert takes_s(by=4, every_s=5.0) == pytest.approx(2 * takes_s() + 5.0)
    assert takes_s(by=8) == takes_s()


def test_an_order_to_a_large_fleet_is_said_in_a_few_lines() -> None:
    fleet = load_fleet(ROOT / "configs/fleets/sixteen.toml")
    names = fleet.enabled_names
    takeoff = parse(f"takeoff {','.join(names)} 1.0", fleet)
    assert order_in_brief(takeoff, names) == "takeoff all 1"
    fewer = order_in_brief(parse(f"takeoff {','.join(names[:3])} 1.0", fleet), names)
    assert fewer == f"takeoff {','.join(names[:3])} 1"

    words = " ".join(f"{name} {index}.125 0.125 1.125" for index, name in enumerate(names))
    goto = order_in_brief(parse(f"goto {words}", fleet), names)
    assert len(goto) <= 240
    assert goto.endswith(" ...")
