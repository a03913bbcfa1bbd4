"""Vehicles that a mission goes on without: ordered by their names, and landed at its end."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from groundstation.client.client import FleetClient
from groundstation.formations.slots import formation_slots
from groundstation.mission_files.loading import load_mission, mission_from_mapping
from groundstation.missions import runner
from groundstation.missions.api import Fleet, OrderFailed
from groundstation.missions.conditions import WaitCondition, all_of, flying, reached
from groundstation.missions.connection import hosted
from groundstation.missions.runner import MissionRun
from groundstation.paths.pieces import fitted
from groundstation.verdict.expectations import Expect
from groundstation.verdict.verdict import judge
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.tuples import Xyz

UP = {"do": "takeoff", "height_m": 1.0}
HALT = {"do": "move", "vehicles": ["mav0"], "position_enu_m": [0, 0, 1.5], "timeout_s": 0.2}


@pytest.mark.parametrize("verb", ["hold", "home", "land"])
async def test_an_order_to_one_vehicle_reaches_it_though_the_mission_goes_on_without_it(
    client: Any, verb: str
) -> None:
    flown = Fleet(client)
    await flown.takeoff(1.0)
    flown.leave_out("mav0")
    results = await getattr(flown["mav0"], verb)()
    assert list(results) == ["mav0"]
    assert results["mav0"].is_done
    assert flown.names == ("mav1", "mav2")


async def test_one_vehicle_without_which_the_mission_goes_on_has_a_goal_of_its_own(
    client: Any,
) -> None:
    flown = Fleet(client)
    await flown.takeoff(1.0)
    flown.leave_out("mav0")
    results = await flown["mav0"].go_to((0.0, 0.0, 1.5))
    assert results["mav0"].is_done


@pytest.mark.parametrize("names", [("mav0", "mav2"), ("mav0,2",), (["mav0", 2],), (0, "2", "mav0")])
async def test_vehicles_are_left_out_by_names_and_by_indices(client: Any, names: Any) -> None:
    lines: list[str] = []
    flown = Fleet(client, say=lines.append)
    flown.leave_out(*names)
    assert flown.names == ("mav1",)
    assert lines == ["The mission goes on without mav0, mav2."]


@pytest.mark.parametrize("wrong", ["mva1", "", ["mva1"], 7, None])
async def test_what_names_no_vehicle_leaves_out_nobody_and_is_refused(
    client: Any, wrong: Any
) -> None:
    flown = Fleet(client)
    with pytest.raises(ConfigError):
        flown.leave_out("mav0", wrong)
    assert flown.names == ("mav0", "mav1", "mav2")


@pytest.mark.parametrize("ends_with_landing", [True, False])
async def test_whoever_failed_is_landed_at_the_end_of_a_mission_that_goes_on(
    fleet: FleetConfig, client: Any, bus: Any, ends_with_landing: bool
) -> None:
    last = {"do": "land"} if ends_with_landing else {"do": "wait", "duration_s": 0.01}
    mission = mission_from_mapping(
        {"schema": 1, "step": [UP, HALT, last], "on_failure": {"do": "go_on"}},
        path="test.toml",
        fleet=fleet,
    )
    bus.accept_only = {"move"}
    run = MissionRun(mission, client)
    verdict = await run.run()
    assert verdict.landed == {"mav0": True, "mav1": ends_with_landing, "mav2": ends_with_landing}
    landed = [name for name, order in bus.orders if order.kind == "land"]
    assert sorted(landed) == (["mav0", "mav1", "mav2"] if ends_with_landing else ["mav0"])


@pytest.mark.parametrize("is_python", [True, False])
async def test_the_last_vehicle_of_a_formation_flies_to_its_slot(
    fleet: FleetConfig, client: Any, bus: Any, is_python: bool
) -> None:
    to_center = {"do": "move", "position_enu_m": [0.0, 1.2, 1.2]}
    mission = mission_from_mapping(
        {"schema": 1, "step": [UP, to_center, {"do": "land"}]}, path="test.toml", fleet=fleet
    )
    run = MissionRun(mission, client)
    run.fleet.leave_out("mav1", "mav2")
    if is_python:
        await run.fleet.takeoff(1.0)
        await run.fleet.move((0.0, 1.2, 1.2))
    else:
        assert (await run.run()).passed

    (goal,) = [order.position_enu_m for _, order in bus.orders if order.kind == "move"]
    x, y, z = formation_slots(fleet, "triangle")["mav0"]
    assert goal == pytest.approx((x, y + 1.2, z + 1.2))


def ordered(bus: Any, kind: str) -> list[str]:
    return [name for name, order in bus.orders if order.kind == kind]


async def come_down(client: Any, bus: Any, name: str) -> None:
    """Have a vehicle land by itself, and wait until the client knows it."""
    bus.tell(name, state="landed", is_airborne=False, is_armed=False)
    assert await client.wait_for(lambda state: name not in state.airborne_names, 5.0)


@pytest.fixture
async def going_on(client: Any) -> Fleet:
    """A fleet that flies, and whose mission goes on without a vehicle that fails."""
    flown = Fleet(client)
    flown.ground.goes_on_without = True
    await flown.takeoff(1.0)
    return flown


STEPS = [
    {"do": "yaw", "yaw_deg": 90.0},
    {"do": "home"},
    {"do": "formation", "name": "triangle", "position_enu_m": [0.0, 1.2, 1.0], "speed_m_s": 0.5},
]


@pytest.mark.parametrize("step", STEPS, ids=lambda step: str(step["do"]))
async def test_a_step_after_a_vehicle_has_come_down_is_for_the_others(
    fleet: FleetConfig, client: Any, bus: Any, step: dict[str, Any]
) -> None:
    steps = [UP, {"do": "wait", "until": {"landed": "mav1"}}, step, {"do": "land"}]
    mission = mission_from_mapping(
        {"schema": 1, "step": steps, "on_failure": {"do": "go_on"}}, path="test.toml", fleet=fleet
    )
    flight = asyncio.create_task(MissionRun(mission, client).run())
    assert await client.wait_for(lambda state: len(state.airborne_names) == 3, 5.0)
    await come_down(client, bus, "mav1")
    verdict = await asyncio.wait_for(flight, 10.0)
    assert ordered(bus, "move") == ["mav0", "mav2"]
    assert verdict.steps[1].vehicles == {"mav0": "done", "mav2": "done"}

    if step["do"] == "formation":
        (duration_s,) = {order.duration_s for _, order in bus.orders if order.kind == "move"}
        assert duration_s > 0.0, "the speed of the step"


async def wreck_at(client: Any, bus: Any, name: str, position_enu_m: Xyz) -> None:
    """Have a vehicle land by itself at a place."""
    bus.tell(name, position_enu_m=position_enu_m)
    await come_down(client, bus, name)


async def test_who_has_a_goal_at_a_wreck_keeps_its_place_and_takes_part_in_the_next_order(
    going_on: Fleet, client: Any, bus: Any
) -> None:
    await wreck_at(client, bus, "mav1", (3.0, 0.0, 0.0))
    results = await going_on.go_to({"mav0": (3.2, 0.0, 1.0), "mav2": (-3.0, 0.0, 1.0)})
    assert results["mav2"].is_done
    assert results["mav0"].phase == "refused"
    assert (
        "its goal is 0.20 m from mav1, which is on the ground or silent" in results["mav0"].reason
    )

    assert "mav0" in going_on.names
    results = await going_on.go_to({"mav0": (0.0, 3.0, 1.0)})
    assert results["mav0"].is_done
    assert ordered(bus, "move") == ["mav2", "mav0"]


async def test_who_has_a_goal_at_one_that_keeps_its_place_keeps_its_own_too(
    going_on: Fleet, client: Any, bus: Any
) -> None:
    await wreck_at(client, bus, "mav1", (3.0, 0.0, 0.0))
    here_enu_m = bus.vehicles["mav0"].position_enu_m
    results = await going_on.go_to({"mav0": (3.2, 0.0, 1.0), "mav2": here_enu_m})
    assert {name: result.phase for name, result in results.items()} == {
        "mav0": "refused",
        "mav2": "refused",
    }
    assert not ordered(bus, "move")
    assert {"mav0", "mav2"} <= set(going_on.names)


async def test_an_order_that_is_wrong_for_all_fails_also_in_a_mission_that_goes_on(
    going_on: Fleet, bus: Any
) -> None:
    far_away = {"mav0": (90.0, 0.0, 1.0), "mav1": (93.0, 0.0, 1.0), "mav2": (96.0, 0.0, 1.0)}
    with pytest.raises(OrderFailed):
        await going_on.go_to(far_away)
    assert not ordered(bus, "move")


@pytest.mark.parametrize(
    "awaited",
    [
        reached({"mav0": (50.0, 0.0, 1.0)}),
        all_of(reached({"mav0": (50.0, 0.0, 1.0)}), flying("mav1")),
        flying(["mav1", "mav2"]),
    ],
    ids=lambda awaited: str(awaited.words),
)
async def test_a_wait_does_not_go_on_for_whom_the_mission_goes_on_without(
    going_on: Fleet, client: Any, bus: Any, awaited: WaitCondition
) -> None:
    await come_down(client, bus, "mav2")
    waiting = asyncio.create_task(going_on.until(awaited, 5.0))
    await asyncio.sleep(0.1)
    assert not waiting.done()

    going_on.leave_out("mav0", "mav2")
    await asyncio.wait_for(waiting, 2.0)


@pytest.mark.parametrize("goes_on", [False, True])
async def test_who_has_not_arrived_counts_as_late_unless_the_mission_goes_on_without_it(
    going_on: Fleet, bus: Any, goes_on: bool
) -> None:
    going_on.ground.goes_on_without = goes_on
    bus.misbehave["mav1"] = "fail"
    with contextlib.suppress(OrderFailed):
        await going_on.move((0.5, 0.0, 1.0))
    arrived = {arrival.vehicle for arrival in going_on.ground.arrivals}
    assert arrived == {"mav0", "mav2"} | (set() if goes_on else {"mav1"})


@pytest.mark.parametrize("verb", ["home", "land"])
async def test_who_is_down_before_its_own_landing_is_reported_done_takes_part_further(
    going_on: Fleet, client: Any, bus: Any, verb: str
) -> None:
    await going_on["mav1"].move((0.5, 0.0, 1.0))
    bus.accept_only = {"move", "land"}
    landing = asyncio.create_task(getattr(going_on["mav1"], verb)())
    assert await client.wait_for(lambda _: len(ordered(bus, "move") + ordered(bus, "land")) > 1, 5)
    await come_down(client, bus, "mav1")
    await going_on["mav0"].hold()
    assert not going_on.ground.left_out
    assert not going_on.ground.other_ends

    _, order = next(sent for sent in reversed(bus.orders) if sent[0] == "mav1")
    bus.report_end("mav1", order, "done", "Done.")
    assert (await landing)["mav1"].is_done
    await come_down(client, bus, "mav1")
    await going_on["mav0"].hold()
    assert not going_on.ground.left_out


async def test_goals_of_a_script_are_for_those_who_have_not_come_down(
    going_on: Fleet, client: Any, bus: Any
) -> None:
    await come_down(client, bus, "mav1")
    goals = {name: (2.0 * index, 0.0, 1.0) for index, name in enumerate(going_on.names)}
    results = await going_on.go_to(goals)
    assert list(results) == ordered(bus, "move") == ["mav0", "mav2"]
    assert going_on.ground.left_out == {"mav1"}


async def test_an_order_only_to_a_vehicle_that_has_come_down_tells_why_it_is_refused(
    going_on: Fleet, client: Any, bus: Any
) -> None:
    await come_down(client, bus, "mav1")
    bus.misbehave["mav1"] = "refuse"
    results = await going_on["mav1"].yaw(90.0)
    assert results["mav1"].sentence == "Because I say so."
    assert list(await going_on.kill("mav1")) == ["mav1"]
    assert ordered(bus, "kill") == ["mav1"]


async def test_an_order_that_waits_is_not_sent_to_a_vehicle_that_is_left_out_meanwhile(
    going_on: Fleet, bus: Any
) -> None:
    lines: list[str] = []
    going_on.ground.say = lines.append
    going_on.ground.pause()
    to_all = asyncio.create_task(going_on.yaw(90.0))
    to_one = asyncio.create_task(going_on["mav1"].yaw(90.0))
    await asyncio.sleep(0.01)
    going_on.leave_out("mav1")
    going_on.ground.go_on(is_stepping=False)

    assert list(await to_all) == ["mav0", "mav2"]
    assert await to_one == {}
    assert ordered(bus, "move") == ["mav0", "mav2"]
    assert "Not sent, because the mission goes on without them: yaw mav1 90" in lines

    assert list(await going_on["mav1"].yaw(90.0)) == ["mav1"], "it is named all the same"


@pytest.mark.parametrize("when", ["load_path", "goto"])
async def test_a_vehicle_that_is_left_out_before_the_start_of_its_path_does_not_start(
    going_on: Fleet, client: Any, bus: Any, when: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundstation.missions.path_following.START_LEAD_S", 0.1)
    paths = {}
    for name in going_on.names:
        x, y, z = bus.vehicles[name].position_enu_m
        paths[name] = fitted(np.arange(5.0), np.array([[x, y, z, 0.0]] * 5))

    async def leave_out_mav1() -> None:
        kind = "move" if when == "goto" else when
        assert await client.wait_for(lambda _: "mav1" in ordered(bus, kind), 5.0)
        going_on.leave_out("mav1")

    leaving = asyncio.create_task(leave_out_mav1())
    results = await asyncio.wait_for(going_on.follow_path(paths, timeout_s=1.0), 10.0)
    await leaving
    assert list(results) == ordered(bus, "follow_path") == ["mav0", "mav2"]


async def test_a_vehicle_that_is_left_out_follows_nobody_any_more(
    going_on: Fleet, bus: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundstation.missions.following._PERIOD_S", 0.05)
    offsets = {"mav1": (0.0, 2.0, 0.0), "mav2": (0.0, 4.0, 0.0)}
    following = asyncio.create_task(going_on.follow("mav0", 0.3, offsets=offsets))
    await asyncio.sleep(0.1)
    going_on.leave_out("mav1")
    x, y, z = bus.vehicles["mav0"].position_enu_m
    bus.tell("mav0", position_enu_m=(x, y + 0.5, z))
    await asyncio.wait_for(following, 5.0)
    assert ordered(bus, "move") == ["mav1", "mav2", "mav2"]


@pytest.mark.parametrize(
    ("failed", "is_left_out", "words"),
    [
        (("mav1",), False, "A pilot has mav1."),
        (("mav0", "mav1"), False, "A pilot has mav1."),
        (("mav0",), False, "mav0 failed: The motor is weak."),
        (("mav0", "mav1"), True, "mav0, mav1 failed: The motor is weak."),
    ],
)
async def test_a_pilot_is_named_only_where_his_vehicle_has_ended_the_mission(
    fleet: FleetConfig, client: Any, bus: Any, failed: Sequence[str], is_left_out: bool, words: str
) -> None:
    def say(line: str) -> None:
        if line.startswith("takeoff") and is_left_out:
            run.fleet.leave_out("mav1")

    mission = mission_from_mapping({"schema": 1, "step": [UP]}, path="test.toml", fleet=fleet)
    bus.misbehave = dict.fromkeys(failed, "fail")
    bus.tell("mav1", is_flown_by_hand=True)
    run = MissionRun(mission, client, say=say)
    assert words in (await run.run()).summary


async def _fly_without_one(flown: Fleet, bus: Any) -> None:
    """Fly without mav1, which fails to take off, and take it out of service."""
    flown.ground.goes_on_without = True
    bus.misbehave = {"mav1": "fail"}
    await flown.takeoff(1.0)
    bus.misbehave = {}
    await flown.disable("mav1")
    await flown.land()


async def test_a_script_passes_without_a_vehicle_as_a_mission_does(client: Any, bus: Any) -> None:
    @contextlib.asynccontextmanager
    async def opened() -> AsyncIterator[FleetClient]:
        yield client

    host: Any = SimpleNamespace(say=print, ready_timeout_s=5.0, opened=opened)
    with hosted(host):
        async with Fleet.connect() as flown:
            await _fly_without_one(flown, bus)
    verdict = judge(host.flown, Expect())
    assert verdict.passed, verdict.summary


async def test_a_vehicle_that_failed_counts_as_failed_also_when_it_is_disabled_later(
    fleet: FleetConfig, client: Any, bus: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fly(flown: Fleet) -> None:
        await _fly_without_one(flown, bus)

    monkeypatch.setattr(runner, "load_function", lambda _: fly)
    path = tmp_path / "mission.py"
    path.write_text("async def mission(fleet):\n    ...\n", encoding="utf-8")
    verdict = await MissionRun(load_mission(path, fleet=fleet), client).run()
    assert verdict.passed, verdict.summary
