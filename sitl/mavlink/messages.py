"""Contents of the streamed messages of a PX4: one builder each, from a view of the vehicle to
values in field order.

A builder returns None while PX4 has nothing to say.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

from sitl.mavlink.codec import Encoder
from sitl.mavlink.view import HOME_ALTITUDE_M, View
from sitl.physics import frames
from sitl.px4.battery import EMPTY_MV
from sitl.px4.modes import MODES, Mode
from sitl.px4.signals import SetpointKind

_MAV_TYPE_QUADROTOR = 2
_MAV_AUTOPILOT_PX4 = 12
_PREARM_BIT = 0x10000000
# Gyro, accelerometer, magnetometer, pressure, GPS, rate and attitude control, motors, AHRS,
# battery.
_SENSOR_BITS = 0x1 | 0x2 | 0x4 | 0x8 | 0x20 | 0x400 | 0x800 | 0x8000 | 0x200000 | 0x2000000
_GPS_BIT = 0x20
_EXTENSION_BIT = 0x80000000  # there are further sensor bits in extension fields; always set
_NAN = math.nan
_UINT16_MAX = 65535
# Upper triangle of a 6x6 covariance, row by row.
_DIAGONAL = frozenset({0, 6, 11, 15, 18, 20})
# MAVLink's capability bits that PX4 shows: mission float and int, parameters float and bytewise,
# COMMAND_INT, FTP, attitude and local position targets, flight termination, MAVLink 2, fence and
# rally missions.
_CAPABILITIES = 0x1 | 0x2 | 0x4 | 0x8 | 0x10 | 0x20 | 0x40 | 0x80 | 0x800 | 0x2000 | 0x4000 | 0x8000

# of a PX4 built for simulation, for system id 1; read from v1.16 and v1.18
_SIMULATION_UID = 0x4954414C44494E4F

Values = tuple[Any, ...]
Builder = Callable[[View], Values | None]


def _ordered(name: str, **fields: Any) -> Values:
    return Encoder.values(name, **fields)


def _clip(value: float, low: int, high: int) -> int:
    return max(low, min(high, round(value))) if math.isfinite(value) else 0


def _degrees_and_mm(
    latitude_deg: float, longitude_deg: float, altitude_m: float
) -> tuple[int, int, int]:
    """Return a place as MAVLink's integers: degrees times 1e7, and millimetres."""
    latitude, longitude, altitude = (
        _clip(value, -(2**31), 2**31 - 1)
        for value in (latitude_deg * 1e7, longitude_deg * 1e7, altitude_m * 1e3)
    )
    return latitude, longitude, altitude


def _int16(value: float) -> int:
    return _clip(value, -32768, 32767)


# -- state of the autopilot ------------------------------------------------------------------------


def heartbeat(v: View) -> Values:
    a, now = v.autopilot, v.now_s
    custom = MODES[a.shown_mode].custom_mode
    return (
        custom,
        _MAV_TYPE_QUADROTOR,
        _MAV_AUTOPILOT_PX4,
        a.base_mode(now),
        int(a.system_status(now)),
        3,
    )


def current_mode(v: View) -> Values:
    mode = v.autopilot.shown_mode
    return (
        MODES[mode].custom_mode,
        MODES[v.autopilot.intent].custom_mode,
        MODES[mode].standard_mode,
    )


def sys_status(v: View) -> Values:
    autopilot = v.autopilot
    estimator, i = v.emulator.estimator, v.index
    hears_satellites = estimator.has_gps[i] and not estimator.gps_blocked[i]
    health = _SENSOR_BITS if hears_satellites else _SENSOR_BITS & ~_GPS_BIT
    if autopilot.is_armed or not autopilot.arming_obstacles(v.now_s):
        health |= _PREARM_BIT
    present = _SENSOR_BITS | _PREARM_BIT | _EXTENSION_BIT
    health |= _EXTENSION_BIT
    battery = autopilot.battery
    current_ca = autopilot.version.no_current_ca
    return (
        present,
        present,
        health,
        100,
        battery.voltage_mv,
        current_ca,
        *[0] * 6,
        battery.remaining_pct,
        0,
        0,
        0,
    )


