"""PX4 over MAVSDK 4; the only file of the project that imports mavsdk.

Everything that is sent while flying goes through ``mavlink_direct``: MAVSDK's offboard plugin repeats the last setpoint
from a thread of its own, so that a hung loop would not be noticed by PX4. Modes and arming are plain commands without
waiting for an answer, since PX4 accepts what it then does not do; HEARTBEAT tells. Parameters are the only blocking
calls and belong on an executor of their own (:meth:`Px4Link.apply_params`).
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping
from typing import Any

import msgspec
from mavsdk import ComponentType
from mavsdk import logging as mavsdk_logging
from mavsdk.mavsdk import Configuration, Mavsdk
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkDirectError, MavlinkMessage
from mavsdk.plugins.param import Param, ParamError
from msgspec.structs import replace

from onboard.autopilot import Landed, LinkError, Snapshot, Vec3, Vec4
from onboard.frames import enu_flu_from_ned_frd, ned_frd_from_enu_flu, ned_from_enu
from onboard.native_threads import keep_thread_state
from onboard.px4 import modes
from onboard.px4.port_lock import PortClaim
from onboard.types import AttitudeSetpoint

_COMPONENT_ID = 191  # MAV_COMP_ID_ONBOARD_COMPUTER
_ONE_AT_A_TIME = threading.Lock()  # two links that start at once in one process crash MAVSDK 4.1 now and then
_AUTOPILOT_COMPONENT_ID = 1
_TYPE_MASK_ATTITUDE_AND_THRUST = 7
_FRAME_LOCAL_NED, _FRAME_LOCAL_FRD_VELOCITY = 1, 12
_ESTIMATOR_TYPE_VISION = 2
_LOCAL_POSITION_NED = 32
# ATTITUDE_QUATERNION, EXTENDED_SYS_STATE, BATTERY_STATUS, ESTIMATOR_STATUS
_RATES_HZ = {31: 50.0, 245: 10.0, 147: 2.0, 230: 1.0}
# Nobody here listens to two thirds of what PX4 tells a companion by itself, and each message costs: GPS_RAW_INT,
# ATTITUDE, GLOBAL_POSITION_INT, SERVO_OUTPUT_RAW, VFR_HUD, targets, HIGHRES_IMU, DISTANCE_SENSOR, ALTITUDE, ODOMETRY
_UNHEARD = (24, 30, 33, 36, 74, 83, 85, 87, 105, 132, 141, 331)
_STOP_US = -1.0
_TUNE = "MFT180O4L8CEGO5CP4O4CEGO5C"  # up a chord, twice; at most 29 characters
_GPS_GLOBAL_ORIGIN = 49
# Any place will do indoors: only PX4's global frame hangs on it. Its altitude must be 0: PX4 takes heights of a mocap
# for altitudes, and its local height would be wrong by the altitude of the origin.
_ORIGIN = (47.397742, 8.545594, 0.0)
_ORIGIN_TOLERANCE_M = 0.01
_UNKNOWN = (None,) * 21  # goes out as NaN
_json = msgspec.json.Encoder().encode  # ten times as fast as the standard library's, at 100 messages a second


def _silent(*_: Any) -> bool:
    """MAVSDK logs to stdout, which belongs to the agent."""
    return True


class Px4Link:
    """One PX4 at one endpoint.

    Args:
        endpoint: for instance ``udpin://127.0.0.1:14540``.
        system_id: MAVLink id that the fleet file gives this vehicle; another id on the endpoint is refused.
        position_hz: how often PX4 is to tell its own position.
    """

    def __init__(self, endpoint: str, system_id: int, *, position_hz: float = 50.0) -> None:
        self.endpoint, self.system_id = endpoint, system_id
        self._rates_hz = {**_RATES_HZ, _LOCAL_POSITION_NED: position_hz}
        self._claim = PortClaim(endpoint)
        self._mavsdk: Mavsdk | None = None
        self._system: Any = None
        self._direct: MavlinkDirect | None = None
        self._param: Param | None = None
        self._told: dict[str, tuple[str, int]] = {}  # the newest of each kind that nobody has looked at: JSON, arrival
        self._lock = threading.Lock()
        self._slot = Snapshot()
        self._covariance: tuple[float, list[float]] = (math.nan, [])
        self._start_ns = 0
        self.send_failures = 0

    # -- life --------------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Open the endpoint; PX4 need not be there yet.

        Raises:
            LinkError: port taken or endpoint not usable.
        """
        if self._mavsdk is not None:
            return
        self._claim.take()
        configuration = Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER)
        configuration.system_id, configuration.component_id = self.system_id, _COMPONENT_ID
        with _ONE_AT_A_TIME:
            mavsdk_logging.log_subscribe(_silent)
            mavsdk = Mavsdk(configuration)
            result = mavsdk.add_any_connection(self.endpoint)
        if int(result) != 0:
            mavsdk.destroy()
            self._claim.release()
            raise LinkError(
                f"MAVSDK cannot open {self.endpoint} ({result}). Correct 'autopilot' of this vehicle in the fleet file."
            )
        self._mavsdk, self._start_ns = mavsdk, time.monotonic_ns()

    def connect(self, timeout_s: float) -> bool:
        """Wait (blocking: for an executor) until PX4 has been heard, then subscribe to all that the agent needs.

        Raises:
            LinkError: another system id answers.
        """
        if self._mavsdk is None or self._direct is not None:
            return self._direct is not None
        system = self._mavsdk.first_autopilot(timeout_s)
        if system is None:
            return False
        found = int(system.get_system_id())
        if found != self.system_id:
            raise LinkError(
                f"At {self.endpoint} answers MAVLink system id {found}, but the fleet file says {self.system_id}. "
                "Correct 'system_id' or 'autopilot' of this vehicle, or MAV_SYS_ID of this PX4."
            )
        self._system, self._param = system, Param(system)
        direct = MavlinkDirect(system)
        for name in _HANDLERS:
            direct.subscribe_message(name, self._receive)
        self._direct = direct
        self.request_rates()
        return True

    def stop(self) -> None:
        """Close the link; a second call does nothing. No call to this object may be under way in another thread."""
        mavsdk, self._mavsdk = self._mavsdk, None
        self._direct = self._param = self._system = None
        if mavsdk is not None:
            mavsdk.destroy()
        self._claim.release()

    # -- in ----------------------------------------------------------------------------------------------------------

    def snapshot(self) -> Snapshot:
        """The newest values; safe from any thread."""
        if self._told:
            with self._lock:
                self._slot = self._read(self._slot)
        return self._slot

    def _receive(self, message: MavlinkMessage, _: Any) -> None:
        """On MAVSDK's thread, which may wait for Python's lock: keep, and let who looks take it apart."""
        keep_thread_state()
        if message.system_id == self.system_id and message.component_id == _AUTOPILOT_COMPONENT_ID:
            self._told[message.message_name] = message.fields_json, time.monotonic_ns()

    def _read(self, known: Snapshot) -> Snapshot:
        changes: dict[str, Any] = {}
        newest_ns = 0
        while self._told:
            name, (text, arrived_ns) = self._told.popitem()
            try:
                changes |= _HANDLERS[name](msgspec.json.decode(text), arrived_ns)
            except (msgspec.DecodeError, KeyError, TypeError, ValueError):
                continue
            newest_ns = max(newest_ns, arrived_ns)
        if not newest_ns:
            return known
        return replace(known, last_packet_ns=newest_ns, system_id=self.system_id, **changes)

    # -- out ---------------------------------------------------------------------------------------------------------

    def send_attitude(self, setpoint: AttitudeSetpoint) -> None:
        """SET_ATTITUDE_TARGET with attitude and thrust, ENU/FLU in, NED/FRD on the wire."""
        self._send(
            "SET_ATTITUDE_TARGET",
            time_boot_ms=self._boot_ms(),
            target_system=self.system_id,
            target_component=_AUTOPILOT_COMPONENT_ID,
            type_mask=_TYPE_MASK_ATTITUDE_AND_THRUST,
            q=ned_frd_from_enu_flu(setpoint.quaternion_wxyz),
            body_roll_rate=0.0,
            body_pitch_rate=0.0,
            body_yaw_rate=0.0,
            thrust=setpoint.thrust_frac,
        )

    def set_offboard(self) -> None:
        """DO_SET_MODE to OFFBOARD."""
        self._command(modes.CMD_SET_MODE, float(modes.BASE_MODE_CUSTOM_ENABLED), float(modes.MAIN_MODE_OFFBOARD))

    def land(self) -> None:
        """PX4's own landing at the present spot."""
        self._command(modes.CMD_LAND)

    def arm(self) -> None:
        """Ask to arm, never by force."""
        self._command(modes.CMD_ARM, 1.0)

    def disarm(self) -> None:
        """Ask to disarm; PX4 refuses in the air."""
        self._command(modes.CMD_ARM, 0.0)

    def kill(self) -> None:
        """Disarm by force: the motors stop at once, also in the air."""
        self._command(modes.CMD_ARM, 0.0, modes.FORCE_DISARM_MAGIC)

    def play_tune(self) -> None:
        """PLAY_TUNE: PX4 plays it on its buzzer or motors, and acknowledges nothing."""
        self._send(
            "PLAY_TUNE",
            target_system=self.system_id,
            target_component=_AUTOPILOT_COMPONENT_ID,
            tune=_TUNE,
            tune2="",
        )

    def send_odometry(
        self, position_enu_m: Vec3, quaternion_enu_flu_wxyz: Vec4, std_m: float, reset_count: int = 0
    ) -> None:
        """ODOMETRY in the fleet's axes as NED; velocity is not known to a mocap and left out."""
        north, east, down = ned_from_enu(position_enu_m)
        w, x, y, z = quaternion_enu_flu_wxyz
        norm = math.hypot(w, x, y, z)  # PX4 leaves out a heading whose quaternion is not a unit one to five digits
        if std_m != self._covariance[0]:
            places = {0: std_m**2, 6: std_m**2, 11: std_m**2, 15: 1e-4, 18: 1e-4, 20: 1e-4}
            self._covariance = std_m, [places.get(place, 0.0) for place in range(21)]
        self._send(
            "ODOMETRY",
            time_usec=time.monotonic_ns() // 1000,
            frame_id=_FRAME_LOCAL_NED,
            child_frame_id=_FRAME_LOCAL_FRD_VELOCITY,
            x=north,
            y=east,
            z=down,
            q=ned_frd_from_enu_flu((w / norm, x / norm, y / norm, z / norm)),
            vx=None,
            vy=None,
            vz=None,
            rollspeed=None,
            pitchspeed=None,
            yawspeed=None,
            pose_covariance=self._covariance[1],
            velocity_covariance=_UNKNOWN,
            reset_counter=reset_count,
            estimator_type=_ESTIMATOR_TYPE_VISION,
            quality=100,
        )

    def set_global_origin(self) -> None:
        """Give PX4 a global origin: without one it refuses its position modes, its hold and land among them."""
        self._send(
            "SET_GPS_GLOBAL_ORIGIN",
            target_system=self.system_id,
            latitude=round(_ORIGIN[0] * 1e7),
            longitude=round(_ORIGIN[1] * 1e7),
            altitude=round(_ORIGIN[2] * 1e3),
            time_usec=time.monotonic_ns() // 1000,
        )

    def settle_global_origin(self, *, gives_ours: bool) -> None:
        """Once a second on the ground: ask PX4 where its local frame lies, and give it ours until it says that.

        PX4 tells by itself only at the moment when it settles there, and a datagram may be lost.

        Args:
            gives_ours: a mocap gives the height, which needs an origin at altitude 0.
        """
        known = self.snapshot().global_origin
        if known is None:
            self._command(modes.CMD_REQUEST_MESSAGE, float(_GPS_GLOBAL_ORIGIN))
        elif gives_ours and abs(known[2] - _ORIGIN[2]) > _ORIGIN_TOLERANCE_M:
            self.set_global_origin()

    def request_rates(self) -> None:
        """SET_MESSAGE_INTERVAL for what the agent reads; PX4's defaults are too slow for close flight."""
        wanted_us = {number: 1e6 / rate_hz for number, rate_hz in self._rates_hz.items()}
        for number, interval_us in (wanted_us | dict.fromkeys(_UNHEARD, _STOP_US)).items():
            self._command(modes.CMD_SET_MESSAGE_INTERVAL, float(number), interval_us)

    # -- parameters: blocking, for an executor -----------------------------------------------------------------------

    def read_params(self, names: Mapping[str, float | int]) -> dict[str, float | int | None]:
        """PX4's values of ``names``; None where it did not answer. Each given value is of the wanted kind."""
        return {name: self._read_param(name, like) for name, like in names.items()}

    def apply_params(self, values: Mapping[str, float | int]) -> None:
        """Set parameters; whether that worked is for :meth:`read_params` to say."""
        if self._param is None:
            return
        for name, value in values.items():
            for _ in range(2):
                try:
                    if isinstance(self._read_param(name, value), int):
                        self._param.set_param_int(name, int(value))
                    else:
                        self._param.set_param_float(name, float(value))
                except ParamError:
                    continue
                break

    def _read_param(self, name: str, like: float | int) -> float | int | None:
        if self._param is None:
            return None
        readers = [self._param.get_param_int, self._param.get_param_float]
        for read in readers if isinstance(like, int) else readers[::-1]:
            try:
                value = read(name)
            except ParamError:
                continue
            return int(value) if read == self._param.get_param_int else float(value)
        return None

    # -- wire --------------------------------------------------------------------------------------------------------

    def _boot_ms(self) -> int:
        return (time.monotonic_ns() - self._start_ns) // 1_000_000 & 0xFFFFFFFF

    def _command(self, command: int, param1: float = 0.0, param2: float = 0.0) -> None:
        self._send(
            "COMMAND_LONG",
            target_system=self.system_id,
            target_component=_AUTOPILOT_COMPONENT_ID,
            command=command,
            confirmation=0,
            param1=param1,
            param2=param2,
            param3=0.0,
            param4=None if command == modes.CMD_LAND else 0.0,  # None goes out as NaN: keep the heading
            param5=None if command == modes.CMD_LAND else 0.0,
            param6=None if command == modes.CMD_LAND else 0.0,
            param7=None if command == modes.CMD_LAND else 0.0,
        )

    def _send(self, name: str, **fields: Any) -> None:
        direct = self._direct
        if direct is None:
            return
        message = MavlinkMessage(
            name, self.system_id, _COMPONENT_ID, self.system_id, _AUTOPILOT_COMPONENT_ID, _json(fields).decode()
        )
        try:
            direct.send_message(message)
        except MavlinkDirectError:
            self.send_failures += 1


