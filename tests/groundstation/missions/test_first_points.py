"""Paths begin together, once all vehicles are at the first points."""

from __future__ import annotations

import asyncio
import functools
from typing import Any

import numpy as np
import pytest

from groundstation.missions.ground import MissionGround
from groundstation.missions.path_following import follow_paths
from groundstation.orders.intents import FollowPath, Intent
from groundstation.orders.result import OrderFailed, Results, VehicleResult
from groundstation.paths.pieces import fitted
from onboard.config.fleet import FleetConfig
from tests.groundstation.conftest import FakeBus

FLYING = {"state": "flying", "is_airborne": True, "is_armed": True}


def begin_above_the_starts(fleet: FleetConfig, bus: FakeBus) -> dict[str, Any]:
    """Return paths that stand 1 m above the starts, where all vehicles are."""
    paths = {}
    for name in fleet.enabled_names:
        x, y, _ = fleet.vehicles[name].start_enu_m
        paths[name] = fitted(np.arange(5.0), np.array([[x, y, 1.0, 0.0]] * 5))
        spot = (x, y, 1.0)
        bus.tell(name, position_enu_m=spot, goal_position_enu_m=spot, **FLYING)
    return paths


async def test_who_went_aside_for_others_that_came_later_is_waited_for(
    fleet: FleetConfig, bus: FakeBus, client: Any
) -> None:
    lines: list[str] = []
    loop = asyncio.get_running_loop()

    def say(line: str) -> None:
        lines.append(line)
        if line.startswith("goto"):  # mav1 has arrived after 0.2 s, and mav2 has not
            go_aside = functools.partial(bus.tell, "mav1", position_enu_m=(x + 1.0, y, 1.0))
            loop.call_later(0.2, go_aside)

    ground: Any = MissionGround(client, say=say)
    paths = begin_above_the_starts(fleet, bus)
    x, y, _ = fleet.vehicles["mav1"].start_enu_m
    bus.misbehave["mav2"] = "late"

    def starts() -> list[str]:
        return [name for name, order in bus.orders if order.kind == "follow_path"]

    flight = asyncio.create_task(
        follow_paths(ground, paths, lights={}, on_lag="land", timeout_s=5.0)
    )
    await asyncio.sleep(1.5)
    assert lines[-1] == "  waits until mav1 is back at the first point of its path"
    assert starts() == []

    bus.tell("mav1", position_enu_m=(x, y, 1.0))
    await asyncio.wait_for(flight, 10.0)
    assert sorted(starts()) == sorted(fleet.enabled_names)


async def test_vehicles_far_from_the_first_points_of_their_paths_get_the_time_to_fly_there(
    fleet: FleetConfig, bus: FakeBus, client: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = begin_above_the_starts(fleet, bus)
    x, y, _ = fleet.vehicles["mav1"].start_enu_m
    bus.tell("mav1", position_enu_m=(x + 100.0, y, 1.0))
    ground: Any = MissionGround(client)
    timeouts_s = []

    async def order(intent: Intent, timeout_s: float, *, may_be_left_out: bool) -> Results:
        timeouts_s.append(timeout_s)
        raise OrderFailed(intent, {})

    monkeypatch.setattr(ground, "order", order)
    with pytest.raises(OrderFailed):
        await follow_paths(ground, paths, lights={}, on_lag="land", timeout_s=5.0)
    mean_m_s = fleet.vehicles["mav1"].max_speed_m_s / 1.875
    assert timeouts_s == [pytest.approx(60.0 + 100.0 / mean_m_s, abs=2.0)]


def test_a_start_that_one_refuses_names_nobody_else() -> None:
    results = {
        "mav0": VehicleResult("mav0", "1", "accepted", ""),
        "mav1": VehicleResult("mav1", "2", "refused", "Because I say so."),
        "mav2": VehicleResult("mav2", "3", "done", ""),
    }
    error = OrderFailed(FollowPath(vehicles=tuple(results)), results)
    assert str(error) == "'follow_path mav0,mav1,mav2' failed. mav1 refused: Because I say so."
