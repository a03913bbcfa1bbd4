"""One MAVLink link of one emulated PX4: what it answers and what it streams. Bytes in, bytes out; no sockets.

Whatever a client sends, nothing here raises: unknown messages are ignored, broken ones counted, odd numbers tamed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from sitl.emulator import Emulator
from sitl.mavlink import ID_BY_NAME, Decoder, Encoder, Message, text_of
from sitl.modes import Mode, Result
from sitl.signals import Text
from sitl.streams import BUILDERS, Schedule, View

_ACK = ID_BY_NAME["COMMAND_ACK"]
_PARAM_VALUE = ID_BY_NAME["PARAM_VALUE"]
_STATUSTEXT = ID_BY_NAME["STATUSTEXT"]
_MAV_TYPE_GCS = 6
_GCS_TIMEOUT_S = 3.0
_TEXT_BACKLOG_S = 5.0
_TEXT_CHUNK = 50
_PARAMS_PER_POLL = 4
_LOCAL_NED, _BODY_NED, _LOCAL_FRD = 1, 8, 20
_MAX_POSITION_M = 1e4


class Link:
    """A MAVLink channel of one vehicle.

    Args:
        emulator, index: the vehicle.
        rates_hz: default rate of each message it can stream.
    """

    def __init__(self, emulator: Emulator, index: int, rates_hz: dict[int, float]) -> None:
        self._emulator = emulator
        self._index = index
        self._autopilot = emulator.autopilots[index]
        self._system_id = emulator.specs[index].system_id
        self._encoder = Encoder(self._system_id)
        self._view = View(emulator, index, self._encoder)
        self._schedule = Schedule(rates_hz)
        self._schedule.start(emulator.time_s)
        self._decoder = Decoder()
        self._params_to_send: deque[str] = deque()
        self._texts_seen = 0
        self._text_id = 0
        self._gcs_time_s = -math.inf
        self._has_gcs = False

    @property
    def malformed(self) -> int:
        """Datagrams that were no MAVLink."""
        return self._decoder.malformed

    def receive(self, datagram: bytes) -> tuple[bool, list[bytes]]:
        """Take one datagram.

        Returns:
            whether it held any MAVLink message, and what to answer.
        """
        messages = self._decoder.decode(datagram)
        answers: list[bytes] = []
        for message in messages:
            handler = _HANDLERS.get(message.name)
            if handler is not None and self._is_for_us(message):
                answers.extend(handler(self, message))
        return bool(messages), answers

    def poll(self) -> list[bytes]:
        """Everything that is due at the emulator's present time."""
        now = self._emulator.time_s
        out = [self._build(message_id) for message_id in self._schedule.pop_due(now)]
        for _ in range(min(_PARAMS_PER_POLL, len(self._params_to_send))):
            out.append(self._param_value(self._params_to_send.popleft()))
        out.extend(self._texts(now))
        return out

    # -- helpers ------------------------------------------------------------------------------------------------

    def _is_for_us(self, message: Message) -> bool:
        return message.fields.get("target_system", 0) in (0, self._system_id)

    def _build(self, message_id: int) -> bytes:
        return self._encoder.encode(message_id, *BUILDERS[message_id](self._view))

    def _texts(self, now_s: float) -> list[bytes]:
        # PX4 tells a link its texts only while a ground station's heartbeat arrives on that very link.
        connected = now_s - self._gcs_time_s < _GCS_TIMEOUT_S
        texts = self._autopilot.texts
        new = texts[self._texts_seen :]
        if not connected:
            self._has_gcs = False
            self._texts_seen = len(texts)
            return []
        if not self._has_gcs:
            self._has_gcs = True
            new = [text for text in texts if now_s - text.time_s < _TEXT_BACKLOG_S]
        self._texts_seen = len(texts)
        return [chunk for text in new for chunk in self._chunks(text)]

    def _chunks(self, text: Text) -> list[bytes]:
        raw = text.text.encode("ascii", "replace")
        if len(raw) <= _TEXT_CHUNK:
            return [self._encoder.encode(_STATUSTEXT, text.severity, raw, 0, 0)]
        self._text_id = self._text_id % 0xFFFF + 1
        pieces = [raw[start : start + _TEXT_CHUNK] for start in range(0, len(raw), _TEXT_CHUNK)]
        return [
            self._encoder.encode(_STATUSTEXT, text.severity, piece, self._text_id, place)
            for place, piece in enumerate(pieces)
        ]

    def _param_value(self, name: str) -> bytes:
        params = self._autopilot.params
        names = params.names()
        return self._encoder.encode(
            _PARAM_VALUE,
            params.wire_value(name),
            len(names),
            names.index(name),
            name.encode("ascii"),
            params.kind(name),
        )

    def _ack(self, message: Message, command: int, result: Result) -> bytes:
        return self._encoder.encode(_ACK, command, int(result), 0, 0, message.system_id, message.component_id)

    # -- messages -----------------------------------------------------------------------------------------------

    def _heartbeat(self, message: Message) -> list[bytes]:
        if message.fields["type"] == _MAV_TYPE_GCS:
            self._gcs_time_s = self._emulator.time_s
        return []

    def _timesync(self, message: Message) -> list[bytes]:
        if message.fields["tc1"] != 0:
            return []
        answer = (self._view.boot_us * 1000, message.fields["ts1"])
        return [self._encoder.encode(message.message_id, *answer)]

    def _ping(self, message: Message) -> list[bytes]:
        f = message.fields
        if f["target_system"] != 0 or f["target_component"] != 0:
            return []
        answer = (f["time_usec"], f["seq"], message.system_id, message.component_id)
        return [self._encoder.encode(message.message_id, *answer)]

    def _param_list(self, message: Message) -> list[bytes]:
        self._params_to_send.clear()
        self._params_to_send.extend(self._autopilot.params.names())
        return []

    def _param_read(self, message: Message) -> list[bytes]:
        names = self._autopilot.params.names()
        place = message.fields["param_index"]
        name = text_of(message.fields["param_id"]) if place < 0 else names[place] if place < len(names) else ""
        if name in self._autopilot.params.values:
            return [self._param_value(name)]
        self._autopilot.say(self._emulator.time_s, 3, f"unknown param: {name}\t")
        return []

    def _param_set(self, message: Message) -> list[bytes]:
        f = message.fields
        name = text_of(f["param_id"])
        if name not in self._autopilot.params.values:
            self._autopilot.say(self._emulator.time_s, 3, f"unknown param: {name}\t")
            return []
        self._autopilot.params.set_from_wire(name, f["param_value"], f["param_type"])
        self._emulator.parameters_changed(self._index)
        return [self._param_value(name)]

    def _attitude_target(self, message: Message) -> list[bytes]:
        f = message.fields
        rates = [f["body_roll_rate"], f["body_pitch_rate"], f["body_yaw_rate"]]
        self._emulator.attitude_setpoint(self._index, f["q"], rates, f["thrust"], f["type_mask"])
        return []

    def _position_target(self, message: Message) -> list[bytes]:
        frame = message.fields["coordinate_frame"]
        if frame in (_LOCAL_NED, _BODY_NED):
            self._emulator.position_setpoint(self._index, message.fields, is_body_frame=frame == _BODY_NED)
        return []

    def _odometry(self, message: Message) -> list[bytes]:
        if message.fields["frame_id"] in (_LOCAL_NED, _LOCAL_FRD):
            self._vision(message)
        return []

    def _vision(self, message: Message) -> list[bytes]:
        f = message.fields
        position = np.array([f["x"], f["y"], f["z"]], dtype=np.float64)
        if bool(np.all(np.isfinite(position))) and float(np.abs(position).max()) < _MAX_POSITION_M:
            self._emulator.vision(self._index, position)
        return []

    def _global_origin(self, message: Message) -> list[bytes]:
        self._emulator.has_global_origin[self._index] = True
        return [self._build(ID_BY_NAME["GPS_GLOBAL_ORIGIN"])]

    def _set_mode(self, message: Message) -> list[bytes]:
        custom = message.fields["custom_mode"]
        result = self._autopilot.request_mode(self._emulator.time_s, custom >> 16 & 0xFF, custom >> 24 & 0xFF)
        return [self._ack(message, message.message_id, result)]

    def _mission_list(self, message: Message) -> list[bytes]:
        to = {"target_system": message.system_id, "target_component": message.component_id}
        return [self._encoder.encode_named("MISSION_COUNT", **to, mission_type=message.fields["mission_type"])]

    def _mission_upload(self, message: Message) -> list[bytes]:
        # Missions are not emulated: MAV_MISSION_UNSUPPORTED, at once rather than by a timeout.
        to = {"target_system": message.system_id, "target_component": message.component_id}
        return [self._encoder.encode_named("MISSION_ACK", **to, type=3, mission_type=message.fields["mission_type"])]

    # -- commands -----------------------------------------------------------------------------------------------

    def _command(self, message: Message) -> list[bytes]:
        f = message.fields
        command = f["command"]
        if message.name == "COMMAND_LONG":
            numbers = [f[f"param{place}"] for place in range(1, 8)]
        else:
            numbers = [f["param1"], f["param2"], f["param3"], f["param4"], float(f["x"]), float(f["y"]), f["z"]]
        handler = _COMMANDS.get(command)
        if handler is None:
            return [self._ack(message, command, Result.UNSUPPORTED)]
        # Clients leave what they do not use as NaN.
        result, extra = handler(self, [value if math.isfinite(value) else 0.0 for value in numbers])
        acks = [self._ack(message, command, result)]
        if command == _DO_SET_MODE:
            # PX4 answers twice: its receiver at once and always yes, then its commander with the truth.
            acks.insert(0, self._ack(message, command, Result.ACCEPTED))
        return acks + extra

    def _do_arm(self, p: list[float]) -> tuple[Result, list[bytes]]:
        if p[0] not in (0.0, 1.0):
            return Result.UNSUPPORTED, []
        return self._autopilot.request_arm(self._emulator.time_s, p[0] == 1.0, p[1]), []

    def _do_set_mode(self, p: list[float]) -> tuple[Result, list[bytes]]:
        if not int(p[0]) & 1:
            return Result.TEMPORARILY_REJECTED, []
        return self._autopilot.request_mode(self._emulator.time_s, int(p[1]), int(p[2])), []

    def _do_terminate(self, p: list[float]) -> tuple[Result, list[bytes]]:
        if p[0] > 0.5:
            return self._autopilot.request_arm(self._emulator.time_s, False, 21196.0), []
        return Result.ACCEPTED, []

    def _do_interval(self, p: list[float]) -> tuple[Result, list[bytes]]:
        done = self._schedule.set_interval(int(p[0]), p[1], self._emulator.time_s)
        return (Result.ACCEPTED if done else Result.FAILED), []

    def _do_get_interval(self, p: list[float]) -> tuple[Result, list[bytes]]:
        wanted = int(p[0]) & 0xFFFF
        interval = self._schedule.interval_us(wanted)
        known = wanted in BUILDERS
        answer = self._encoder.encode_named("MESSAGE_INTERVAL", message_id=wanted, interval_us=interval if known else 0)
        return Result.ACCEPTED, [answer]

    def _do_request_message(self, p: list[float]) -> tuple[Result, list[bytes]]:
        wanted = int(p[0])
        return (Result.ACCEPTED, [self._build(wanted)]) if wanted in BUILDERS else (Result.DENIED, [])

    def _do_capabilities(self, p: list[float]) -> tuple[Result, list[bytes]]:
        return self._do_request_message([float(ID_BY_NAME["AUTOPILOT_VERSION"])])

    def _do_home(self, p: list[float]) -> tuple[Result, list[bytes]]:
        return self._do_request_message([float(ID_BY_NAME["HOME_POSITION"])])


