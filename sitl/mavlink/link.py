"""One MAVLink link of one emulated PX4: its answers and its streams.

`receive` takes bytes and returns the answers, `poll` returns the streams. There are no sockets
here. A table at the end of the file lists the messages with their handlers and addressees. The
tables of commands and of streams are in `commands.py` and `streams.py`.

No datagram raises an error: unknown messages are ignored, malformed ones are counted, and unusual
numbers are replaced or ignored.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from sitl.emulator.emulator import Emulator
from sitl.mavlink import commands
from sitl.mavlink.codec import ID_BY_NAME, Decoder, Encoder, MavlinkMessage, text_of
from sitl.mavlink.link_key import LinkKey
from sitl.mavlink.log_transfer import LOG_DATA_BYTES, FileServer, LogSender
from sitl.mavlink.streams import BUILDERS, schedule_of
from sitl.mavlink.view import View
from sitl.physics.earth import EarthPoint
from sitl.px4 import setpoints
from sitl.px4.commander import EmulatedPx4
from sitl.px4.journal import Px4Event
from sitl.px4.modes import CommandResult
from sitl.px4.parameters import HASH_CHECK, MAV_PARAM_TYPE_UINT32
from sitl.px4.signals import Setpoint, StatusText
from sitl.px4.sticks import CENTRED

_ACK = ID_BY_NAME["COMMAND_ACK"]
_PARAM_VALUE = ID_BY_NAME["PARAM_VALUE"]
_DOES_NOT_EXIST = 1  # MAV_PARAM_ERROR
_STATUSTEXT = ID_BY_NAME["STATUSTEXT"]
_EVENT = ID_BY_NAME["EVENT"]
_ORIGIN = ID_BY_NAME["GPS_GLOBAL_ORIGIN"]
_FILE_TRANSFER = ID_BY_NAME["FILE_TRANSFER_PROTOCOL"]

_AUTOPILOT_COMPONENT = 1
_MAV_TYPE_GCS = 6
_DO_SET_MODE = 176
_HASH_INDEX = 0xFFFF  # -1 as param_index

_GCS_TIMEOUT_S = 3.0  # time without a heartbeat after which a ground station is lost
_TEXT_BACKLOG_S = 5.0  # largest age of texts that a new ground station receives
_TEXT_CHUNK = 50  # characters in one STATUSTEXT
_PARAMS_PER_POLL = 4

# External positions and headings with a larger number are ignored.
_MAX_POSITION_M = 1e4
_MAX_YAW_RAD = 1e4

# Fields of MANUAL_CONTROL in the order of `Axes`, with the least value of each: a throttle has no
# negative half.
_STICK_RANGES = (("x", -1000), ("y", -1000), ("z", 0), ("r", -1000))
_FULL_STICK = 1000.0  # largest value of each

_RTCM_BYTES = 180  # largest number of bytes in a GPS_RTCM_DATA

_Xyz = tuple[float, float, float]


class _Frame(IntEnum):
    """Frames of ODOMETRY that are fused (MAV_FRAME)."""

    LOCAL_NED = 1
    LOCAL_ENU = 4
    LOCAL_FRD = 20
    LOCAL_FLU = 21


class Link:
    """A MAVLink channel of one vehicle.

    Args:
        emulator: emulator with the vehicle.
        index: index of the vehicle.
        rates_hz: default rate of each message that the link can stream.
        link_id: PX4's number of the link: 0 is the link of the ground, 1 that of the companion.
    """

    def __init__(
        self, emulator: Emulator, index: int, rates_hz: Mapping[int, float], link_id: int = 1
    ) -> None:
        self.emulator = emulator
        self.index = index
        self.view = View(emulator, index)
        self.encoder = Encoder(self.view.system_id)
        self.schedule = schedule_of(self.autopilot.version, rates_hz)
        self.schedule.start(self.view.now_s, boot_s=self.autopilot.boot_time_s, phase=index)

        self._decoder = Decoder()
        self._key = LinkKey(emulator.key_stores[index], link_id, self.encoder, self._decoder)

        logs = None
        if emulator.flight_logs is not None:
            logs = emulator.flight_logs[index]
        self._file_server = FileServer(logs)
        self._log_sender = LogSender(logs)

        self._params_to_send: deque[str] = deque()
        self._texts_sent = 0
        self._events_sent = self.autopilot.journal.events.count
        self._text_id = -1
        # Time of the newest heartbeat of a ground station on this link.
        self._gcs_time_s = -math.inf
        self._has_gcs = False
        self._sent_origin: object = None  # origin that was sent last on this link

    @property
    def autopilot(self) -> EmulatedPx4:
        """The vehicle's PX4."""
        return self.emulator.autopilots[self.index]

    @property
    def boot(self) -> int:
        """Number of restarts of the autopilot."""
        return self.emulator.disturbances.boots[self.index]

    @property
    def malformed(self) -> int:
        """Number of malformed datagrams."""
        return self._decoder.malformed

    def receive(self, datagram: bytes) -> list[bytes]:
        """Carry out the messages of one datagram; return the answers."""
        self._key.follow()

        answers: list[bytes] = []
        for message in self._decoder.decode(datagram):
            reaction = REACTIONS.get(message.name)
            if reaction is None or not reaction.is_meant(self, message):
                continue
            handler_answers = reaction.handler(self, message)
            if handler_answers is not None:
                answers.extend(handler_answers)
        return self._key.signed(answers)

    def poll(self) -> list[bytes]:
        """Return all datagrams that are due at the present time of the emulator."""
        now_s = self.view.now_s
        self._key.follow()

        frames = self._streamed(now_s)
        for _ in range(min(_PARAMS_PER_POLL, len(self._params_to_send))):
            frames.append(self._param_value(self._params_to_send.popleft()))

        journal = self.autopilot.journal
        if journal.events.count != self._events_sent:
            frames.extend(self._event(event) for event in journal.events.since(self._events_sent))
            self._events_sent = journal.events.count
        if journal.texts.count != self._texts_sent or now_s - self._gcs_time_s < _GCS_TIMEOUT_S:
            frames.extend(self._texts(now_s))
        frames.extend(self._pieces())

        return self._key.signed(frames)

    def _streamed(self, now_s: float) -> list[bytes]:
        """Return the streamed messages that are due."""
        frames: list[bytes] = []
        for message_id in self.schedule.pop_due(now_s):
            values = BUILDERS[message_id](self.view)
            if values is None:
                continue

            if message_id == _ORIGIN:
                # PX4 sends the origin only when the origin differs from the last one on this link.
                latitude, longitude, altitude_mm, _ = values
                origin = (latitude, longitude, altitude_mm)
                if origin == self._sent_origin:
                    continue
                self._sent_origin = origin
            frames.append(self.encoder.encode(message_id, *values))
        return frames

    def build(self, message_id: int) -> bytes | None:
        """Return one of the messages that can be streamed; None when it has no content."""
        if message_id in self.schedule.silent or message_id not in BUILDERS:
            return None
        values = BUILDERS[message_id](self.view)
        if values is None:
            return None
        return self.encoder.encode(message_id, *values)

    def ack(self, message: MavlinkMessage, command: int, result: CommandResult) -> bytes:
        """Return the COMMAND_ACK to the sender of a message."""
        progress = 0
        result_param2 = 0
        return self.encoder.encode(
            _ACK,
            command,
            int(result),
            progress,
            result_param2,
            message.system_id,
            message.component_id,
        )

    # -- texts, events, parameters -----------------------------------------------------------------

    def _texts(self, now_s: float) -> list[bytes]:
        """Return the STATUSTEXTs that are new for this link.

        PX4 sends its texts to a link only while the link receives heartbeats of a ground station.
        """
        journal = self.autopilot.journal
        new = journal.texts.since(self._texts_sent)
        self._texts_sent = journal.texts.count

        if now_s - self._gcs_time_s >= _GCS_TIMEOUT_S:
            self._has_gcs = False
            return []

        if not self._has_gcs:
            self._has_gcs = True
            new = [text for text in journal.texts.newest if now_s - text.time_s < _TEXT_BACKLOG_S]

        chunks: list[bytes] = []
        for text in new:
            chunks.extend(self._chunks(text))
        return chunks

    def _chunks(self, text: StatusText) -> list[bytes]:
        """Return a text as STATUSTEXTs."""
        # PX4 counts from 0, and includes texts of a single chunk.
        self._text_id = (self._text_id + 1) & 0xFFFF

        raw = text.text.encode("ascii", "replace")
        pieces = [raw[start : start + _TEXT_CHUNK] for start in range(0, len(raw), _TEXT_CHUNK)]
        return [
            self.encoder.encode(_STATUSTEXT, text.severity, piece, self._text_id, chunk)
            for chunk, piece in enumerate(pieces)
        ]

    def _event(self, event: Px4Event) -> bytes:
        time_ms = round((event.time_s - self.autopilot.boot_time_s) * 1e3) & 0xFFFFFFFF
        destination = (0, 0)  # all components of all systems
        arguments = event.arguments.ljust(40, b"\0")
        return self.encoder.encode(
            _EVENT,
            event.event_id,
            time_ms,
            event.sequence,
            *destination,
            event.log_levels,
            *arguments,
        )

    def _param_value(self, name: str) -> bytes:
        params = self.autopilot.params
        if name == HASH_CHECK:
            value = params.hash_value()
            index = _HASH_INDEX
            kind = MAV_PARAM_TYPE_UINT32
        else:
            value = params.encoded_value(name)
            index = params.index(name)
            kind = params.kind(name)
        return self.encoder.encode(
            _PARAM_VALUE, value, len(params.values), index, name.encode("ascii"), kind
        )

    # -- addressees of messages --------------------------------------------------------------------

    def _is_for_vehicle(self, message: MavlinkMessage) -> bool:
        """Return whether a message is for this vehicle or for all."""
        return message.fields.get("target_system", 0) in (0, self.view.system_id)

    def _is_for_autopilot(self, message: MavlinkMessage) -> bool:
        """Return whether a message is for the autopilot of this vehicle or for all."""
        if not self._is_for_vehicle(message):
            return False
        return message.fields["target_component"] in (0, _AUTOPILOT_COMPONENT)

    def _is_for_vehicle_alone(self, message: MavlinkMessage) -> bool:
        """Return whether a message names this vehicle."""
        return bool(message.fields["target_system"] == self.view.system_id)

    def _is_for_autopilot_alone(self, message: MavlinkMessage) -> bool:
        """Return whether a message names this vehicle; PX4 ignores commands of a broadcast."""
        return self._is_for_vehicle_alone(message) and self._is_for_autopilot(message)

    def _is_command_for_us(self, message: MavlinkMessage) -> bool:
        """Return whether a command is for this autopilot; all vehicles answer some commands."""
        if message.fields["command"] in commands.FOR_EVERYBODY:
            return self._is_for_vehicle(message)
        return self._is_for_autopilot_alone(message)

    def _is_for_anybody(self, message: MavlinkMessage) -> bool:
        """Return True, since the message is accepted with any address."""
        return True

    # -- messages ----------------------------------------------------------------------------------

    def _heartbeat(self, message: MavlinkMessage) -> None:
        if message.fields["type"] == _MAV_TYPE_GCS:
            self._gcs_time_s = self.view.now_s
            self.autopilot.ground_time_s = self.view.now_s

    def _timesync(self, message: MavlinkMessage) -> list[bytes]:
        is_answer = message.fields["tc1"] != 0
        if is_answer:
            return []
        boot_ns = self.view.boot_us * 1000
        return [self.encoder.encode(message.message_id, boot_ns, message.fields["ts1"])]

    def _ping(self, message: MavlinkMessage) -> list[bytes]:
        fields = message.fields
        is_answer = fields["target_system"] != 0 or fields["target_component"] != 0
        if is_answer:
            return []
        return [
            self.encoder.encode(
                message.message_id,
                fields["time_usec"],
                fields["seq"],
                message.system_id,
                message.component_id,
            )
        ]

    def _param_list(self, message: MavlinkMessage) -> None:
        # The checksum comes first, so that a ground station can use the values that it has stored.
        self._params_to_send.clear()
        self._params_to_send.extend([HASH_CHECK, *self.autopilot.params.names()])

    def _param_read(self, message: MavlinkMessage) -> list[bytes]:
        names = self.autopilot.params.names()
        index = message.fields["param_index"]

        name = ""
        if index < 0:
            name = text_of(message.fields["param_id"])
        elif index < len(names):
            name = names[index]

        if name in self.autopilot.params.values or name == HASH_CHECK:
            return [self._param_value(name)]
        return self._param_unknown(message, name, index)

    def _param_unknown(self, message: MavlinkMessage, name: str, index: int) -> list[bytes]:
        if not self.autopilot.version.answers_unknown_parameters:
            return []
        return [
            self.encoder.encode_named(
                "PARAM_ERROR",
                target_system=message.system_id,
                target_component=message.component_id,
                param_id=name.encode("ascii", "replace"),
                param_index=index,
                error=_DOES_NOT_EXIST,
            )
        ]

    def _param_set(self, message: MavlinkMessage) -> list[bytes]:
        fields = message.fields
        name = text_of(fields["param_id"])
        if name == HASH_CHECK:
            self._params_to_send.clear()  # the ground station has all values already
            return []

        # PX4 answers neither a wrong type nor, before v1.18, an unknown name; its console shows
        # them.
        is_set = self.autopilot.params.set_encoded(
            name, fields["param_value"], fields["param_type"]
        )
        if not is_set and name not in self.autopilot.params.values:
            no_index = -1
            return self._param_unknown(message, name, no_index)
        if not is_set:
            return []
        self.emulator.parameters_changed(self.index)
        return [self._param_value(name)]

    def _attitude_target(self, message: MavlinkMessage) -> None:
        fields = message.fields
        rate_rad_s = [fields["body_roll_rate"], fields["body_pitch_rate"], fields["body_yaw_rate"]]
        self.emulator.attitude_setpoint(
            self.index,
            attitude_wxyz=fields["q"],
            rate_rad_s=rate_rad_s,
            thrust_frac=fields["thrust"],
            type_mask=fields["type_mask"],
        )

    def _corrections(self, message: MavlinkMessage) -> None:
        fields = message.fields
        length = min(fields["len"], _RTCM_BYTES)
        data = bytes(fields["data"])[:length].ljust(length, b"\0")
        self.emulator.corrections(self.index, fields["flags"], data)

    def _sticks(self, message: MavlinkMessage) -> None:
        fields = message.fields
        if fields["target"] not in (0, self.view.system_id):
            return

        # PX4 takes a stick beyond its range as centred.
        positions = list(CENTRED)
        for place, (axis, least) in enumerate(_STICK_RANGES):
            if least <= fields[axis] <= _FULL_STICK:
                positions[place] = fields[axis] / _FULL_STICK
        pitch, roll, throttle, yaw = positions
        self.autopilot.take_sticks(self.view.now_s, (pitch, roll, throttle, yaw))

    def _position_target(self, message: MavlinkMessage) -> None:
        self.emulator.position_setpoint(self.index, message.fields)

    def _global_target(self, message: MavlinkMessage) -> None:
        fields = message.fields
        frame = fields["coordinate_frame"]
        is_known = frame in setpoints.ABOVE_SEA or frame in setpoints.ABOVE_HOME
        if not is_known or not self.view.has_origin:
            return

        altitude_m = fields["alt"]
        if frame in setpoints.ABOVE_HOME:
            altitude_m = altitude_m + self.view.home_altitude_m
        position = self.view.to_local(
            fields["lat_int"] * 1e-7, fields["lon_int"] * 1e-7, altitude_m
        )

        setpoint = setpoints.from_global(fields, position, now_s=self.view.now_s)
        if isinstance(setpoint, Setpoint):
            self.emulator.accept_setpoint(self.index, setpoint)

    def _odometry(self, message: MavlinkMessage) -> None:
        fields = message.fields
        position = _odometry_position(fields)
        if position is None:
            return

        # works for a quaternion of any length; NaN for a quaternion of zeros
        w, x, y, z = fields["q"]
        yaw_rad = math.nan
        if abs(w) + abs(x) + abs(y) + abs(z) > 0.0:
            yaw_rad = math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)

        has_velocity = math.isfinite(fields["vx"] + fields["vy"] + fields["vz"])
        self._take_vision(position, yaw_rad, fields["reset_counter"], has_velocity=has_velocity)

    def _vision(self, message: MavlinkMessage) -> None:
        fields = message.fields
        position = (fields["x"], fields["y"], fields["z"])
        self._take_vision(position, fields["yaw"], fields["reset_counter"], has_velocity=False)

    def _take_vision(
        self, position: _Xyz, yaw_rad: float, reset_count: int, *, has_velocity: bool
    ) -> None:
        """Pass an external position to the estimator; a heading beyond the limit counts as NaN."""
        if not all(abs(coordinate) < _MAX_POSITION_M for coordinate in position):
            return

        if not abs(yaw_rad) < _MAX_YAW_RAD:
            yaw_rad = math.nan
        self.emulator.vision(
            self.index,
            np.array(position),
            yaw_rad=yaw_rad,
            has_velocity=has_velocity,
            reset_count=reset_count,
        )

    def _set_origin(self, message: MavlinkMessage) -> None:
        fields = message.fields
        received = EarthPoint(
            latitude_deg=fields["latitude"] * 1e-7,
            longitude_deg=fields["longitude"] * 1e-7,
            altitude_m=fields["altitude"] * 1e-3,
        )
        self.emulator.set_global_origin(self.index, received)

    def _set_mode(self, message: MavlinkMessage) -> list[bytes]:
        custom_mode = message.fields["custom_mode"]
        result = self.autopilot.request_mode(
            self.view.now_s,
            main=custom_mode >> 16 & 0xFF,
            sub=custom_mode >> 24 & 0xFF,
            base_mode=message.fields["base_mode"],
        )
        return [self.ack(message, _DO_SET_MODE, result)]

    def _setup_signing(self, message: MavlinkMessage) -> None:
        self._key.set_up(self.autopilot, self.view.now_s, message)

    def _play_tune(self, message: MavlinkMessage) -> None:
        self.autopilot.play_tune()  # PX4 does not acknowledge a tune

    def _request_event(self, message: MavlinkMessage) -> list[bytes]:
        # Sequence numbers have 16 bits, so the last one may be smaller than the first.
        first = message.fields["first_sequence"]
        last = message.fields["last_sequence"]
        span = (last - first) & 0xFFFF

        stored = self.autopilot.journal.events.newest
        requested = [event for event in stored if (event.sequence - first) & 0xFFFF <= span]
        if requested:
            return [self._event(event) for event in requested]

        oldest = 0
        if stored:
            oldest = stored[0].sequence
        return [
            self.encoder.encode_named(
                "RESPONSE_EVENT_ERROR",
                sequence=first,
                sequence_oldest_available=oldest,
                target_system=message.system_id,
                target_component=message.component_id,
            )
        ]

    # -- missions: not emulated; refused, so that clients do not wait for a timeout ----------------

    def _mission_list(self, message: MavlinkMessage) -> list[bytes]:
        return [self._to_sender("MISSION_COUNT", message)]

    def _mission_upload(self, message: MavlinkMessage) -> list[bytes]:
        accepted = 0
        unsupported = 3
        is_empty = message.fields["count"] == 0
        if is_empty:
            return [self._to_sender("MISSION_ACK", message, type=accepted)]
        return [self._to_sender("MISSION_ACK", message, type=unsupported)]

    def _mission_clear(self, message: MavlinkMessage) -> list[bytes]:
        return [self._to_sender("MISSION_ACK", message)]

    def _mission_item(self, message: MavlinkMessage) -> list[bytes]:
        invalid_sequence = 13
        return [self._to_sender("MISSION_ACK", message, type=invalid_sequence)]

    def _to_sender(self, name: str, message: MavlinkMessage, **fields: int) -> bytes:
        """Return a message about missions, addressed to the sender of another message."""
        return self.encoder.encode_named(
            name,
            target_system=message.system_id,
            target_component=message.component_id,
            mission_type=message.fields.get("mission_type", 0),
            **fields,
        )

    # -- logs and files ----------------------------------------------------------------------------

    def _log_list(self, message: MavlinkMessage) -> list[bytes]:
        entries = self._log_sender.listed()
        if not entries:
            return [self.encoder.encode_named("LOG_ENTRY")]  # an entry of zeros stands for no logs
        first = message.fields["start"]
        last = message.fields["end"]
        return [
            self.encoder.encode_named("LOG_ENTRY", **entry)
            for entry in entries
            if first <= entry["id"] <= last
        ]

    def _log_data(self, message: MavlinkMessage) -> None:
        fields = message.fields
        self._log_sender.request(fields["id"], fields["ofs"], fields["count"])

    def _log_end(self, message: MavlinkMessage) -> None:
        self._log_sender.stop()

    def _file_transfer(self, message: MavlinkMessage) -> list[bytes]:
        sender = (message.system_id, message.component_id)
        payload = bytes(message.fields["payload"])
        answer = self._file_server.answer(payload, sender, self.view.now_s)
        if answer is None:
            return []
        return [self._file_message(answer, sender)]

    def _file_message(self, payload: bytes, receiver: tuple[int, int]) -> bytes:
        network = 0
        return self.encoder.encode(_FILE_TRANSFER, network, *receiver, *payload)

    def _pieces(self) -> list[bytes]:
        """Return the messages with pieces of logs and files that are due."""
        frames = [self._file_message(*piece) for piece in self._file_server.due(self.view.now_s)]
        for number, offset, data in self._log_sender.due():
            padded = data.ljust(LOG_DATA_BYTES, b"\0")
            frames.append(
                self.encoder.encode_named(
                    "LOG_DATA", ofs=offset, id=number, count=len(data), data=padded
                )
            )
        return frames


