"""Contents of the streamed messages of a PX4, with one builder for each message.

A builder takes a view of the vehicle. It returns the values of the message in wire order, or None
while the message has no content. Most builders return plain tuples, because they are called
thousands of times a second. A comment after a value names its field where the value does not. Where
many fields of a message are zero, `_ordered` puts the other fields into wire order by their names.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

from sitl.mavlink.codec import Encoder
from sitl.mavlink.view import View
from sitl.physics import frames
from sitl.physics.earth import degrees_at
from sitl.px4.arming_checks import BOOT_S
from sitl.px4.battery import EMPTY_MV
from sitl.px4.modes import AUTO_MAIN, MODES, LandedState, Mode
from sitl.px4.signals import SetpointKind

_MAV_TYPE_QUADROTOR = 2
_MAV_AUTOPILOT_PX4 = 12
_MAVLINK_VERSION = 3
_LOCAL_NED = 1
_GLOBAL_INT = 5

_PREARM_BIT = 0x10000000
# Gyro, accelerometer, magnetometer, pressure, GPS, rate and attitude control, motors, AHRS,
# battery.
_SENSOR_BITS = 0x1 | 0x2 | 0x4 | 0x8 | 0x20 | 0x400 | 0x800 | 0x8000 | 0x200000 | 0x2000000
_GPS_BIT = 0x20
_EXTENSION_BIT = 0x80000000  # extension fields have further sensor bits; always set

_NAN = math.nan
_UINT16_MAX = 65535
_INT32_MIN = -(2**31)
_INT32_MAX = 2**31 - 1

# Upper triangle of a 6x6 covariance, row by row.
_DIAGONAL = frozenset({0, 6, 11, 15, 18, 20})
# MAVLink's capability bits of PX4: mission float and int, parameters float and bytewise,
# COMMAND_INT, FTP, attitude and local position targets, flight termination, MAVLink 2, fence and
# rally missions.
_CAPABILITIES = 0x1 | 0x2 | 0x4 | 0x8 | 0x10 | 0x20 | 0x40 | 0x80 | 0x800 | 0x2000 | 0x4000 | 0x8000

# uid of a PX4 built for simulation with system id 1, read from v1.16 and v1.18.
_SIMULATION_UID = 0x4954414C44494E4F

Values = tuple[Any, ...]
Builder = Callable[[View], Values | None]


def _ordered(name: str, **fields: Any) -> Values:
    return Encoder.values(name, **fields)


def _clip(value: float, low: int, high: int) -> int:
    """Return a value as an integer within bounds; 0 for NaN and infinity."""
    if not math.isfinite(value):
        return 0
    return max(low, min(high, round(value)))


def _int16(value: float) -> int:
    return _clip(value, -32768, 32767)


def _int32(value: float) -> int:
    return _clip(value, _INT32_MIN, _INT32_MAX)


def _degrees_and_mm(
    latitude_deg: float, longitude_deg: float, altitude_m: float
) -> tuple[int, int, int]:
    """Return a global position as MAVLink's integers: degrees times 1e7, and millimetres."""
    return _int32(latitude_deg * 1e7), _int32(longitude_deg * 1e7), _int32(altitude_m * 1e3)


def _heading_cdeg(v: View) -> int:
    return round(math.degrees(v.yaw_rad) * 100.0) % 36000


# -- state of the autopilot ------------------------------------------------------------------------


def heartbeat(v: View) -> Values:
    px4 = v.autopilot
    now_s = v.now_s
    return (
        MODES[px4.shown_mode].custom_mode,
        _MAV_TYPE_QUADROTOR,
        _MAV_AUTOPILOT_PX4,
        px4.base_mode(now_s),
        int(px4.system_status(now_s)),
        _MAVLINK_VERSION,
    )


def current_mode(v: View) -> Values:
    px4 = v.autopilot
    shown = MODES[px4.shown_mode]
    intended = MODES[px4.requested_mode]
    return (shown.custom_mode, intended.custom_mode, shown.standard_mode)


