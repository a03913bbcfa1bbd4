"""Forecasts: near misses are foreseen, standing vehicles are part of them, and the process is
replaceable.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import numpy as np
import psutil
import pytest

from groundstation.orders.forecast import Leg, forecast, objections
from groundstation.orders.forecast_process import Forecaster, ForecastFailed
from groundstation.orders.intents import Move, Takeoff
from onboard.config.fences import Fence, FenceCircle
from onboard.config.fleet import FleetConfig
from onboard.config.obstacles import Obstacle

MOVE = Move(vehicles=("mav0", "mav1"), position_enu_m=(0.0, 0.0, 1.0))
SWAP = {
    "mav0": Leg((-1.2, 0.0, 1.0), (1.2, 0.0, 1.0)),
    "mav1": Leg((1.2, 0.0, 1.0), (-1.2, 0.0, 1.0)),
}


def without_law(fleet: FleetConfig) -> FleetConfig:
    law = msgspec.convert({**msgspec.to_builtins(fleet.law), "name": "off"}, type(fleet.law))
    return msgspec.structs.replace(fleet, law=law)


def test_a_swap_is_safe_under_the_law_and_refused_without_it(fleet: FleetConfig) -> None:
    fine = forecast(fleet, SWAP)
    assert fine.closest_m >= fleet.fleet.safety_distance_m
    assert objections(fine, MOVE, fleet) == ()
    assert fine.now_m == pytest.approx(2.4)
    assert set(fine.paths_enu_m) == {"mav0", "mav1"}
    crash = forecast(without_law(fleet), SWAP)
    assert crash.closest_m < 0.4
    (reason,) = objections(crash, MOVE, fleet)
    assert "mav0 and mav1 would come within" in reason


def wall(name: str, west: float, south: float, east: float, north: float) -> Obstacle:
    corners = ((west, south), (east, south), (east, north), (west, north))
    return Obstacle(name, polygon_enu_m=corners)


def test_who_would_not_arrive_and_who_would_be_in_the_way_is_said(fleet: FleetConfig) -> None:
    dead_end = (
        wall("south", -3.9, -0.8, 0.0, -0.7),
        wall("north", -3.9, 0.7, 0.0, 0.8),
        wall("west", -3.9, -0.7, -3.8, 0.7),
    )
    fleet = msgspec.structs.replace(fleet, obstacles=dead_end)
    deep = Leg((2.5, 0.0, 1.0), (-2.8, 0.0, 1.0))
    near = Leg((1.2, 0.0, 1.0), (-1.2, 0.0, 1.0))

    held_up = forecast(fleet, {"mav0": near, "mav1": deep}, seeds=(0,))
    assert held_up.held_up == {"mav1": "mav0"}
    (reason,) = objections(held_up, MOVE, fleet)
    assert "mav1 would not arrive within 0.15 m in time: mav0 would be in the way" in reason
    assert "Send mav1 first" in reason

    standing = Leg((-1.2, 0.0, 1.0), (-1.2, 0.0, 1.0), is_by_this_order=False)
    behind = forecast(fleet, {"mav0": standing, "mav1": deep}, seeds=(0,))
    only_mav1 = msgspec.structs.replace(MOVE, vehicles=("mav1",))
    assert "Move mav0 away first" in objections(behind, only_mav1, fleet)[0]

    alone = forecast(fleet, {"mav1": deep}, seeds=(0,))
    assert alone.held_up == {}
    assert objections(alone, only_mav1, fleet) == ()


def test_the_same_question_has_the_same_answer(fleet: FleetConfig) -> None:
    assert forecast(fleet, SWAP) == forecast(fleet, SWAP)


def test_the_worst_of_several_flights_is_forecast_as_if_it_were_flown_alone(
    fleet: FleetConfig,
) -> None:
    seeds = (0, 1)
    worst = forecast(fleet, SWAP, seeds=seeds)
    alone = [forecast(fleet, SWAP, seeds=(seed,)) for seed in seeds]

    nearest = min(alone, key=lambda flown: flown.closest_m)
    assert worst.closest_m == pytest.approx(nearest.closest_m, abs=1e-9)
    for name, path in nearest.paths_enu_m.items():
        np.testing.assert_allclose(worst.paths_enu_m[name], path, atol=1e-9)


def test_a_vehicle_on_the_ground_stays_there_and_is_flown_around(fleet: FleetConfig) -> None:
    flying = Leg((-1.5, 0.0, 1.0), (1.5, 0.1, 1.0))
    parked = Leg((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), is_by_this_order=False, is_parked=True)
    legs = {"mav0": flying, "mav2": parked}

    predicted = forecast(fleet, legs)
    assert set(predicted.paths_enu_m["mav2"]) == {(0.0, 0.0, 0.0)}
    assert predicted.closest_m >= fleet.fleet.safety_distance_m - 0.05
    assert predicted.duration_s < 30.0
    assert forecast(without_law(fleet), legs).closest_m < 0.2


def test_a_take_off_takes_longer_than_its_climb_and_an_arming_has_no_paths(
    fleet: FleetConfig,
) -> None:
    legs = {"mav0": Leg((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))}
    alone = forecast(fleet, legs, is_takeoff=True)
    assert alone.duration_s > 3.0 + 1.0
    assert alone.closest_m == float("inf")
    assert objections(alone, Takeoff(vehicles=("mav0",), height_m=1.0), fleet) == ()
    assert (
        forecast(
            fleet, {"mav0": Leg((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), is_by_this_order=False)}
        ).paths_enu_m
        == {}
    )


@pytest.mark.long
async def test_another_process_computes_and_is_replaced_when_it_ends(fleet: FleetConfig) -> None:
    forecaster = Forecaster()
    turns = 0

    async def count() -> None:
        nonlocal turns
        while True:
            await asyncio.sleep(0.005)
            turns += 1

    counting = asyncio.create_task(count())
    try:
        await forecaster.ready()
        one = await forecaster.forecast(fleet, SWAP)
        assert turns > 5, "the loop was not free while the child computed"
        assert one == forecast(fleet, SWAP)
        first = forecaster.pid
        assert first not in (None, os.getpid())
        request = asyncio.create_task(forecaster.forecast(fleet, SWAP))
        await asyncio.sleep(0.01)
        os.kill(first, signal.SIGKILL)
        with pytest.raises(ForecastFailed, match="could not be computed"):
            await request
        await forecaster.ready()  # else the request would be cancelled before it is sent
        request = asyncio.create_task(forecaster.forecast(fleet, SWAP))
        await asyncio.sleep(0.05)
        cancelled = forecaster.pid
        request.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await request
        await forecaster.ready()
        assert (await forecaster.forecast(fleet, SWAP)).closest_m == one.closest_m
        assert forecaster.pid != cancelled
    finally:
        counting.cancel()
        await forecaster.stop()
    assert forecaster.pid is None


@pytest.mark.realtime
async def test_the_first_forecast_on_a_machine_does_not_wait_for_the_compiler(
    fleet: FleetConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    forecaster = Forecaster()
    ready = asyncio.create_task(forecaster.ready())
    try:
        first = await forecaster.forecast(fleet, SWAP)
        assert not ready.done(), "the compiler was faster than the interpreter"
        assert first.flight_count == 1
        assert first == forecast(fleet, SWAP, seeds=(0,))
    finally:
        ready.cancel()
        await forecaster.stop()


_PARENT = """
import asyncio
from groundstation.orders.forecast_process import Forecaster

