"""An emulated copy of a fleet that flies while it is attacked.

The copy has a folder, ports and keys of its own, so running processes of the original are not
touched. Its vehicles cross each other's paths all the time, so that a disturbance of the avoidance
shows in the smallest distance.
"""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import math
import tomllib
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from groundstation.client.client import FleetClient
from groundstation.fleet.state import FleetState
from groundstation.keys.secured_fleet import secure_fleet
from groundstation.missions.runner import READY_TIMEOUT_SIM_S
from groundstation.processes.fleet_processes import EMULATOR, start_fleet
from groundstation.processes.free_ports import in_another_folder, toml_text, with_free_ports
from groundstation.processes.supervisor import ProcessError, Processes
from onboard.config.fleet import FleetConfig, fleet_from_mapping, load_fleet

# A vehicle of the copy that is never started. The attempts open a node with its name, endpoint and
# keys, which notes what reaches it.
SPARE = "attacked-spare"

_MAX_VEHICLES = 6
_LARGEST_ID = 250  # largest MAVLink system id of a vehicle; larger ones belong to ground stations
_HEIGHT_M = 1.0
_ORDER_S = 20.0  # timeout of a take-off or a formation
_FLYING_S = 5.0  # longest time from the end of the take-off until all fly under the law
_LANDED_S = 40.0  # timeout of the landing at the end
_MEASURE_PERIOD_S = 0.2

# keys of a vehicle that are left out of the copy
_NOT_COPIED = ("emulated", "enabled", "mavlink_signing")


def copied_names(fleet: FleetConfig) -> tuple[str, ...]:
    """Return the names of the vehicles that a copy has, besides the spare one."""
    return fleet.enabled_names[:_MAX_VEHICLES]


def copy_of(fleet: FleetConfig, folder: Path, *, is_locked: bool) -> FleetConfig:
    """Write a copy of a fleet for this machine, with keys of its own or without any.

    Args:
        fleet: the original; at most its first six vehicles are copied.
        folder: folder of the copy, which is created.
        is_locked: whether the copy gets keys.
    """
    names = copied_names(fleet)
    data = tomllib.loads(fleet.text)
    data["vehicles"] = _vehicle_tables(fleet, names, data["vehicles"])
    data["formations"] = _formations(fleet, names)
    data["fleet"] = {
        key: value for key, value in data["fleet"].items() if key not in ("simulator", "routers")
    }

    resolved = fleet_from_mapping(data, path=fleet.path)
    data = with_free_ports(in_another_folder(data, fleet), resolved)

    folder.mkdir()
    file = folder / "fleet.toml"
    text = toml_text(data, "An emulated copy, made by covey check attack")
    file.write_text(text, encoding="utf-8")
    if is_locked:
        return secure_fleet(str(file), datetime.datetime.now(datetime.UTC))
    return load_fleet(file)


def _vehicle_tables(
    fleet: FleetConfig, names: Sequence[str], tables: Mapping[str, dict[str, Any]]
) -> dict[str, dict[str, Any]]:
    """Return the tables of the copied vehicles and of the spare one.

    Args:
        fleet: the original.
        names: names of the vehicles to copy.
        tables: the vehicles' tables in the fleet file, by name.
    """
    vehicles = {}
    for name in names:
        vehicles[name] = {
            key: value for key, value in tables[name].items() if key not in _NOT_COPIED
        }

    taken_ids = {vehicle.system_id for vehicle in fleet.vehicles.values()}
    free_id = next(number for number in range(_LARGEST_ID, 0, -1) if number not in taken_ids)
    spare = {**vehicles[names[0]], "system_id": free_id, "enabled": False, "mocap_body": SPARE}
    vehicles[SPARE] = spare

    # Endpoints on this machine; with_free_ports replaces their ports by free ones. PX4's ground
    # link is attacked, too, so each copy has one.
    for port, table in enumerate(vehicles.values(), start=1000):
        table["agent"] = f"tcp/127.0.0.1:{port}"
        table["autopilot"] = f"udpin://127.0.0.1:{port}"
        table["direct"] = f"udpout://127.0.0.1:{port + 1000}"
    del spare["direct"]  # no PX4 belongs to it
    return vehicles


