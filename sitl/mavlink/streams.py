"""Messages that a link streams by itself, their rates, and the time at which each is due."""

from __future__ import annotations

import heapq
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from sitl.mavlink import messages
from sitl.mavlink.codec import ID_BY_NAME
from sitl.mavlink.messages import Builder

FASTEST_HZ = 250.0  # the loop of PX4's simulator


class Stream(NamedTuple):
    """One message that PX4 can stream."""

    # name, build: the message and what it says
    name: str
    build: Builder
    # onboard_hz, ground_hz: default rates on the companion's and on the ground station's link; 0 = not by itself
    onboard_hz: float
    ground_hz: float
    ceiling_hz: float = FASTEST_HZ  # what PX4 reaches when asked for more


STREAMS: tuple[Stream, ...] = (
    Stream("HEARTBEAT", messages.heartbeat, 1.0, 1.0),
    Stream("TIMESYNC", messages.timesync, 10.0, 0.0),
    Stream("ATTITUDE", messages.attitude, 100.0, 15.0, 218.0),
    Stream("HIGHRES_IMU", messages.highres_imu, 50.0, 0.0),
    Stream("ATTITUDE_QUATERNION", messages.attitude_quaternion, 50.0, 10.0, 220.0),
    Stream("GLOBAL_POSITION_INT", messages.global_position_int, 50.0, 5.0, 125.0),
    Stream("LOCAL_POSITION_NED", messages.local_position, 30.0, 1.0, 125.0),  # the rate of the estimator
    Stream("ODOMETRY", messages.odometry, 30.0, 0.0, 125.0),
    Stream("ALTITUDE", messages.altitude, 10.0, 1.0),
    Stream("DISTANCE_SENSOR", messages.distance_sensor, 10.0, 0.5),
    Stream("ATTITUDE_TARGET", messages.attitude_target, 10.0, 2.0),
    Stream("POSITION_TARGET_LOCAL_NED", messages.local_target, 10.0, 1.5),
    Stream("POSITION_TARGET_GLOBAL_INT", messages.global_target, 10.0, 1.0),
    Stream("SERVO_OUTPUT_RAW", messages.servo_output, 10.0, 1.0),
    Stream("VFR_HUD", messages.vfr_hud, 10.0, 4.0),
    Stream("GPS_RAW_INT", messages.gps_raw, 8.0, 5.0, 8.0),  # as fast as the receiver
    Stream("EXTENDED_SYS_STATE", messages.extended_sys_state, 5.0, 1.0),
    Stream("SYS_STATUS", messages.sys_status, 5.0, 1.0),
    Stream("ESTIMATOR_STATUS", messages.estimator_status, 1.0, 0.5),
    Stream("OPEN_DRONE_ID_LOCATION", messages.drone_id_location, 1.0, 1.0),
    Stream("OPEN_DRONE_ID_SYSTEM", messages.drone_id_system, 1.0, 1.0),
    Stream("PING", messages.ping, 1.0, 0.1),
    Stream("SCALED_PRESSURE", messages.scaled_pressure, 1.0, 1.0),
    Stream("SYSTEM_TIME", messages.system_time, 1.0, 0.0),
    Stream("LINK_NODE_STATUS", messages.link_node_status, 1.0, 1.0),
    Stream("MISSION_CURRENT", messages.mission_current, 1.0, 1.0),
    Stream("GPS_GLOBAL_ORIGIN", messages.global_origin, 1.0, 1.0),  # but only when it has changed: see the link
    Stream("BATTERY_STATUS", messages.battery_status, 0.5, 0.5),
    Stream("CURRENT_MODE", messages.current_mode, 0.5, 0.5),
    Stream("HOME_POSITION", messages.home_position, 0.5, 0.5),
    Stream("VIBRATION", messages.vibration, 0.5, 0.1),
    Stream("TIME_ESTIMATE_TO_TARGET", messages.time_estimate, 0.5, 0.5),
    Stream("CURRENT_EVENT_SEQUENCE", messages.event_sequence, 0.3, 0.3),
    Stream("ACTUATOR_OUTPUT_STATUS", messages.actuator_output, 0.0, 0.0),
    Stream("HIL_STATE_QUATERNION", messages.hil_state, 0.0, 0.0),
    Stream("HIL_ACTUATOR_CONTROLS", messages.hil_actuators, 0.0, 0.0),
    Stream("AUTOPILOT_VERSION", messages.autopilot_version, 0.0, 0.0),
    Stream("PROTOCOL_VERSION", messages.protocol_version, 0.0, 0.0),
    Stream("FLIGHT_INFORMATION", messages.flight_information, 0.0, 0.0),
)
BUILDERS: dict[int, Builder] = {ID_BY_NAME[stream.name]: stream.build for stream in STREAMS}
ONBOARD_RATES_HZ: dict[int, float] = {ID_BY_NAME[stream.name]: stream.onboard_hz for stream in STREAMS}
GCS_RATES_HZ: dict[int, float] = {ID_BY_NAME[stream.name]: stream.ground_hz for stream in STREAMS}
_CEILINGS_HZ: dict[int, float] = {ID_BY_NAME[stream.name]: stream.ceiling_hz for stream in STREAMS}

