"""Vehicles that follow another one: who follows no longer has failed, unless that was ordered."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from groundstation.missions import following
from groundstation.missions.api import Fleet
from groundstation.missions.conditions import battery_below
from groundstation.orders.result import OrderFailed
from onboard.config.fleet import ConfigError

BESIDE = {"mav1": (0.0, 2.0, 0.0), "mav2": (0.0, -2.0, 0.0)}
STALLED = "Loop stalled: holding."


class Flight:
    """A fleet in the air, and the lines that it says."""

    def __init__(self, client: Any, bus: Any) -> None:
        self.lines: list[str] = []
        self.fleet = Fleet(client, say=self._say)
        self.bus = bus
        self.obeys_hold = True

    def _say(self, line: str) -> None:
        self.lines.append(line)
        if line.startswith("hold") and self.obeys_hold:
            self.bus.misbehave.clear()  # who has refused its goals holds

    def kinds_of(self, name: str) -> list[str]:
        return [order.kind for vehicle, order in self.bus.orders if vehicle == name]


@pytest.fixture
async def flight(client: Any, bus: Any, monkeypatch: pytest.MonkeyPatch) -> Flight:
    monkeypatch.setattr(following, "_PERIOD_S", 0.1)
    flight = Flight(client, bus)
    await flight.fleet.takeoff(1.0)
    return flight


async def test_nobody_follows_itself(flight: Flight) -> None:
    with pytest.raises(ConfigError, match="mav1 cannot follow itself"):
        await flight.fleet.follow("mav1", 0.1, offsets=BESIDE)
    assert flight.kinds_of("mav2") == ["takeoff"]


@pytest.mark.parametrize(
    ("offset", "words"),
    [((0.3, 0.0, 0.0), "keeps 1.05 m between parked vehicles"), ((0.0, 2.0, 0.0), "I say so")],
)
async def test_who_has_refused_all_goals_has_not_followed_and_holds(
    flight: Flight, offset: tuple[float, float, float], words: str
) -> None:
    if "so" in words:
        flight.bus.misbehave["mav1"] = "refuse"
    with pytest.raises(
        OrderFailed, match=f"'follow mav0' failed. mav1 refused: .*{words}"
    ) as error:
        await flight.fleet.follow("mav0", 0.1, offsets={"mav1": offset})
    assert error.value.results["mav1"].phase == "refused"
    assert flight.kinds_of("mav1")[-1] == "hold"
    assert flight.fleet.steps[-1].vehicles == {"mav1": "refused"}


async def test_the_others_follow_on_without_one_that_refuses_its_goals_for_long(
    flight: Flight, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(following, "_REFUSED_S", 0.15)
    flight.bus.misbehave["mav1"] = "refuse"
    with pytest.raises(OrderFailed) as error:
        await flight.fleet.follow("mav0", 0.4, offsets=BESIDE)
    assert "  mav1 follows mav0 no longer: Because I say so." in flight.lines
    phases = {name: result.phase for name, result in error.value.results.items()}
    assert phases == {"mav1": "refused", "mav2": "done"}


@pytest.mark.parametrize("goes_on", [False, True])
@pytest.mark.parametrize(
    ("state", "reason"), [("holding", STALLED), ("landing", "The battery has 5 %: landing.")]
)
async def test_who_is_stopped_by_a_failsafe_has_failed_and_the_others_follow_on(
    flight: Flight, state: str, reason: str, goes_on: bool
) -> None:
    flight.fleet.ground.goes_on_without = goes_on
    follow = asyncio.create_task(flight.fleet.follow("mav0", 0.4, offsets=BESIDE))
    await asyncio.sleep(0.25)
    flight.bus.tell("mav1", state=state, reason=reason, follows="")
    if goes_on:
        results = await follow
        assert flight.fleet.names == ("mav0", "mav2")
    else:
        with pytest.raises(
            OrderFailed, match=f"'follow mav0' failed. mav1 failed: {reason}"
        ) as error:
            await follow
        results = error.value.results

    assert f"  mav1 follows mav0 no longer: {reason}" in flight.lines
    assert (results["mav1"].phase, results["mav1"].sentence) == ("failed", reason)
    assert results["mav2"].is_done
    assert flight.kinds_of("mav1")[-1] == "move"
    assert flight.kinds_of("mav2")[-1] == "hold"


@pytest.mark.parametrize("order", ["land", "home", "yaw"])
async def test_who_gets_another_order_of_the_script_follows_no_longer(
    flight: Flight, order: str
) -> None:
    follow = asyncio.create_task(flight.fleet.follow("mav0", 1.0, offsets=BESIDE))
    await asyncio.sleep(0.15)
    vehicle = flight.fleet["mav1"]
    orders = {"land": vehicle.land, "home": vehicle.home, "yaw": lambda: vehicle.yaw(90.0)}
    assert (await orders[order]())["mav1"].is_done
    before = len(flight.kinds_of("mav1"))

    x, y, z = flight.bus.vehicles["mav0"].position_enu_m
    flight.bus.tell("mav0", position_enu_m=(x, y + 0.5, z))
    assert list(await follow) == ["mav2"]
    assert len(flight.kinds_of("mav1")) == before
    words = "mav1: another order ends following mav0"
    assert [line.strip() for line in flight.lines].count(words) == 1


@pytest.mark.parametrize("how", ["", "refuse", "silent"])
async def test_who_gets_an_order_of_a_person_here_follows_no_longer_if_it_takes_it(
    flight: Flight, client: Any, how: str
) -> None:
    follow = asyncio.create_task(flight.fleet.follow("mav0", 2.5, offsets=BESIDE))
    await asyncio.sleep(0.15)
    if how:
        flight.bus.misbehave["mav1"] = how
    results = await client.order("goto mav1 3 3 1", 5.0)
    flight.bus.misbehave.clear()
    assert results["mav1"].is_done is not bool(how)
    followed = await follow
    assert set(followed) == ({"mav1", "mav2"} if how else {"mav2"})


async def test_locate_after_another_order_does_not_hide_that_order(
    flight: Flight, client: Any
) -> None:
    follow = asyncio.create_task(flight.fleet.follow("mav0", 0.8, offsets=BESIDE))
    await asyncio.sleep(0.15)
    client.submit_now("goto mav1 3 3 1")
    client.submit_now("locate mav1")
    flight.bus.tell("mav0", velocity_enu_m_s=(0.5, 0.0, 0.0))
    assert set(await follow) == {"mav2"}


async def test_all_come_home_that_are_ordered_home_while_they_follow(flight: Flight) -> None:
    follow = asyncio.create_task(flight.fleet.follow("mav0", 5.0, offsets=BESIDE))
    await asyncio.sleep(0.15)
    flight.bus.tell("mav0", velocity_enu_m_s=(0.5, 0.0, 0.0))  # the next goals are others
    brought = await flight.fleet.bring_home()
    assert all(result.is_done for result in brought.values())
    assert await asyncio.wait_for(follow, 1.0) == {}
    assert flight.kinds_of("mav1")[-1] == flight.kinds_of("mav2")[-1] == "move"


@pytest.mark.parametrize("state", ["landing", "landed", "failed"])
async def test_the_followers_hold_and_the_leader_has_failed_when_a_failsafe_ends_its_flight(
    flight: Flight, state: str
) -> None:
    follow = asyncio.create_task(flight.fleet.follow("mav0", 5.0, offsets=BESIDE))
    await asyncio.sleep(0.15)
    x, y, _ = flight.bus.vehicles["mav0"].position_enu_m
    flight.bus.tell(
        "mav0", state=state, reason="The battery has 5 %: landing.", position_enu_m=(x, y, 0.3)
    )
    with pytest.raises(
        OrderFailed, match=r"'follow mav0' failed\. mav0 failed: The battery"
    ) as error:
        await asyncio.wait_for(follow, 2.0)
    phases = {name: result.phase for name, result in error.value.results.items()}
    assert phases == {"mav0": "failed", "mav1": "done", "mav2": "done"}
    assert flight.kinds_of("mav1") == ["takeoff", "move", "hold"]


async def test_the_others_go_on_without_a_leader_that_nobody_hears(flight: Flight) -> None:
    flight.fleet.ground.goes_on_without = True
    follow = asyncio.create_task(flight.fleet.follow("mav0", 5.0, offsets=BESIDE))
    await asyncio.sleep(0.15)
    flight.bus.tell("mav0", is_position_valid=False)
    results = await asyncio.wait_for(follow, 2.0)
    assert results["mav0"].sentence == "It does not report where it is."
    assert flight.fleet.names == ("mav1", "mav2")
    assert flight.kinds_of("mav1")[-1] == "hold"


@pytest.mark.parametrize("is_left_out", [False, True])
async def test_the_followers_hold_when_the_leader_lands_by_order_or_is_left_out(
    flight: Flight, is_left_out: bool
) -> None:
    follow = asyncio.create_task(flight.fleet.follow("mav0", 5.0, offsets=BESIDE))
    await asyncio.sleep(0.15)
    if is_left_out:
        flight.fleet.leave_out("mav0")
    else:
        assert (await flight.fleet["mav0"].land())["mav0"].is_done
    results = await asyncio.wait_for(follow, 2.0)
    assert {name: result.phase for name, result in results.items()} == {
        "mav1": "done",
        "mav2": "done",
    }


async def test_a_leader_that_stands_can_be_followed(flight: Flight) -> None:
    flight.bus.tell("mav0", state="landed", is_airborne=False, reason="The battery has 5 %.")
    await asyncio.sleep(0.1)
    results = await flight.fleet.follow("mav0", 0.3, offsets=BESIDE)
    assert all(result.is_done for result in results.values())


async def test_who_is_left_out_follows_no_longer_and_keeps_its_order(flight: Flight) -> None:
    follow = asyncio.create_task(flight.fleet.follow("mav0", 0.3, offsets=BESIDE))
    await asyncio.sleep(0.15)
    flight.fleet.leave_out("mav1")
    assert list(await follow) == ["mav2"]
    assert flight.kinds_of("mav1") == ["takeoff", "move"]


@pytest.mark.parametrize("is_stopped", [True, False])
async def test_a_reaction_that_ends_the_following_comes_also_when_a_vehicle_does_not_hold(
    flight: Flight, is_stopped: bool
) -> None:
    reactions: list[str] = []

    async def react() -> None:
        reactions.append("comes")

    low = battery_below(25.0, "mav1")
    async with flight.fleet.reacting(low, react, ends=True):
        asyncio.get_running_loop().call_later(0.15, _stop_mav1, flight, is_stopped)
        await flight.fleet.follow("mav0", 5.0, offsets=BESIDE)
    assert reactions == ["comes"]
    assert flight.kinds_of("mav1")[-1] == ("move" if is_stopped else "hold")
    assert flight.kinds_of("mav2")[-1] == "hold"


def _stop_mav1(flight: Flight, is_stopped: bool) -> None:
    """Let a failsafe land mav1, or let mav1 refuse whatever is ordered."""
    flight.obeys_hold = False
    flight.bus.misbehave["mav1"] = "refuse"
    stopped = {"state": "landing", "reason": "The battery falls: landing.", "follows": ""}
    flight.bus.tell("mav1", battery_frac=0.2, **(stopped if is_stopped else {}))


async def test_who_holds_by_a_failsafe_while_this_ground_heard_nobody_follows_again(
    flight: Flight, client: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks = 0

    async def wait_while_lost() -> bool:
        nonlocal looks
        looks += 1
        if looks != 3:
            return False
        flight.bus.tell("mav1", state="holding", reason="Bus lost: holding.", follows="")
        assert await client.wait_for(
            lambda state: state.vehicles["mav1"].telemetry.state == "holding", 5.0
        )
        return True

    monkeypatch.setattr(flight.fleet.ground.link, "wait_while_lost", wait_while_lost)
    results = await flight.fleet.follow("mav0", 0.6, offsets=BESIDE)
    assert results["mav1"].is_done
    assert flight.kinds_of("mav1") == ["takeoff", "move", "hold", "move", "hold"]
    assert flight.kinds_of("mav2") == ["takeoff", "move", "move", "hold"]
