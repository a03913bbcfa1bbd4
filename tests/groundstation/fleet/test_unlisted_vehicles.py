"""A vehicle that the fleet file lacks: heard, alarmed, and no flight begins beside it."""

from __future__ import annotations

import asyncio
import itertools
import time
import tomllib
from typing import Any

import pytest
from msgspec import structs

from groundstation.alarms.alarm_table import AlarmSeverity, GroundCondition
from groundstation.alarms.alarms import conditions
from groundstation.client import preflight_page
from groundstation.client.client import FleetClient
from groundstation.fleet import state as fleet_state
from groundstation.fleet.state import MAX_UNLISTED, FleetState
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.missions.api import Fleet, NotReady
from groundstation.missions.readiness import fleet_refusal
from groundstation.missions.runner import MissionRun
from groundstation.orders.kill_latch import KillLatch, reset
from groundstation.processes.free_ports import with_free_ports
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping
from onboard.exit_status import EXIT_FAILED
from tests.groundstation.conftest import FakeBus, telemetry

UP: dict[str, Any] = {"state": "flying", "is_armed": True, "is_airborne": True}
SECOND = 1_000_000_000
HOP = [{"do": "takeoff"}, {"do": "land"}]


def hear(before: FleetState, name: str, now_ns: int = 0, **changes: Any) -> FleetState:
    return fleet_state.fold(before, telemetry(name, **changes), now_ns)


def tell(bus: FakeBus, name: str, **changes: Any) -> None:
    """Let a vehicle send telemetry that the bus's fleet file lacks."""
    bus.on_message[Topic.TELEMETRY](Topic.TELEMETRY, name, telemetry(name, **changes))


def mission(fleet: FleetConfig, **tables: Any) -> Any:
    return mission_from_mapping({"schema": 1, "step": HOP, **tables}, path="test.toml", fleet=fleet)


def test_it_is_kept_beside_the_fleet_with_its_newest_telemetry(fleet: FleetConfig) -> None:
    before = fleet_state.initial(fleet)
    state = hear(hear(before, "ghost", **UP), "ghost", 5, state="landed")
    assert state.vehicles == before.vehicles
    (ghost,) = state.unlisted
    assert ghost.telemetry is not None
    assert (ghost.name, ghost.telemetry.state, ghost.received_ns) == ("ghost", "landed", 5)
    assert state.unlisted_up == ()


def test_vehicles_at_rest_do_not_push_out_one_that_flies(fleet: FleetConfig) -> None:
    state = hear(fleet_state.initial(fleet), "real", **UP)
    for number in range(3 * MAX_UNLISTED):
        state = hear(state, f"ghost{number}", state="ready")
    assert len(state.unlisted) == MAX_UNLISTED
    assert state.unlisted[-1].name == f"ghost{3 * MAX_UNLISTED - 1}"
    assert [view.name for view in state.unlisted_up] == ["real"]

    for number in range(2 * MAX_UNLISTED):
        state = hear(state, f"flying{number}", **UP)
    assert len(state.unlisted) == MAX_UNLISTED
    assert state.unlisted[0].name == f"flying{MAX_UNLISTED}"


async def test_an_operators_word_forgets_one_that_is_silent(fleet: FleetConfig, bus: Any) -> None:
    """Otherwise one that lost its power once keeps missions from beginning for ever."""
    late_ns = 0

    def refusal() -> str:
        return fleet_refusal(client.state, fleet.enabled_names, fleet, client.now_ns())

    client = FleetClient(fleet, bus=bus, clock_ns=lambda: time.monotonic_ns() + late_ns)
    await client.start()
    try:
        tell(bus, "ghost", **UP)
        assert await client.wait_for(lambda state: bool(state.unlisted_up), 1.0)
        assert "reset" not in refusal()
        with pytest.raises(ConfigError, match="ghost"):
            reset("ghost", KillLatch(), fleet, client.forget_silent)

        late_ns = 9 * SECOND
        assert "ghost is silent now. If you see that it is down, write reset ghost" in refusal()
        said = reset("ghost", KillLatch(), fleet, client.forget_silent)
        assert said == "ghost is forgotten until it is heard again."
        assert refusal() == ""

        tell(bus, "ghost", sequence=2, **UP)
        assert await client.wait_for(lambda state: bool(state.unlisted_up), 1.0)
    finally:
        await client.stop()