async def main():
    forecaster = Forecaster()
    await forecaster.start()
    print(forecaster.pid, flush=True)
    await asyncio.sleep(600)

asyncio.run(main())
"""


def test_the_process_ends_when_its_parent_is_killed() -> None:
    environment = {**os.environ, "COVEY_NUMBA": "0"}  # nothing to warm up
    with subprocess.Popen(
        [sys.executable, "-c", _PARENT], stdout=subprocess.PIPE, text=True, env=environment
    ) as parent:
        assert parent.stdout is not None
        child = psutil.Process(int(parent.stdout.readline()))
        parent.kill()
    end_s = time.monotonic() + 60.0
    while child.is_running() and child.status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < end_s, "the child lives on"
        time.sleep(0.05)


def test_a_forecast_flies_around_a_tree_and_names_who_is_in_it(fleet: FleetConfig) -> None:
    tree = Fence(name="tree", keep="out", circle=FenceCircle(0.3, (0.0, 0.0)))
    fenced = msgspec.structs.replace(fleet, fences=(tree,))
    straight = {"mav0": Leg((-1.5, 0.0, 1.0), (1.5, 0.0, 1.0))}
    around = forecast(fenced, straight)
    assert around.outside == ()
    widest_m = max(abs(y) for _, y, _ in around.paths_enu_m["mav0"])
    assert widest_m > 0.3
    assert around.duration_s < 20.0
    within = {"mav0": Leg((0.0, 0.1, 1.0), (1.5, 0.0, 1.0))}
    assert forecast(fenced, within).outside == ("mav0",)