def _odometry_position(fields: Mapping[str, Any]) -> _Xyz | None:
    """Return the position of an ODOMETRY [m], x, y and z down; None in a frame that is not fused.

    PX4 converts the position of each of these frames, but takes the quaternion as it is.
    """
    x, y, z = fields["x"], fields["y"], fields["z"]
    match fields["frame_id"]:
        case _Frame.LOCAL_NED | _Frame.LOCAL_FRD:
            return x, y, z
        case _Frame.LOCAL_ENU:
            return y, x, -z
        case _Frame.LOCAL_FLU:
            return x, -y, -z
        case _:
            return None


class Reaction(NamedTuple):
    """Handler of one message, and whether the message is addressed to the link's vehicle."""

    handler: Callable[[Link, MavlinkMessage], list[bytes] | None]
    is_meant: Callable[[Link, MavlinkMessage], bool] = Link._is_for_vehicle


REACTIONS: dict[str, Reaction] = {
    "HEARTBEAT": Reaction(Link._heartbeat),
    "TIMESYNC": Reaction(Link._timesync),
    "PING": Reaction(Link._ping),
    "PARAM_REQUEST_LIST": Reaction(Link._param_list, Link._is_for_autopilot_alone),
    "PARAM_REQUEST_READ": Reaction(Link._param_read, Link._is_for_autopilot_alone),
    "PARAM_SET": Reaction(Link._param_set, Link._is_for_autopilot_alone),
    "COMMAND_LONG": Reaction(commands.handle, Link._is_command_for_us),
    "COMMAND_INT": Reaction(commands.handle, Link._is_command_for_us),
    "SET_MODE": Reaction(Link._set_mode),
    "SETUP_SIGNING": Reaction(Link._setup_signing, Link._is_for_anybody),
    "SET_GPS_GLOBAL_ORIGIN": Reaction(Link._set_origin, Link._is_for_vehicle_alone),
    "SET_ATTITUDE_TARGET": Reaction(Link._attitude_target, Link._is_for_autopilot),
    "SET_POSITION_TARGET_LOCAL_NED": Reaction(Link._position_target, Link._is_for_autopilot),
    "SET_POSITION_TARGET_GLOBAL_INT": Reaction(Link._global_target, Link._is_for_autopilot),
    "ODOMETRY": Reaction(Link._odometry),
    "VISION_POSITION_ESTIMATE": Reaction(Link._vision),
    "GPS_RTCM_DATA": Reaction(Link._corrections, Link._is_for_anybody),
    "MANUAL_CONTROL": Reaction(Link._sticks),
    "PLAY_TUNE": Reaction(Link._play_tune, Link._is_for_autopilot),
    "REQUEST_EVENT": Reaction(Link._request_event),
    "MISSION_REQUEST_LIST": Reaction(Link._mission_list),
    "MISSION_COUNT": Reaction(Link._mission_upload),
    "MISSION_CLEAR_ALL": Reaction(Link._mission_clear),
    "MISSION_REQUEST_INT": Reaction(Link._mission_item),
    "MISSION_REQUEST": Reaction(Link._mission_item),
    "LOG_REQUEST_LIST": Reaction(Link._log_list),
    "LOG_REQUEST_DATA": Reaction(Link._log_data),
    "LOG_REQUEST_END": Reaction(Link._log_end),
    "FILE_TRANSFER_PROTOCOL": Reaction(Link._file_transfer, Link._is_for_autopilot),
}
