"""Vehicles that follow another one and are paused, while it flies on among them."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from groundstation.missions.group import Group
from onboard.tuples import Xyz
from sitl.faults.catalogue import Fault
from sitl.lockstep.flight import Lockstep
from tests.sitl.lockstep.test_paused_show import HEIGHT_M, PROMISE_M, fleet_of, is_down

pytestmark = [pytest.mark.long, pytest.mark.timeout(1800)]

LEADER = "mav0"
FOLLOW_S = 14.0
STEP_M = 0.8
PAUSED_M = 0.25  # that a paused vehicle may move while it brakes and holds


def position_of(flight: Lockstep, name: str) -> Xyz:
    position = flight.fleet[name].position_enu_m
    assert position is not None
    return position


async def lead(flight: Lockstep) -> None:
    """Fly the leader along the row's side and back to where it was."""
    x, y, z = position_of(flight, LEADER)
    for north_m in (STEP_M, 2.0 * STEP_M, STEP_M, 0.0):
        await flight.fleet.move((x, y + north_m, z), [LEADER], duration_s=2.0)


def flown(flight: Lockstep, stop: Callable[[Group], Coroutine[Any, Any, None]]) -> dict[str, Xyz]:
    """Let all follow the leader, and stop them; return the offsets that they follow at."""
    fleet = flight.fleet
    flight.takeoff(HEIGHT_M)
    begin = position_of(flight, LEADER)
    offsets = {}
    for name in fleet.names[1:]:
        position = position_of(flight, name)
        east_m, north_m, up_m = (one - other for one, other in zip(position, begin, strict=True))
        offsets[name] = (east_m, north_m, up_m)

    async def show() -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(lead(flight))
            tasks.create_task(stop(fleet))
            await fleet.follow(LEADER, FOLLOW_S, offsets=offsets)

    flight.wait_for(show())
    return offsets


@pytest.mark.parametrize("after_s", [0.5, 2.0, 4.0])
@pytest.mark.parametrize("paused_s", [1.0, 5.0])
def test_paused_followers_hold_and_follow_again(
    lockstep: Callable[..., Lockstep], after_s: float, paused_s: float
) -> None:
    flight = lockstep(fleet_of(3))
    moved_m: list[float] = []

    async def stop(fleet: Group) -> None:
        await fleet.wait(after_s)
        await fleet.pause()
        await fleet.wait(2.0)  # to brake
        before = {name: position_of(flight, name) for name in fleet.names[1:]}
        await fleet.wait(paused_s)
        moved_m.extend(math.dist(before[name], position_of(flight, name)) for name in before)
        await fleet.resume()

    offsets = flown(flight, stop)

    assert max(moved_m) < PAUSED_M
    assert flight.min_separation_m > PROMISE_M
    leader = position_of(flight, LEADER)
    for name, offset in offsets.items():
        goal = tuple(one + other for one, other in zip(leader, offset, strict=True))
        assert math.dist(position_of(flight, name), goal) < 0.3


@pytest.mark.parametrize("after_s", [0.0, 1.0])
def test_followers_that_are_paused_and_landed_stay_down(
    lockstep: Callable[..., Lockstep], after_s: float
) -> None:
    flight = lockstep(fleet_of(3))

    async def stop(fleet: Group) -> None:
        await fleet.wait(2.0)
        await fleet.pause()
        await fleet.wait(after_s)
        await fleet.land(fleet.names[1:])

    flown(flight, stop)

    assert flight.min_separation_m > PROMISE_M
    assert [is_down(flight, name) for name in flight.fleet.names] == [False, True, True]


@pytest.mark.parametrize("after_s", [0.0, 0.5, 2.0])
def test_poses_of_all_that_fail_while_followers_are_paused_bring_all_down_apart(
    lockstep: Callable[..., Lockstep], after_s: float
) -> None:
    flight = lockstep(fleet_of(3))

    async def stop(fleet: Group) -> None:
        await fleet.wait(2.0)
        await fleet.pause()
        await fleet.wait(after_s)
        for name in fleet.names:
            flight.inject(Fault("mocap_lost", name, flight.time_s, 0.0))

    with pytest.raises(ExceptionGroup):
        flown(flight, stop)
    flight.wait_for(flight.fleet.wait(8.0))

    assert flight.min_separation_m > PROMISE_M
    assert all(is_down(flight, name) for name in flight.fleet.names)