def _attitude(f: dict[str, Any], now_ns: int) -> dict[str, Any]:
    q = enu_flu_from_ned_frd((f["q1"], f["q2"], f["q3"], f["q4"]))
    if not math.isfinite(sum(q)):
        return {}
    return {
        "quaternion_enu_flu_wxyz": q,
        "attitude_ns": now_ns,
        "px4_boot_ms": int(f["time_boot_ms"]),
    }


def _local_position(f: dict[str, Any], now_ns: int) -> dict[str, Any]:
    position, velocity = (f["x"], f["y"], f["z"]), (f["vx"], f["vy"], f["vz"])
    if not all(isinstance(value, float) and math.isfinite(value) for value in (*position, *velocity)):
        return {}
    return {"position_local_ned_m": position, "velocity_local_ned_m_s": velocity, "local_position_ns": now_ns}


def _estimator_status(f: dict[str, Any], _: int) -> dict[str, Any]:
    accuracy_m = f["pos_horiz_accuracy"]
    is_told = isinstance(accuracy_m, float) and math.isfinite(accuracy_m) and accuracy_m >= 0.0
    return {"position_accuracy_m": accuracy_m} if is_told else {}


def _global_origin(f: dict[str, Any], _: int) -> dict[str, Any]:
    return {"global_origin": (f["latitude"] * 1e-7, f["longitude"] * 1e-7, f["altitude"] * 1e-3)}


