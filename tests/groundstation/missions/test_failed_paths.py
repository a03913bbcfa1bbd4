"""Paths that are not followed to the end: the step fails, or the mission goes on without some."""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Sequence
from typing import Any

import pytest

from groundstation.missions import path_following
from groundstation.missions.ground import MissionGround
from groundstation.missions.path_following import follow_paths
from groundstation.missions.taken import FleetTaken
from groundstation.orders.intents import Land
from groundstation.orders.result import OrderFailed, Results
from onboard.config.fleet import FleetConfig
from tests.groundstation.conftest import FakeBus
from tests.groundstation.missions.test_first_points import begin_above_the_starts

ALL = ("mav0", "mav1", "mav2")


class Flight:
    """Vehicles that all start along their paths; some of them arrive, and some leave."""

    def __init__(self, fleet: FleetConfig, bus: FakeBus, client: Any) -> None:
        self.lines: list[str] = []
        self.ground = MissionGround(client, say=self._say)
        self._bus = bus
        self._paths = begin_above_the_starts(fleet, bus)
        self._arrived: Collection[str] = ()
        self._failed: Collection[str] = ()
        self._has_begun = asyncio.Event()
        bus.accept_only = {"follow_path"}

    async def follow(
        self,
        names: Sequence[str] = ALL,
        *,
        arrived: Collection[str] = (),
        failed: Collection[str] = (),
        timeout_s: float = 0.25,
    ) -> Results:
        self._arrived = arrived
        self._failed = failed
        paths = {name: self._paths[name] for name in names}
        return await follow_paths(self.ground, paths, lights={}, on_lag="land", timeout_s=timeout_s)

    async def supersede(self, names: Sequence[str] = ALL) -> None:
        """Once all follow their paths, let the vehicles report that an order has replaced these."""
        await self._has_begun.wait()
        for name, order in self._bus.orders:
            if order.kind == "follow_path" and name in names:
                self._bus.report_end(name, order, "superseded", "Ended by order land.")

    async def land(self, names: Sequence[str]) -> None:
        """Once all follow their paths, let the mission land some, as another task of it does."""
        await self.supersede(())
        self.ground.client.submit_now(Land(vehicles=tuple(names)), is_by_mission=True)
        await self.supersede(names)

    @property
    def path_steps(self) -> list[dict[str, str]]:
        """Phases of the vehicles in each step that the verdict gets of paths."""
        steps = self.ground.steps
        return [step.vehicles for step in steps if step.step.startswith("follow_path")]

    def land_at_once(self, name: str) -> None:
        """Let a vehicle stand on the ground."""
        self._bus.tell(name, state="landed", is_airborne=False, is_armed=False)

    def _say(self, line: str) -> None:
        self.lines.append(line)
        if not line.startswith("follow_path"):
            return
        self._has_begun.set()
        for name, order in self._bus.orders:
            if order.kind == "follow_path" and name in self._arrived:
                self._bus._end(name, order, "")
            elif order.kind == "follow_path" and name in self._failed:
                self._bus._end(name, order, "fail")


@pytest.fixture
def flight(fleet: FleetConfig, bus: FakeBus, client: Any) -> Flight:
    return Flight(fleet, bus, client)


@pytest.mark.parametrize("arrived", [(), ("mav0",)])
async def test_the_step_fails_when_the_users_time_is_over(
    flight: Flight, arrived: Sequence[str]
) -> None:
    with pytest.raises(OrderFailed, match=r"mav2 unfinished: not finished within 0\.25 s"):
        await flight.follow(arrived=arrived)
    assert "  mav1 unfinished: not finished within 0.25 s (the order was accepted)." in flight.lines


async def test_the_step_fails_when_all_have_left_their_paths(flight: Flight) -> None:
    with pytest.raises(OrderFailed, match="The motor is weak") as error:
        await flight.follow(failed=ALL)
    assert {result.phase for result in error.value.results.values()} == {"failed"}


async def test_the_others_go_on_when_one_has_left_its_path(flight: Flight) -> None:
    results = await flight.follow(arrived=ALL[1:], failed=["mav0"])
    assert [name for name, result in results.items() if result.is_done] == ["mav1", "mav2"]
    assert flight.ground.left_out == set()


