"""Takes off and lands as a ground station, listening to the texts."""

from __future__ import annotations

import asyncio
from typing import Any

from mavsdk.asyncio import ComponentType
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.exceptions import MavsdkError
from vehicle import connected, first, run


async def takeoff_and_land(endpoint: str, seen: dict[str, Any]) -> None:
    """Up, refuse to be disarmed, down."""
    _client, system = await connected(endpoint, ComponentType.GROUND_STATION)
    action = ActionAsync(system)
    telemetry = TelemetryAsync(system)
    texts: list[str] = []

    async def listen() -> None:
        async for text in telemetry.subscribe_status_text():
            texts.append(text.text)

    listening = asyncio.create_task(listen())
    await first(
        telemetry.subscribe_health(),
        30,
        lambda h: h.is_global_position_ok and h.is_home_position_ok,
    )
    seen["altitude_m"] = await action.get_takeoff_altitude()
    await action.arm()
    await action.takeoff()
    await first(telemetry.subscribe_in_air(), 30, bool)
    highest = await first(telemetry.subscribe_position(), 30, lambda p: p.relative_altitude_m > 2.0)
    seen["height_m"] = highest.relative_altitude_m
    try:
        await action.disarm()
        seen["disarm_in_air"] = "done"
    except MavsdkError as error:
        seen["disarm_in_air"] = str(error).split(";")[0]
    await action.hold()
    seen["mode"] = (
        await first(telemetry.subscribe_flight_mode(), 10, lambda mode: mode.name == "HOLD")
    ).name
    await action.land()
    await first(telemetry.subscribe_in_air(), 60, lambda flies: not flies)
    await first(telemetry.subscribe_armed(), 20, lambda armed: not armed)
    seen["landed"] = True
    await asyncio.sleep(0.3)
    listening.cancel()
    seen["texts"] = texts


run(takeoff_and_land)
