"""Kill and land past an agent that hangs: straight to PX4, said so, and not undone by an agent that
comes back.
"""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from groundstation.client.client import FleetClient
from groundstation.fleet.state import FleetState
from groundstation.processes.free_ports import toml_text, with_free_ports
from onboard.bus.schema import Message, Truth
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, load_fleet

ROOT = Path(__file__).resolve().parents[2]
SOLO = "mav0"
TAKE_OFFS = 3
pytestmark = pytest.mark.timeout(180)


def solo_fleet(folder: Path) -> FleetConfig:
    """The paper's fleet with one vehicle only, on free ports."""
    paper = load_fleet(ROOT / "configs" / "fleets" / "paper.toml")
    data: dict[str, Any] = with_free_ports(tomllib.loads(paper.text), paper)
    data["fleet"]["name"] = f"direct-{os.getpid()}"
    for name in ("mav1", "mav2"):
        data["vehicles"][name]["enabled"] = False
    path = folder / "fleet.toml"
    path.write_text(toml_text(data, "for a test"), encoding="utf-8")
    return load_fleet(path)


class Hover:
    """One vehicle in the air: its agent's process, the ground, and the height that is true."""

    def __init__(self, agent: subprocess.Popen[bytes], client: FleetClient) -> None:
        self.agent = agent
        self.client = client
        self.heights_m: list[tuple[float, float]] = []
        client.add_sink(self._sink)

    def _sink(self, topic: Topic, name: str, message: Message, _: int) -> None:
        if isinstance(message, Truth) and name == SOLO:
            self.heights_m.append((time.monotonic(), message.position_enu_m[2]))

    def highest_m(self, since_s: float) -> float:
        return max(height for stamp, height in self.heights_m if stamp >= since_s)

    async def until(self, what: str, condition: Any, timeout_s: float) -> None:
        assert await self.client.wait_for(condition, timeout_s), what


def start(log_path: Path, words: list[str]) -> subprocess.Popen[bytes]:
    with log_path.open("wb") as log:
        return subprocess.Popen(
            [sys.executable, "-m", *words], stdout=log, stderr=subprocess.STDOUT, cwd=ROOT
        )


@asynccontextmanager
async def hover(folder: Path) -> AsyncIterator[Hover]:
    fleet = solo_fleet(folder)
    commands = {
        "sitl": ["sitl", "--fleet", fleet.path],
        "agent": [
            "onboard",
            "--fleet",
            fleet.path,
            "--vehicle",
            SOLO,
            "--apply-params",
            "--mocap",
            "bus",
        ],
    }
    processes: dict[str, subprocess.Popen[bytes]] = {}
    client = FleetClient(fleet, author="test")
    try:
        for name, words in commands.items():
            processes[name] = start(folder / f"{name}.log", words)
        found = Hover(processes["agent"], client)
        await client.start()
        await found.until(
            "never ready", lambda state: _told(state, "ready") and client.control.is_operator, 60.0
        )
        await _take_off(client, found)
        yield found
    finally:
        await client.stop()
        for process in processes.values():
            process.kill()
            process.wait(5)


async def _take_off(client: FleetClient, flight: Hover) -> None:
    """Take off, once more if this computer was so busy that the agent's loop stalled.

    A stalled loop lands the vehicle, or lets it hold where it is, so it is landed in either case.
    """
    for _ in range(TAKE_OFFS):
        results = await client.order(f"takeoff {SOLO} 1.0", 40.0)
        if results[SOLO].phase == "done":
            return

        assert "Loop stalled" in results[SOLO].sentence, results
        await client.order(f"land {SOLO}", 40.0)
        await flight.until("not on the ground", _is_on_the_ground, 60.0)
    raise AssertionError(results)


def _told(state: FleetState, wanted: str) -> bool:
    telemetry = state.vehicles[SOLO].telemetry
    return telemetry is not None and telemetry.state == wanted


def _is_on_the_ground(state: FleetState) -> bool:
    """Whether the agent takes a take-off: landed after a flight, or ready if it only armed."""
    return _told(state, "landed") or _told(state, "ready")


@pytest.mark.parametrize("comes_back", [True, pytest.param(False, marks=pytest.mark.long)])
async def test_land_goes_straight_to_px4_when_the_agent_hangs_and_stays_when_it_comes_back(
    tmp_path: Path, comes_back: bool
) -> None:
    async with hover(tmp_path) as flight:
        os.kill(flight.agent.pid, signal.SIGSTOP)
        ordered_s = time.monotonic()
        handle = await flight.client.submit(f"land {SOLO}")
        while handle.results[SOLO].phase != "direct":
            assert time.monotonic() - ordered_s < 2.0, handle.results
            await asyncio.sleep(0.005)
        sent_after_s = time.monotonic() - ordered_s
        assert sent_after_s > 0.99  # a landing goes to the agent for 1 s; the loop bounds the rest
        assert "straight to PX4" in handle.results[SOLO].sentence
        await asyncio.sleep(0.3)
        if comes_back:
            os.kill(flight.agent.pid, signal.SIGCONT)
        results = await handle.wait(60.0)
        assert results[SOLO].phase == "done", results
        assert "PX4 accepted it, and it is disarmed" in results[SOLO].sentence
        assert flight.heights_m[-1][1] < 0.05
        assert flight.highest_m(ordered_s + 1.5) < flight.highest_m(ordered_s - 1.0) + 0.1
        later = [height for stamp, height in flight.heights_m if stamp > ordered_s + 3.0]
        climbs_m = max(later[place] - min(later[: place + 1]) for place in range(len(later)))
        assert climbs_m < 0.1, "it climbed again after PX4 had begun to land"
        codes = {logged.event.code for logged in flight.client.state.events}
        assert {"direct_command", "direct_disarmed"} <= codes
        if comes_back:
            await flight.until("agent silent", _is_on_the_ground, 20.0)
            await asyncio.sleep(1.0)
            telemetry = flight.client.state.vehicles[SOLO].telemetry
            assert telemetry is not None
            assert not telemetry.is_armed


@pytest.mark.long
async def test_kill_goes_straight_to_px4_when_the_agent_hangs(tmp_path: Path) -> None:
    async with hover(tmp_path) as flight:
        os.kill(flight.agent.pid, signal.SIGSTOP)
        ordered_s = time.monotonic()
        results = await flight.client.order(f"kill {SOLO}", 10.0)
        assert results[SOLO].phase == "done", results
        assert "straight to PX4" in results[SOLO].sentence
        assert "it is disarmed" in results[SOLO].sentence
        await asyncio.sleep(1.5)
        assert flight.heights_m[-1][1] < 0.05
        down_s = next(
            stamp for stamp, height in flight.heights_m if stamp > ordered_s and height < 0.1
        )
        assert down_s - ordered_s < 1.5  # it fell: nobody lands from 1 m in that time
        os.kill(flight.agent.pid, signal.SIGCONT)
        await flight.until(
            "never told", lambda state: not state.vehicles[SOLO].telemetry.is_armed, 10.0
        )
        await asyncio.sleep(2.0)
        assert flight.highest_m(ordered_s + 2.0) < 0.1
