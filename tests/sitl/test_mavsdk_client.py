"""An unmodified MAVSDK program against the emulator, as it would fly a PX4: arm, take off, offboard attitude, land."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

mavsdk = pytest.importorskip("mavsdk.asyncio")

FLEET = """
schema = 1
[fleet]
name = "mavsdk-test"
geofence_m = {{ x = [-50.0, 50.0], y = [-50.0, 50.0], z = [0.0, 20.0] }}
[types.sih]
hover_thrust_frac = 0.49
drag_1_s = 1.0
[defaults]
type = "sih"
[vehicles.solo]
system_id = 1
start_enu_m = [0.0, 0.0, 0.0]
agent = "tcp/127.0.0.1:{agent}"
autopilot = "udpin://127.0.0.1:{port}"
"""


def free_pair() -> int:
    """A UDP port that is free, and free again 40 higher."""
    while True:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as low:
            low.bind(("127.0.0.1", 0))
            port = int(low.getsockname()[1])
            if port > 65000:
                continue
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as high:
                try:
                    high.bind(("127.0.0.1", port + 40))
                except OSError:
                    continue
                return port


@pytest.fixture
def port(tmp_path: Path) -> Iterator[int]:
    """A running emulator of one vehicle; the port where its companion listens."""
    companion = free_pair()
    fleet = tmp_path / "fleet.toml"
    fleet.write_text(FLEET.format(port=companion, agent=free_pair()), encoding="utf-8")
    command = [sys.executable, "-m", "sitl", "--fleet", str(fleet), "--no-bus"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("ready: solo")
        yield companion
        process.terminate()
        assert process.wait(5) == 0


async def first(stream: AsyncIterator[Any], accept: Callable[[Any], bool], timeout_s: float) -> Any:
    """The first value of a telemetry stream that is accepted."""
    async with asyncio.timeout(timeout_s):
        async for value in stream:
            if accept(value):
                return value
    raise AssertionError("the stream ended")


async def fly(port: int) -> dict[str, Any]:
    """The flight; returns what was seen."""
    from mavsdk import logging as mavsdk_logging
    from mavsdk.asyncio.plugins.action import ActionAsync
    from mavsdk.asyncio.plugins.offboard import Attitude, OffboardAsync
    from mavsdk.asyncio.plugins.param import ParamAsync
    from mavsdk.asyncio.plugins.telemetry import FlightMode, LandedState, TelemetryAsync

    mavsdk_logging.log_subscribe(lambda *_: True)
    seen: dict[str, Any] = {}
    configuration = mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.COMPANION_COMPUTER)
    client = mavsdk.Mavsdk(configuration)
    await client.add_any_connection(f"udpin://127.0.0.1:{port}")
    system = await client.first_autopilot(timeout_s=10)
    assert system is not None
    action, offboard, telemetry = ActionAsync(system), OffboardAsync(system), TelemetryAsync(system)
    params = ParamAsync(system)
    seen["loss_s"] = await params.get_param_float("COM_OF_LOSS_T")
    await params.set_param_int("COM_OBL_RC_ACT", 4)
    seen["loss_action"] = await params.get_param_int("COM_OBL_RC_ACT")
    await first(telemetry.subscribe_health(), lambda h: h.is_armable, 10)
    await action.set_takeoff_altitude(1.5)
    await action.arm()
    await first(telemetry.subscribe_armed(), bool, 3)
    await action.takeoff()
    await first(telemetry.subscribe_flight_mode(), lambda mode: mode == FlightMode.HOLD, 15)
    climbed = await first(telemetry.subscribe_position_velocity_ned(), lambda _: True, 2)
    seen["climbed_m"] = -climbed.position.down_m
    await offboard.set_attitude(Attitude(0.0, -5.0, 90.0, 0.49))
    await offboard.start()
    await first(telemetry.subscribe_flight_mode(), lambda mode: mode == FlightMode.OFFBOARD, 3)
    euler = await first(telemetry.subscribe_attitude_euler(), lambda e: abs(e.pitch_deg + 5.0) < 1.0, 2)
    seen["pitch_deg"] = euler.pitch_deg
    await offboard.set_attitude(Attitude(0.0, 0.0, 90.0, 0.49))
    await action.land()
    await first(telemetry.subscribe_landed_state(), lambda state: state == LandedState.ON_GROUND, 20)
    await first(telemetry.subscribe_armed(), lambda armed: not armed, 6)
    seen["landed"] = True
    return seen


@pytest.mark.timeout(60)
def test_a_mavsdk_program_arms_takes_off_flies_offboard_and_lands(port: int) -> None:
    seen = asyncio.run(fly(port))
    assert seen["loss_s"] == pytest.approx(1.0)
    assert seen["loss_action"] == 4
    assert 1.1 < seen["climbed_m"] < 2.2
    assert seen["pitch_deg"] == pytest.approx(-5.0, abs=1.0)
    assert seen["landed"]