def sys_status(v: View) -> Values:
    px4 = v.autopilot
    estimator = v.emulator.estimator
    present = _SENSOR_BITS | _PREARM_BIT | _EXTENSION_BIT

    health = _SENSOR_BITS | _EXTENSION_BIT
    sensors = estimator.sensors[v.index]
    receives_satellites = sensors.has_gps and not sensors.gps_blocked
    if not receives_satellites:
        health &= ~_GPS_BIT
    if px4.is_armed or not px4.arming_obstacles(v.now_s):
        health |= _PREARM_BIT

    return (
        present,
        present,  # enabled
        health,
        100,  # load of the processor
        px4.battery.voltage_mv,
        px4.version.no_current_ca,
        *[0] * 6,  # errors
        px4.battery.remaining_pct,
        *[0] * 3,  # further sensor bits
    )


def battery_status(v: View) -> Values:
    px4 = v.autopilot
    return _ordered(
        "BATTERY_STATUS",
        current_consumed=0,
        energy_consumed=-1,
        temperature=32767,
        voltages=[max(EMPTY_MV, px4.battery.voltage_mv)] + [_UINT16_MAX] * 9,
        current_battery=px4.version.no_current_ca,
        id=0,
        type=1,
        battery_remaining=px4.battery.remaining_pct,
        charge_state=px4.charge_state.value,
    )


def manual_control(v: View) -> Values | None:
    px4 = v.autopilot
    if not px4.has_sticks(v.now_s):
        return None
    pitch, roll, throttle, yaw = (round(1000.0 * position) for position in px4.sticks.positions)
    return _ordered("MANUAL_CONTROL", target=v.system_id, x=pitch, y=roll, z=throttle, r=yaw)


def extended_sys_state(v: View) -> Values:
    vtol_state = 0
    return (vtol_state, int(v.autopilot.landed))


def estimator_status(v: View) -> Values:
    estimator = v.emulator.estimator
    now_s = v.emulator.time_s
    accuracy_m = estimator.accuracy_m(v.index, now_s)
    return (
        v.boot_us,
        0.1,  # test ratio of the velocity
        estimator.position_ratio(v.index),
        0.1,  # of the height
        estimator.heading_ratio(v.index),
        *[0.1] * 2,  # of the height above the ground and of the airspeed
        accuracy_m,  # horizontal
        accuracy_m,  # vertical
        estimator.flags(v.index, now_s),
    )


def mission_current(v: View) -> Values:
    no_mission = 1
    return _ordered("MISSION_CURRENT", mission_state=no_mission)


def current_event_sequence(v: View) -> Values:
    flags = 0
    return (v.autopilot.journal.newest_sequence, flags)


def time_estimate_to_target(v: View) -> Values:
    unknown = -1
    return (unknown,) * 5


def link_node_status(v: View) -> Values:
    return (
        v.boot_us,
        24_000,  # sent [bytes/s]
        0,  # received [bytes/s]
        *[0] * 6,  # messages and errors
        100,  # free part of the buffers [%]: sending
        100,  # receiving
    )


def autopilot_version(v: View) -> Values:
    flight_sw_version = v.autopilot.version.flight_sw_version
    return _ordered(
        "AUTOPILOT_VERSION",
        capabilities=_CAPABILITIES,
        uid=_SIMULATION_UID + v.system_id - 1,
        flight_sw_version=flight_sw_version,
        middleware_sw_version=flight_sw_version,
        os_sw_version=0x060000FF,
        board_version=1,
        uid2=[v.system_id - 1] + [0] * 17,
    )


def protocol_version(v: View) -> Values:
    present = 200
    least = 100
    most = 200
    return (present, least, most, *[0] * 16)


def flight_information(v: View) -> Values:
    return _ordered("FLIGHT_INFORMATION", time_boot_ms=v.boot_ms)


