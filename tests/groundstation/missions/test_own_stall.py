"""A ground that was stopped takes its own stall for nobody's failure."""

from __future__ import annotations

from typing import Any

from groundstation.client.client import FleetClient
from groundstation.missions.files import mission_from_mapping
from groundstation.missions.runner import AFTER_STALL_S, MissionRun
from onboard.config.fleet import FleetConfig


async def test_a_ground_that_was_stopped_marks_the_gap_and_waits_before_it_calls_vehicles_silent(
    fleet: FleetConfig, bus: Any
) -> None:
    now_ns = [10**9]

    def clock_ns() -> int:
        return now_ns[0]

    client = FleetClient(fleet, bus=bus, clock_ns=clock_ns)
    await client.start()
    mission = mission_from_mapping({"schema": 1, "step": [{"do": "land"}]}, path="m.toml", fleet=fleet)
    run = MissionRun(mission, client, boot_clock_ns=clock_ns)
    bus.tell("mav1", is_armed=True, is_airborne=True)
    assert await client.wait_for(lambda state: bool(state.airborne_names), 5.0)
    assert not run.abort_if_silent()
    now_ns[0] += 25 * 10**9
    waited_s = 0.0
    while not run.abort_if_silent():
        now_ns[0] += 2 * 10**8
        waited_s += 0.2
        assert waited_s < 60.0
    assert waited_s >= AFTER_STALL_S
    assert await client.wait_for(lambda state: any(one.event.code == "ground_stalled" for one in state.events), 5.0)
    await client.stop()
