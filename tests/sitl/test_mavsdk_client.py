"""An unmodified MAVSDK program against the emulator, as it would fly a PX4: arm, take off, offboard
attitude, land.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.clients.running import running_emulator

mavsdk = pytest.importorskip("mavsdk.asyncio")


@pytest.fixture
def port(tmp_path: Path) -> Iterator[int]:
    """A running emulator of one vehicle; the port where its companion listens."""
    with running_emulator(tmp_path) as emulator:
        yield emulator.companion


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
    configuration = mavsdk.Configuration.create_with_component_type(
        mavsdk.ComponentType.COMPANION_COMPUTER
    )
    client = mavsdk.Mavsdk(configuration)
    await client.add_any_connection(f"udpin://127.0.0.1:{port}")
    system = await client.first_autopilot(timeout_s=10)
    assert system is not None
    action = ActionAsync(system)
    offboard = OffboardAsync(system)
    telemetry = TelemetryAsync(system)
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
    euler = await first(
        telemetry.subscribe_attitude_euler(), lambda e: abs(e.pitch_deg + 5.0) < 1.0, 2
    )
    seen["pitch_deg"] = euler.pitch_deg
    await offboard.set_attitude(Attitude(0.0, 0.0, 90.0, 0.49))
    await action.land()
    await first(
        telemetry.subscribe_landed_state(), lambda state: state == LandedState.ON_GROUND, 20
    )
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
