"""Python missions that catch their end, or end the process: the vehicles land all the same."""

from __future__ import annotations

import asyncio
import textwrap
from pathlib import Path
from typing import Any

import pytest

from groundstation.mission_files.loading import load_mission, mission_from_mapping
from groundstation.missions import runner
from groundstation.missions.runner import MissionRun
from onboard.config.fleet import FleetConfig

RETURNS = """
    try:
        await fleet.wait(60.0)
    except BaseException:
        pass
"""
MOVES_IN_THE_END = """
    try:
        await fleet.wait(60.0)
    finally:
        await fleet.move((0.0, 1.0, 1.2))
"""
NEVER_ENDS = """
    for _ in range(5):
        try:
            await fleet.wait(60.0)
        except BaseException:
            pass
"""


BEGIN = """
import asyncio
import sys


async def mission(fleet):
    await fleet.takeoff()
    fleet.say("up")
"""


def _run(client: Any, fleet: FleetConfig, folder: Path, body: str) -> tuple[MissionRun, Any]:
    """A Python mission that takes off, says so, and does this then; and an event for "up"."""
    path = folder / "stubborn.py"
    path.write_text(BEGIN + textwrap.indent(textwrap.dedent(body), "    "))
    is_up = asyncio.Event()

    def say(line: str) -> None:
        if line == "up":
            is_up.set()

    return MissionRun(load_mission(path, fleet), client, say=say), is_up


@pytest.mark.parametrize("body", [RETURNS, MOVES_IN_THE_END, NEVER_ENDS])
async def test_an_interruption_lands_the_vehicles_of_a_mission_that_catches_it(
    fleet: FleetConfig,
    client: Any,
    bus: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    body: str,
) -> None:
    monkeypatch.setattr(runner, "_CANCEL_AGAIN_S", 0.1)
    run, is_up = _run(client, fleet, tmp_path, body)
    task = asyncio.create_task(run.run())
    await asyncio.wait_for(is_up.wait(), 5.0)
    await asyncio.sleep(0.05)

    run.interrupt()
    verdict = await asyncio.wait_for(task, 5.0)

    assert verdict.exit_status == 130
    assert all(verdict.landed.values())
    assert [order.kind for name, order in bus.orders if name == "mav1"] == ["takeoff", "land"]


async def test_the_vehicles_of_a_mission_that_catches_its_abortion_land(
    fleet: FleetConfig, client: Any, tmp_path: Path
) -> None:
    run, is_up = _run(client, fleet, tmp_path, RETURNS)
    task = asyncio.create_task(run.run())
    await asyncio.wait_for(is_up.wait(), 5.0)
    await asyncio.sleep(0.05)

    run.abort("The emulator ended.")
    verdict = await asyncio.wait_for(task, 5.0)

    assert verdict.exit_status == 1
    assert "The emulator ended." in verdict.summary
    assert all(verdict.landed.values())


async def test_the_vehicles_of_a_mission_that_ends_the_process_land(
    fleet: FleetConfig, client: Any, tmp_path: Path
) -> None:
    run, _ = _run(client, fleet, tmp_path, "sys.exit('the wind is too strong')")
    verdict = await asyncio.wait_for(run.run(), 5.0)

    assert verdict.exit_status == 1
    assert "The mission called sys.exit('the wind is too strong')." in verdict.summary
    assert all(verdict.landed.values())


@pytest.mark.parametrize(("do", "kind"), [("home", "move"), ("hold", "hold")])
async def test_an_interruption_lands_vehicles_that_a_failed_mission_holds_or_sends_home(
    fleet: FleetConfig, client: Any, bus: Any, do: str, kind: str
) -> None:
    steps = [
        {"do": "takeoff", "height_m": 1.0},
        {"do": "expect", "all_landed": True},
    ]
    content = {"schema": 1, "step": steps, "on_failure": {"do": do}}
    run = MissionRun(mission_from_mapping(content, path="test.toml", fleet=fleet), client)
    bus.accept_only = {kind}
    task = asyncio.create_task(run.run())
    assert await client.wait_for(lambda _: any(order.kind == kind for _, order in bus.orders), 5.0)

    run.interrupt()
    verdict = await asyncio.wait_for(task, 5.0)

    assert verdict.exit_status == 130
    assert all(verdict.landed.values())
    assert [order.kind for name, order in bus.orders if name == "mav1"] == ["takeoff", kind, "land"]


LEAVES_A_TASK = """
    async def wander():
        while True:
            try:
                await fleet.move((0.0, 1.0, 1.2))
            except Exception:
                pass

    async def start_again():
        await fleet.has_landed.wait()
        await fleet.takeoff()

    fleet.tasks = [asyncio.create_task(wander()), asyncio.create_task(start_again())]
    await fleet.wait(0.05)
    raise ValueError("the camera is dirty")
"""


async def test_a_task_that_a_failed_mission_has_left_moves_nobody_who_lands(
    fleet: FleetConfig, client: Any, bus: Any, tmp_path: Path
) -> None:
    run, _ = _run(client, fleet, tmp_path, LEAVES_A_TASK)
    has_landed = asyncio.Event()
    run.fleet.has_landed = has_landed  # type: ignore[attr-defined]
    verdict = await asyncio.wait_for(run.run(), 5.0)
    has_landed.set()
    await asyncio.sleep(0.3)

    kinds = [order.kind for name, order in bus.orders if name == "mav1"]
    assert "the camera is dirty" in verdict.summary
    assert "move" in kinds
    assert kinds[-1] == "land"
