"""The agent's link to its PX4; the only file of onboard that imports mavsdk.

Setpoints, poses and commands go through the relay (mavlink_relay.py), in the call that makes them.
MAVSDK's offboard plugin is not used, because it cannot sign. It would also repeat the last setpoint
from its own thread, so PX4 would not notice a hung loop. MAVSDK finds PX4, and reads and sets its
parameters, through the same relay.

Modes and arming are plain commands. No answer is awaited, because PX4 may accept a command without
executing it. HEARTBEAT shows the result. Only the calls about parameters block; call them on an
executor (:meth:`Px4Link.apply_params`).
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from mavsdk import ComponentType
from mavsdk import logging as mavsdk_logging
from mavsdk.mavsdk import Configuration, Mavsdk
from mavsdk.plugins.param import Param, ParamError, ParamResult
from msgspec.structs import replace

from onboard.autopilot import AUTOPILOT_COMPONENT, LinkError, Snapshot
from onboard.frames import ned_frd_from_enu_flu, ned_from_enu
from onboard.native_threads import keep_thread_state
from onboard.px4 import modes
from onboard.px4.battery_reports import BatteryReports
from onboard.px4.mavlink_relay import Ids, MavlinkRelay
from onboard.px4.message_parsers import PARSERS
from onboard.px4.packets import (
    LOG_ANSWERS,
    MAVSDK_READS,
    MAVSDK_SENDS,
    NAMES,
    SENT,
    Packet,
    cut,
    fields_of,
)
from onboard.px4.port_lock import PortClaim
from onboard.px4.signing import Signer
from onboard.px4.status_texts import StatusTexts
from onboard.security.mavlink_key import AGENT_LINK_ID
from onboard.tuples import Wxyz, Xyz
from onboard.types import AttitudeSetpoint

_COMPONENT_ID = 191  # MAV_COMP_ID_ONBOARD_COMPUTER

# two links that start at the same time in one process sometimes crash MAVSDK 4.1
_ONE_AT_A_TIME = threading.Lock()

# PX4 has restarted if its clock went back by more than this. In the first second after its start it
# sends no origin.
_RESTARTED_MS = 500
_CLOCK_RANGE_MS = 1 << 32  # PX4's clock in messages overflows after this time
_NEAR_OVERFLOW_MS = 60_000  # a clock this near to an overflow may be beyond it in the next message

# A silence longer than this counts as an interruption of PX4's messages. A cable may have been
# unplugged.
_SILENT_NS = 1_000_000_000

# Numbers of messages.
_HEARTBEAT = 0
_GPS_RAW_INT = 24
_ATTITUDE_QUATERNION = 31
_LOCAL_POSITION_NED = 32
_GPS_GLOBAL_ORIGIN = 49
_MANUAL_CONTROL = 69
_BATTERY_STATUS = 147
_AUTOPILOT_VERSION = 148
_ESTIMATOR_STATUS = 230
_EXTENDED_SYS_STATE = 245
_STATUSTEXT = 253
_MONITOR = slice(32, 33)  # the battery monitor's id in the payload of BATTERY_STATUS

_RATES_HZ = {
    _ATTITUDE_QUATERNION: 50.0,
    _EXTENDED_SYS_STATE: 10.0,
    _BATTERY_STATUS: 2.0,
    _ESTIMATOR_STATUS: 5.0,
    # The sticks that PX4 has selected, from a radio control or a joystick. PX4 sends this message
    # while it receives sticks, and once more when it loses them. RC_CHANNELS is not a substitute,
    # because PX4 also sends it while the transmitter is lost.
    _MANUAL_CONTROL: 5.0,
}

# Two thirds of the messages that PX4 sends to a companion by default are not used, and each costs
# time: ATTITUDE, GLOBAL_POSITION_INT, SERVO_OUTPUT_RAW, VFR_HUD, targets, HIGHRES_IMU,
# DISTANCE_SENSOR, ALTITUDE, ODOMETRY.
_UNUSED = (30, 33, 36, 74, 83, 85, 87, 105, 132, 141, 331)
_STOP_US = -1.0  # interval that stops a message

# Values of fields of SET_ATTITUDE_TARGET and ODOMETRY.
_TYPE_MASK_ATTITUDE_AND_THRUST = 7  # ignore all rates
_FRAME_LOCAL_NED = 1
_FRAME_LOCAL_FRD_VELOCITY = 12
_ESTIMATOR_TYPE_VISION = 2
_QUALITY_PERCENT = 100
_ATTITUDE_VARIANCE_RAD2 = 1e-4  # variance of roll, of pitch and of yaw

_TUNE = "MFT180O4L8CEGO5CP4O4CEGO5C"  # a rising chord, twice; at most 29 characters

# Indoors, any latitude and longitude will do, because only PX4's global frame uses them. The
# altitude must be 0, because PX4 treats a mocap's heights as altitudes, and its local height would
# be wrong by the altitude of the origin.
_ORIGIN = (47.397742, 8.545594, 0.0)  # latitude [deg], longitude [deg], altitude [m]
_ORIGIN_TOLERANCE_M = 0.01  # of the altitude that PX4 confirms
_PAUSE_NS = 1_000_000_000  # an origin is set only after this time without poses

_NAN = math.nan
_UNKNOWN_VELOCITY = (_NAN,) * 6  # linear and angular
_UNKNOWN_COVARIANCE = (_NAN,) * 21  # upper triangle of 6 x 6
_ATTEMPTS = 2  # number of attempts to set a parameter


def _pose_covariance(std_m: float) -> list[float]:
    """Return the upper triangle of the covariance of north, east, down, roll, pitch and yaw."""
    variance_m2 = std_m**2
    # index in the triangle, which is written row by row -> variance; all covariances are 0
    diagonal = {
        0: variance_m2,
        6: variance_m2,
        11: variance_m2,
        15: _ATTITUDE_VARIANCE_RAD2,
        18: _ATTITUDE_VARIANCE_RAD2,
        20: _ATTITUDE_VARIANCE_RAD2,
    }
    return [diagonal.get(index, 0.0) for index in range(21)]


def _silent(*_: Any) -> bool:
    """Take a line of MAVSDK's log. Returning True keeps MAVSDK from printing it to stdout."""
    return True


