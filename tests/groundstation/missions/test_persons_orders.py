"""Orders that a person at this ground gives beside a mission: whether they explain its failure."""

from __future__ import annotations

import asyncio
import functools
from typing import Any

import numpy as np
import pytest

from groundstation.missions.api import Fleet
from groundstation.missions.ground import MissionGround
from groundstation.missions.path_following import follow_paths
from groundstation.missions.taken import FleetTaken
from groundstation.orders.result import OrderFailed
from groundstation.paths.pieces import fitted
from onboard.bus.schema import Order
from onboard.config.fleet import FleetConfig


def end(bus: Any, name: str, outcome: str) -> None:
    """Let a vehicle report how its order of the mission ended."""
    (order,) = (order for vehicle, order in bus.orders if vehicle == name and is_of_mission(order))
    bus.report_end(name, order, outcome, "The motor is weak.")


def is_of_mission(order: Order) -> bool:
    return order.kind == "move" and order.reason == "mission"


@pytest.mark.parametrize("other", ["done", "failed"])
async def test_a_persons_order_ends_a_mission_only_if_it_explains_all_that_went_wrong(
    client: Any, bus: Any, other: str
) -> None:
    client.has_person = True
    script = Fleet(client)
    await script.takeoff(1.0)
    bus.accept_only = {"move"}
    moving = asyncio.create_task(script.move((0.5, 0.0, 1.0)))
    await asyncio.sleep(0.1)
    person = client.submit_now("yaw mav2 30")
    bus.tell(
        "mav2",
        taken_order_id=person.results["mav2"].order_id,
        taken_order_kind="move",
        taken_order_from="olga",
    )
    await asyncio.sleep(0.1)

    end(bus, "mav0", "done")
    end(bus, "mav1", other)
    end(bus, "mav2", "superseded")
    if other == "done":
        with pytest.raises(FleetTaken, match="olga has ordered yaw mav2: that stays"):
            await moving
    else:
        with pytest.raises(OrderFailed, match="mav1 failed: The motor is weak"):
            await moving


async def test_a_vehicle_that_a_script_enables_takes_part_in_its_next_order(
    client: Any, bus: Any
) -> None:
    script = Fleet(client)
    await script.disable("mav1")
    bus.tell("mav1", disabled_by="olga")
    await asyncio.sleep(0.1)
    report = functools.partial(bus.tell, "mav1", disabled_by="")
    asyncio.get_running_loop().call_later(0.3, report)  # later than the result of its order
    await script.enable("mav1")
    assert set(await script.takeoff(1.0)) == {"mav0", "mav1", "mav2"}
    assert script.names == ("mav0", "mav1", "mav2")


async def test_an_order_to_a_disabled_vehicle_alone_fails(client: Any, bus: Any) -> None:
    script = Fleet(client)
    bus.tell("mav1", disabled_by="olga")
    bus.misbehave["mav1"] = "refuse"
    await asyncio.sleep(0.1)
    with pytest.raises(OrderFailed, match="mav1 refused"):
        await script["mav1"].takeoff(1.0)


async def test_a_start_of_paths_is_called_off_once_however_often_it_is_looked_at(
    fleet: FleetConfig, client: Any, bus: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines: list[str] = []
    ground: Any = MissionGround(client, say=lines.append)
    paths = {}
    for name in fleet.enabled_names:
        x, y, _ = fleet.vehicles[name].start_enu_m
        paths[name] = fitted(np.arange(5.0), np.array([[x, y, 1.0, 0.0]] * 5))
        bus.tell(name, state="flying", is_airborne=True, is_armed=True,
                 position_enu_m=(x, y, 1.0), goal_position_enu_m=(x, y, 1.0))  # fmt: skip
    bus.accept_only = {"follow_path"}  # it goes on until it is replaced
    following = asyncio.create_task(
        follow_paths(ground, paths, lights={}, on_lag="land", timeout_s=20.0)
    )
    await client.wait_for(lambda _: any(one.kind == "follow_path" for _, one in bus.orders), 5.0)
    await asyncio.sleep(0.3)

    monkeypatch.setattr(ground.watch, "takeover", lambda: "somebody")
    for name, order in bus.orders:
        bus.tell(name, taken_order_id=order.order_id)
    await asyncio.sleep(1.5)
    following.cancel()
    await asyncio.gather(following, return_exceptions=True)
    assert [line for line in lines if "nobody starts" in line] == [
        "  mav0, mav1, mav2 hold, and nobody starts."
    ]
