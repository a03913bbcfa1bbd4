"""Missions started, stepped through and ended by written orders."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

from groundstation.console.mission_orders import MissionOrders

MISSION = """
schema = 1
fleet = "paper"
[[step]]
do = "takeoff"
[[step]]
do = "formation"
name = "triangle"
position_enu_m = [0.0, 0.0, 1.0]
[[step]]
do = "land"
"""


class Worker:
    """Flies what it is given, one at a time."""

    def __init__(self) -> None:
        self.task: asyncio.Task[Any] | None = None

    def begin(self, mission: Any, progress: Any) -> bool:
        if self.task is not None and not self.task.done():
            return False
        self.task = asyncio.create_task(mission())
        return True


async def test_a_mission_is_stepped_through_and_judged(
    client: Any, bus: Any, tmp_path: Path
) -> None:
    worker = Worker()
    path = tmp_path / "m.toml"
    path.write_text(MISSION, encoding="utf-8")
    orders = MissionOrders(client, worker.begin)
    assert "No mission flies" in orders.take(["step"])
    assert "Which mission" in orders.take(["mission"])
    assert "no such" in orders.take(["mission", str(tmp_path / "none.toml")]).lower()
    assert "only Python" in orders.take(["mission", str(path), "height_m=1"])
    assert orders.take(["mission", str(path), "stepping"]) == ""
    assert "flies already" in orders.take(["mission", str(path)])

    def waits(verb: str) -> Any:
        return lambda state: any(
            one.event.sentence.startswith(f"Waits before: {verb}") for one in state.events
        )

    assert await client.wait_for(waits("takeoff"), 5.0)
    assert not bus.orders
    assert orders.take(["step"]) == ""
    assert await client.wait_for(waits("formation"), 5.0)
    assert {order.kind for _, order in bus.orders} == {"takeoff"}
    orders.take(["continue"])
    assert worker.task is not None
    verdict = await asyncio.wait_for(worker.task, 5.0)
    assert verdict.passed, verdict.summary
    assert [order.kind for name, order in bus.orders if name == "mav0"] == [
        "takeoff",
        "move",
        "land",
    ]


async def test_a_mission_that_is_stopped_lands_all(client: Any, bus: Any, tmp_path: Path) -> None:
    worker = Worker()
    path = tmp_path / "m.toml"
    path.write_text(
        MISSION.replace('do = "land"', 'do = "wait"\nduration_s = 600'), encoding="utf-8"
    )
    orders = MissionOrders(client, worker.begin)
    assert orders.take(["mission", str(path)]) == ""
    assert await client.wait_for(lambda state: len(state.airborne_names) == 3, 5.0)
    assert orders.take(["stop"]) == ""
    assert worker.task is not None
    verdict = await asyncio.wait_for(worker.task, 10.0)
    assert verdict.is_interrupted
    assert all(verdict.landed.values())
    assert "No mission flies" in orders.take(["stop"])
