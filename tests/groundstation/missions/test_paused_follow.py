"""Vehicles that follow another one are paused and go on; their time stands still meanwhile."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest

from groundstation.missions.api import Fleet
from groundstation.orders.result import OrderFailed

FOLLOW_S = 0.6


@pytest.fixture
async def flying(client: Any, bus: Any) -> Any:
    """A fleet in the air."""
    fleet = Fleet(client)
    await fleet.ready(5.0)
    await fleet.takeoff(1.0)
    return fleet


def kinds_of(bus: Any, name: str) -> list[str]:
    return [order.kind for vehicle, order in bus.orders if vehicle == name]


async def test_a_pause_holds_the_followers_and_resume_lets_them_follow_for_the_rest(
    flying: Any, bus: Any
) -> None:
    begin_s = time.monotonic()
    follow = asyncio.create_task(flying.follow("mav0", FOLLOW_S, offsets={"mav1": (0.0, 2.0, 0.0)}))
    await asyncio.sleep(0.1)
    results = await flying.pause()
    assert {name: result.phase for name, result in results.items()} == {"mav1": "done"}
    assert kinds_of(bus, "mav1")[-1] == "pause"
    assert kinds_of(bus, "mav0")[-1] == "takeoff"  # who is followed has nothing to pause

    # the leader flies on, and nobody follows
    x, y, z = bus.vehicles["mav0"].position_enu_m
    bus.tell("mav0", position_enu_m=(x, y + 0.5, z))
    await asyncio.sleep(1.2)
    assert kinds_of(bus, "mav1")[-1] == "pause"
    assert flying.ground.pause_line.startswith("paused")

    resumed = await flying.resume("mav1")
    assert resumed["mav1"].is_done
    await asyncio.wait_for(follow, 5.0)
    assert time.monotonic() - begin_s > 1.3 + FOLLOW_S - 0.1
    assert kinds_of(bus, "mav1")[-2:] == ["move", "hold"]
    assert flying.ground.pause_line == ""


async def test_a_pause_of_followers_ends_at_home_while_the_weakest_battery_still_can(
    flying: Any, bus: Any
) -> None:
    follow = asyncio.create_task(flying.follow("mav0", 60.0, offsets={"mav1": (0.0, 2.0, 0.0)}))
    await asyncio.sleep(0.1)
    bus.tell("mav1", battery_frac=0.21)
    await flying.pause("mav1")
    with pytest.raises(OrderFailed):
        await asyncio.wait_for(follow, 5.0)
    home = bus.orders[-1][1]
    assert home.kind == "move"
    assert home.then_land


@pytest.mark.parametrize(
    "cannot",
    [
        {"state": "landed", "is_airborne": False, "is_position_valid": False},
        {"is_position_valid": False},
        {"is_flown_by_hand": True, "mode": "POSCTL"},
    ],
)
async def test_the_leaders_battery_ends_a_pause_and_all_that_can_fly_home_do(
    flying: Any, bus: Any, cannot: dict[str, Any]
) -> None:
    offsets = {"mav1": (0.0, 2.0, 0.0), "mav2": (0.0, 4.0, 0.0)}
    follow = asyncio.create_task(flying.follow("mav0", 60.0, offsets=offsets))
    await asyncio.sleep(0.1)
    await flying.pause()
    bus.tell("mav2", **cannot)
    bus.tell("mav0", battery_frac=0.21)
    with pytest.raises(OrderFailed) as failed:
        await asyncio.wait_for(follow, 5.0)
    assert sorted(failed.value.results) == ["mav0", "mav1"]
    assert kinds_of(bus, "mav0")[-1] == kinds_of(bus, "mav1")[-1] == "move"
    assert kinds_of(bus, "mav2")[-1] != "move"


async def test_a_pause_by_another_ground_stops_the_followers_and_the_next_leg_of_their_leader(
    flying: Any, bus: Any
) -> None:
    follow = asyncio.create_task(flying.follow("mav0", FOLLOW_S, offsets={"mav1": (0.0, 2.0, 0.0)}))
    await asyncio.sleep(0.1)
    bus.tell("mav1", state="holding", is_path_paused=True)

    x, y, z = bus.vehicles["mav0"].position_enu_m
    leg = asyncio.create_task(flying["mav0"].go_to((x, y - 0.5, z)))
    await asyncio.sleep(0.5)
    assert flying.ground.pause_line.startswith("paused")
    assert kinds_of(bus, "mav0")[-1] == "takeoff"

    bus.tell("mav1", state="flying", is_path_paused=False)
    await asyncio.wait_for(asyncio.gather(leg, follow), 5.0)
    assert kinds_of(bus, "mav0")[-1] == "move"


async def test_the_mission_goes_on_when_all_followers_skip_the_rest(flying: Any, bus: Any) -> None:
    follow = asyncio.create_task(flying.follow("mav0", 60.0, offsets={"mav1": (0.0, 2.0, 0.0)}))
    await asyncio.sleep(0.6)
    skipped = await flying.skip()
    assert list(skipped) == ["mav1"]
    await asyncio.wait_for(follow, 5.0)
    assert kinds_of(bus, "mav1")[-2:] == ["skip", "hold"]


async def test_who_is_landed_by_the_same_script_follows_no_longer(flying: Any, bus: Any) -> None:
    offsets = {"mav1": (0.0, 2.0, 0.0), "mav2": (0.0, -2.0, 0.0)}
    follow = asyncio.create_task(flying.follow("mav0", 2.0, offsets=offsets))
    await asyncio.sleep(0.1)
    landed = await flying.land(["mav1"])
    assert landed["mav1"].is_done
    (order,) = (order for name, order in bus.orders if name == "mav1" and order.kind == "land")
    bus.tell("mav1", order_kind="land", order_id=order.order_id)

    results = await asyncio.wait_for(follow, 8.0)
    assert set(results) == {"mav2"}
    assert kinds_of(bus, "mav1")[-1] == "land"
    assert kinds_of(bus, "mav2")[-1] == "hold"
