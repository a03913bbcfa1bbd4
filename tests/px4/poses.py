"""``python -m tests.px4.poses FLEET FOLDER``: truth of real PX4s (SIH) as poses and truth of the bus, and into a file.

While FOLDER/cut exists, no poses are published; truth goes on. The file FOLDER/truth.jsonl is the judge's: it needs
neither a ground nor an agent.
"""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path
from typing import Any

from onboard.bus.topics import Topic
from onboard.config.fleet import load_fleet
from sitl.server import simulator_bus
from sitl.sih_truth import serve


class _CutBus:
    """A bus that passes truth on, writes it down, and withholds poses while they are cut."""

    def __init__(self, bus: Any, folder: Path) -> None:
        self._bus, self._cut = bus, folder / "cut"
        self._file = (folder / "truth.jsonl").open("w", buffering=1, encoding="utf-8")
        self._every = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bus, name)

    def publish(self, topic: Topic, name: str, message: Any, *args: Any) -> None:
        if topic is Topic.TRUTH:
            row = [name, message.stamp_ns * 1e-9, *message.position_enu_m, *message.velocity_enu_m_s]
            self._file.write(json.dumps([row[0], *(round(value, 3) for value in row[1:])]) + "\n")
        elif self._cut.exists():
            return
        self._bus.publish(topic, name, message, *args)


if __name__ == "__main__":
    fleet = load_fleet(sys.argv[1])
    asyncio.run(serve(fleet, fleet.enabled_names, _CutBus(simulator_bus(fleet), Path(sys.argv[2])), with_mocap=True))