@pytest.mark.parametrize(
    ("changes", "later_s", "severity", "sentence"),
    [
        ({"state": "ready"}, 0.0, AlarmSeverity.WARNING, "ghost, which {lacks}, is ready"),
        (UP, 0.0, AlarmSeverity.CRITICAL, "ghost, which {lacks}, is flying"),
        (
            {"state": "armed", "is_armed": True},
            0.0,
            AlarmSeverity.CRITICAL,
            "ghost, which {lacks}, is armed",
        ),
        (UP, 9.0, AlarmSeverity.CRITICAL, "ghost, which {lacks}, is silent, and was flying"),
        ({"state": "ready"}, 9.0, None, ""),
    ],
)
def test_an_alarm_names_it_and_says_what_it_does(
    fleet: FleetConfig,
    changes: dict[str, Any],
    later_s: float,
    severity: AlarmSeverity | None,
    sentence: str,
) -> None:
    state = hear(fleet_state.initial(fleet), "ghost", **changes)
    found = [
        alarm
        for alarm in conditions(state, fleet, round(later_s * SECOND))
        if alarm.kind is GroundCondition.UNLISTED
    ]
    if severity is None:
        assert found == []
        return
    (alarm,) = found
    assert alarm.severity is severity
    assert alarm.sentence == sentence.format(lacks="this ground's fleet file lacks")
    is_critical = severity is AlarmSeverity.CRITICAL
    assert ("Neither LAND ALL nor a mission here reaches it" in alarm.advice) is is_critical


async def test_no_mission_begins_while_it_flies_and_the_verdict_names_it(
    fleet: FleetConfig, client: FleetClient, bus: Any
) -> None:
    tell(bus, "ghost", **UP)
    verdict = await MissionRun(mission(fleet, expect={"all_landed": True}), client).run()
    assert verdict.exit_status == EXIT_FAILED
    assert "ghost is armed or in the air, and not in this ground's fleet file" in verdict.summary
    assert verdict.landed["ghost"] is False
    assert any("NOT: ghost." in line for line in verdict.sentences)
    assert bus.orders == []

    tell(bus, "ghost", sequence=2, state="landed")
    verdict = await MissionRun(mission(fleet, expect={"all_landed": True}), client).run()
    assert verdict.passed, verdict.summary
    assert "ghost" not in verdict.landed


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"expect": {"all_landed": True}}, "Landed and disarmed: not ghost."),
        ({}, "The mission has ended and ghost is not down, which the fleet file lacks."),
        ({"expect": {"all_landed": False}}, "Landed and disarmed: all."),
    ],
)
async def test_a_mission_beside_one_that_took_off_meanwhile_has_not_passed(
    fleet: FleetConfig, client: FleetClient, bus: Any, tables: dict[str, Any], words: str
) -> None:
    """Nor is the stranger the vehicle that a mission means to leave in the air."""
    run = asyncio.create_task(MissionRun(mission(fleet, **tables), client).run())
    assert await client.wait_for(lambda state: bool(state.airborne_names), 5.0)
    tell(bus, "ghost", **UP)
    verdict = await run
    assert not verdict.passed
    assert words in verdict.summary


async def test_the_preflight_page_is_no_go_while_it_flies(fleet: FleetConfig) -> None:
    state = fleet_state.initial(fleet)
    for name in fleet.enabled_names:
        state = hear(state, name, config_hash=fleet.config_hash)
    for changes, is_said in ((UP, True), ({"state": "landed"}, False)):
        state = hear(state, "ghost", **changes)
        text = preflight_page.as_text(preflight_page.pages_of(state, fleet, ["mav0"], 0))
        assert ("NO-GO  other vehicles  ghost is armed or in the air" in text) is is_said


@pytest.mark.realtime
async def test_a_ground_that_has_just_connected_hears_it_before_a_flight(
    fleet: FleetConfig,
) -> None:
    private = fleet_from_mapping(with_free_ports(tomllib.loads(fleet.text), fleet))
    ready = {"config_hash": private.config_hash, "state": "ready"}
    own = {name: telemetry(name, **ready) for name in private.enabled_names}
    # all reach the ground through one node, as behind a router
    node = BusSession(
        namespace=private.namespace, node="mav0", listen=[private.vehicles["mav0"].agent]
    )
    client = FleetClient(private, author="tester")

    async def send_for_ever() -> None:
        for sequence in itertools.count():
            for name, message in own.items():
                node.publish(Topic.TELEMETRY, name, structs.replace(message, sequence=sequence))
            await asyncio.sleep(0.1)
            if client.state.vehicles["mav2"].telemetry is not None:  # all others are ready
                ghost = telemetry("ghost", sequence=sequence, **UP)
                node.publish(Topic.TELEMETRY, "ghost", ghost)

    await asyncio.to_thread(node.start)
    beat = asyncio.create_task(send_for_ever())
    try:
        await client.start()
        with pytest.raises(NotReady, match="ghost is armed or in the air"):
            await Fleet(client).ready(10.0)
    finally:
        beat.cancel()
        await client.stop()
        await asyncio.to_thread(node.stop)
