"""Vehicles that fly home are waited for as long as their way takes, and named if they fail."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.missions import going_home
from groundstation.missions.api import Fleet
from groundstation.missions.going_home import fly_home
from groundstation.missions.ground import MissionGround
from groundstation.missions.pause_watch import PauseWatch
from groundstation.missions.runner import MissionRun
from groundstation.orders.battery_reserve import Reserve
from groundstation.orders.intents import Intent
from groundstation.orders.result import OrderResult, Results
from onboard.config.fleet import FleetConfig
from tests.groundstation.conftest import FakeBus

PEAK_OF_MEAN = 1.875  # of a quintic
AWAY_M = 100.0


@pytest.fixture
def way_s(fleet: FleetConfig, bus: FakeBus, client: Any) -> float:
    """The time of the way home of mav1, which flies far away [s]."""
    x, y, _ = fleet.vehicles["mav1"].start_enu_m
    bus.tell(
        "mav1",
        state="flying",
        is_airborne=True,
        is_armed=True,
        position_enu_m=(x + AWAY_M, y, 1.0),
    )
    return PEAK_OF_MEAN * AWAY_M / fleet.vehicles["mav1"].max_speed_m_s


async def test_a_vehicle_far_from_home_gets_the_time_of_its_way(
    client: Any, way_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    timeouts_s = []

    async def wait(order: OrderResult, timeout_s: float) -> Results:
        timeouts_s.append(timeout_s)
        return dict(order.results)

    monkeypatch.setattr(OrderResult, "wait", wait)
    await fly_home(client, ("mav1",), say=lambda line: None)
    assert timeouts_s == [pytest.approx(90.0 + way_s, abs=2.0)]


async def test_a_vehicle_that_a_pause_brings_home_gets_the_time_of_its_way(
    client: Any, way_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    ground: Any = MissionGround(client)
    timeouts_s = []

    async def order(intent: Intent, timeout_s: float) -> Results:
        timeouts_s.append(timeout_s)
        return {}

    monkeypatch.setattr(ground, "order", order)
    reserve = Reserve(name="mav1", has_pct=20.0, needs_pct=20.0, left_s=0.0)
    await PauseWatch(ground).bring_home(["mav1"], reserve, 120.0)
    assert timeouts_s == [pytest.approx(120.0 + way_s, abs=2.0)]


async def test_a_spot_on_which_another_vehicle_has_landed_blind_is_no_goal(
    fleet: FleetConfig, bus: FakeBus, client: Any
) -> None:
    x, y, _ = fleet.vehicles["mav0"].start_enu_m
    own_x, own_y, _ = fleet.vehicles["mav1"].start_enu_m
    for name in ("mav0", "mav2"):
        bus.tell(name, state="flying", is_airborne=True, is_armed=True)
    bus.tell("mav1", state="landed", position_enu_m=(x, y, 0.0))
    await asyncio.sleep(0.1)
    bus.tell("mav1", position_enu_m=(math.nan, 0.0, 0.0), is_position_valid=False)
    await asyncio.sleep(0.1)

    planned = client.plan("bring home mav0,mav2")
    assert not planned.refusals
    assert planned.orders["mav0"].position_enu_m[:2] == pytest.approx((own_x, own_y))


async def test_a_spot_on_which_another_vehicle_is_landing_is_no_goal(
    fleet: FleetConfig, bus: FakeBus, client: Any
) -> None:
    x, y, _ = fleet.vehicles["mav0"].start_enu_m
    own_x, own_y, _ = fleet.vehicles["mav1"].start_enu_m
    for name in ("mav0", "mav1", "mav2"):
        bus.tell(name, state="flying", is_airborne=True, is_armed=True)
    bus.tell("mav1", state="landing", position_enu_m=(x, y, 0.5))
    await asyncio.sleep(0.1)

    planned = client.plan("bring home mav0,mav2")
    assert not planned.refusals
    assert planned.orders["mav0"].position_enu_m[:2] == pytest.approx((own_x, own_y))


@pytest.mark.parametrize("verb", ["home", "bring_home"])
@pytest.mark.parametrize("when", ["it lands", "it begins to land", "it has landed"])
async def test_whoever_lands_at_home_has_its_second_order_to_fly_home_done_when_it_is_down(
    bus: FakeBus, client: Any, verb: str, when: str
) -> None:
    flown = Fleet(client)
    await flown.takeoff(1.0)
    bus.accept_only = {"move"}
    first = asyncio.create_task(flown.home())
    assert await client.wait_for(lambda _: len(bus.orders) == 6, 5.0)
    _, way_home = bus.orders[4]
    first.cancel()
    bus.accept_only = set()
    bus.misbehave = {"mav1": "refuse"}
    bus.tell("mav1", state="landing")
    if when != "it begins to land":
        await asyncio.sleep(0.1)
    if when == "it has landed":
        bus.report_end("mav1", way_home, "done", "Done.")
        bus.tell("mav1", state="landed", is_airborne=False, is_armed=False)
        await asyncio.sleep(0.1)

    second = asyncio.create_task(getattr(flown, verb)())
    await asyncio.sleep(0.2)
    assert second.done() == (when == "it has landed")
    bus.report_end("mav1", way_home, "done", "Done.")
    results = await asyncio.wait_for(second, 5.0)
    assert all(result.is_done for result in results.values())
    assert sorted(results) == ["mav0", "mav1", "mav2"]


@pytest.mark.parametrize("is_script", [False, True])
async def test_who_does_not_get_home_is_named_before_it_lands(
    fleet: FleetConfig,
    bus: FakeBus,
    client: Any,
    monkeypatch: pytest.MonkeyPatch,
    is_script: bool,
) -> None:
    monkeypatch.setattr(going_home, "_LATE_S", 0.1)
    monkeypatch.setattr(going_home, "way_home_s", lambda client, planned: 0.1)
    lines: list[str] = []
    bus.accept_only = {"move"}
    if is_script:
        flown = Fleet(client, say=lines.append)
        await flown.takeoff(1.0)
        await flown.leave("home")
    else:
        steps = [{"do": "takeoff", "height_m": 1.0}, {"do": "expect", "all_landed": True}]
        content = {"schema": 1, "step": steps, "on_failure": {"do": "home"}}
        mission = mission_from_mapping(content, path="test.toml", fleet=fleet)
        await MissionRun(mission, client, say=lines.append).run()

    words = "did not get home; unfinished: not finished within 0.2 s"
    not_home = [line for line in lines if words in line]
    assert [line.split()[0] for line in not_home] == list(fleet.enabled_names)
    assert lines.index(not_home[-1]) < lines.index("Landing mav0, mav1, mav2.")