def _heartbeat(f: dict[str, Any], now_ns: int) -> dict[str, Any]:
    return {
        "heartbeat_ns": now_ns,
        "is_armed": bool(int(f["base_mode"]) & modes.BASE_MODE_ARMED),
        "mode": modes.mode_name(int(f["custom_mode"])),
        "is_failsafe": int(f["system_status"]) == modes.STATUS_CRITICAL,
    }


def _extended_state(f: dict[str, Any], now_ns: int) -> dict[str, Any]:
    return {"landed": Landed(int(f["landed_state"])), "landed_ns": now_ns}


def _battery(f: dict[str, Any], _: int) -> dict[str, Any]:
    remaining, voltages = int(f["battery_remaining"]), f["voltages"]
    return {
        "battery_frac": remaining / 100.0 if remaining >= 0 else math.nan,
        "battery_voltage_v": sum(v for v in voltages if v < 65535) / 1000.0,
    }


def _status_text(f: dict[str, Any], now_ns: int) -> dict[str, Any]:
    return {"status_text": str(f["text"]).strip(), "status_text_ns": now_ns}


def _sys_status(f: dict[str, Any], now_ns: int) -> dict[str, Any]:
    return {
        "sensors_enabled": int(f["onboard_control_sensors_enabled"]),
        "sensors_healthy": int(f["onboard_control_sensors_health"]),
        "sensors_ns": now_ns,
    }


_HANDLERS = {
    "HEARTBEAT": _heartbeat,
    "ATTITUDE_QUATERNION": _attitude,
    "LOCAL_POSITION_NED": _local_position,
    "ESTIMATOR_STATUS": _estimator_status,
    "EXTENDED_SYS_STATE": _extended_state,
    "GPS_GLOBAL_ORIGIN": _global_origin,
    "BATTERY_STATUS": _battery,
    "STATUSTEXT": _status_text,
    "SYS_STATUS": _sys_status,
}
