"""Vehicles that are out of service: orders to all, missions and preflight go on without them."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import msgspec
import pytest

from groundstation.client.client import FleetClient
from groundstation.client.preflight_page import as_text, page_of
from groundstation.fleet import state as fleet_state
from groundstation.mission_files.loading import load_mission, mission_from_mapping
from groundstation.mission_files.mission import Mission
from groundstation.mission_files.mission_findings import refused_findings
from groundstation.missions.api import Fleet
from groundstation.missions.beginning import without_unused_slots
from groundstation.missions.conditions import flying
from groundstation.missions.runner import MissionRun
from groundstation.missions.taken import FleetWatch
from groundstation.orders.result import OrderFailed
from onboard.config.fleet import ConfigError, FleetConfig
from tests.groundstation.console.fake import telemetry as telemetry_of

OFF = {"disabled_by": "olga", "not_ready": ("mav1 is disabled by olga.",), "state": "waiting"}


@pytest.fixture
async def serviced(bus: Any, client: Any) -> Any:
    """A client that has heard that mav1 is out of service."""
    bus.tell("mav1", **OFF)
    assert await client.wait_for(lambda state: state.vehicles["mav1"].is_disabled, 5.0)
    return client


def ordered(bus: Any, kind: str) -> list[str]:
    return [name for name, order in bus.orders if order.kind == kind]


async def test_an_order_to_all_leaves_it_out_and_one_that_names_it_does_not(
    serviced: Any,
) -> None:
    assert set(serviced.plan("takeoff all 1.0").orders) == {"mav0", "mav2"}
    assert set(serviced.plan("takeoff 1.0").orders) == {"mav0", "mav2"}
    assert set(serviced.plan("takeoff mav1 1.0").orders) == {"mav1"}
    assert set(serviced.plan("takeoff mav0,mav1,mav2 1.0").orders) == {"mav0", "mav1", "mav2"}
    assert set(serviced.plan("takeoff 0-2 1.0").orders) == {"mav0", "mav1", "mav2"}
    assert set(serviced.plan("land all").orders) == {"mav0", "mav1", "mav2"}
    assert set(serviced.plan("enable mav1").orders) == {"mav1"}


async def test_a_mission_flies_without_it_and_passes(
    fleet: FleetConfig, serviced: Any, bus: Any
) -> None:
    steps = [{"do": "takeoff", "height_m": 1.0}, {"do": "land"}]
    mission = mission_from_mapping({"schema": 1, "step": steps}, path="t.toml", fleet=fleet)
    lines: list[str] = []
    verdict = await asyncio.wait_for(MissionRun(mission, serviced, say=lines.append).run(), 20.0)
    assert verdict.passed, verdict.summary
    assert verdict.exit_status == 0
    assert verdict.landed == {"mav0": True, "mav2": True}, "nobody has landed mav1"
    assert ordered(bus, "takeoff") == ["mav0", "mav2"]
    assert "The mission goes on without mav1." in lines


async def test_preflight_says_that_it_is_left_out_and_lets_the_others_go(
    fleet: FleetConfig, serviced: Any
) -> None:
    page = page_of(serviced.state.vehicles["mav1"], fleet, serviced.now_ns())
    assert page.is_go
    text = " ".join(as_text([page]).split())
    assert "mav1 is disabled by olga: flights go on without it." in text
    assert "enable mav1" in text


async def test_scripts_disable_and_enable(client: Any, bus: Any) -> None:
    flown = Fleet(client)
    await flown.disable("mav1")
    assert flown.names == ("mav0", "mav2")
    await flown.enable("mav1")
    assert flown.names == ("mav0", "mav1", "mav2")
    assert ordered(bus, "disable") == ordered(bus, "enable") == ["mav1"]


async def test_all_of_a_group_means_its_vehicles_when_they_are_disabled_and_enabled(
    client: Any, bus: Any
) -> None:
    flown = Fleet(client)
    group = flown.group("mav0,mav1")
    await flown.disable("mav2")
    await group.disable("all")
    assert ordered(bus, "disable") == ["mav2", "mav0", "mav1"]
    await flown["mav0"].enable("all")
    await group.enable("all")
    assert ordered(bus, "enable") == ["mav0", "mav0", "mav1"]
    assert flown.names == ("mav0", "mav1")

    for order in (group.disable, group.enable):
        with pytest.raises(ConfigError, match="mav2 is not among mav0, mav1"):
            await order("mav2")


async def test_a_vehicle_that_refuses_to_be_disabled_in_the_air_is_landed_at_the_end(
    fleet: FleetConfig, client: Any, bus: Any, tmp_path: Path
) -> None:
    code = [
        "async def mission(fleet):",
        "    fleet.ground.goes_on_without = True",
        "    await fleet.takeoff(1.0)",
        "    await fleet.disable('mav1')",
        "    await fleet.land()",
    ]
    path = tmp_path / "m.py"
    path.write_text("\n".join(code), encoding="utf-8")

    def say(line: str) -> None:
        """Let mav1 refuse the order to be disabled, and no other one."""
        bus.misbehave = {"mav1": "refuse"} if line == "disable mav1" else {}

    run = MissionRun(load_mission(path, fleet=fleet), client, say=say)
    await asyncio.wait_for(run.run(), 20.0)

    assert ordered(bus, "disable") == ["mav1"]
    assert "mav1" in ordered(bus, "land")
    assert not client.state.airborne_names


async def test_a_vehicle_that_refuses_to_be_enabled_stays_out_of_service(
    client: Any, bus: Any
) -> None:
    flown = Fleet(client)
    await flown.disable("mav1")
    bus.misbehave = {"mav1": "refuse"}
    assert (await flown.enable("mav1"))["mav1"].phase == "refused"
    assert flown.names == ("mav0", "mav2")
    assert flown.ground.disabled == {"mav1"}


async def test_who_did_it_counts_when_another_one_refuses(client: Any, bus: Any) -> None:
    flown = Fleet(client)
    bus.misbehave = {"mav1": "refuse"}
    with pytest.raises(OrderFailed):
        await flown.disable(["mav0", "mav1"])
    assert flown.ground.disabled == {"mav0"}
    assert flown.names == ("mav1", "mav2")

    bus.misbehave = {}
    await flown.disable("mav2")
    bus.misbehave = {"mav1": "refuse"}
    with pytest.raises(OrderFailed):
        await flown.enable(["mav0", "mav1"])
    assert flown.ground.disabled == {"mav2"}
    assert flown.names == ("mav0", "mav1")


async def test_an_order_for_which_nobody_is_left_is_refused_in_words(client: Any, bus: Any) -> None:
    flown = Fleet(client)
    await flown.disable("all")
    for order in (flown.takeoff, flown.land):
        with pytest.raises(ConfigError, match="is for nobody: all vehicles were disabled"):
            await order()

    await flown.enable("mav2")
    await flown.takeoff()
    assert ordered(bus, "takeoff") == ["mav2"]


def over_the_spot_of_mav1(fleet: FleetConfig, **takeoff: object) -> Mission:
    """Return a mission in which mav0 stops above the take-off spot of mav1."""
    x, y, _ = fleet.vehicles["mav1"].start_enu_m
    steps = [
        {"do": "takeoff", "height_m": 1.0, **takeoff},
        {"do": "goto", "goals": {"mav0": [x, y, 1.0]}},
        {"do": "land"},
    ]
    return mission_from_mapping({"schema": 1, "step": steps}, path="t.toml", fleet=fleet)


def test_no_finding_is_about_a_vehicle_that_is_out_of_service(
    fleet: FleetConfig, serviced: Any
) -> None:
    mission = over_the_spot_of_mav1(fleet)
    (finding,) = refused_findings(mission, is_simulated=False)
    assert "mav1" in finding.sentence

    flown_now = without_unused_slots(mission, serviced.state)
    assert refused_findings(flown_now, is_simulated=False) == []


def test_a_vehicle_out_of_service_that_a_step_names_is_checked_all_the_same(
    fleet: FleetConfig, serviced: Any
) -> None:
    mission = over_the_spot_of_mav1(fleet, vehicles=["mav0", "mav1"])
    flown_now = without_unused_slots(mission, serviced.state)
    (finding,) = refused_findings(flown_now, is_simulated=False)
    assert "mav1" in finding.sentence


def test_a_spare_is_checked_at_the_place_that_it_takes_and_not_at_its_own(
    fleet: FleetConfig, bus: Any, client: Any
) -> None:
    state = client.state
    telemetry = telemetry_of("mav2", stands_in_for="mav1")
    state = fleet_state.fold(state, telemetry, client.now_ns())

    flown_now = without_unused_slots(over_the_spot_of_mav1(fleet), state)
    assert flown_now.fleet.enabled_names == ("mav0", "mav1")
    assert len(refused_findings(flown_now, is_simulated=False)) == 1


async def test_a_wait_for_all_to_fly_does_not_wait_for_it(
    fleet: FleetConfig, serviced: Any, bus: Any
) -> None:
    steps = [
        {"do": "takeoff", "height_m": 1.0},
        {"do": "wait", "until": {"flying": "all"}, "timeout_s": 2.0},
        {"do": "land"},
    ]
    mission = mission_from_mapping({"schema": 1, "step": steps}, path="t.toml", fleet=fleet)
    verdict = await asyncio.wait_for(MissionRun(mission, serviced).run(), 20.0)
    assert verdict.passed, verdict.summary


async def test_a_script_that_waits_for_all_to_fly_does_not_wait_for_it(
    fleet: FleetConfig, serviced: Any
) -> None:
    flown = Fleet(serviced)
    await flown.ready(5.0)
    await flown.takeoff(1.0)
    await flown.until(flying(), 2.0)
    await flown.land()


async def test_no_reaction_is_to_its_failure_or_to_its_empty_battery(
    fleet: FleetConfig, serviced: Any, bus: Any
) -> None:
    bus.tell("mav1", state="failed", battery_frac=0.05)
    to_middle = {"do": "goto", "goals": {"mav0": [0.0, 0.0, 1.0]}}
    steps: list[dict[str, Any]] = [{"do": "takeoff", "height_m": 1.0}]
    for when in ({"fails": True}, {"battery_below_pct": 30.0}):
        step = {"do": "react", "when": when, "steps": [to_middle], "then": [{"do": "land"}]}
        steps.append(step)
    steps.append({"do": "land"})

    mission = mission_from_mapping({"schema": 1, "step": steps}, path="t.toml", fleet=fleet)
    verdict = await asyncio.wait_for(MissionRun(mission, serviced).run(), 20.0)
    assert verdict.passed, verdict.summary
    assert ordered(bus, "move") == ["mav0", "mav0"]
    assert ordered(bus, "land") == ["mav0", "mav2"]


async def test_a_wait_for_all_does_not_wait_for_whom_the_mission_goes_on_without(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    bus.misbehave = {"mav1": "fail"}
    steps = [
        {"do": "takeoff", "height_m": 1.0},
        {"do": "wait", "until": {"flying": "all"}, "timeout_s": 2.0},
        {"do": "land", "vehicles": "mav0,mav2"},
        {"do": "wait", "until": {"landed": "all"}, "timeout_s": 2.0},
    ]
    mission = mission_from_mapping(
        {"schema": 1, "step": steps, "on_failure": {"do": "go_on"}}, path="t.toml", fleet=fleet
    )
    verdict = await asyncio.wait_for(MissionRun(mission, client).run(), 20.0)
    assert verdict.passed, verdict.summary
    assert "takeoff" in {order.kind for name, order in bus.orders if name == "mav1"}


async def test_an_order_of_an_earlier_flight_to_a_vehicle_heard_late_does_not_end_a_mission(
    fleet: FleetConfig, bus: Any
) -> None:
    off = msgspec.structs.replace(fleet.vehicles["mav2"], enabled=False)
    without = msgspec.structs.replace(fleet, vehicles={**fleet.vehicles, "mav2": off})
    client = FleetClient(without, author="tester", bus=bus)
    await client.start()
    bus.tell("mav0")
    bus.tell("mav1")
    assert await client.wait_for(lambda state: state.vehicles["mav1"].telemetry is not None, 5.0)
    watch = FleetWatch(client)
    watch.begin()

    bus.tell("mav2", taken_order_id="ground-1-7", taken_order_kind="land", taken_order_from="ada")
    assert await client.wait_for(lambda state: "mav2" in state.vehicles, 5.0)
    assert watch.takeover() is None

    bus.tell("mav2", taken_order_id="ground-1-8", taken_order_kind="hold", taken_order_from="ada")
    assert await client.wait_for(lambda _: watch.takeover() is not None, 5.0)
    await client.stop()


async def test_a_vehicle_that_a_person_disables_between_two_steps_fails_no_later_one(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    script = Fleet(client)
    await script.takeoff(1.0)
    await script.land()
    bus.tell("mav1", disabled_by="olga")
    bus.misbehave["mav1"] = "refuse"
    await asyncio.sleep(0.1)

    taken_off = await script.takeoff(1.0)
    assert set(taken_off) == {"mav0", "mav2"}
    goals = {name: (*fleet.vehicles[name].start_enu_m[:2], 1.5) for name in fleet.enabled_names}
    results = await script.go_to(goals)
    assert {name for name, result in results.items() if result.is_done} == {"mav0", "mav2"}
    assert script.ground.disabled == {"mav1"}
