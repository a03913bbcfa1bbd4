"""Flies by attitude and thrust, as a companion computer, after asking for OFFBOARD without a
setpoint.
"""

from __future__ import annotations

import asyncio
from typing import Any

from mavsdk.asyncio import ComponentType
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.offboard import Attitude, OffboardAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.exceptions import MavsdkError
from vehicle import connected, first, run


async def offboard_attitude(endpoint: str, seen: dict[str, Any]) -> None:
    """Arm, climb, roll both ways, stop, land."""
    _client, system = await connected(endpoint, ComponentType.COMPANION_COMPUTER)
    action = ActionAsync(system)
    offboard = OffboardAsync(system)
    telemetry = TelemetryAsync(system)
    await first(telemetry.subscribe_health(), 30, lambda h: h.is_armable)
    try:
        await offboard.start()
        seen["without_setpoint"] = "started"
    except MavsdkError as error:
        seen["without_setpoint"] = str(error).split(";")[0]
    await action.arm()
    await offboard.set_attitude(Attitude(0.0, 0.0, 0.0, 0.0))
    await offboard.start()
    await first(telemetry.subscribe_flight_mode(), 10, lambda mode: mode.name == "OFFBOARD")
    await offboard.set_attitude(Attitude(0.0, 0.0, 0.0, 0.6))
    await first(telemetry.subscribe_position_velocity_ned(), 16, lambda p: p.position.down_m < -2.0)
    for roll_deg in (10.0, -10.0):
        await offboard.set_attitude(Attitude(roll_deg, 0.0, 0.0, 0.5))
        euler = await first(
            telemetry.subscribe_attitude_euler(),
            10,
            lambda e, r=roll_deg: abs(e.roll_deg - r) < 1.0,
        )
        seen[f"roll_{roll_deg:+.0f}"] = euler.roll_deg
    await offboard.set_attitude(Attitude(0.0, 0.0, 0.0, 0.49))
    await asyncio.sleep(0.5)
    await offboard.stop()
    seen["after_stop"] = (
        await first(telemetry.subscribe_flight_mode(), 10, lambda m: m.name != "OFFBOARD")
    ).name
    await action.land()
    await first(telemetry.subscribe_armed(), 80, lambda armed: not armed)
    seen["landed"] = True


run(offboard_attitude)
