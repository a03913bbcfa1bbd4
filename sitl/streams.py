"""The messages that a PX4 streams by itself: one builder each, and the default rates of its two links."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from sitl import rotation
from sitl.battery import EMPTY_MV
from sitl.emulator import Emulator
from sitl.mavlink import ID_BY_NAME, Encoder
from sitl.modes import MODES
from sitl.sensors import Source
from sitl.vehicle import GRAVITY_M_S2

HOME_LATITUDE_DEG, HOME_LONGITUDE_DEG, HOME_ALTITUDE_M = 47.397742, 8.545594, 489.4
_METRES_PER_DEGREE = 111_319.49
_MAV_TYPE_QUADROTOR = 2
_MAV_AUTOPILOT_PX4 = 12
_PREARM_BIT = 0x10000000
# Gyro, accelerometer, magnetometer, pressure, GPS, rate and attitude control, motors, AHRS, battery.
_SENSOR_BITS = 0x1 | 0x2 | 0x4 | 0x8 | 0x20 | 0x400 | 0x800 | 0x8000 | 0x200000 | 0x2000000
_GPS_BIT = 0x20
_NAN = math.nan
_NAN_COVARIANCE = (_NAN,) * 20
_UINT16_MAX = 65535


@dataclass(slots=True)
class View:
    """One vehicle as its messages show it; encodes with the sequence numbers of one link."""

    emulator: Emulator
    index: int
    encoder: Encoder

    @property
    def boot_ms(self) -> int:
        """time_boot_ms: simulated time."""
        return round(self.emulator.time_s * 1e3) & 0xFFFFFFFF

    @property
    def boot_us(self) -> int:
        """time_usec of messages that count from boot."""
        return round(self.emulator.time_s * 1e6)

    def attitude(self) -> tuple[float, float, float, float]:
        """Believed attitude wxyz with a sample of noise."""
        roll, pitch, yaw = self.emulator.estimator.attitude_noise()
        w, x, y, z = self.emulator.believed_attitude(self.index).tolist()
        # A small rotation applied on the body's side; its square is far below the noise.
        w, x, y, z = (
            w - 0.5 * (x * roll + y * pitch + z * yaw),
            x + 0.5 * (w * roll + y * yaw - z * pitch),
            y + 0.5 * (w * pitch + z * roll - x * yaw),
            z + 0.5 * (w * yaw + x * pitch - y * roll),
        )
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        return w / norm, x / norm, y / norm, z / norm

    def body_rates(self) -> tuple[float, float, float]:
        """Measured body rates [rad/s]."""
        states = self.emulator.world.vehicles.states
        p, q = states.tilt_rate_rad_s[self.index].tolist()
        r = float(states.yaw_rate_rad_s[self.index])
        noise = self.emulator.estimator.gyro_noise()
        return p + noise[0], q + noise[1], r + noise[2]

    def global_position(self) -> tuple[float, float, float]:
        """Latitude [deg], longitude [deg], altitude [m] of the estimate."""
        origin = self.emulator.specs[self.index].start_enu_m
        north, east, down = self.emulator.estimator.local(self.index).position_ned_m
        lat = HOME_LATITUDE_DEG + (north + origin[1]) / _METRES_PER_DEGREE
        scale = _METRES_PER_DEGREE * math.cos(math.radians(HOME_LATITUDE_DEG))
        return lat, HOME_LONGITUDE_DEG + (east + origin[0]) / scale, HOME_ALTITUDE_M - down


def _heartbeat(v: View) -> tuple[Any, ...]:
    a, now = v.emulator.autopilots[v.index], v.emulator.time_s
    custom = MODES[a.mode].custom_mode
    return (custom, _MAV_TYPE_QUADROTOR, _MAV_AUTOPILOT_PX4, a.base_mode(now), int(a.system_status(now)), 3)


def _attitude(v: View) -> tuple[Any, ...]:
    return (v.boot_ms, *rotation.euler(v.attitude()), *v.body_rates())


def _attitude_quaternion(v: View) -> tuple[Any, ...]:
    return (v.boot_ms, *v.attitude(), *v.body_rates(), 0.0, 0.0, 0.0, 0.0)


def _local_position(v: View) -> tuple[Any, ...]:
    local = v.emulator.estimator.local(v.index)
    return (v.boot_ms, *local.position_ned_m, *local.velocity_ned_m_s)


def _odometry(v: View) -> tuple[Any, ...]:
    local = v.emulator.estimator.local(v.index)
    return (
        v.boot_us,
        *local.position_ned_m,
        *v.attitude(),
        *local.velocity_ned_m_s,
        *v.body_rates(),
        0.01,
        *_NAN_COVARIANCE,
        0.01,
        *_NAN_COVARIANCE,
        1,
        1,
        13,
        8,
        0,
    )


def _global_position_int(v: View) -> tuple[Any, ...]:
    lat, lon, alt = v.global_position()
    local = v.emulator.estimator.local(v.index)
    velocity = [max(-32767, min(32767, round(100.0 * c))) for c in local.velocity_ned_m_s]
    heading = round(math.degrees(v.emulator.believed_yaw_rad(v.index)) * 100.0) % 36000
    relative = -local.position_ned_m[2]
    return (v.boot_ms, round(lat * 1e7), round(lon * 1e7), round(alt * 1e3), round(relative * 1e3), *velocity, heading)


def _gps_raw(v: View) -> tuple[Any, ...]:
    lat, lon, alt = v.global_position()
    has_fix = v.emulator.estimator.has_gps[v.index] and v.emulator.time_s > 2.3
    return _ordered(
        "GPS_RAW_INT",
        time_usec=v.boot_us,
        fix_type=3 if has_fix else 0,
        lat=round(lat * 1e7),
        lon=round(lon * 1e7),
        alt=round(alt * 1e3),
        eph=90,
        epv=100,
        vel=_UINT16_MAX,
        cog=_UINT16_MAX,
        satellites_visible=10 if has_fix else 0,
    )


def _sys_status(v: View) -> tuple[Any, ...]:
    autopilot = v.emulator.autopilots[v.index]
    health = _SENSOR_BITS if v.emulator.estimator.has_gps[v.index] else _SENSOR_BITS & ~_GPS_BIT
    if not autopilot.arming_obstacles(v.emulator.time_s):
        health |= _PREARM_BIT
    present = _SENSOR_BITS | _PREARM_BIT
    return _ordered(
        "SYS_STATUS",
        onboard_control_sensors_present=present,
        onboard_control_sensors_enabled=present,
        onboard_control_sensors_health=health,
        load=100,
        voltage_battery=autopilot.battery.voltage_mv,
        current_battery=-1,
        battery_remaining=autopilot.battery.remaining_pct,
    )


def _battery_status(v: View) -> tuple[Any, ...]:
    autopilot = v.emulator.autopilots[v.index]
    battery = autopilot.battery
    return _ordered(
        "BATTERY_STATUS",
        current_consumed=0,
        energy_consumed=-1,
        temperature=32767,
        voltages=[max(EMPTY_MV, battery.voltage_mv)] + [_UINT16_MAX] * 9,
        current_battery=-100,
        id=0,
        type=1,
        battery_remaining=battery.remaining_pct,
        charge_state=autopilot.battery_stage.value,
    )


def _extended_sys_state(v: View) -> tuple[Any, ...]:
    return (0, int(v.emulator.autopilots[v.index].landed))


def _altitude(v: View) -> tuple[Any, ...]:
    height = -v.emulator.estimator.local(v.index).position_ned_m[2]
    return (v.boot_us, HOME_ALTITUDE_M, HOME_ALTITUDE_M + height, height, height, _NAN, _NAN)


def _vfr_hud(v: View) -> tuple[Any, ...]:
    local = v.emulator.estimator.local(v.index)
    speed = math.hypot(*local.velocity_ned_m_s[:2])
    yaw_deg = math.degrees(v.emulator.believed_yaw_rad(v.index)) % 360.0
    throttle = round(100.0 * v.emulator.autopilots[v.index].actuation.thrust_frac)
    altitude = HOME_ALTITUDE_M - local.position_ned_m[2]
    return _ordered(
        "VFR_HUD",
        airspeed=speed,
        groundspeed=speed,
        alt=altitude,
        climb=-local.velocity_ned_m_s[2],
        heading=int(yaw_deg),
        throttle=throttle,
    )


def _attitude_target(v: View) -> tuple[Any, ...]:
    actuation = v.emulator.autopilots[v.index].actuation
    return (v.boot_ms, *actuation.attitude.tolist(), *actuation.rate_rad_s.tolist(), actuation.thrust_frac, 0)


def _servo_output(v: View) -> tuple[Any, ...]:
    autopilot = v.emulator.autopilots[v.index]
    thrust = float(v.emulator.world.vehicles.states.thrust_frac[v.index])
    pulse = round(1000.0 + 1000.0 * thrust) if autopilot.is_armed else 900
    return _ordered(
        "SERVO_OUTPUT_RAW",
        time_usec=v.boot_us & 0xFFFFFFFF,
        servo1_raw=pulse,
        servo2_raw=pulse,
        servo3_raw=pulse,
        servo4_raw=pulse,
    )


def _highres_imu(v: View) -> tuple[Any, ...]:
    states = v.emulator.world.vehicles.states
    thrust = float(states.thrust_frac[v.index])
    up = GRAVITY_M_S2 * thrust / v.emulator.specs[v.index].profile.hover_thrust_frac
    z_force = GRAVITY_M_S2 if states.on_ground[v.index] else up
    height = HOME_ALTITUDE_M - float(states.position_ned_m[v.index][2])
    return _ordered(
        "HIGHRES_IMU",
        time_usec=v.boot_us,
        zacc=-z_force,
        **dict(zip(("xgyro", "ygyro", "zgyro"), v.body_rates(), strict=True)),
        xmag=0.21,
        zmag=0.43,
        abs_pressure=955.0,
        pressure_alt=height,
        temperature=25.0,
        fields_updated=7167,
    )


def _timesync(v: View) -> tuple[Any, ...]:
    return (0, v.boot_us * 1000)


def _system_time(v: View) -> tuple[Any, ...]:
    return (0, v.boot_ms)


def _ping(v: View) -> tuple[Any, ...]:
    return (v.boot_us, 0, 0, 0)


def _home_position(v: View) -> tuple[Any, ...]:
    origin = v.emulator.specs[v.index].start_enu_m
    scale = _METRES_PER_DEGREE * math.cos(math.radians(HOME_LATITUDE_DEG))
    return _ordered(
        "HOME_POSITION",
        latitude=round((HOME_LATITUDE_DEG + origin[1] / _METRES_PER_DEGREE) * 1e7),
        longitude=round((HOME_LONGITUDE_DEG + origin[0] / scale) * 1e7),
        altitude=round(HOME_ALTITUDE_M * 1e3),
        q=[1.0, 0.0, 0.0, 0.0],
        approach_x=_NAN,
        approach_y=_NAN,
        approach_z=_NAN,
        time_usec=v.boot_us,
    )


def _global_origin(v: View) -> tuple[Any, ...]:
    home = _home_position(v)
    return (home[0], home[1], home[2], v.boot_us)


def _estimator_status(v: View) -> tuple[Any, ...]:
    has_position = v.emulator.estimator.source[v.index] is not Source.NONE
    flags = 0x1EF if has_position else 0xE5
    return (v.boot_us, *((0.1,) * 6), 0.3, 0.3, flags)


def _autopilot_version(v: View) -> tuple[Any, ...]:
    # MAVLink 2, float parameters bytewise, attitude and position targets, COMMAND_INT, flight termination.
    capabilities = 0x1 | 0x8 | 0x40 | 0x80 | 0x800 | 0x2000 | 0x20000
    return _ordered(
        "AUTOPILOT_VERSION",
        capabilities=capabilities,
        uid=v.emulator.specs[v.index].system_id,
        flight_sw_version=0x011000FF,
        middleware_sw_version=0x011000FF,
        os_sw_version=0x060000FF,
        board_version=1,
        uid2=[v.emulator.specs[v.index].system_id] + [0] * 17,
    )


def _ordered(name: str, **fields: Any) -> tuple[Any, ...]:
    return Encoder.values(name, **fields)


Builder = Callable[[View], tuple[Any, ...]]

# Name, builder, default rate on the onboard link and on the GCS link [Hz]; 0 = only when asked for.
_TABLE: tuple[tuple[str, Builder, float, float], ...] = (
    ("HEARTBEAT", _heartbeat, 1.0, 1.0),
    ("ATTITUDE", _attitude, 100.0, 15.0),
    ("HIGHRES_IMU", _highres_imu, 50.0, 0.0),
    ("ATTITUDE_QUATERNION", _attitude_quaternion, 50.0, 10.0),
    ("GLOBAL_POSITION_INT", _global_position_int, 50.0, 10.0),
    ("LOCAL_POSITION_NED", _local_position, 30.0, 10.0),
    ("ODOMETRY", _odometry, 30.0, 0.0),
    ("TIMESYNC", _timesync, 10.0, 0.0),
    ("ALTITUDE", _altitude, 10.0, 5.0),
    ("ATTITUDE_TARGET", _attitude_target, 10.0, 2.0),
    ("SERVO_OUTPUT_RAW", _servo_output, 10.0, 1.0),
    ("VFR_HUD", _vfr_hud, 10.0, 4.0),
    ("GPS_RAW_INT", _gps_raw, 8.0, 1.0),
    ("EXTENDED_SYS_STATE", _extended_sys_state, 5.0, 1.0),
    ("SYS_STATUS", _sys_status, 5.0, 1.0),
    ("ESTIMATOR_STATUS", _estimator_status, 1.0, 0.5),
    ("PING", _ping, 1.0, 0.1),
    ("SYSTEM_TIME", _system_time, 1.0, 1.0),
    ("BATTERY_STATUS", _battery_status, 0.5, 0.5),
    ("HOME_POSITION", _home_position, 0.5, 0.5),
    ("GPS_GLOBAL_ORIGIN", _global_origin, 0.0, 0.0),
    ("AUTOPILOT_VERSION", _autopilot_version, 0.0, 0.0),
)
BUILDERS: dict[int, Builder] = {ID_BY_NAME[name]: builder for name, builder, _, _ in _TABLE}
ONBOARD_RATES_HZ: dict[int, float] = {ID_BY_NAME[name]: rate for name, _, rate, _ in _TABLE}
GCS_RATES_HZ: dict[int, float] = {ID_BY_NAME[name]: rate for name, _, _, rate in _TABLE}
HEARTBEAT_ID = ID_BY_NAME["HEARTBEAT"]
_FASTEST_S = 0.004


@dataclass(slots=True)
class Schedule:
    """When each message of a link is due, in simulated time."""

    default_hz: dict[int, float]
    interval_s: dict[int, float] = field(default_factory=dict)
    _due: list[tuple[float, int]] = field(default_factory=list)

    def start(self, now_s: float) -> None:
        """Schedule everything at its default, spread out a little so that not all is sent in one step."""
        for place, (message_id, rate_hz) in enumerate(self.default_hz.items()):
            if rate_hz > 0.0:
                self.interval_s[message_id] = 1.0 / rate_hz
                heapq.heappush(self._due, (now_s + (place % 5) * _FASTEST_S, message_id))

    def set_interval(self, message_id: int, interval_us: float, now_s: float) -> bool:
        """MAV_CMD_SET_MESSAGE_INTERVAL: below zero stops, zero is the default; False for what cannot be set."""
        if message_id not in self.default_hz or message_id == HEARTBEAT_ID or not math.isfinite(interval_us):
            return False
        if interval_us > 0.0:
            interval_s = max(interval_us * 1e-6, _FASTEST_S)
        else:
            default_hz = self.default_hz[message_id]
            interval_s = 1.0 / default_hz if interval_us == 0.0 and default_hz > 0.0 else 0.0
        self._due = [entry for entry in self._due if entry[1] != message_id]
        heapq.heapify(self._due)
        self.interval_s.pop(message_id, None)
        if interval_s > 0.0:
            self.interval_s[message_id] = interval_s
            heapq.heappush(self._due, (now_s + interval_s, message_id))
        return True

    def interval_us(self, message_id: int) -> int:
        """MESSAGE_INTERVAL.interval_us: -1 when not streamed."""
        interval_s = self.interval_s.get(message_id)
        return -1 if interval_s is None else round(interval_s * 1e6)

    def pop_due(self, now_s: float) -> list[int]:
        """Ids that are due now; each is scheduled again."""
        due: list[int] = []
        while self._due and self._due[0][0] <= now_s + 1e-6:
            at_s, message_id = heapq.heappop(self._due)
            due.append(message_id)
            heapq.heappush(self._due, (max(at_s, now_s - 0.1) + self.interval_s[message_id], message_id))
        return due
