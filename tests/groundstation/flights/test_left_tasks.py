"""Missions that leave a task which catches its own end: the process ends all the same."""

from __future__ import annotations

import asyncio
import contextlib
import subprocess
import sys
from pathlib import Path

import pytest

from groundstation.flights import left_tasks, mission_flight
from groundstation.flights.left_tasks import end_other_tasks
from groundstation.flights.mission_flight import MissionFlight

MISSION = """
import asyncio

FLEET = "paper"


async def mission(fleet):
    async def watch():
        while True:
            try:
                await fleet.wait(1.0)
            except:
                pass

    fleet.watching = asyncio.create_task(watch())
    await fleet.wait(0.1)
"""


async def _go_on(until: asyncio.Event) -> None:
    while not until.is_set():
        with contextlib.suppress(asyncio.CancelledError):
            await until.wait()


def test_a_flight_in_lockstep_ends_with_its_verdict(tmp_path: Path) -> None:
    mission = tmp_path / "stubborn.py"
    mission.write_text(MISSION)
    command = [sys.executable, "-m", "groundstation", "fly", str(mission), "--lockstep"]

    ended = subprocess.run(
        [*command, "--record", str(tmp_path / "flight")],
        stdout=subprocess.PIPE,
        text=True,
        timeout=120,
    )
    assert ended.returncode == 0
    assert "PASSED" in ended.stdout
    assert "times real time" in ended.stdout.splitlines()[-1]


async def test_tasks_are_cancelled_and_not_waited_for_for_ever(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(left_tasks, "_LONGEST_END_S", 0.05)
    assert await end_other_tasks()

    obedient = asyncio.create_task(asyncio.sleep(60.0))
    assert await end_other_tasks()
    assert obedient.cancelled()

    may_end = asyncio.Event()
    stubborn = asyncio.create_task(_go_on(may_end))
    await asyncio.sleep(0.0)
    assert not await end_other_tasks()
    may_end.set()
    await stubborn


async def test_a_flight_in_real_time_leaves_its_process_with_its_status(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(left_tasks, "_LONGEST_END_S", 0.05)
    left_with: list[int] = []
    monkeypatch.setattr(mission_flight, "leave_process", left_with.append)
    may_end = asyncio.Event()
    started: list[asyncio.Task[None]] = []

    async def fly(_: MissionFlight) -> int:
        started.append(asyncio.create_task(_go_on(may_end)))
        await asyncio.sleep(0.0)
        return 1

    monkeypatch.setattr(MissionFlight, "_fly_and_listen", fly)
    await MissionFlight.__new__(MissionFlight).fly()
    assert left_with == [1]

    may_end.set()
    await started[0]
