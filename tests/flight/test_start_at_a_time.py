"""A mission that starts at a time of the wall clock, with real agents and real clocks."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from groundstation.client.client import FleetClient
from groundstation.flights.flight_settings import open_folder, simulated_fleet
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.wall_time import local_now, wall_time
from groundstation.missions.api import Fleet
from groundstation.missions.runner import MissionRun
from groundstation.processes.fleet_processes import start_fleet
from groundstation.processes.supervisor import Processes
from onboard.config.fleet import load_fleet

AHEAD_S = 6.0
READY_S = 150.0
STEPS = [
    {"do": "takeoff", "height_m": 0.6, "vehicles": "mav0"},
    {"do": "land", "vehicles": "mav0"},
]


@pytest.mark.long
@pytest.mark.timeout(300)
async def test_a_mission_waits_for_its_time_and_sets_out_then(tmp_path: Path) -> None:
    folder = tmp_path / "flight"
    fleet = simulated_fleet(
        load_fleet("paper"), folder, law=None, has_free_ports=True, needs_ports=True
    )
    open_folder(folder, {"fleet.toml": fleet.text}, is_headless=True)
    mission = mission_from_mapping({"schema": 1, "step": STEPS}, path="hop.toml", fleet=fleet)

    processes = Processes(folder)
    client = FleetClient(fleet)
    said: list[tuple[float, str]] = []
    try:
        start_fleet(fleet, folder, 1, processes)
        await client.start()
        await Fleet(client).ready(READY_S)

        # all that may be slow is over: from here on a few messages are exchanged
        now = local_now(client.wall_clock.wall_ns)
        text = time.strftime("%H:%M:%S", time.localtime(time.time() + AHEAD_S + 1.0))
        at = wall_time(text, now)
        run = MissionRun(mission, client, say=lambda line: said.append((time.time(), line)), at=at)
        verdict = await run.run()
    finally:
        await client.stop()
        await processes.stop()

    lines = "\n".join(line for _, line in said)
    assert verdict.passed, f"{verdict.summary}\n{lines}"
    assert "Starts at" in lines
    set_out_s = next(at_s for at_s, line in said if line.startswith("[1/2] takeoff"))
    assert set_out_s >= at.wall_ns * 1e-9 - 0.1
