"""A pause of paths: how long it may last, and that all are brought home before it is too late."""

from __future__ import annotations

import asyncio
import functools
import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from groundstation.missions.api import Fleet
from groundstation.missions.ground import MissionGround
from groundstation.missions.path_following import follow_paths
from groundstation.missions.pause_watch import PauseWatch
from groundstation.orders import battery_reserve
from groundstation.orders.battery_reserve import Discharge, Reserve, weakest
from groundstation.orders.grammar import parse
from groundstation.orders.plan import plan_order
from groundstation.orders.result import OrderFailed
from groundstation.paths.pieces import fitted
from onboard.config.fleet import FleetConfig
from tests.groundstation.conftest import FakeBus

SHOW = {"state": "flying", "is_airborne": True, "is_armed": True, "show_id": "s"}


@pytest.fixture
def flying(fleet: FleetConfig, bus: FakeBus, client: Any) -> Any:
    """A client of vehicles that follow paths 3 m north of their take-off spots."""
    for name in fleet.enabled_names:
        x, y, _ = fleet.vehicles[name].start_enu_m
        spot = (x, y + 3.0, 1.5)
        bus.tell(name, position_enu_m=spot, goal_position_enu_m=(0.0, 0.0, 1.5), **SHOW)
    return client


async def test_the_weakest_needs_more_the_farther_it_is_and_the_shorter_its_battery_lasts(
    fleet: FleetConfig, bus: FakeBus, flying: Any
) -> None:
    bus.tell("mav1", battery_frac=0.35)
    await asyncio.sleep(0.1)
    reserve = weakest(fleet, flying.state, fleet.enabled_names, Discharge(), 0)
    assert reserve is not None
    assert reserve.name == "mav1"
    assert not reserve.is_used_up or reserve.needs_pct >= 35.0
    assert "the weakest battery is mav1's with 35 %" in str(reserve)
    hover_s = 300.0  # of a battery about which the file says nothing
    expected_s = max(0.0, 0.01 * (35.0 - reserve.needs_pct) * hover_s)
    assert reserve.left_s == pytest.approx(expected_s)

    vehicles = {
        name: replace(vehicle, hover_time_s=3000.0) for name, vehicle in fleet.vehicles.items()
    }
    lasting = weakest(
        replace(fleet, vehicles=vehicles), flying.state, fleet.enabled_names, Discharge(), 0
    )
    assert lasting is not None
    assert lasting.needs_pct < reserve.needs_pct
    bus.tell("mav1", position_enu_m=(30.0, 0.0, 1.5))
    await asyncio.sleep(0.1)
    farther = weakest(fleet, flying.state, fleet.enabled_names, Discharge(), 0)
    assert farther is not None
    assert farther.needs_pct > reserve.needs_pct
    assert weakest(fleet, flying.state, (), Discharge(), 0) is None

    # who does not know where it is was last seen 30 m away, and not at the origin
    bus.tell("mav1", position_enu_m=(math.nan, 0.0, 0.0), is_position_valid=False)
    await asyncio.sleep(0.1)
    lost = weakest(fleet, flying.state, fleet.enabled_names, Discharge(), 0)
    assert lost is not None
    assert (lost.name, lost.needs_pct) == ("mav1", pytest.approx(farther.needs_pct, abs=0.5))


async def test_all_are_brought_home_from_where_they_are_and_not_from_the_ends_of_their_paths(
    fleet: FleetConfig, flying: Any
) -> None:
    await asyncio.sleep(0.1)
    planned = flying.plan(parse("bring home", fleet))
    assert not planned.refusals
    for name, order in planned.orders.items():
        x, y, _ = fleet.vehicles[name].start_enu_m
        assert order.position_enu_m == pytest.approx((x, y, 1.5))
        assert order.then_land


async def test_an_order_after_skip_is_not_for_those_that_have_skipped(
    bus: FakeBus, flying: Any
) -> None:
    script = Fleet(flying)
    report = functools.partial(bus.tell, "mav1", show_id="")
    asyncio.get_running_loop().call_later(0.3, report)  # later than the result of its order
    skipped = await script.skip("mav1")
    assert skipped["mav1"].is_done
    resumed = await script.resume()
    assert set(resumed) == {"mav0", "mav2"}


@pytest.mark.parametrize("line", ["home", "bring home"])
async def test_one_that_stands_without_a_position_keeps_nobody_from_going_home(
    flying: Any, bus: Any, fleet: FleetConfig, line: str
) -> None:
    bus.tell("mav1", state="landed", is_airborne=False, is_position_valid=False)
    await asyncio.sleep(0.1)
    planned = flying.plan(parse(line, fleet))
    assert not planned.refusals
    assert sorted(planned.orders) == ["mav0", "mav2"]

    bus.tell("mav2", is_position_valid=False)  # in the air
    await asyncio.sleep(0.1)
    assert "mav2" in flying.plan(parse(line, fleet)).refusals