def _enter(mode: Mode) -> Callable[[Link, list[float]], tuple[Result, list[bytes]]]:
    def handler(link: Link, p: list[float]) -> tuple[Result, list[bytes]]:
        return link._autopilot.request(link._emulator.time_s, mode), []

    return handler


_DO_SET_MODE = 176
_COMMANDS: dict[int, Callable[[Link, list[float]], tuple[Result, list[bytes]]]] = {
    20: _enter(Mode.RTL),
    21: _enter(Mode.LAND),
    22: _enter(Mode.TAKEOFF),
    _DO_SET_MODE: Link._do_set_mode,
    185: Link._do_terminate,
    192: _enter(Mode.LOITER),
    400: Link._do_arm,
    410: Link._do_home,
    510: Link._do_get_interval,
    511: Link._do_interval,
    512: Link._do_request_message,
    520: Link._do_capabilities,
}

_HANDLERS: dict[str, Callable[[Link, Message], list[bytes]]] = {
    "HEARTBEAT": Link._heartbeat,
    "TIMESYNC": Link._timesync,
    "PING": Link._ping,
    "PARAM_REQUEST_LIST": Link._param_list,
    "PARAM_REQUEST_READ": Link._param_read,
    "PARAM_SET": Link._param_set,
    "COMMAND_LONG": Link._command,
    "COMMAND_INT": Link._command,
    "SET_MODE": Link._set_mode,
    "SET_GPS_GLOBAL_ORIGIN": Link._global_origin,
    "SET_ATTITUDE_TARGET": Link._attitude_target,
    "SET_POSITION_TARGET_LOCAL_NED": Link._position_target,
    "ODOMETRY": Link._odometry,
    "VISION_POSITION_ESTIMATE": Link._vision,
    "MISSION_REQUEST_LIST": Link._mission_list,
    "MISSION_COUNT": Link._mission_upload,
}