def battery_status(v: View) -> Values:
    autopilot = v.autopilot
    return _ordered(
        "BATTERY_STATUS",
        current_consumed=0,
        energy_consumed=-1,
        temperature=32767,
        voltages=[max(EMPTY_MV, autopilot.battery.voltage_mv)] + [_UINT16_MAX] * 9,
        current_battery=autopilot.version.no_current_ca,
        id=0,
        type=1,
        battery_remaining=autopilot.battery.remaining_pct,
        charge_state=autopilot.charge_state.value,
    )


def extended_sys_state(v: View) -> Values:
    return (0, int(v.autopilot.landed))


def estimator_status(v: View) -> Values:
    estimator, i, now_s = v.emulator.estimator, v.index, v.emulator.time_s
    accuracy_m = estimator.accuracy_m(i, now_s)
    return (v.boot_us, *((0.1,) * 6), accuracy_m, accuracy_m, estimator.flags(i, now_s))


def mission_current(v: View) -> Values:
    return _ordered("MISSION_CURRENT", mission_state=1)  # there is no mission


def current_event_sequence(v: View) -> Values:
    return (v.autopilot.journal.newest_sequence, 0)


def time_estimate_to_target(v: View) -> Values:
    return (-1, -1, -1, -1, -1)


def link_node_status(v: View) -> Values:
    return (v.boot_us, 24_000, 0, 0, 0, 0, 0, 0, 0, 100, 100)


def autopilot_version(v: View) -> Values:
    version = v.autopilot.version.flight_sw_version
    return _ordered(
        "AUTOPILOT_VERSION",
        capabilities=_CAPABILITIES,
        uid=_SIMULATION_UID + v.system_id - 1,
        flight_sw_version=version,
        middleware_sw_version=version,
        os_sw_version=0x060000FF,
        board_version=1,
        uid2=[v.system_id - 1] + [0] * 17,
    )


def protocol_version(v: View) -> Values:
    return (200, 100, 200, *((0,) * 16))


def flight_information(v: View) -> Values:
    return (0, 0, 0, v.boot_ms, 0)


# -- attitude and position -------------------------------------------------------------------------


def attitude(v: View) -> Values:
    return (v.boot_ms, *frames.euler(v.sensed.attitude), *v.sensed.rates_rad_s)


def attitude_quaternion(v: View) -> Values:
    return (v.boot_ms, *v.sensed.attitude, *v.sensed.rates_rad_s, 0.0, 0.0, 0.0, 0.0)


def local_position_ned(v: View) -> Values:
    return (v.boot_ms, *v.sensed.position_ned_m, *v.sensed.velocity_ned_m_s)


@functools.cache
def _covariance(off_diagonal: float) -> tuple[float, ...]:
    return tuple(0.01 if position in _DIAGONAL else off_diagonal for position in range(21))


def odometry(v: View) -> Values:
    covariance = _covariance(v.autopilot.version.covariance_off_diagonal)
    return (
        v.boot_us,
        *v.sensed.position_ned_m,
        *v.sensed.attitude,
        *v.sensed.velocity_ned_m_s,
        *v.sensed.rates_rad_s,
        *covariance,
        *covariance,
        1,  # local NED, also for the velocity
        1,
        v.reset_counter,
        8,  # estimated by the autopilot
        0,
    )


def global_position_int(v: View) -> Values:
    place = v.global_position
    above_home = _clip((place[2] - v.home_altitude_m) * 1e3, -(2**31), 2**31 - 1)
    speed = (_int16(100.0 * c) for c in v.sensed.velocity_ned_m_s)
    heading = round(math.degrees(v.yaw_rad) * 100.0) % 36000
    return (v.boot_ms, *_degrees_and_mm(*place), above_home, *speed, heading)