async def test_vehicles_that_the_mission_itself_lands_do_not_fail_their_paths(
    flight: Flight, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(path_following, "START_LEAD_S", 0.05)  # so that the paths have begun
    following = asyncio.create_task(flight.follow(timeout_s=5.0))
    await flight.land(ALL)
    results = await following
    assert {result.phase for result in results.values()} == {"superseded"}
    assert flight.path_steps == []
    assert not any("followed in" in line for line in flight.lines)


async def test_the_verdict_counts_the_vehicles_that_the_mission_leaves_on_their_paths(
    flight: Flight,
) -> None:
    following = asyncio.create_task(flight.follow(arrived=ALL[1:], timeout_s=5.0))
    await flight.land(ALL[:1])
    results = await following
    assert results["mav0"].phase == "superseded"
    assert flight.path_steps == [{"mav1": "done", "mav2": "done"}]


async def test_a_path_that_the_landing_at_the_end_of_a_script_cuts_off_has_failed(
    flight: Flight,
) -> None:
    following = asyncio.create_task(flight.follow(timeout_s=5.0))
    await flight.supersede(())
    flight.ground.is_ending = True
    await flight.land(ALL)
    with pytest.raises(OrderFailed, match="superseded"):
        await following
    assert flight.path_steps == [dict.fromkeys(ALL, "superseded")]


async def test_the_step_fails_when_the_mission_lands_one_and_all_others_have_left(
    flight: Flight,
) -> None:
    following = asyncio.create_task(flight.follow(failed=ALL[1:], timeout_s=5.0))
    await flight.land(ALL[:1])
    with pytest.raises(OrderFailed, match="The motor is weak"):
        await following


async def test_the_step_fails_when_orders_of_somebody_else_replace_all_paths(
    flight: Flight,
) -> None:
    following = asyncio.create_task(flight.follow(timeout_s=5.0))
    await flight.supersede()
    with pytest.raises(OrderFailed, match="superseded"):
        await following


@pytest.mark.parametrize("is_cancelled", [True, False])
async def test_nobody_starts_around_a_vehicle_that_somebody_has_held_before_the_start(
    flight: Flight, client: Any, bus: FakeBus, is_cancelled: bool
) -> None:
    following = asyncio.create_task(flight.follow(timeout_s=5.0))
    await flight.supersede(())
    for name, order in bus.orders:
        if order.kind == "follow_path":
            bus.tell(name, taken_order_id=order.order_id, taken_order_kind="follow_path")
    bus.tell("mav1", taken_order_id="b-1", taken_order_kind="hold", taken_order_from="ada (b)")
    if is_cancelled:  # as by the mission's end
        await asyncio.sleep(0.05)
        following.cancel()

    def held(_: object = None) -> set[str]:
        return {name for name, order in bus.orders if order.kind == "hold"}

    assert await client.wait_for(lambda _: bool(held()), 2.0)
    assert held() == {"mav0", "mav2"}
    await flight.supersede()
    with pytest.raises(asyncio.CancelledError if is_cancelled else FleetTaken):
        await following


async def test_who_was_left_out_before_and_does_not_fly_keeps_no_other_from_its_path(
    flight: Flight,
) -> None:
    flight.ground.goes_on_without = True
    flight.ground.leave_out("mav0")
    flight.land_at_once("mav0")
    await asyncio.sleep(0.1)
    results = await flight.follow(arrived=ALL)
    assert {name: result.phase for name, result in results.items()} == {
        "mav1": "done",
        "mav2": "done",
    }
    assert await flight.follow(["mav0"]) == {}


async def test_a_path_to_a_vehicle_on_the_ground_is_said_before_the_start(
    flight: Flight, bus: FakeBus
) -> None:
    below_mav1 = bus.vehicles["mav1"].position_enu_m
    bus.tell("mav0", state="landed", is_airborne=False, is_armed=False, position_enu_m=below_mav1)
    await asyncio.sleep(0.1)
    await flight.follow(["mav1", "mav2"], arrived=["mav1", "mav2"])
    (sentence,) = [line for line in flight.lines if "The path of" in line]
    assert "The path of mav1 leads 0.00 m from mav0" in sentence


async def test_a_mission_that_goes_on_leaves_out_who_has_not_arrived(flight: Flight) -> None:
    flight.ground.goes_on_without = True
    await flight.follow(arrived=["mav0"], failed=["mav1"])
    assert flight.ground.left_out == {"mav1", "mav2"}
    assert "The mission goes on without mav1, mav2." in flight.lines
    with pytest.raises(OrderFailed):
        await flight.follow(["mav0"], failed=["mav0"])
