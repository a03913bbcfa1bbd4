"""A real agent dies in flight and comes back: it sends nothing until PX4 holds and somebody orders
it to take over.
"""

from __future__ import annotations

import asyncio
import math
import os
import signal
from pathlib import Path

import pytest
from pymavlink import mavutil

from tests.bench.fixture import BenchFleet, fleet_data

pytestmark = [pytest.mark.long, pytest.mark.timeout(180)]

AUTO = 4.0
LOITER = 3.0


def put_on_hold(endpoint: str, system_id: int) -> None:
    """As a pilot does: PX4's hold, over the vehicle's second link."""
    link = mavutil.mavlink_connection(endpoint.replace("udpout://", "udpout:"), source_system=255)
    try:
        for _ in range(3):
            link.mav.heartbeat_send(
                mavutil.mavlink.MAV_TYPE_GCS, mavutil.mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0
            )
            link.mav.command_long_send(
                system_id, 1, mavutil.mavlink.MAV_CMD_DO_SET_MODE, 0, 1.0, AUTO, LOITER, 0, 0, 0, 0
            )
    finally:
        link.close()


async def test_a_restarted_agent_takes_a_held_vehicle_over_where_it_is_and_lands_it(
    tmp_path: Path,
) -> None:
    bench_fleet = BenchFleet(fleet_data(2, 2.0, "restart"), tmp_path)
    async with bench_fleet:
        client = bench_fleet.client
        vehicle = bench_fleet.config.vehicles["mav0"]

        def told(state: str, mode: str) -> bool:
            telemetry = client.state.vehicles["mav0"].telemetry
            return telemetry is not None and telemetry.state == state and telemetry.mode == mode

        await bench_fleet.fleet.takeoff(height_m=2.0)
        os.kill(bench_fleet.processes.pids["mav0"], signal.SIGKILL)
        await asyncio.sleep(0.8)  # PX4 has begun to land
        assert vehicle.direct is not None
        put_on_hold(vehicle.direct, vehicle.system_id)
        command = [
            "onboard",
            "--fleet",
            str(bench_fleet.path),
            "--vehicle",
            "mav0",
            "--apply-params",
        ]
        bench_fleet.processes.start("mav0-again", command)
        assert await client.wait_for(lambda _: told("failed", "HOLD"), 60.0)
        await asyncio.sleep(3.0)
        assert told("failed", "HOLD"), "the new agent must not touch it by itself"

        (refused,) = (await client.order("move mav0 0 0 1", 10.0)).values()
        assert refused.phase == "refused"
        before = client.state.vehicles["mav0"].truth
        (taken,) = (await client.order("hold mav0", 20.0)).values()
        assert taken.phase == "done", taken
        assert told("holding", "OFFBOARD")
        farthest_m = 0.0
        for _ in range(30):
            await asyncio.sleep(0.1)
            now = client.state.vehicles["mav0"].truth
            assert before is not None
            assert now is not None
            farthest_m = max(farthest_m, math.dist(now.position_enu_m, before.position_enu_m))
        assert farthest_m < 0.3
        assert await bench_fleet.fleet.land_all()
        log = (tmp_path / "mav0-again.log").read_text()
        assert "its parameters are left as they are" in log
