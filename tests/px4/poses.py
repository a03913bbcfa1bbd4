"""``python -m tests.px4.poses FLEET FOLDER``: truth of real PX4s (SIH) as poses and truth of the
bus, and into a file; as odometry to those that fly by vision, whose poses are not published.

While FOLDER/cut exists, no poses and no odometry are sent; while FOLDER/stall exists poses are
kept, and come late, all at once; truth goes on. Once FOLDER/turned exists, the frames of odometry
are turned; while FOLDER/frozen exists, odometry repeats itself. The file FOLDER/truth.jsonl is the
judge's: it needs neither a ground nor an agent.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import sys
from pathlib import Path
from typing import Any, cast

from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, load_fleet
from sitl.server import simulator_bus
from sitl.sih_truth import serve
from tests.px4.odometry import Odometry

_PERIOD_S = 0.019  # of the file
_TURN_RAD = math.radians(40.0)
_PRIORITY = 20  # a motion capture waits for no computer: above the agents, below PX4


class _CutBus:
    """A bus that passes truth on, writes it down, and withholds poses while they are cut."""

    def __init__(self, bus: Any, folder: Path, fleet: FleetConfig) -> None:
        self._bus = bus
        self._cut = folder / "cut"
        self._file = (folder / "truth.jsonl").open("w", buffering=1, encoding="utf-8")
        self._written_s: dict[str, float] = {}
        self._turned = folder / "turned"
        self._frozen = folder / "frozen"
        self._stall = folder / "stall"
        self._kept: list[tuple[Any, ...]] = []  # poses that wait
        self._odometry = {
            name: Odometry(vehicle)
            for name, vehicle in fleet.vehicles.items()
            if vehicle.flies_by_vision
        }

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bus, name)

    def publish(self, topic: Topic, name: str, message: Any, *args: Any) -> None:
        if topic is Topic.TRUTH:
            stamp_s = message.stamp_ns * 1e-9
            if stamp_s - self._written_s.get(name, 0.0) > _PERIOD_S:
                self._written_s[name] = stamp_s
                row = (stamp_s, *message.position_enu_m, *message.velocity_enu_m_s)
                self._file.write(json.dumps([name, *(round(value, 3) for value in row)]) + "\n")
            if name in self._odometry and not self._cut.exists():
                if self._turned.exists():
                    self._odometry[name].turn(message, _TURN_RAD)
                self._odometry[name].send(message, is_frozen=self._frozen.exists())
        elif self._cut.exists() or self._odometry:
            return
        elif self._stall.exists():
            self._kept.append((topic, name, message, *args))
            return

        for late in self._kept:
            self._bus.publish(*late)
        self._kept.clear()
        self._bus.publish(topic, name, message, *args)


if __name__ == "__main__":
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(_PRIORITY))
    fleet = load_fleet(sys.argv[1])
    asyncio.run(
        serve(
            fleet,
            fleet.enabled_names,
            cast(BusSession, _CutBus(simulator_bus(fleet), Path(sys.argv[2]), fleet)),
            with_mocap=True,
        )
    )
