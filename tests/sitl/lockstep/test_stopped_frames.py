"""Moving frames that are stopped as shows are, and poses that fail while a show is stopped.

A formation that flies, turns and stretches is flown as paths from one instant on: a pause, the end
of it, skipping the rest and bringing all home are the same orders.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable

import pytest

from groundstation.formations.frame import FormationStart, FramePoint, frame_paths
from groundstation.missions.group import Group
from groundstation.orders.result import OrderFailed
from onboard.control.path import Path, point_at
from sitl.faults.catalogue import Fault
from sitl.lockstep.flight import Lockstep
from tests.sitl.lockstep.test_paused_show import (
    HEIGHT_M,
    PROMISE_M,
    come_to,
    fleet_of,
    is_down,
)

Order = Callable[[Group], Awaitable[object]]


def frame_of(flight: Lockstep) -> dict[str, Path]:
    """A ring that flies 1.5 m north, turns a quarter and becomes wider on its way."""
    start = FormationStart(name="ring", position_enu_m=(0.0, 0.0, HEIGHT_M))
    points = [
        FramePoint(position_enu_m=(0.0, 0.8, HEIGHT_M), turn_deg=45.0),
        FramePoint(position_enu_m=(0.0, 1.5, HEIGHT_M), turn_deg=45.0, spacing_m=2.0),
    ]
    return frame_paths(flight.config, start, points)


def stopped_at(
    flight: Lockstep, time_s: float, orders: list[Order], *, ends: set[str]
) -> dict[str, Path]:
    """Fly the frame; at a time of it give the orders, one after the other."""
    fleet = flight.fleet
    flight.takeoff(HEIGHT_M)
    paths = frame_of(flight)

    async def stop_it() -> None:
        await come_to(flight, time_s)
        for order in orders:
            await order(fleet)

    async def show() -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(stop_it())
            results = await fleet.follow_path(paths)
        assert {result.phase for result in results.values()} == ends

    flight.wait_for(show())
    assert flight.min_separation_m > PROMISE_M
    return paths


async def wait(fleet: Group) -> None:
    """Let a pause last."""
    await fleet.wait(5.0)


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("time_s", [1.0, 3.0])
def test_a_moving_frame_is_paused_and_goes_on_to_its_end(
    lockstep: Callable[..., Lockstep], time_s: float
) -> None:
    flight = lockstep(fleet_of(3))
    spots: list[dict[str, tuple[float, float, float]]] = []

    async def look(fleet: Group) -> None:
        await fleet.wait(3.0)
        found = {name: flight.fleet[name].position_enu_m for name in fleet.names}
        assert all(found.values())
        spots.append({name: spot for name, spot in found.items() if spot is not None})

    paths = stopped_at(flight, time_s, [Group.pause, look, look, Group.resume], ends={"done"})
    before, after = spots
    for name, path in paths.items():
        assert math.dist(before[name], after[name]) < 0.2
        end = point_at(path, path.duration_s).position_enu_m
        position = flight.fleet[name].position_enu_m
        assert position is not None
        assert math.dist(position, end) < 0.3


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_a_moving_frame_is_skipped_from_a_pause_to_its_end(
    lockstep: Callable[..., Lockstep],
) -> None:
    flight = lockstep(fleet_of(3))
    paths = stopped_at(flight, 2.0, [Group.pause, wait, Group.skip], ends={"done"})
    for name, path in paths.items():
        end = point_at(path, path.duration_s).position_enu_m
        position = flight.fleet[name].position_enu_m
        assert position is not None
        assert math.dist(position, end) < 0.3


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_a_moving_frame_is_brought_home(lockstep: Callable[..., Lockstep]) -> None:
    flight = lockstep(fleet_of(3))
    stopped_at(flight, 2.0, [Group.pause, wait, Group.bring_home], ends={"superseded"})
    assert all(is_down(flight, name) for name in flight.fleet.names)


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("after_s", [0.0, 0.3, 1.0, 2.5])
@pytest.mark.parametrize("order", ["pause", "skip", "bring_home"])
@pytest.mark.parametrize("back_s", [0.0, 1.5])
def test_poses_of_all_that_fail_while_a_show_is_stopped_bring_all_down_apart(
    lockstep: Callable[..., Lockstep], order: str, after_s: float, back_s: float
) -> None:
    """Lost for good, or for longer than a vehicle goes on without; both in each phase of it."""
    flight = lockstep(fleet_of(3))
    fleet = flight.fleet
    flight.takeoff(HEIGHT_M)
    paths = frame_of(flight)

    async def stop_it() -> None:
        await come_to(flight, 2.0)
        stopping = asyncio.create_task(getattr(fleet, order)())
        await fleet.wait(0.1 + after_s)
        for name in fleet.names:
            flight.inject(Fault("mocap_lost", name, flight.time_s, back_s))
        await asyncio.gather(stopping, return_exceptions=True)

    async def show() -> None:
        stopping = asyncio.create_task(stop_it())
        with contextlib.suppress(OrderFailed):  # done where skipping was quicker than the fault
            await fleet.follow_path(paths)
        await stopping

    flight.wait_for(show())

    def is_at_rest(_: object) -> bool:
        px4s = flight.simulation.emulator.autopilots
        return not any(px4.is_armed for px4 in px4s)

    assert flight.until(is_at_rest, 40.0)
    for name in fleet.names:
        assert is_down(flight, name), name
    assert flight.min_separation_m > PROMISE_M
