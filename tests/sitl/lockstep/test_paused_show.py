"""A show that is stopped: paused at any moment, let go on, or brought home from there."""

from __future__ import annotations

import asyncio
import math
import tomllib
from collections.abc import Callable

import numpy as np
import pytest

from groundstation.orders.result import OrderFailed
from groundstation.paths.pieces import fitted
from groundstation.processes.free_ports import toml_text
from groundstation.starter.starter_files import Answers, starter
from onboard.config.fleet import FleetConfig, fleet_from_mapping
from onboard.control.path import Path, point_at
from sitl.lockstep.flight import Lockstep

HEIGHT_M = 1.2
SECONDS = 16.0
PROMISE_M = 0.8


def fleet_of(count: int) -> FleetConfig:
    """A fleet as `covey init` makes it."""
    text = starter(Answers(vehicles=count)).fleet_text
    return fleet_from_mapping(tomllib.loads(text), path="fleet.toml", text=text)


def _with_hover_time(fleet: FleetConfig, hover_time_s: float) -> FleetConfig:
    """Return the fleet with batteries that last so long."""
    values = tomllib.loads(fleet.text)
    for table in values["types"].values():
        table["hover_time_s"] = hover_time_s
    return fleet_from_mapping(values, path="fleet.toml", text=toml_text(values))


def turning_grid(fleet: FleetConfig, degrees: float) -> dict[str, Path]:
    """All turn about the middle of their take-off spots and come back: neighbours stay apart."""
    spots = np.array([fleet.vehicles[name].start_enu_m[:2] for name in fleet.enabled_names])
    middle = spots.mean(0)
    times_s = np.linspace(0.0, SECONDS, 161)
    share = times_s / SECONDS
    turn_rad = math.radians(degrees) * np.sin(math.pi * share) ** 2

    paths = {}
    for name, spot in zip(fleet.enabled_names, spots - middle, strict=True):
        x = middle[0] + spot[0] * np.cos(turn_rad) - spot[1] * np.sin(turn_rad)
        y = middle[1] + spot[0] * np.sin(turn_rad) + spot[1] * np.cos(turn_rad)
        still = np.zeros(len(times_s))
        paths[name] = fitted(times_s, np.column_stack([x, y, still + HEIGHT_M, still]))
    return paths


def is_down(flight: Lockstep, name: str) -> bool:
    """Return whether a vehicle stands on the ground."""
    truth = flight.state.vehicles[name].truth
    return truth is not None and truth.is_on_ground


async def come_to(flight: Lockstep, path_time_s: float) -> None:
    """Wait until all have flown so much of their paths."""

    def has_come(_: object) -> bool:
        views = flight.state.vehicles.values()
        return all(
            view.telemetry is not None
            and view.telemetry.show_id
            and view.telemetry.path_time_s >= path_time_s
            for view in views
        )

    assert await flight.fleet.client.wait_for(has_come, 60.0)


def fly(flight: Lockstep, degrees: float, pause_s: float, *, is_brought_home: bool) -> None:
    """Pause a show so long after its start, then let it go on or bring all home."""
    fleet = flight.fleet
    flight.takeoff(HEIGHT_M)

    async def stop_it() -> None:
        await come_to(flight, pause_s)
        assert all(result.is_done for result in (await fleet.pause()).values())
        await fleet.wait(4.0)

        places = {name: fleet[name].position_enu_m for name in fleet.names}
        await fleet.wait(3.0)
        for name, before in places.items():
            now = fleet[name].position_enu_m
            assert before is not None
            assert now is not None
            assert math.dist(before, now) < 0.2, (name, before, now)

        if is_brought_home:
            await fleet.bring_home()
        else:
            assert all(result.is_done for result in (await fleet.resume()).values())

    async def show() -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(stop_it())
            results = await fleet.follow_path(turning_grid(fleet.config, degrees))
        phase = "superseded" if is_brought_home else "done"
        assert {result.phase for result in results.values()} == {phase}

    flight.wait_for(show())
    if is_brought_home:
        for name in fleet.names:
            assert is_down(flight, name), name
    assert flight.min_separation_m > PROMISE_M


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("is_brought_home", [False, True])
def test_three_vehicles_are_paused_and_go_on_or_come_home(
    lockstep: Callable[..., Lockstep], is_brought_home: bool
) -> None:
    fly(lockstep(fleet_of(3)), 70.0, 5.0, is_brought_home=is_brought_home)


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("pause_s", range(1, int(SECONDS) - 1))
def test_thirty_vehicles_paused_at_every_second_are_brought_home_and_keep_the_promise(
    lockstep: Callable[..., Lockstep], pause_s: int
) -> None:
    fly(lockstep(fleet_of(30)), 15.0, float(pause_s), is_brought_home=True)


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("skip_s", [1, 5, 8, 12])
def test_a_show_that_is_skipped_ends_at_its_last_positions_above_the_promise(
    lockstep: Callable[..., Lockstep], skip_s: int
) -> None:
    flight = lockstep(fleet_of(3))
    fleet = flight.fleet
    flight.takeoff(HEIGHT_M)
    paths = turning_grid(fleet.config, 170.0)

    async def skip() -> None:
        await come_to(flight, skip_s)
        assert all(result.is_done for result in (await fleet.skip()).values())

    async def show() -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(skip())
            results = await fleet.follow_path(paths)
        assert {result.phase for result in results.values()} == {"done"}

    flight.wait_for(show())
    for name, path in paths.items():
        position = fleet[name].position_enu_m
        assert position is not None
        end = point_at(path, path.duration_s).position_enu_m
        assert math.dist(position, end) < 0.3
    assert flight.min_separation_m > PROMISE_M
    assert flight.land()  # the mission goes on


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_a_pause_ends_by_itself_with_all_at_home_when_a_battery_must_leave(
    lockstep: Callable[..., Lockstep],
) -> None:
    flight = lockstep(_with_hover_time(fleet_of(3), 120.0))
    fleet = flight.fleet
    flight.takeoff(HEIGHT_M)

    async def stop_it() -> None:
        await fleet.wait(6.0)
        await fleet.pause()

    async def show() -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(stop_it())
            with pytest.raises(OrderFailed):
                await fleet.follow_path(turning_grid(fleet.config, 70.0))

    flight.wait_for(show())
    for name in fleet.names:
        assert is_down(flight, name), name
    assert flight.min_separation_m > PROMISE_M