def _ignored(_: Packet) -> None:
    """Ignore a packet that was not requested."""


class Px4Link:
    """One PX4 at one endpoint.

    Args:
        endpoint: address of the link, for instance ``udpin://127.0.0.1:14540``.
        system_id: MAVLink id that the fleet file gives this vehicle; another id on the endpoint is
            refused.
        position_hz: rate at which PX4 sends its own position.
        satellites_hz: rate at which PX4 sends its fix; 0: never.
        key: key of MAVLink signing; None for a vehicle that does not sign.
    """

    def __init__(
        self,
        endpoint: str,
        system_id: int,
        *,
        position_hz: float = 50.0,
        satellites_hz: float = 0.0,
        key: bytes | None = None,
    ) -> None:
        self.endpoint = endpoint
        self.system_id = system_id
        self._rates_hz = {
            **_RATES_HZ,
            _LOCAL_POSITION_NED: position_hz,
            _GPS_RAW_INT: satellites_hz,
        }

        signer: Signer | None = None
        if key is not None:
            signer = Signer(key, AGENT_LINK_ID)
        self._port = PortClaim(endpoint)
        self._relay = MavlinkRelay(endpoint, Ids(system_id, _COMPONENT_ID), signer, self._receive)

        self._mavsdk: Mavsdk | None = None  # while the link is open
        self._system: Any = None  # MAVSDK's system; None before PX4 has been heard
        self._param: Param | None = None  # MAVSDK's parameters; None before PX4 has been heard

        # (name of a message, id of its battery monitor or empty) -> (newest payload not yet parsed,
        # its arrival); for a STATUSTEXT, its whole text replaces the payload
        self._unread: dict[tuple[str, bytes], tuple[bytes, int]] = {}
        self._batteries = BatteryReports()
        self._texts = StatusTexts()
        # arrivals of the two newest messages about a pilot's sticks
        self._sticks_ns = 0
        self._sticks_before_ns = 0
        self._lock = threading.Lock()  # protects the newest snapshot
        self._newest = Snapshot()
        self._clock_ms = 0  # PX4's clock in its newest messages; 0 before the first

        self._std_m = math.nan  # standard deviation of the last pose
        self._covariance: list[float] = []  # covariance for that standard deviation
        self._start_ns = 0
        # time of the last pose sent to PX4; at first the start time, because another program may
        # have sent poses before
        self._poses_ns = 0
        # whether poses are withheld from a disarmed PX4, see settle_global_origin
        self.withholds_poses = False
        # called on the relay's thread with PX4's replies to requests for its logs
        self.on_log_answer: Callable[[Packet], object] = _ignored

    # -- life --------------------------------------------------------------------------------------

    def start(self) -> None:
        """Open the endpoint. PX4 need not be running yet.

        Raises:
            EndpointAbsentError: The endpoint is not there, but may be there later.
            LinkError: The port is taken, or the endpoint cannot be used.
        """
        if self._mavsdk is not None:
            return
        self._port.take()

        configuration = Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER)
        configuration.system_id = self.system_id
        configuration.component_id = _COMPONENT_ID
        with _ONE_AT_A_TIME:
            mavsdk_logging.log_subscribe(_silent)
            mavsdk = Mavsdk(configuration)
            mavsdk.add_any_connection("raw://")  # its packets pass through this object
            mavsdk.subscribe_raw_bytes_to_be_sent(self._send_for_mavsdk)
        self._mavsdk = mavsdk

        try:
            self._relay.start()
        except LinkError:
            self.stop()
            raise
        self._start_ns = time.monotonic_ns()
        self._poses_ns = self._start_ns

    def connect(self, timeout_s: float) -> bool:
        """Wait until PX4 has been heard, then request all messages that the agent needs.

        It blocks, so call it on an executor.

        Args:
            timeout_s: longest time to wait.
        Returns:
            Whether PX4 has been heard, now or before.
        Raises:
            LinkError: A PX4 with another system id answers.
        """
        if self._param is not None:
            return True
        if self._mavsdk is None:
            return False

        system = self._mavsdk.first_autopilot(timeout_s)
        if system is not None:
            self._system = system
            self._param = Param(system)
            self.request_rates()
            return True

        other_system_id = self._relay.other_system_id
        if other_system_id is not None:
            raise LinkError(
                f"The PX4 at {self.endpoint} has MAVLink system id {other_system_id}, but the "
                f"fleet file says {self.system_id}. Correct 'system_id' or 'autopilot' of this "
                "vehicle, or MAV_SYS_ID of this PX4."
            )
        return False

    def stop(self) -> None:
        """Close the link; a second call does nothing.

        No other thread may use this object at the same time.
        """
        mavsdk = self._mavsdk
        self._mavsdk = None

        self._relay.stop()
        self._param = None
        self._system = None
        if mavsdk is not None:
            mavsdk.destroy()
        self._port.release()

    # -- in ----------------------------------------------------------------------------------------

    def snapshot(self) -> Snapshot:
        """Return the newest values; safe from any thread."""
        relay = self._relay
        if self._unread or relay.refused is not self._newest.refused:
            with self._lock:
                known = replace(
                    self._newest,
                    refused=relay.refused,
                    is_signed=relay.is_signed,
                    has_wrong_clock=relay.has_wrong_clock,
                )
                self._newest = self._read(known)
        return self._newest

    def _receive(self, packet: Packet) -> None:
        """Keep a message, on the relay's thread; :meth:`snapshot` parses it.

        MAVSDK receives the messages that it needs.
        """
        name = NAMES.get(packet.number)
        if name is not None:
            arrived_ns = time.monotonic_ns()
            if packet.number == _MANUAL_CONTROL:
                self._sticks_before_ns = self._sticks_ns
                self._sticks_ns = arrived_ns
            payload = packet.payload
            monitor = b""
            if packet.number == _BATTERY_STATUS:
                monitor = payload[_MONITOR]
            if packet.number == _STATUSTEXT:
                payload = self._texts.joined(fields_of(name, payload))
            self._unread[name, monitor] = (payload, arrived_ns)

        mavsdk = self._mavsdk
        if packet.number in MAVSDK_READS and mavsdk is not None:
            mavsdk.pass_received_raw_bytes(packet.data)

        if packet.number in LOG_ANSWERS:
            self.on_log_answer(packet)

    def _read(self, known: Snapshot) -> Snapshot:
        """Return the snapshot, updated with all messages that have arrived since."""
        changes: dict[str, Any] = {}
        arrivals_ns = []
        clocks_ms = []  # PX4's clock in the messages that carry it
        while self._unread:  # the relay's thread may add messages in the meantime
            (name, _), (payload, arrived_ns) = self._unread.popitem()
            try:
                fields: dict[str, Any]
                if name == "STATUSTEXT":
                    fields = {"text": payload}
                else:
                    fields = fields_of(name, payload)
                if "time_boot_ms" in fields:
                    fields["time_boot_ms"] = self._without_overflow_ms(fields["time_boot_ms"])
                change = PARSERS[name](fields, arrived_ns)
            except ValueError:
                continue
            if name == "BATTERY_STATUS":
                change = self._batteries.changes(fields["id"], change, is_armed=known.is_armed)
            changes |= change
            arrivals_ns.append(arrived_ns)
            if "time_boot_ms" in fields:
                clocks_ms.append(fields["time_boot_ms"])

        if not arrivals_ns:
            return known
        if clocks_ms and self._has_restarted(min(clocks_ms)):
            changes.setdefault("global_origin", None)
            changes["restarts"] = known.restarts + 1
        if known.last_packet_ns and min(arrivals_ns) - known.last_packet_ns > _SILENT_NS:
            changes["returns"] = known.returns + 1
        if "sticks_ns" in changes:
            changes["sticks_before_ns"] = self._sticks_before_ns
        changes["last_packet_ns"] = max(arrivals_ns)
        return replace(known, system_id=self.system_id, **changes)

    def _has_restarted(self, clock_ms: int) -> bool:
        """Return whether PX4's clock has restarted. If so, the known origin is no longer valid.

        PX4's local positions are then relative to a new origin. With the old origin, a vehicle that
        was carried while off would seem to be at its old position.
        """
        has_restarted = clock_ms + _RESTARTED_MS < self._clock_ms
        self._clock_ms = clock_ms
        if has_restarted:
            self._clock_ms %= _CLOCK_RANGE_MS
        return has_restarted

    def _without_overflow_ms(self, clock_ms: int) -> int:
        """Return PX4's clock of 32 bits, continued beyond its overflow after 49.7 days."""
        overflows, last_ms = divmod(self._clock_ms, _CLOCK_RANGE_MS)
        late_ms = _CLOCK_RANGE_MS - _NEAR_OVERFLOW_MS
        if last_ms > late_ms and clock_ms < _NEAR_OVERFLOW_MS:
            overflows += 1
        elif overflows and last_ms < _NEAR_OVERFLOW_MS and clock_ms > late_ms:
            overflows -= 1  # a message from before the overflow
        return overflows * _CLOCK_RANGE_MS + clock_ms

    # -- out ---------------------------------------------------------------------------------------

    def send_attitude(self, setpoint: AttitudeSetpoint) -> None:
        """Send SET_ATTITUDE_TARGET with attitude and thrust, converted from ENU/FLU to NED/FRD."""
        rates_rad_s = (0.0, 0.0, 0.0)  # ignored
        self._send(
            "SET_ATTITUDE_TARGET",
            self._boot_ms(),
            *ned_frd_from_enu_flu(setpoint.quaternion_wxyz),
            *rates_rad_s,
            setpoint.thrust_frac,
            self.system_id,
            AUTOPILOT_COMPONENT,
            _TYPE_MASK_ATTITUDE_AND_THRUST,
        )

    def set_offboard(self) -> None:
        """Command the mode OFFBOARD (DO_SET_MODE)."""
        self._command(
            modes.CMD_SET_MODE,
            float(modes.BASE_MODE_CUSTOM_ENABLED),
            float(modes.MAIN_MODE_OFFBOARD),
        )

    def land(self) -> None:
        """Command PX4's own landing at the present position."""
        self._command(modes.CMD_LAND)

    def arm(self) -> None:
        """Command PX4 to arm, never by force."""
        self._command(modes.CMD_ARM, 1.0)

    def disarm(self) -> None:
        """Command PX4 to disarm. In the air, PX4 refuses."""
        self._command(modes.CMD_ARM, 0.0)

    def kill(self) -> None:
        """Disarm by force. The motors stop at once, even in the air."""
        self._command(modes.CMD_ARM, 0.0, modes.FORCE_DISARM_MAGIC)

    def request_heartbeat(self) -> None:
        """Request one HEARTBEAT (REQUEST_MESSAGE), because its rate cannot be raised in PX4."""
        self._command(modes.CMD_REQUEST_MESSAGE, float(_HEARTBEAT))

    def reboot(self) -> None:
        """Reboot only the autopilot (PREFLIGHT_REBOOT_SHUTDOWN); an armed PX4 refuses."""
        self._command(modes.CMD_REBOOT, 1.0)

    def play_tune(self) -> None:
        """Play a tune on PX4's buzzer or motors (PLAY_TUNE), which PX4 does not acknowledge."""
        self._send("PLAY_TUNE", self.system_id, AUTOPILOT_COMPONENT, _TUNE.encode())

    def request_log(self, number: int, payload: bytes) -> None:
        """Pass on a request for PX4's own logs: one of :data:`onboard.px4.packets.LOG_REQUESTS`."""
        self._relay.send(number, payload)

    def send_corrections(self, flags: int, data: bytes) -> None:
        """Send corrections to PX4's receiver (GPS_RTCM_DATA), which PX4 does not acknowledge."""
        self._send("GPS_RTCM_DATA", flags, len(data), data)

    def send_odometry(
        self,
        position_enu_m: Xyz,
        quaternion_enu_flu_wxyz: Wxyz,
        std_m: float,
        reset_count: int = 0,
    ) -> None:
        """Send ODOMETRY in the fleet's axes as NED, without velocity, which a mocap does not
        measure.

        Nothing is sent to a disarmed PX4 that does not have its global origin yet.
        """
        if self.withholds_poses and not self.snapshot().is_armed:
            return
        self._poses_ns = time.monotonic_ns()

        # PX4 ignores the heading if the norm of the quaternion differs from 1 by 1e-5 or more
        w, x, y, z = quaternion_enu_flu_wxyz
        norm = math.hypot(w, x, y, z)
        unit_quaternion = (w / norm, x / norm, y / norm, z / norm)

        if std_m != self._std_m:
            self._std_m = std_m
            self._covariance = _pose_covariance(std_m)

        self._send(
            "ODOMETRY",
            time.monotonic_ns() // 1000,
            *ned_from_enu(position_enu_m),
            *ned_frd_from_enu_flu(unit_quaternion),
            *_UNKNOWN_VELOCITY,
            *self._covariance,
            *_UNKNOWN_COVARIANCE,
            _FRAME_LOCAL_NED,
            _FRAME_LOCAL_FRD_VELOCITY,
            reset_count,
            _ESTIMATOR_TYPE_VISION,
            _QUALITY_PERCENT,
        )

    def set_global_origin(self) -> None:
        """Give PX4 a global origin.

        Without it, PX4 refuses its position modes, for instance hold and land.
        """
        latitude_deg, longitude_deg, altitude_m = _ORIGIN
        self._send(
            "SET_GPS_GLOBAL_ORIGIN",
            round(latitude_deg * 1e7),
            round(longitude_deg * 1e7),
            round(altitude_m * 1e3),
            self.system_id,
            time.monotonic_ns() // 1000,
        )

    def settle_global_origin(self, *, sets_ours: bool) -> bool:
        """Request PX4's global origin, and set ours until PX4 confirms it.

        Call it once a second on the ground.

        PX4 sends its origin by itself only when it sets it, and that datagram may be lost. If PX4
        v1.18 gets an origin while it fuses poses, its local position moves by thousands of
        kilometres and stays there, because PX4 treats the move as an error of the poses. Therefore
        no poses are sent until PX4 has our origin, and our origin is set only after a second
        without poses.

        Args:
            sets_ours: whether PX4 needs our origin, because a height from a mocap needs altitude 0.

        Returns:
            Whether PX4 has an origin; with ``sets_ours``, whether it has ours.
        """
        px4_origin = self.snapshot().global_origin
        if px4_origin is None:
            is_settled = False
        elif sets_ours:
            # only the altitude matters, as the comment at _ORIGIN says
            _, _, px4_altitude_m = px4_origin
            _, _, our_altitude_m = _ORIGIN
            is_settled = abs(px4_altitude_m - our_altitude_m) <= _ORIGIN_TOLERANCE_M
        else:
            is_settled = True
        self.withholds_poses = sets_ours and not is_settled

        if px4_origin is None:
            self.request_global_origin()
        if self.withholds_poses and time.monotonic_ns() - self._poses_ns > _PAUSE_NS:
            self.set_global_origin()
        return is_settled

    def request_global_origin(self) -> None:
        """Request PX4's global origin, which PX4 sends by itself only when it sets it."""
        self._command(modes.CMD_REQUEST_MESSAGE, float(_GPS_GLOBAL_ORIGIN))

    def request_rates(self) -> None:
        """Request the rates of all messages that the agent reads, and PX4's version.

        PX4's default rates are too low for flying close to others.
        """
        for number, rate_hz in self._rates_hz.items():
            interval_us = _STOP_US
            if rate_hz:
                interval_us = 1e6 / rate_hz
            self._command(modes.CMD_SET_MESSAGE_INTERVAL, float(number), interval_us)

        for number in _UNUSED:
            self._command(modes.CMD_SET_MESSAGE_INTERVAL, float(number), _STOP_US)

        self.request_version()

    def request_version(self) -> None:
        """Request PX4's version, which PX4 sends only on request."""
        self._command(modes.CMD_REQUEST_MESSAGE, float(_AUTOPILOT_VERSION))

    # -- parameters: blocking, for an executor -----------------------------------------------------

    def read_params(self, names: Mapping[str, float | int]) -> dict[str, float | int | None]:
        """Read parameters.

        Args:
            names: Name -> any value of the parameter's type.
        Returns:
            Name -> value; None if PX4 did not answer.
        """
        return {name: self._read_param(name, like) for name, like in names.items()}

    def apply_params(self, values: Mapping[str, float | int]) -> None:
        """Set parameters; :meth:`read_params` shows whether that worked."""
        if self._param is None:
            return
        for name, value in values.items():
            for _ in range(_ATTEMPTS):
                try:
                    self._set_param(self._param, name, value)
                except ParamError:
                    continue
                break

    def _set_param(self, param: Param, name: str, value: float | int) -> None:
        """Set a parameter, converted to the type that PX4 uses for it."""
        if isinstance(self._read_param(name, value), int):
            param.set_param_int(name, int(value))
        else:
            param.set_param_float(name, float(value))

    def _read_param(self, name: str, like: float | int) -> float | int | None:
        """Return a parameter; None if PX4 does not answer. The type of ``like`` is tried first."""
        param = self._param
        if param is None:
            return None

        def read_int() -> int:
            return int(param.get_param_int(name))

        def read_float() -> float:
            return float(param.get_param_float(name))

        readers: list[Callable[[], float | int]] = [read_float, read_int]
        if isinstance(like, int):
            readers.reverse()

        for read in readers:
            try:
                return read()
            except ParamError as error:
                # PX4 does not know the parameter (v1.18 and later say so), or was silent for
                # seconds; another type would not help
                if error.result in (ParamResult.DOES_NOT_EXIST, ParamResult.TIMEOUT):
                    return None
        return None

    # -- wire --------------------------------------------------------------------------------------

    def _boot_ms(self) -> int:
        """Return the time since the start of the link, as an unsigned number of 32 bits."""
        since_start_ms = (time.monotonic_ns() - self._start_ns) // 1_000_000
        return since_start_ms & 0xFFFFFFFF

    def _command(self, command: int, param1: float = 0.0, param2: float = 0.0) -> None:
        """Send a command, without waiting for its answer."""
        param3 = 0.0
        params4_to_7 = (0.0,) * 4
        if command == modes.CMD_LAND:
            params4_to_7 = (_NAN,) * 4  # keep heading and position
        confirmation = 0

        self._send(
            "COMMAND_LONG",
            param1,
            param2,
            param3,
            *params4_to_7,
            command,
            self.system_id,
            AUTOPILOT_COMPONENT,
            confirmation,
        )

    def _send(self, name: str, *values: float | bytes) -> None:
        """Send a message of SENT with these values, in wire order."""
        message = SENT[name]
        self._relay.send(message.number, message.layout.pack(*values))

    def _send_for_mavsdk(self, data: bytes) -> None:
        """Send MAVSDK's packets, on its thread: heartbeats, and requests of parameters."""
        keep_thread_state()
        for packet in cut(data):
            if isinstance(packet, Packet) and packet.number in MAVSDK_SENDS:
                self._relay.send(packet.number, packet.payload)
