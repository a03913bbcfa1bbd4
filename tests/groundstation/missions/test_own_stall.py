"""A ground that was stopped takes its own stall for nobody's failure."""

from __future__ import annotations

import asyncio
from typing import Any

from groundstation.alarms.alarm_table import GroundCondition
from groundstation.alarms.alarms import conditions
from groundstation.client.client import FleetClient
from groundstation.client.direct_mavlink import DirectCommand, DirectResult
from groundstation.fleet.own_stall import AFTER_STALL_S
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.missions.runner import MissionRun
from onboard.config.fleet import FleetConfig

STALL_NS = 25 * 10**9


class Clock:
    """The ground's clock, which the test moves."""

    def __init__(self) -> None:
        self.now_ns = 10**9

    def __call__(self) -> int:
        return self.now_ns


async def test_a_ground_that_was_stopped_marks_the_gap_and_waits_before_it_calls_vehicles_silent(
    fleet: FleetConfig, bus: Any
) -> None:
    clock = Clock()
    client = FleetClient(fleet, bus=bus, clock_ns=clock)
    await client.start()
    mission = mission_from_mapping(
        {"schema": 1, "step": [{"do": "land"}]}, path="m.toml", fleet=fleet
    )
    run = MissionRun(mission, client)
    bus.tell("mav1", is_armed=True, is_airborne=True)
    assert await client.wait_for(lambda state: bool(state.airborne_names), 5.0)
    assert not run.abort_if_silent()
    clock.now_ns += STALL_NS
    waited_s = 0.0
    while not run.abort_if_silent():
        alarms = {alarm.kind for alarm in conditions(client.state, fleet, client.now_ns())}
        assert GroundCondition.SILENT not in alarms
        clock.now_ns += 2 * 10**8
        waited_s += 0.2
        assert waited_s < 60.0
    assert waited_s >= AFTER_STALL_S
    assert GroundCondition.SILENT in {
        alarm.kind for alarm in conditions(client.state, fleet, client.now_ns())
    }
    assert await client.wait_for(
        lambda state: any(one.event.code == "ground_stalled" for one in state.events), 5.0
    )
    await client.stop()


async def test_a_stall_before_the_first_word_of_a_vehicle_is_no_event(
    fleet: FleetConfig, bus: Any
) -> None:
    clock = Clock()
    client = FleetClient(fleet, bus=bus, clock_ns=clock)
    await client.start()
    client.notice_own_stall()
    clock.now_ns += STALL_NS
    client.notice_own_stall()
    bus.tell("mav1")
    assert await client.wait_for(lambda state: state.vehicles["mav1"].telemetry is not None, 5.0)
    assert not [one for one in client.state.events if one.event.code == "ground_stalled"]
    await client.stop()


async def test_a_landing_whose_reply_a_stall_swallowed_goes_to_px4_only_when_the_agent_stays_silent(
    fleet: FleetConfig, bus: Any
) -> None:
    for is_followed in (True, False):
        clock = Clock()
        sent: list[str] = []

        async def send(command: DirectCommand, sent: list[str] = sent) -> DirectResult:
            sent.append(command.kind)
            return DirectResult(True, True, "PX4 accepted it")

        client = FleetClient(fleet, bus=bus, clock_ns=clock, send=send)
        await client.start()
        bus.misbehave["mav1"] = "silent"
        bus.tell("mav1", is_armed=True, is_airborne=True)
        assert await client.wait_for(lambda state: bool(state.airborne_names), 5.0)
        result = await client.submit("land mav1")
        await asyncio.sleep(0.05)  # the wait for the reply has begun
        clock.now_ns += STALL_NS
        if is_followed:
            await asyncio.sleep(1.0)  # the landing has waited for so long
            clock.now_ns += 10**8
            bus.tell("mav1", is_armed=True, is_airborne=True, order_kind="land")
        await asyncio.sleep(2.5)
        if is_followed:
            assert not sent
        else:
            assert sent == ["land"]
        assert (result.results["mav1"].phase == "direct") is False
        await client.stop()