# Streams that PX4 has and for which its simulated quadrotor has no data: their rate can be set, nothing comes.
SILENT: frozenset[int] = frozenset(
    ID_BY_NAME[name]
    for name in (
        "ADSB_VEHICLE",
        "CAMERA_IMAGE_CAPTURED",
        "CAMERA_TRIGGER",
        "DEBUG",
        "DEBUG_VECT",
        "DEBUG_FLOAT_ARRAY",
        "EFI_STATUS",
        "ESC_INFO",
        "ESC_STATUS",
        "GIMBAL_MANAGER_STATUS",
        "GPS2_RAW",
        "GPS_STATUS",
        "HIGH_LATENCY2",
        "HYGROMETER_SENSOR",
        "MANUAL_CONTROL",
        "NAMED_VALUE_FLOAT",
        "NAV_CONTROLLER_OUTPUT",
        "OBSTACLE_DISTANCE",
        "OPTICAL_FLOW_RAD",
        "ORBIT_EXECUTION_STATUS",
        "RAW_RPM",
        "RC_CHANNELS",
        "SCALED_IMU",
        "SCALED_IMU2",
        "SCALED_IMU3",
        "SCALED_PRESSURE2",
        "SCALED_PRESSURE3",
        "WIND_COV",
    )
    if name in ID_BY_NAME
)

_HEARTBEAT = ID_BY_NAME["HEARTBEAT"]
# After its start a PX4 says nothing for a moment, and is alive a little later.
_FIRST_PACKET_S = 0.3
_FIRST_HEARTBEAT_S = 1.3
_STEP_S = 0.004
_SPREAD_STEPS = 25


@dataclass(slots=True)
class Schedule:
    """Times at which each message of a link is due, in simulated time."""

    default_hz: Mapping[int, float]  # rate of each message that the link can stream
    _interval_s: dict[int, float] = field(default_factory=dict)
    _due: list[tuple[float, int]] = field(default_factory=list)

    def start(self, now_s: float, *, boot_s: float = 0.0, phase: int = 0) -> None:
        """Schedule everything at its default rate, spread out so that neither all messages nor all vehicles coincide.

        Args:
            now_s, boot_s: present time and when the autopilot started.
            phase: any number that differs between vehicles.
        """
        for index, (message_id, rate_hz) in enumerate(self.default_hz.items()):
            if rate_hz > 0.0:
                earliest_s = boot_s + (_FIRST_HEARTBEAT_S if message_id == _HEARTBEAT else _FIRST_PACKET_S)
                spread_s = ((index * 7 + phase * 3) % _SPREAD_STEPS) * _STEP_S
                self._interval_s[message_id] = 1.0 / rate_hz
                heapq.heappush(self._due, (max(now_s, earliest_s) + spread_s, message_id))

    def set_interval(self, message_id: int, interval_us: float, now_s: float) -> bool:
        """MAV_CMD_SET_MESSAGE_INTERVAL: below zero stops, zero is the default; False for what cannot be set."""
        if message_id in SILENT:
            return True
        if message_id not in self.default_hz or message_id == _HEARTBEAT or not math.isfinite(interval_us):
            return False
        if interval_us > 0.0:
            interval_s = max(interval_us * 1e-6, 1.0 / _CEILINGS_HZ[message_id])
        else:
            default_hz = self.default_hz[message_id]
            interval_s = 1.0 / default_hz if interval_us == 0.0 and default_hz > 0.0 else 0.0
        self._due = [entry for entry in self._due if entry[1] != message_id]
        heapq.heapify(self._due)
        self._interval_s.pop(message_id, None)
        if interval_s > 0.0:
            self._interval_s[message_id] = interval_s
            heapq.heappush(self._due, (now_s + min(interval_s, 1.0), message_id))
        return True

    def interval_us(self, message_id: int) -> int:
        """MESSAGE_INTERVAL.interval_us: -1 when not streamed, 0 when unknown."""
        if message_id not in self.default_hz and message_id not in SILENT:
            return 0
        interval_s = self._interval_s.get(message_id)
        return -1 if interval_s is None else min(round(interval_s * 1e6), 2**31 - 1)

    def pop_due(self, now_s: float) -> list[int]:
        """Ids that are due now; each is scheduled again."""
        due: list[int] = []
        heap, limit_s = self._due, now_s + 1e-6
        while heap and heap[0][0] <= limit_s:
            at_s, message_id = heap[0]
            due.append(message_id)
            heapq.heapreplace(heap, (max(at_s, now_s - 0.1) + self._interval_s[message_id], message_id))
        return due
