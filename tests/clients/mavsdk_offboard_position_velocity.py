"""Flies by positions and velocities in the local frame, as a ground station."""

from __future__ import annotations

import asyncio
import math
from typing import Any

from mavsdk.asyncio import ComponentType
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.offboard import (
    OffboardAsync,
    PositionNedYaw,
    VelocityBodyYawspeed,
    VelocityNedYaw,
)
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from vehicle import connected, first, run


async def offboard_position_velocity(endpoint: str, seen: dict[str, Any]) -> None:
    """Up by position, aside by position, back by velocity, turned by body velocity, down."""
    _client, system = await connected(endpoint, ComponentType.GROUND_STATION)
    action = ActionAsync(system)
    offboard = OffboardAsync(system)
    telemetry = TelemetryAsync(system)
    await first(
        telemetry.subscribe_health(),
        30,
        lambda h: h.is_global_position_ok and h.is_local_position_ok,
    )
    await action.arm()
    await offboard.set_position_ned(PositionNedYaw(0.0, 0.0, -2.0, 0.0))
    await offboard.start()
    await first(
        telemetry.subscribe_position_velocity_ned(),
        20,
        lambda p: abs(p.position.down_m + 2.0) < 0.4,
    )
    await offboard.set_position_ned(PositionNedYaw(3.0, 0.0, -2.0, 90.0))

    def there(p: Any) -> bool:
        return math.hypot(p.position.north_m - 3.0, p.position.east_m) < 0.6

    place = await first(telemetry.subscribe_position_velocity_ned(), 24, there)
    seen["north_m"] = place.position.north_m
    heading = await first(
        telemetry.subscribe_attitude_euler(), 12, lambda e: abs(e.yaw_deg - 90.0) < 12.0
    )
    seen["yaw_deg"] = heading.yaw_deg
    await offboard.set_velocity_ned(VelocityNedYaw(-1.0, 0.0, 0.0, 90.0))
    fast = await first(telemetry.subscribe_velocity_ned(), 10, lambda v: v.north_m_s < -0.7)
    seen["north_m_s"] = fast.north_m_s
    # Forward is east now.
    await offboard.set_velocity_body(VelocityBodyYawspeed(1.0, 0.0, 0.0, 0.0))
    fast = await first(telemetry.subscribe_velocity_ned(), 10, lambda v: v.east_m_s > 0.7)
    seen["east_m_s"] = fast.east_m_s
    await offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
    await asyncio.sleep(1.0)
    await offboard.stop()
    seen["after_stop"] = (
        await first(telemetry.subscribe_flight_mode(), 10, lambda m: m.name != "OFFBOARD")
    ).name
    await action.land()
    await first(telemetry.subscribe_armed(), 80, lambda armed: not armed)
    seen["landed"] = True


run(offboard_position_velocity)
