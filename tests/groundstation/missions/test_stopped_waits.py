"""Orders to stop that come while a mission waits for its vehicles: it ends at once."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.missions.runner import MissionRun
from onboard.bus.schema import Event
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig


def _run(fleet: FleetConfig, client: Any, bus: Any) -> MissionRun:
    """The run of a mission that waits, because mav1 is not ready."""
    bus.tell("mav1", state="waiting", not_ready=("no motion capture",))
    content = {"schema": 1, "step": [{"do": "takeoff", "height_m": 1.0}, {"do": "land"}]}
    return MissionRun(mission_from_mapping(content, path="test.toml", fleet=fleet), client)


def _answer(bus: Any, order_id: str, words: str) -> None:
    """An agent's event about an order that it has answered."""
    event = Event(
        vehicle="mav1",
        stamp_ns=time.monotonic_ns(),
        severity="debug",
        code="order",
        sentence=f"{order_id} {words}",
    )
    bus.on_message[Topic.EVENT](Topic.EVENT, "mav1", event)


@pytest.mark.parametrize("line", ["land all", "hold mav1"])
async def test_a_persons_order_to_stop_ends_a_wait_for_vehicles_at_once(
    fleet: FleetConfig, client: Any, bus: Any, line: str
) -> None:
    client.has_person = True
    task = asyncio.create_task(_run(fleet, client, bus).run())
    await asyncio.sleep(0.1)

    client.submit_now(line)
    verdict = await asyncio.wait_for(task, 2.0)

    assert verdict.exit_status == 2
    assert "has ordered to land, to hold or to kill here while it waited" in verdict.summary
    assert not [order for _, order in bus.orders if order.kind == "takeoff"]


async def test_an_order_to_stop_of_another_ground_ends_a_wait_although_the_vehicle_refuses_it(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    _answer(bus, "ground-ada-1", "land mav1 refused: It stands on the ground.")
    task = asyncio.create_task(_run(fleet, client, bus).run())
    await asyncio.sleep(0.1)

    _answer(bus, "ground-ada-2", "locate mav1 accepted.")
    _answer(bus, "ground-test-2", "land mav1 refused: It stands on the ground.")
    await asyncio.sleep(0.4)
    assert not task.done()

    _answer(bus, "ground-ada-3", "land mav1 refused: It stands on the ground.")
    verdict = await asyncio.wait_for(task, 2.0)

    assert verdict.exit_status == 2
    assert "was not begun: ground-ada has ordered mav1 to land while it waited" in verdict.summary
    assert not bus.orders
