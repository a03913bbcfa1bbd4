"""Reads one of everything that MAVSDK's telemetry offers of a quadrotor; changes a few rates."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

from mavsdk.asyncio import ComponentType
from mavsdk.asyncio.plugins.info import InfoAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from vehicle import connected, first, run


async def telemetry(endpoint: str, seen: dict[str, Any]) -> None:
    """Every stream once."""
    _client, system = await connected(endpoint, ComponentType.COMPANION_COMPUTER)
    t = TelemetryAsync(system)
    seen["armed"] = await first(t.subscribe_armed(), 10)
    seen["mode"] = (await first(t.subscribe_flight_mode(), 10)).name
    seen["landed"] = (await first(t.subscribe_landed_state(), 10)).name
    seen["in_air"] = await first(t.subscribe_in_air(), 10)
    seen["vtol"] = (await first(t.subscribe_vtol_state(), 10)).name
    # Health is told as it becomes known: wait until all of it is.
    health = await first(t.subscribe_health(), 20, lambda h: h.is_armable and h.is_home_position_ok)
    seen["health"] = [health.is_armable, health.is_local_position_ok, health.is_global_position_ok]
    seen["calibrated"] = [
        health.is_gyrometer_calibration_ok,
        health.is_accelerometer_calibration_ok,
    ]
    position = await first(t.subscribe_position(), 10)
    seen["position"] = [position.latitude_deg, position.longitude_deg, position.relative_altitude_m]
    home = await first(t.subscribe_home(), 10)
    seen["home"] = [home.latitude_deg, home.longitude_deg]
    local = await first(t.subscribe_position_velocity_ned(), 10)
    seen["down_m"] = local.position.down_m
    seen["euler"] = (await first(t.subscribe_attitude_euler(), 10)).roll_deg
    seen["quaternion_w"] = (await first(t.subscribe_attitude_quaternion(), 10)).w
    seen["rates"] = (await first(t.subscribe_attitude_angular_velocity_body(), 10)).roll_rad_s
    seen["velocity"] = (await first(t.subscribe_velocity_ned(), 10)).down_m_s
    seen["heading_deg"] = (await first(t.subscribe_heading(), 10)).heading_deg
    seen["altitude_m"] = (await first(t.subscribe_altitude(), 10)).altitude_amsl_m
    gps = await first(t.subscribe_gps_info(), 10)
    seen["gps"] = [gps.num_satellites, gps.fix_type.name]
    battery = await first(t.subscribe_battery(), 10)
    seen["battery"] = [battery.voltage_v, battery.remaining_percent]
    imu = await first(t.subscribe_imu(), 10)
    seen["imu_down_m_s2"] = imu.acceleration_frd.down_m_s2
    odometry = await first(t.subscribe_odometry(), 10)
    seen["odometry_frame"] = odometry.frame_id.name
    version = await InfoAsync(system).get_version()
    seen["version"] = [version.flight_sw_major, version.flight_sw_minor]
    await t.set_rate_position_velocity_ned(50.0)
    await t.set_rate_attitude_quaternion(100.0)
    seen["rate_hz"] = await _rate(t)


async def _rate(t: TelemetryAsync) -> float:
    count = 0

    async def counting() -> None:
        nonlocal count
        async for _ in t.subscribe_attitude_quaternion():
            count += 1

    await asyncio.sleep(0.5)
    with contextlib.suppress(TimeoutError):
        await asyncio.wait_for(counting(), 1.5)
    return count / 1.5


run(telemetry)
