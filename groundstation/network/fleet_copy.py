"""An emulated copy of a fleet, in a folder and on ports of its own, that flies while somebody
attacks it.
"""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import math
import tomllib
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from groundstation.client.client import FleetClient
from groundstation.keys.secured_fleet import secure_fleet
from groundstation.missions.runner import READY_TIMEOUT_SIM_S
from groundstation.processes.fleet_processes import EMULATOR, start_fleet
from groundstation.processes.free_ports import in_another_folder, toml_text, with_free_ports
from groundstation.processes.supervisor import ProcessError, Processes
from onboard.config.fleet import FleetConfig, fleet_from_mapping, load_fleet

SPARE = "attacked-spare"  # a vehicle of the copy that nobody flies: what reaches it is looked at
_MOST_VEHICLES = 6
_HEIGHT_M = 1.0
_ORDER_S = 20.0
_LANDED_S = 40.0


def copy_of(fleet: FleetConfig, folder: Path, *, is_locked: bool) -> FleetConfig:
    """Write a copy of a fleet for this machine, with keys of its own or without any.

    Args:
        fleet: to be copied, at most the first six of its vehicles.
        folder: of the copy; made.
        is_locked: whether the copy gets keys.
    """
    data = tomllib.loads(fleet.text)
    names = fleet.enabled_names[:_MOST_VEHICLES]
    vehicles = {name: _plain(data["vehicles"][name]) for name in names}
    ids = {vehicle.system_id for vehicle in fleet.vehicles.values()}
    own_id = next(number for number in range(250, 0, -1) if number not in ids)
    spare = {"system_id": own_id, "enabled": False, "mocap_body": SPARE}
    vehicles[SPARE] = {**vehicles[names[0]], **spare}
    vehicles[SPARE].pop("direct", None)
    # of this machine; the ports are chosen below
    for port, table in enumerate(vehicles.values(), start=1000):
        table |= {"agent": f"tcp/127.0.0.1:{port}", "autopilot": f"udpin://127.0.0.1:{port}"}
    starts = [fleet.vehicles[name].start_enu_m[:2] for name in names]
    data["formations"] = {
        "home": _slots(names, starts),
        # everybody across to where another one started
        "there": _slots(names, [*starts[1:], *starts[:1]]),
    }
    data["fleet"] = {
        key: value for key, value in data["fleet"].items() if key not in ("simulator", "routers")
    }
    data["vehicles"] = vehicles
    data.pop("shapes", None)
    data = with_free_ports(
        in_another_folder(data, fleet), fleet_from_mapping(data, path=fleet.path)
    )
    folder.mkdir()
    file = folder / "fleet.toml"
    file.write_text(
        toml_text(data, "An emulated copy, made by covey check attack"), encoding="utf-8"
    )
    return (
        secure_fleet(str(file), datetime.datetime.now(datetime.UTC))
        if is_locked
        else load_fleet(file)
    )


def _plain(table: dict[str, Any]) -> dict[str, Any]:
    return {
        key: value
        for key, value in table.items()
        if key not in ("emulated", "enabled", "mavlink_signing")
    }


def _slots(names: tuple[str, ...], places: Sequence[tuple[float, float]]) -> dict[str, list[float]]:
    return {name: [x, y, 0.0] for name, (x, y) in zip(names, places, strict=True)}


@dataclass(slots=True)
class CopyFlight:
    """The flight of the copy, and what it suffered."""

    fleet: FleetConfig
    client: FleetClient
    # p99 of the period, the largest that was told
    worst_loop_ms: dict[str, float] = field(default_factory=dict)
    worst_age_ms: float = 0.0  # of any neighbour's state, as told

    @property
    def names(self) -> tuple[str, ...]:
        """Vehicles that fly."""
        return self.fleet.enabled_names

    @property
    def separation_m(self) -> float:
        """Smallest distance so far, by ground truth."""
        smallest = self.client.state.smallest_truth
        return math.inf if smallest is None else smallest.distance_m

    def is_flying(self) -> bool:
        """Whether all are in the air, under the law, as ordered."""
        now_ns = self.client.now_ns()
        views = [self.client.state.vehicles[name] for name in self.names]
        return all(
            view.telemetry is not None
            and view.is_fresh(now_ns)
            and view.telemetry.state in ("flying", "holding")
            for view in views
        )

    def measure(self) -> None:
        """Take what the vehicles tell of their loops and of each other's age."""
        for name in self.names:
            last = self.client.state.vehicles[name].telemetry
            if last is not None and last.is_airborne:
                self.worst_loop_ms[name] = max(
                    self.worst_loop_ms.get(name, 0.0), last.loop_period_p99_ms
                )
                self.worst_age_ms = max(self.worst_age_ms, 1e3 * last.neighbour_age_s)

    async def cross(self) -> None:
        """Cross each other's ways for ever."""
        while True:
            for formation in ("there", "home"):
                await self.client.order(f"formation {formation} 0 0 {_HEIGHT_M}", _ORDER_S)

    async def watch(self) -> None:
        """Measure for ever."""
        while True:
            self.measure()
            await asyncio.sleep(0.2)


@contextlib.asynccontextmanager
async def flying(fleet: FleetConfig, seed: int = 0) -> AsyncIterator[CopyFlight]:
    """Start a copy's emulator and agents, take off, cross each other's ways meanwhile; land and end
    all afterwards.

    Raises:
        ProcessError: it did not get into the air.
    """
    folder = Path(fleet.path).parent
    processes = Processes(folder)
    client = FleetClient(fleet)
    try:
        start_fleet(fleet, folder, seed, processes)
        await processes.wait_for_line(EMULATOR, "ready:", READY_TIMEOUT_SIM_S)
        await client.start()
        flight = CopyFlight(fleet, client)
        await client.wait_for(
            lambda state: _are(state.vehicles, fleet, "ready"), READY_TIMEOUT_SIM_S
        )
        await client.order(f"takeoff all {_HEIGHT_M}", _ORDER_S)
        processes.check()
        if not await client.wait_for(lambda _: flight.is_flying(), 5.0):
            raise ProcessError(f"The copy did not take off; its logs are in {folder}.")
        tasks = [asyncio.create_task(work) for work in (flight.cross(), flight.watch())]
        try:
            yield flight
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        await client.order("land", _LANDED_S)
    finally:
        await client.stop()
        await processes.stop()


def _are(vehicles: Any, fleet: FleetConfig, state: str) -> bool:
    told = [vehicles[name].telemetry for name in fleet.enabled_names]
    return all(one is not None and one.state == state for one in told)