def gps_raw_int(v: View) -> Values:
    fix, satellites = (3, 10) if v.has_fix else (0, 0)
    lat, lon, alt = _degrees_and_mm(*v.global_position)
    vx, vy, _ = v.sensed.velocity_ned_m_s
    speed, course = math.hypot(vx, vy), math.degrees(math.atan2(vy, vx)) % 360.0
    cm_s, cdeg = _clip(100.0 * speed, 0, _UINT16_MAX), _clip(100.0 * course, 0, 35999)
    return (v.boot_us, lat, lon, alt, 90, 90, cm_s, cdeg, fix, satellites, alt, 900, 1780, 0, 0, 0)


def altitude(v: View) -> Values:
    height = -v.sensed.position_ned_m[2]
    above_home = height + HOME_ALTITUDE_M - v.home_altitude_m
    return (v.boot_us, HOME_ALTITUDE_M, HOME_ALTITUDE_M + height, height, above_home, _NAN, _NAN)


def vfr_hud(v: View) -> Values:
    vx, vy, vz = v.sensed.velocity_ned_m_s
    speed = math.hypot(vx, vy)
    heading = int(math.degrees(v.yaw_rad) % 360.0)
    throttle = round(100.0 * v.autopilot.actuation.thrust_frac)
    return (speed, speed, HOME_ALTITUDE_M - v.sensed.position_ned_m[2], -vz, heading, throttle)


def home_position(v: View) -> Values | None:
    if not v.has_origin:
        return None
    north, east, down = v.home_ned_m
    latitude, longitude, altitude = _degrees_and_mm(*v.to_global(v.home_ned_m))
    return _ordered(
        "HOME_POSITION",
        latitude=latitude,
        longitude=longitude,
        altitude=altitude,
        x=north,
        y=east,
        z=down,
        q=[1.0, 0.0, 0.0, 0.0],
        approach_x=_NAN,
        approach_y=_NAN,
        approach_z=_NAN,
        time_usec=v.boot_us,
    )


def gps_global_origin(v: View) -> Values | None:
    if not v.has_origin:
        return None
    return (*_degrees_and_mm(*v.origin_deg, v.origin_altitude_m), v.boot_us)


# -- setpoints and outputs -------------------------------------------------------------------------


def attitude_target(v: View) -> Values:
    actuation = v.autopilot.actuation
    return (
        v.boot_ms,
        *actuation.attitude.tolist(),
        *actuation.rate_rad_s.tolist(),
        actuation.thrust_frac,
        0,
    )


def position_target_local_ned(v: View) -> Values | None:
    a = v.autopilot
    if (
        a.mode is Mode.OFFBOARD
        and a.setpoint is not None
        and a.setpoint.kind is not SetpointKind.POSITION
    ):
        return None
    goal = a.mode_control.goal
    if goal is None:
        return (v.boot_ms, *((_NAN,) * 11), 0, 1)
    position, speed = goal.position_ned_m.tolist(), goal.velocity_ned_m_s.tolist()
    return (v.boot_ms, *position, *speed, _NAN, _NAN, _NAN, goal.yaw_rad, _NAN, 0, 1)


def position_target_global_int(v: View) -> Values | None:
    a = v.autopilot
    if not a.is_armed or a.mode_control.goal is None or MODES[a.mode].main != 4:
        return None
    north, east, down = a.mode_control.goal.position_ned_m.tolist()
    here = v.sensed.position_ned_m
    position = tuple(
        g if math.isfinite(g) else h for g, h in zip((north, east, down), here, strict=True)
    )
    latitude, longitude, height = v.to_global((position[0], position[1], position[2]))
    return (v.boot_ms, round(latitude * 1e7), round(longitude * 1e7), height, *((0.0,) * 8), 0, 5)


def _commanded_thrust(v: View) -> float:
    """Return the thrust that is commanded to the motors, before their lag."""
    actuation = v.autopilot.actuation
    return actuation.thrust_frac if actuation.motors_on else 0.0


def _pulse(v: View) -> int:
    return round(1000.0 + 1000.0 * _commanded_thrust(v)) if v.autopilot.is_armed else 900


def servo_output_raw(v: View) -> Values:
    pulse = _pulse(v)
    return (
        v.boot_us & 0xFFFFFFFF,
        pulse,
        pulse,
        pulse,
        pulse,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
    )


