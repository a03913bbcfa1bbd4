"""A made-up fleet in real processes, for benchmarks: emulator, agents and a client, on free ports
and in one folder.
"""

from __future__ import annotations

import asyncio
import datetime
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from groundstation.client.client import FleetClient
from groundstation.keys.secured_fleet import secure_fleet
from groundstation.missions.api import Fleet
from groundstation.processes.free_ports import toml_text, with_free_ports
from groundstation.processes.supervisor import Processes, agent_command
from groundstation.recording.channels import RECORDED
from groundstation.recording.writer import RecordWriter
from onboard.config.fleet import FleetConfig, fleet_from_mapping

EMULATOR = "sitl"
READY_TIMEOUT_S = 90.0
_QUAD = {
    "mass_kg": 1.0,
    "hover_thrust_frac": 0.49,
    "attitude_delay_s": 0.04,
    "attitude_wn_rad_s": 11.0,
    "attitude_zeta": 0.6,
    "drag_1_s": 1.0,
    "max_tilt_deg": 30.0,
    "max_speed_m_s": 1.4,
}

Command = Callable[[str, str], list[str]]
Start = Callable[[str, list[str]], list[str]]


def fleet_data(count: int, spacing_m: float, name: str = "stage") -> dict[str, Any]:
    """A fleet file's data: ``count`` quadrotors on a square grid, on ports that are free now."""
    columns = math.ceil(math.sqrt(count))
    rows = math.ceil(count / columns)
    east = 0.5 * spacing_m * (columns - 1)
    north = 0.5 * spacing_m * (rows - 1)
    vehicles = {
        f"mav{place}": {
            "system_id": place + 1,
            "start_enu_m": [
                spacing_m * (place % columns) - east,
                spacing_m * (place // columns) - north,
                0.0,
            ],
            "agent": f"tcp/127.0.0.1:{7460 + place}",
            "autopilot": f"udpin://127.0.0.1:{15540 + place}",
            "direct": f"udpout://127.0.0.1:{19570 + place}",
        }
        for place in range(count)
    }
    fence = {"x": [-east - 3.0, east + 3.0], "y": [-north - 3.0, north + 3.0], "z": [0.0, 3.0]}
    data = {
        "schema": 1,
        "fleet": {"name": name, "geofence_m": fence},
        "types": {"quad": _QUAD},
        "defaults": {"type": "quad"},
        "vehicles": vehicles,
    }
    return with_free_ports(data, fleet_from_mapping(data))


class BenchFleet:
    """``async with BenchFleet(...) as fleet``: everything is up when the block begins, and ended
    when it is left.

    Args:
        data: of the fleet file that agents and client use.
        folder: for logs and record.
        emulator_data: of the emulator's, where it is another one.
        command: starts an agent.
        has_record: whether the ground writes everything on the bus, as in a flight.
        has_keys: whether the bus is locked: mutual TLS on every link, signed orders.
        start: of the words that start the process of this name, those that start it where it
            belongs.
        say: progress in words.
    """

    def __init__(
        self,
        data: Mapping[str, Any],
        folder: Path,
        *,
        emulator_data: Mapping[str, Any] | None = None,
        command: Command = agent_command,
        has_record: bool = False,
        has_keys: bool = False,
        start: Start = lambda _name, words: words,
        say: Callable[[str], None] = lambda line: None,
    ) -> None:
        self.path = folder / "fleet.toml"
        self.path.write_text(toml_text(dict(data)), encoding="utf-8")
        self._emulator_path = self.path
        if emulator_data is not None:
            self._emulator_path = folder / "emulator.toml"
            self._emulator_path.write_text(toml_text(dict(emulator_data)), encoding="utf-8")
        self.config: FleetConfig = (
            secure_fleet(str(self.path), datetime.datetime.now(datetime.UTC))
            if has_keys
            else fleet_from_mapping(dict(data), path=str(self.path))
        )
        self.processes = Processes(folder)
        self.client = FleetClient(self.config, extra_topics=RECORDED if has_record else ())
        self.fleet = Fleet(self.client, say=say)
        self._record = RecordWriter(folder) if has_record else None
        self._command = command
        self._start = start

    async def __aenter__(self) -> BenchFleet:
        """Start everything and wait until every vehicle is ready; ProcessError or NotReady when
        that fails.
        """
        try:
            words = ["sitl", "--fleet", str(self._emulator_path), "--no-gcs"]
            self.processes.start(EMULATOR, self._start(EMULATOR, words))
            for name in self.config.enabled_names:
                self.start_agent(name)
            if self._record is not None:
                self._record.start()
                self.client.add_sink(self._record.put)
            await self.client.start()
            await self._ready()
        except BaseException:
            await self._close()
            raise
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End everything."""
        await self._close()

    def start_agent(self, name: str) -> None:
        """Start the agent of one vehicle."""
        self.processes.start(name, self._start(name, self._command(str(self.path), name)))

    async def _ready(self) -> None:
        waiting = asyncio.create_task(self.fleet.ready(READY_TIMEOUT_S))
        try:
            while not (await asyncio.wait({waiting}, timeout=0.3))[0]:
                self.processes.check()
            await waiting
        finally:
            waiting.cancel()

    async def _close(self) -> None:
        try:
            await self.processes.stop()
            await self.client.stop()
            if self._record is not None:
                await asyncio.to_thread(self._record.stop)
        finally:
            self.processes.kill()
