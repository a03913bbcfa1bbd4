"""The ground of one flight through a partition: ``python -m tests.bench.network.crossing HUB FOLDER
AT_S LASTS_S``.

Six vehicles in two rows of three fly through each other's gaps and are cut into 3 + 3 on their way,
the ground with the first three. Each agent, the emulator and the ground have a network namespace of
their own, as hosts; the bus is locked. The emulator, which is also the motion capture, hears and is
heard by all. Prints what was seen.
"""

from __future__ import annotations

import asyncio
import json
import math
import re
import sys
from pathlib import Path
from typing import Any

from tests.bench.network.hub import join

GROUND = "10.77.0.1"
EMULATOR = "10.77.0.2"
HOSTS = tuple(f"10.77.0.{11 + place}" for place in range(6))
SIDES = (GROUND, *HOSTS[:3]), HOSTS[3:]
_AIRBORNE_M = 0.1
_RECOVERY_S = 8.0


def stage() -> dict[str, Any]:
    """Return the fleet file's data: two rows of three, each vehicle with a host of its own."""
    from tests.bench.fixture import fleet_data

    data = fleet_data(6, 2.6, "partition")
    for place, (vehicle, host) in enumerate(zip(data["vehicles"].values(), HOSTS, strict=True)):
        vehicle["start_enu_m"] = [2.6 * (place % 3) - 2.6, -1.8 if place < 3 else 1.8, 0.0]
        vehicle["agent"] = f"tcp/{host}:7460"
        vehicle["autopilot"] = f"udpout://{EMULATOR}:{15540 + place}"
        vehicle["direct"] = f"udpout://{EMULATOR}:{19570 + place}"
    data["fleet"]["simulator"] = f"tcp/{EMULATOR}:7450"
    data["fleet"]["geofence_m"] |= {"x": [-9.0, 9.0], "y": [-9.0, 9.0]}
    return data


class Watch:
    """A sink: the smallest true distance of two vehicles of which one flies."""

    def __init__(self) -> None:
        self.nearest_m = math.inf
        self._stamp_ns = 0
        self._at: list[tuple[float, float, float]] = []

    def put(self, topic: Any, _name: str, message: Any, _received_ns: int) -> None:
        """Called on the bus's threads."""
        if topic.value != "truth":
            return
        if message.stamp_ns != self._stamp_ns:
            self._stamp_ns = message.stamp_ns
            self._at = []
        here = message.position_enu_m
        for there in self._at:
            if max(here[2], there[2]) > _AIRBORNE_M:
                self.nearest_m = min(self.nearest_m, math.dist(here[:2], there[:2]))
        self._at.append(here)


async def fly(line: Any, hub: str, folder: Path, at_s: float, lasts_s: float) -> dict[str, Any]:
    """Fly across, cut and joined again on the way, fly back and land; what was seen."""
    from tests.bench.fixture import BenchFleet

    data = stage()
    watch = Watch()
    addresses = dict(zip(data["vehicles"], HOSTS, strict=True)) | {"sitl": EMULATOR}

    def on_host(name: str, words: list[str]) -> list[str]:
        return ["tests.bench.network.host", hub, f"{addresses[name]}/24", *words]

    bench_fleet = BenchFleet(data, folder, has_record=True, has_keys=True, start=on_host)
    bench_fleet.client.add_sink(watch.put)
    starts = {name: vehicle["start_enu_m"][:2] for name, vehicle in data["vehicles"].items()}
    across = {name: (x + (1.3 if y < 0 else -1.3), -y, 1.0) for name, (x, y) in starts.items()}
    back = {name: (x, y, 1.0) for name, (x, y) in starts.items()}
    async with bench_fleet:
        await bench_fleet.fleet.takeoff(height_m=1.0)
        crossing = asyncio.create_task(_move(bench_fleet, across))
        await asyncio.sleep(at_s)
        line.send(b"cut")
        await asyncio.sleep(lasts_s)
        line.send(b"heal")
        ends = await crossing
        await asyncio.sleep(_RECOVERY_S)
        returns = await _move(bench_fleet, back)
        has_landed = await bench_fleet.fleet.land_all()
    told = {name: conditions((folder / f"{name}.log").read_text()) for name in starts}
    return {
        "nearest_m": watch.nearest_m,
        "ends": ends,
        "returns": returns,
        "has_landed": has_landed,
        "told": told,
    }


def conditions(log: str) -> list[tuple[str, str, str]]:
    """Return what an agent's log says of failures: the condition, the vehicles that it is about,
    the action.
    """
    from onboard.safety.failsafe_table import Condition

    known = "|".join(re.escape(one.value) for one in Condition)
    return re.findall(rf"(?mi) ({known})(?: \(([^)]*)\))?: (.*)\.$", log)


async def _move(bench_fleet: Any, goals: dict[str, tuple[float, float, float]]) -> dict[str, str]:
    """Order each on its own; the end of each order, "" for done."""
    moves = (bench_fleet.fleet[name].move(goal, timeout_s=40.0) for name, goal in goals.items())
    ends = await asyncio.gather(*moves, return_exceptions=True)
    return {
        name: "" if not isinstance(end, BaseException) else str(end)
        for name, end in zip(goals, ends, strict=True)
    }


def main(words: list[str]) -> int:
    """Fly once."""
    hub, folder, at_s, lasts_s = words
    line = join(hub, f"{GROUND}/24")  # before any library starts a thread
    print(
        json.dumps(asyncio.run(fly(line, hub, Path(folder), float(at_s), float(lasts_s)))),
        flush=True,
    )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