def _formations(fleet: FleetConfig, names: Sequence[str]) -> dict[str, dict[str, list[float]]]:
    """Return two formations: ``home`` at the starts, and ``there`` with each at the next start."""
    starts = [fleet.vehicles[name].start_enu_m[:2] for name in names]
    starts_of_next = [*starts[1:], *starts[:1]]
    return {"home": _slots(names, starts), "there": _slots(names, starts_of_next)}


def _slots(
    names: Sequence[str], positions_m: Sequence[tuple[float, float]]
) -> dict[str, list[float]]:
    return {name: [x, y, 0.0] for name, (x, y) in zip(names, positions_m, strict=True)}


@dataclass(slots=True)
class CopyFlight:
    """The flight of a copy, and the worst figures that its vehicles have reported."""

    fleet: FleetConfig
    client: FleetClient
    # vehicle -> largest reported p99 of its loop period
    worst_loop_ms: dict[str, float] = field(default_factory=dict)
    # largest age of a neighbour's state that any vehicle has reported
    worst_age_ms: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the vehicles that fly."""
        return self.fleet.enabled_names

    @property
    def separation_m(self) -> float:
        """Smallest distance so far, by ground truth."""
        smallest = self.client.state.smallest_truth
        if smallest is None:
            return math.inf
        return smallest.distance_m

    def is_flying(self) -> bool:
        """Return whether all vehicles are in the air and fly under the law."""
        now_ns = self.client.now_ns()
        for name in self.names:
            view = self.client.state.vehicles[name]
            if view.telemetry is None or not view.is_fresh(now_ns):
                return False
            if view.telemetry.state not in ("flying", "holding"):
                return False
        return True

    def measure(self) -> None:
        """Note the loop periods and the ages of neighbours' states that the vehicles report."""
        for name in self.names:
            last = self.client.state.vehicles[name].telemetry
            if last is None or not last.is_airborne:
                continue
            worst_so_far_ms = self.worst_loop_ms.get(name, 0.0)
            self.worst_loop_ms[name] = max(worst_so_far_ms, last.loop_period_p99_ms)
            self.worst_age_ms = max(self.worst_age_ms, 1e3 * last.neighbour_age_s)

    async def cross_forever(self) -> None:
        """Let all vehicles cross each other's paths, again and again."""
        while True:
            for formation in ("there", "home"):
                await self.client.order(f"formation {formation} 0 0 {_HEIGHT_M}", _ORDER_S)

    async def measure_forever(self) -> None:
        """Measure again and again."""
        while True:
            self.measure()
            await asyncio.sleep(_MEASURE_PERIOD_S)


@contextlib.asynccontextmanager
async def flying(fleet: FleetConfig, seed: int = 0) -> AsyncIterator[CopyFlight]:
    """Fly a copy while the context lasts; afterwards land it and end its processes.

    Args:
        fleet: a copy, whose folder gets the logs.
        seed: seed of all random numbers of the emulator.

    Raises:
        ProcessError: the copy did not get into the air.
    """
    folder = Path(fleet.path).parent
    processes = Processes(folder)
    client = FleetClient(fleet)
    try:
        start_fleet(fleet, folder, seed, processes)
        await processes.wait_for_line(EMULATOR, "ready:", READY_TIMEOUT_SIM_S)
        await client.start()

        flight = CopyFlight(fleet, client)
        await client.wait_for(lambda state: _are_ready(state, fleet), READY_TIMEOUT_SIM_S)
        await client.order(f"takeoff all {_HEIGHT_M}", _ORDER_S)
        processes.check()
        if not await client.wait_for(lambda _: flight.is_flying(), _FLYING_S):
            raise ProcessError(f"The copy did not take off; its logs are in {folder}.")

        tasks = [
            asyncio.create_task(flight.cross_forever()),
            asyncio.create_task(flight.measure_forever()),
        ]
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


def _are_ready(state: FleetState, fleet: FleetConfig) -> bool:
    for name in fleet.enabled_names:
        telemetry = state.vehicles[name].telemetry
        if telemetry is None or telemetry.state != "ready":
            return False
    return True
