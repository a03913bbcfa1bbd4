"""Who fails is named, and "all" does not mean a vehicle whose failure a mission has reacted to."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from typing import Any

import pytest

from groundstation.fleet.state import MAX_EVENTS, FleetState
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.missions.conditions import (
    ConditionTimeout,
    FleetMoment,
    all_of,
    any_of,
    battery_below,
    event,
    fails,
    flying,
    landed,
    reached,
)
from groundstation.missions.ground import MissionGround
from groundstation.missions.group import Group
from groundstation.missions.runner import MissionRun
from groundstation.orders.result import OrderFailed
from onboard.bus.schema import Event
from onboard.bus.topics import Topic
from onboard.config.fleet import ConfigError, FleetConfig


@pytest.fixture
async def group(fleet: FleetConfig, client: Any, bus: Any) -> Group:
    """A group of all vehicles, which fly; what is said stands in ``group.ground.lines``."""
    lines: list[str] = []
    ground: Any = MissionGround(client, say=lines.append)
    ground.lines = lines
    for name in fleet.enabled_names:
        bus.tell(name, state="flying", is_airborne=True, is_armed=True)
    return Group(ground, fleet.enabled_names)


@pytest.mark.parametrize("paused", ["the paths", "an order beside it", "the wait alone"])
async def test_time_in_which_an_operator_pauses_does_not_count_for_a_wait(
    group: Group, paused: str
) -> None:
    ground = group.ground
    moving = None
    if paused == "the paths":
        ground.pause_line = "paused"
    else:
        ground.pause()
    if paused == "an order beside it":
        moving = asyncio.create_task(group.move((0.5, 0.0, 1.0)))
        await asyncio.sleep(0.05)
    waiting = asyncio.create_task(group.until(landed(), 0.3))
    await asyncio.sleep(1.0)
    assert not waiting.done()

    ground.pause_line = ""
    ground.go_on(is_stepping=False)
    with pytest.raises(ConditionTimeout, match=r"within 0\.3 s"):
        await asyncio.wait_for(waiting, 2.0)
    if moving is not None:
        await moving


async def test_a_loss_in_the_middle_of_a_wait_makes_it_exactly_as_much_longer(
    group: Group, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = group.ground.link
    clock = asyncio.get_running_loop()
    begin_s = clock.time()
    lost_s = 0.0

    async def wait_while_lost() -> bool:
        nonlocal lost_s
        if lost_s or clock.time() < begin_s + 0.8:
            return False
        await asyncio.sleep(0.5)
        lost_s = 0.7  # 0.2 s of it before it was noticed
        return True

    monkeypatch.setattr(link, "wait_while_lost", wait_while_lost)
    monkeypatch.setattr(type(link), "lost_s", property(lambda _: lost_s))
    with pytest.raises(ConditionTimeout):
        await group.until(landed(), 1.2)
    assert clock.time() - begin_s == pytest.approx(1.9, abs=0.2)


async def test_a_reaction_says_who_fails_and_all_means_the_others_until_it_flies_again(
    group: Group, bus: Any
) -> None:
    reason = "The battery is at its landing level."

    async def react() -> None:
        assert group.select("all") == ("mav0", "mav2")

    async with group.reacting(fails(), react):
        bus.tell("mav1", state="landing", reason=reason, order_id="")
        await asyncio.sleep(0.1)

    lines = group.ground.lines  # type: ignore[attr-defined]
    assert "Anybody failing." in lines
    assert "  mav1: landing, The battery is at its landing level." in lines
    assert group.select("all", with_lost=True) == ("mav0", "mav1", "mav2")
    assert group.select("mav1") == ("mav1",)

    bus.tell("mav1", state="landed", is_airborne=False, is_armed=False)
    await asyncio.sleep(0.1)
    assert group.select("all") == ("mav0", "mav2")
    bus.tell("mav1", state="taking off", is_airborne=True, is_armed=True)
    await asyncio.sleep(0.1)
    assert group.select("all") == ("mav0", "mav1", "mav2")


async def test_a_failure_in_a_block_or_in_its_reaction_is_raised_as_what_it_is(
    group: Group, bus: Any
) -> None:
    async def hold() -> None:
        await group.hold()

    bus.misbehave = {"mav0": "refuse"}
    with pytest.raises(OrderFailed, match="mav0 refused"):
        async with group.reacting(battery_below(1.0), hold):
            await hold()

    with pytest.raises(OrderFailed, match="mav0 refused"):
        async with group.reacting(battery_below(99.0), hold):
            await group.wait(5.0)


async def test_a_reaction_is_a_function_whose_result_is_awaited_if_that_can_be(
    group: Group,
) -> None:
    for reaction in (group.hold(), None):
        wrong: Any = reaction
        with pytest.raises(ConfigError, match="Write the function without parentheses"):
            async with group.reacting(battery_below(99.0), wrong):
                raise AssertionError("the block has begun")

    called: list[str] = []
    for ends in (False, True):
        async with group.reacting(battery_below(99.0), lambda: called.append("now"), ends=ends):
            await asyncio.sleep(0.01)
        async with group.reacting(battery_below(99.0), lambda: group.hold(), ends=ends):
            await asyncio.sleep(0.01)
    assert called == ["now", "now"]
    assert [step.step for step in group.ground.steps] == ["hold mav0,mav1,mav2"] * 2


@pytest.mark.parametrize("timeout_s", [0.0, -1.0])
async def test_a_wait_without_time_only_looks_whether_the_condition_holds_now(
    group: Group, timeout_s: float
) -> None:
    assert await group.client.wait_for(lambda state: len(state.airborne_names) == 3, 5.0)
    await group.until(flying(), timeout_s)
    with pytest.raises(ConditionTimeout):
        await group.until(landed(), timeout_s)


async def test_an_event_that_has_come_is_not_forgotten_while_the_rest_of_a_condition_comes(
    group: Group, bus: Any
) -> None:
    stamps_ns = itertools.count()

    def publish(code: str) -> None:
        message = Event(
            vehicle="mav1",
            stamp_ns=next(stamps_ns),
            severity="info",
            code=code,
            sentence="Made up.",
        )
        bus.on_message[Topic.EVENT](Topic.EVENT, "mav1", message)

    def has_last(code: str) -> Callable[[FleetState], bool]:
        return lambda state: bool(state.events) and state.events[-1].event.code == code

    both = all_of(landed("mav1"), event("released", "mav1"))
    publish("released")
    assert await group.client.wait_for(has_last("released"), 5.0)
    with pytest.raises(ConditionTimeout):
        await group.until(event("released"), 0.0)  # it has come before this wait

    wait = asyncio.create_task(group.until(both, 5.0))
    await asyncio.sleep(0)
    publish("released")
    assert await group.client.wait_for(lambda state: len(state.events) == 2, 5.0)
    for _ in range(MAX_EVENTS):
        publish("other")
    assert await group.client.wait_for(has_last("other"), 5.0)

    bus.tell("mav1", state="landed", is_airborne=False, is_armed=False)
    await wait


async def test_a_function_is_no_condition(group: Group) -> None:
    condition: Any = lambda: True  # noqa: E731
    with pytest.raises(ConfigError, match="'function' is no condition"):
        await group.until(condition)
    with pytest.raises(ConfigError, match="'function' is no condition"):
        async with group.reacting(condition, group.hold):
            pass


@pytest.mark.parametrize("combination", [all_of, any_of])
def test_a_combination_of_no_conditions_is_refused(combination: Any) -> None:
    with pytest.raises(ConfigError, match="there is no condition to combine"):
        combination()


async def test_several_conditions_name_those_who_fail(group: Group, bus: Any) -> None:
    bus.tell("mav2", state="failed", reason="PX4 has left OFFBOARD.")
    await asyncio.sleep(0.1)
    moment = FleetMoment(group.state, group.client.now_ns(), 0)
    both = any_of(battery_below(5.0), fails())
    assert both.lost(moment) == {"mav2": "failed, PX4 has left OFFBOARD"}


async def test_who_orders_nobody_but_the_lost_hears_why_they_refuse(group: Group) -> None:
    group.ground.note_lost(dict.fromkeys(group.names, "failed"))
    group.ground.still_lost = lambda: group.ground.lost  # type: ignore[method-assign]
    assert group.select("all") == group.names


async def test_all_are_killed_whoever_is_lost_and_only_the_others_hold(
    group: Group, bus: Any
) -> None:
    group.ground.note_lost({"mav1": "silent"})
    group.ground.still_lost = lambda: group.ground.lost  # type: ignore[method-assign]
    assert set(await group.hold()) == {"mav0", "mav2"}
    assert set(await group.kill("all")) == {"mav0", "mav1", "mav2"}


async def test_a_goal_is_reached_when_a_vehicle_says_so_and_not_when_it_would_be_there_by_now(
    group: Group, bus: Any
) -> None:
    goal = (0.0, 0.0, 1.0)
    bus.tell("mav1", position_enu_m=(-0.5, 0.0, 1.0), velocity_enu_m_s=(1.0, 0.0, 0.0))
    await asyncio.sleep(0.1)
    arrival = reached({"mav1": goal})
    heard_ns = group.state.vehicles["mav1"].received_ns
    assert not arrival.holds(FleetMoment(group.state, heard_ns + 500_000_000, 0))

    bus.tell("mav1", position_enu_m=(-0.1, 0.0, 1.0))
    await asyncio.sleep(0.1)
    assert arrival.holds(FleetMoment(group.state, group.client.now_ns(), 0))
    assert not arrival.holds(FleetMoment(group.state, heard_ns + 3_000_000_000, 0))


async def test_a_reaction_of_a_mission_file_orders_all_but_whoever_is_lost(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    wait = {"do": "wait", "duration_s": 60.0}
    then = [{"do": "hold"}, {"do": "yaw", "yaw_deg": 90.0}]
    react = {"do": "react", "when": {"fails": True}, "steps": [wait], "then": then}
    steps = [{"do": "takeoff", "height_m": 1.0}, react, {"do": "land"}]
    mission = mission_from_mapping({"schema": 1, "step": steps}, path="test.toml", fleet=fleet)
    run = MissionRun(mission, client)
    flown = asyncio.create_task(run.run())
    assert await client.wait_for(lambda state: len(state.airborne_names) == 3, 5.0)
    bus.tell("mav1", state="landing", reason="The battery is low.", order_id="")
    await asyncio.wait_for(flown, 10.0)
    turned = [name for name, order in bus.orders if order.yaw_deg == 90.0]
    assert turned == ["mav0", "mav2"]
    assert [name for name, order in bus.orders if order.kind == "hold"] == ["mav0", "mav2"]
    landed = [name for name, order in bus.orders if order.kind == "land"]
    assert sorted(set(landed)) == ["mav0", "mav1", "mav2"]