# -- attitude and position -------------------------------------------------------------------------


def attitude(v: View) -> Values:
    return (v.boot_ms, *frames.euler(v.sensed.attitude), *v.sensed.rates_rad_s)


def attitude_quaternion(v: View) -> Values:
    no_offset = (0.0, 0.0, 0.0, 0.0)
    return (v.boot_ms, *v.sensed.attitude, *v.sensed.rates_rad_s, *no_offset)


def local_position_ned(v: View) -> Values:
    return (v.boot_ms, *v.sensed.position_ned_m, *v.sensed.velocity_ned_m_s)


@functools.cache
def _covariance(off_diagonal: float) -> tuple[float, ...]:
    covariance = [off_diagonal] * 21
    for position in _DIAGONAL:
        covariance[position] = 0.01
    return tuple(covariance)


def odometry(v: View) -> Values:
    covariance = _covariance(v.autopilot.version.covariance_off_diagonal)
    return (
        v.boot_us,
        *v.sensed.position_ned_m,
        *v.sensed.attitude,
        *v.sensed.velocity_ned_m_s,
        *v.sensed.rates_rad_s,
        *covariance,  # pose
        *covariance,  # velocity
        _LOCAL_NED,  # frame
        _LOCAL_NED,  # frame of the velocity
        v.reset_counter,
        8,  # estimated by the autopilot
        0,  # quality
    )


def global_position_int(v: View) -> Values:
    latitude_deg, longitude_deg, altitude_m = v.global_position
    vx, vy, vz = v.sensed.velocity_ned_m_s
    return (
        v.boot_ms,
        *_degrees_and_mm(latitude_deg, longitude_deg, altitude_m),
        _int32((altitude_m - v.home_altitude_m) * 1e3),
        _int16(100.0 * vx),
        _int16(100.0 * vy),
        _int16(100.0 * vz),
        _heading_cdeg(v),
    )


def gps_raw_int(v: View) -> Values:
    fix_type = v.fix_type
    satellites = 0
    if v.has_fix:
        satellites = 10

    latitude, longitude, altitude_mm = _degrees_and_mm(*v.global_position)
    vx, vy, _ = v.sensed.velocity_ned_m_s
    speed_m_s = math.hypot(vx, vy)
    course_deg = math.degrees(math.atan2(vy, vx)) % 360.0
    return (
        v.boot_us,
        latitude,
        longitude,
        altitude_mm,
        90,  # dilution of precision, horizontal
        90,  # dilution of precision, vertical
        _clip(100.0 * speed_m_s, 0, _UINT16_MAX),
        _clip(100.0 * course_deg, 0, 35999),
        fix_type,
        satellites,
        altitude_mm,  # above the ellipsoid
        v.fix_accuracy_mm,
        1780,  # vertical accuracy
        0,  # accuracy of the speed
        0,  # accuracy of the heading
        0,  # yaw, which is not known
    )


def altitude(v: View) -> Values:
    height_m = -v.sensed.position_ned_m[2]
    altitude_m = v.origin_altitude_m + height_m
    return (
        v.boot_us,
        v.ground_altitude_m,  # monotonic
        altitude_m,  # above the sea
        height_m,  # in the local frame
        altitude_m - v.home_altitude_m,  # above home
        _NAN,  # above the terrain
        _NAN,  # below the vehicle
    )


def vfr_hud(v: View) -> Values:
    vx, vy, vz = v.sensed.velocity_ned_m_s
    speed_m_s = math.hypot(vx, vy)
    return (
        speed_m_s,  # in the air
        speed_m_s,  # over the ground
        v.origin_altitude_m - v.sensed.position_ned_m[2],
        -vz,
        int(math.degrees(v.yaw_rad) % 360.0),
        round(100.0 * v.autopilot.actuation.thrust_frac),
    )