def test_without_a_state_bring_home_is_judged_by_the_fleet_file(fleet: FleetConfig) -> None:
    planned = plan_order(
        parse("bring home all 1.2", fleet),
        fleet,
        None,
        held=_no_formation(),
        author="x",
        now_ns=0,
    )
    assert not planned.refusals


def _no_formation() -> Any:
    from groundstation.orders.held_formation import HeldFormation

    return HeldFormation(None)


async def test_a_pause_ends_with_all_brought_home_when_the_weakest_must_leave(
    fleet: FleetConfig, bus: FakeBus, client: Any
) -> None:
    lines: list[str] = []
    ground: Any = MissionGround(client, say=lines.append)
    paths = {}
    for name in fleet.enabled_names:
        x, y, _ = fleet.vehicles[name].start_enu_m
        still = np.array([[x, y, 1.0, 0.0]] * 5)
        paths[name] = fitted(np.arange(5.0), still)
        bus.tell(name, position_enu_m=(x, y, 1.0), goal_position_enu_m=(x, y, 1.0), **SHOW)
    bus.accept_only = {"follow_path"}  # it goes on until it is replaced

    live_lines: list[str] = []

    async def pause() -> None:
        await asyncio.sleep(0.8)
        for name in fleet.enabled_names:
            bus.tell(name, is_path_paused=True)
        await asyncio.sleep(0.7)
        live_lines.append(ground.live_line)
        for name in fleet.enabled_names:
            bus.tell(name, battery_frac=0.24)

    task = asyncio.create_task(pause())
    with pytest.raises(OrderFailed):
        await follow_paths(ground, paths, lights={}, on_lag="land", timeout_s=20.0)
    await task
    assert live_lines[0].startswith("paused · mav0 90 %: all home at ")
    assert ground.live_line == ""
    assert any("The pause ends: the weakest battery is" in line for line in lines)
    homes = [order for _, order in bus.orders if order.then_land]
    assert len(homes) == len(fleet.enabled_names)


def test_a_battery_that_sinks_faster_than_its_file_says_has_to_leave_earlier() -> None:
    discharge = Discharge()
    assert discharge.rate_1_s("mav0", 0, 0.9) == 0.0
    assert discharge.rate_1_s("mav0", 2_000_000_000, 0.5) == 0.0  # too soon to believe
    assert discharge.rate_1_s("mav0", 10_000_000_000, 0.7) == pytest.approx(0.02)
    assert discharge.rate_1_s("mav1", 10_000_000_000, 0.7) == 0.0


async def test_a_pause_counts_on_by_the_clock_while_the_reported_charge_stands_still(
    fleet: FleetConfig, bus: FakeBus, flying: Any
) -> None:
    for name in fleet.enabled_names:
        bus.tell(name, battery_frac=0.5)  # where PX4's simulated battery stops
    await asyncio.sleep(0.1)
    discharge = Discharge()

    def at(time_s: int, paused_s: float) -> Reserve:
        reserve = weakest(
            fleet,
            flying.state,
            fleet.enabled_names,
            discharge,
            time_s * 1_000_000_000,
            paused_s=paused_s,
        )
        assert reserve is not None
        return reserve

    before = at(0, 0.0)
    assert at(1000, 0.0) == before  # only a pause has to end
    assert at(1030, 30.0) == before

    counted = at(1060, 60.0)
    assert counted.has_pct == pytest.approx(40.0)  # 30 s of the 300 s of a full battery
    assert "with 40 % by the clock, because its report stands at 50 %" in str(counted)
    assert at(1200, 200.0).is_used_up

    assert discharge.stands_s("mav0", 1_200_000_000_000, 0.49) == 0.0  # it is reported again


async def test_a_pause_is_counted_from_its_own_begin(
    fleet: FleetConfig, flying: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(battery_reserve, "_STANDS_S", 0.0)
    ground: Any = MissionGround(flying)
    watch = PauseWatch(ground)

    async def stands_after(wait_s: float) -> bool:
        watch.weakest_battery(fleet.enabled_names)
        await asyncio.sleep(wait_s)
        reserve = watch.weakest_battery(fleet.enabled_names)
        assert reserve is not None
        return reserve.stands_at_pct is not None

    assert not await stands_after(0.1)
    watch.show(None)
    assert await stands_after(0.1)
    watch.hide()
    assert not await stands_after(0.1)