def actuator_output_status(v: View) -> Values:
    return (v.boot_us, 4, *((float(_pulse(v)),) * 4), *((0.0,) * 28))


def hil_actuator_controls(v: View) -> Values:
    thrust = _commanded_thrust(v)
    return (v.boot_us, 0, *((thrust,) * 4), *((0.0,) * 12), 129 if v.autopilot.is_armed else 1)


# -- sensors ---------------------------------------------------------------------------------------


def highres_imu(v: View) -> Values:
    height = HOME_ALTITUDE_M - v.sensed.position_ned_m[2]
    magnetometer, pressure_hpa = (0.21, 0.0, 0.43), 955.0
    return (
        v.boot_us,
        *v.accelerometer(),
        *v.sensed.rates_rad_s,
        *magnetometer,
        pressure_hpa,
        0.0,
        height,
        25.0,
        7167,
        0,
    )


def scaled_pressure(v: View) -> Values:
    return (v.boot_ms, 955.0, 0.0, 2500, 0)


def distance_sensor(v: View) -> Values | None:
    height_m = -float(v.emulator.world.vehicles.states.position_ned_m[v.index, 2])
    centimetres = _clip(100.0 * height_m, 0, _UINT16_MAX)
    return (v.boot_ms, 0, 10_000, centimetres, 0, 0, 25, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0)


def vibration(v: View) -> Values:
    level = 0.002 if v.autopilot.landed == 1 else 0.02
    return (v.boot_us, level, level, level, 0, 0, 0)


def hil_state_quaternion(v: View) -> Values:
    """Ground truth, as the simulator's own link of PX4 has it: its time stamp is zero."""
    states, i = v.emulator.world.vehicles.states, v.index
    north, east, down = states.position_ned_m[i].tolist()
    start_east, start_north, start_up = v.emulator.specs[i].start_enu_m
    position = _degrees_and_mm(
        *v.to_global((north - start_north, east - start_east, down + start_up))
    )
    speed = [_int16(100.0 * c) for c in states.velocity_ned_m_s[i].tolist()]
    p, q = states.tilt_rate_rad_s[i].tolist()
    attitude_wxyz = states.attitude[i].tolist()
    mg = [_int16(c / 9.80665e-3) for c in v.accelerometer()]
    return (0, *attitude_wxyz, p, q, float(states.yaw_rate_rad_s[i]), *position, *speed, 0, 0, *mg)


# -- time, identity --------------------------------------------------------------------------------


def timesync(v: View) -> Values:
    return (0, v.boot_us * 1000)


def system_time(v: View) -> Values:
    return (round(v.unix_s * 1e6), v.boot_ms)


def ping(v: View) -> Values:
    return (v.boot_us, 0, 0, 0)


def open_drone_id_location(v: View) -> Values:
    height = v.global_position[2]
    latitude, longitude, _ = _degrees_and_mm(*v.global_position)
    flies = v.autopilot.landed != 1
    vx, vy, vz = v.sensed.velocity_ned_m_s
    return _ordered(
        "OPEN_DRONE_ID_LOCATION",
        latitude=latitude,
        longitude=longitude,
        altitude_barometric=height,
        altitude_geodetic=height,
        height=height - HOME_ALTITUDE_M,
        timestamp=65535.0,
        direction=round(math.degrees(v.yaw_rad) * 100.0) % 36000,
        speed_horizontal=_clip(100.0 * math.hypot(vx, vy), 0, 25425),
        speed_vertical=_clip(-100.0 * vz, -6200, 6200),
        status=2 if flies else 1,
    )


def open_drone_id_system(v: View) -> Values:
    latitude, longitude = v.origin_deg
    return _ordered(
        "OPEN_DRONE_ID_SYSTEM",
        operator_latitude=round(latitude * 1e7),
        operator_longitude=round(longitude * 1e7),
        area_ceiling=-1000.0,
        area_floor=-1000.0,
        operator_altitude_geo=HOME_ALTITUDE_M,
        area_count=1,
    )