def home_position(v: View) -> Values | None:
    # PX4 sets home once its checks pass. Programs take this as the sign that PX4 can be armed.
    if not v.has_origin or v.time_s < BOOT_S:
        return None

    north, east, down = v.home_ned_m
    latitude, longitude, altitude_mm = _degrees_and_mm(*v.to_global(v.home_ned_m))
    return _ordered(
        "HOME_POSITION",
        latitude=latitude,
        longitude=longitude,
        altitude=altitude_mm,
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
    type_mask = 0
    return (
        v.boot_ms,
        *actuation.attitude.tolist(),
        *actuation.rate_rad_s.tolist(),
        actuation.thrust_frac,
        type_mask,
    )


def position_target_local_ned(v: View) -> Values | None:
    px4 = v.autopilot
    setpoint = px4.setpoint
    is_in_offboard = px4.mode is Mode.OFFBOARD
    if is_in_offboard and setpoint is not None and setpoint.kind is not SetpointKind.POSITION:
        return None

    type_mask = 0
    goal = px4.mode_control.goal
    if goal is None:
        return (v.boot_ms, *[_NAN] * 11, type_mask, _LOCAL_NED)
    return (
        v.boot_ms,
        *goal.position_ned_m.tolist(),
        *goal.velocity_ned_m_s.tolist(),
        *[_NAN] * 3,  # acceleration
        goal.yaw_rad,
        _NAN,  # yaw rate
        type_mask,
        _LOCAL_NED,
    )


def position_target_global_int(v: View) -> Values | None:
    px4 = v.autopilot
    goal = px4.mode_control.goal
    if not px4.is_armed or goal is None or MODES[px4.mode].main != AUTO_MAIN:
        return None

    # On an axis without a goal position, use the position of the vehicle.
    position_ned_m = list(v.sensed.position_ned_m)
    for axis, goal_m in enumerate(goal.position_ned_m.tolist()):
        if math.isfinite(goal_m):
            position_ned_m[axis] = goal_m
    north, east, down = position_ned_m
    latitude_deg, longitude_deg, altitude_m = v.to_global((north, east, down))

    type_mask = 0
    return (
        v.boot_ms,
        round(latitude_deg * 1e7),
        round(longitude_deg * 1e7),
        altitude_m,
        *[0.0] * 8,  # velocity, acceleration, yaw and its rate
        type_mask,
        _GLOBAL_INT,
    )


def _commanded_thrust(v: View) -> float:
    """Return the thrust commanded to the motors, before their lag."""
    actuation = v.autopilot.actuation
    if not actuation.motors_on:
        return 0.0
    return actuation.thrust_frac


def _pulse_us(v: View) -> int:
    """Return the length of the pulse to each motor."""
    if not v.autopilot.is_armed:
        return 900
    return round(1000.0 + 1000.0 * _commanded_thrust(v))


def servo_output_raw(v: View) -> Values:
    port = 0
    return (
        v.boot_us & 0xFFFFFFFF,
        *[_pulse_us(v)] * 4,
        *[0] * 4,  # outputs 5 to 8
        port,
        *[0] * 8,  # outputs 9 to 16
    )


def actuator_output_status(v: View) -> Values:
    active = 4
    return (v.boot_us, active, *[float(_pulse_us(v))] * 4, *[0.0] * 28)


def hil_actuator_controls(v: View) -> Values:
    flags = 0
    mode = 1
    if v.autopilot.is_armed:
        mode = 129
    return (v.boot_us, flags, *[_commanded_thrust(v)] * 4, *[0.0] * 12, mode)


# -- sensors ---------------------------------------------------------------------------------------


def highres_imu(v: View) -> Values:
    # The gyros and the accelerometer draw their noise from one generator, in this order.
    sensed = v.sensed
    return (
        v.boot_us,
        *v.accelerometer(),
        *sensed.rates_rad_s,
        *(0.21, 0.0, 0.43),  # magnetometer [gauss]
        955.0,  # pressure [hPa]
        0.0,  # pressure of the airflow
        v.true_altitude_m,  # pressure altitude
        25.0,  # temperature [deg C]
        7167,  # bits of the updated fields
        0,  # id
    )


def scaled_pressure(v: View) -> Values:
    return _ordered("SCALED_PRESSURE", time_boot_ms=v.boot_ms, press_abs=955.0, temperature=2500)


def distance_sensor(v: View) -> Values | None:
    return _ordered(
        "DISTANCE_SENSOR",
        time_boot_ms=v.boot_ms,
        max_distance=10_000,
        current_distance=_clip(100.0 * v.true_height_m, 0, _UINT16_MAX),
        orientation=25,  # down
    )


def vibration(v: View) -> Values:
    level = 0.02
    if v.autopilot.landed is LandedState.ON_GROUND:
        level = 0.002
    clippings = (0, 0, 0)
    return (v.boot_us, level, level, level, *clippings)


def hil_state_quaternion(v: View) -> Values:
    """Return ground truth as on the link of PX4's simulator, where its time stamp is zero."""
    states = v.emulator.world.vehicles.states
    index = v.index

    # Truth counts from the start of the vehicle, whatever origin its PX4 has received.
    north, east, _ = states.position_ned_m[index].tolist()
    start_east, start_north, _ = v.emulator.specs[index].start_enu_m
    latitude_deg, longitude_deg = degrees_at(
        v.start_on_earth, north - start_north, east - start_east
    )

    specific_force_mg = [_int16(force_m_s2 / 9.80665e-3) for force_m_s2 in v.accelerometer()]
    return (
        0,  # time
        *states.attitude[index].tolist(),
        *states.tilt_rate_rad_s[index].tolist(),
        float(states.yaw_rate_rad_s[index]),
        *_degrees_and_mm(latitude_deg, longitude_deg, v.true_altitude_m),
        *[_int16(100.0 * speed_m_s) for speed_m_s in states.velocity_ned_m_s[index].tolist()],
        0,  # indicated airspeed
        0,  # true airspeed
        *specific_force_mg,
    )


# -- time, identity --------------------------------------------------------------------------------


def timesync(v: View) -> Values:
    is_request = 0
    return (is_request, v.boot_us * 1000)


def system_time(v: View) -> Values:
    return (round(v.unix_s * 1e6), v.boot_ms)


def ping(v: View) -> Values:
    sequence = 0
    all_components = (0, 0)
    return (v.boot_us, sequence, *all_components)


def open_drone_id_location(v: View) -> Values:
    latitude_deg, longitude_deg, altitude_m = v.global_position
    latitude, longitude, _ = _degrees_and_mm(latitude_deg, longitude_deg, altitude_m)
    vx, vy, vz = v.sensed.velocity_ned_m_s

    on_ground = 1
    airborne = 2
    status = airborne
    if v.autopilot.landed is LandedState.ON_GROUND:
        status = on_ground
    return _ordered(
        "OPEN_DRONE_ID_LOCATION",
        latitude=latitude,
        longitude=longitude,
        altitude_barometric=altitude_m,
        altitude_geodetic=altitude_m,
        height=altitude_m - v.home_altitude_m,
        timestamp=65535.0,  # unknown, as MAVLink defines
        direction=_heading_cdeg(v),
        speed_horizontal=_clip(100.0 * math.hypot(vx, vy), 0, 25425),
        speed_vertical=_clip(-100.0 * vz, -6200, 6200),
        status=status,
    )


def open_drone_id_system(v: View) -> Values:
    latitude_deg, longitude_deg = v.origin_deg
    return _ordered(
        "OPEN_DRONE_ID_SYSTEM",
        operator_latitude=round(latitude_deg * 1e7),
        operator_longitude=round(longitude_deg * 1e7),
        area_ceiling=-1000.0,
        area_floor=-1000.0,
        operator_altitude_geo=v.home_altitude_m,
        area_count=1,
    )
