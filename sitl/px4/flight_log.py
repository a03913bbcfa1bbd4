"""PX4's log of an emulated flight from arming to disarming, as a ULog file.

A ULog begins with the layouts of its topics. The samples follow in the order of time, with the
texts that PX4 sent meanwhile. PX4's documentation describes the format in "ULog File Format". The
emulator logs the topics that are needed to compare flights: attitude and its setpoint, local
position, battery, status. Their fields are a part of PX4's fields, with PX4's names and units. The
rates are taken from PX4's rates.

Logs are stored in memory. When there are too many, the oldest is removed. A log ends when it is
full, as on PX4's card.
"""

from __future__ import annotations

import struct
import time
from dataclasses import dataclass, field
from typing import NamedTuple

from sitl.px4.commander import EmulatedPx4
from sitl.px4.modes import Mode
from sitl.px4.signals import AutopilotInputs, StatusText

FOLDER = "/fs/microsd/log"
_MAGIC = b"ULog\x01\x12\x35"
_VERSION = 1
_MAX_LOGS = 5
_MAX_BYTES = 8_000_000  # largest size of one log
_LEVEL_ZERO = ord("0")  # the level of a logged text is the digit of its severity
_CELLS = 4
_ARMING_TEXT_S = 0.1  # a log includes texts from this long before its start

# Ticks of 20 ms between two samples of a topic.
_ATTITUDE_TICKS = 2
_POSITION_TICKS = 5
_STATUS_TICKS = 25

# Values of vehicle_status.nav_state.
_NAV_STATES: dict[Mode, int] = {
    Mode.MANUAL: 0,
    Mode.ALTCTL: 1,
    Mode.POSCTL: 2,
    Mode.MISSION: 3,
    Mode.LOITER: 4,
    Mode.RTL: 5,
    Mode.DESCEND: 12,
    Mode.TERMINATION: 13,
    Mode.OFFBOARD: 14,
    Mode.STABILIZED: 15,
    Mode.TAKEOFF: 17,
    Mode.LAND: 18,
}


class LogTopic(NamedTuple):
    """One logged topic."""

    name: str
    fields: str  # declaration of the fields in the file
    packer: struct.Struct  # layout of the same fields


ATTITUDE = LogTopic("vehicle_attitude", "uint64_t timestamp;float[4] q;", struct.Struct("<Q4f"))
ATTITUDE_SETPOINT = LogTopic(
    "vehicle_attitude_setpoint",
    "uint64_t timestamp;float[4] q_d;float[3] thrust_body;",
    struct.Struct("<Q4f3f"),
)
LOCAL_POSITION = LogTopic(
    "vehicle_local_position",
    "uint64_t timestamp;float x;float y;float z;float vx;float vy;float vz;float heading;"
    "bool xy_valid;bool z_valid;",
    struct.Struct("<Q7f2?"),
)
BATTERY = LogTopic(
    "battery_status",
    "uint64_t timestamp;float voltage_v;float remaining;uint8_t cell_count;bool connected;",
    struct.Struct("<Q2fB?"),
)
STATUS = LogTopic(
    "vehicle_status",
    "uint64_t timestamp;uint8_t arming_state;uint8_t nav_state;bool failsafe;",
    struct.Struct("<Q2B?"),
)
TOPICS = (ATTITUDE, ATTITUDE_SETPOINT, LOCAL_POSITION, BATTERY, STATUS)


def _message(kind: str, content: bytes) -> bytes:
    """Return one message of a ULog: size, letter of the kind, content."""
    return struct.pack("<Hc", len(content), kind.encode("ascii")) + content


class LogWriter:
    """Content of one ULog, to which samples and texts are appended.

    Args:
        start_us: time since PX4's start.
        infos: information messages at the beginning of the file, by name.
        parameters: parameters of the vehicle.
    """

    def __init__(
        self, start_us: int, infos: dict[str, str], parameters: dict[str, float | int]
    ) -> None:
        self.content = bytearray(_MAGIC + struct.pack("<BQ", _VERSION, start_us))
        flag_bits = bytes(8 + 8 + 3 * 8)  # no incompatible flags, and no appended data
        self.content += _message("B", flag_bits)

        for topic in TOPICS:
            self.content += _message("F", f"{topic.name}:{topic.fields}".encode("ascii"))
        for name, text in infos.items():
            value = text.encode("utf-8")
            key = f"char[{len(value)}] {name}".encode("ascii")
            self.content += _message("I", bytes((len(key),)) + key + value)
        for name, number in parameters.items():
            self.content += _message("P", self._parameter(name, number))
        for number_of_topic, topic in enumerate(TOPICS):
            first_instance = 0
            subscription = struct.pack("<BH", first_instance, number_of_topic)
            self.content += _message("A", subscription + topic.name.encode("ascii"))

    @staticmethod
    def _parameter(name: str, number: float | int) -> bytes:
        if isinstance(number, int):
            key = f"int32_t {name}".encode("ascii")
            return bytes((len(key),)) + key + struct.pack("<i", number)
        key = f"float {name}".encode("ascii")
        return bytes((len(key),)) + key + struct.pack("<f", number)

    @property
    def is_full(self) -> bool:
        """Whether the log has reached its largest size."""
        return len(self.content) >= _MAX_BYTES

    def sample(self, topic: LogTopic, time_us: int, *values: float) -> None:
        """Append a sample of a topic.

        Args:
            topic: topic of :data:`TOPICS`.
            time_us: time since PX4's start.
            values: values of the fields other than the timestamp.
        """
        if self.is_full:
            return
        number = struct.pack("<H", TOPICS.index(topic))
        self.content += _message("D", number + topic.packer.pack(time_us, *values))

    def text(self, time_us: int, severity: int, text: str) -> None:
        """Append a text that PX4 has sent."""
        if self.is_full:
            return
        head = struct.pack("<BQ", _LEVEL_ZERO + severity, time_us)
        self.content += _message("L", head + text.encode("utf-8"))


@dataclass(slots=True)
class LogFile:
    """One log on the vehicle's card."""

    path: str
    unix_s: float  # date of its start
    writer: LogWriter

    @property
    def content(self) -> bytearray:
        """The bytes of the file so far."""
        return self.writer.content


@dataclass(slots=True)
class FlightLogs:
    """The logs of one vehicle, which a restart of its PX4 keeps.

    Attributes:
        files: the logs, oldest first.
        session_limit_bytes: number of bytes after which a file transfer ends silently; 0: no limit.
    """

    files: list[LogFile] = field(default_factory=list)
    session_limit_bytes: int = 0
    _open: LogFile | None = None
    _ticks: int = 0
    _texts_logged: int = 0  # number of journal texts that no longer need to be logged

    def tick(self, autopilot: EmulatedPx4, inputs: AutopilotInputs, unix_s: float) -> None:
        """Write the samples and texts of the present tick; begin and end the log with the flight.

        Args:
            autopilot: autopilot after its tick.
            inputs: inputs of that tick.
            unix_s: the date.
        """
        time_us = max(0, round((inputs.time_s - autopilot.boot_time_s) * 1e6))
        if autopilot.is_armed and self._open is None:
            self._begin(autopilot, time_us, unix_s)
        if self._open is None:
            return

        self._write(self._open.writer, autopilot, inputs, time_us)
        self._ticks += 1
        if not autopilot.is_armed:
            self._open = None

    def restart(self) -> None:
        """End the log of the present flight, as a restart of PX4 does."""
        self._open = None

    def _begin(self, autopilot: EmulatedPx4, time_us: int, unix_s: float) -> None:
        date = time.strftime("%Y-%m-%d/%H_%M_%S", time.gmtime(unix_s))
        infos = {"sys_name": "PX4", "ver_sw_release_str": autopilot.version.name, "ver_hw": "SITL"}
        writer = LogWriter(time_us, infos, dict(autopilot.params.values))
        self._open = LogFile(path=f"{FOLDER}/{date}.ulg", unix_s=unix_s, writer=writer)
        self.files.append(self._open)
        del self.files[:-_MAX_LOGS]
        self._ticks = 0

        # The texts about the arming belong to this flight.
        texts = autopilot.journal.texts
        now_s = autopilot.boot_time_s + time_us * 1e-6
        recent = [text for text in texts.newest if now_s - text.time_s <= _ARMING_TEXT_S]
        self._texts_logged = texts.count - len(recent)

    def _write(
        self, writer: LogWriter, autopilot: EmulatedPx4, inputs: AutopilotInputs, time_us: int
    ) -> None:
        if self._ticks % _ATTITUDE_TICKS == 0:
            writer.sample(ATTITUDE, time_us, *inputs.attitude.tolist())
        if self._ticks % _POSITION_TICKS == 0:
            self._write_position(writer, autopilot, inputs, time_us)
        if self._ticks % _STATUS_TICKS == 0 or not autopilot.is_armed:
            self._write_status(writer, autopilot, time_us)

        texts = autopilot.journal.texts
        for text in texts.since(self._texts_logged):
            writer.text(time_us, text.severity, _without_tab(text))
        self._texts_logged = texts.count

    def _write_position(
        self, writer: LogWriter, autopilot: EmulatedPx4, inputs: AutopilotInputs, time_us: int
    ) -> None:
        position_ned_m = inputs.position_ned_m.tolist()
        velocity_ned_m_s = inputs.velocity_ned_m_s.tolist()
        is_valid = inputs.has_local_position
        writer.sample(
            LOCAL_POSITION,
            time_us,
            *position_ned_m,
            *velocity_ned_m_s,
            inputs.yaw_rad,
            is_valid,
            is_valid,
        )

        actuation = autopilot.actuation
        thrust_frd = (0.0, 0.0, -actuation.thrust_frac)
        writer.sample(ATTITUDE_SETPOINT, time_us, *actuation.attitude.tolist(), *thrust_frd)

    def _write_status(self, writer: LogWriter, autopilot: EmulatedPx4, time_us: int) -> None:
        armed = 2
        disarmed = 1
        arming_state = disarmed
        if autopilot.is_armed:
            arming_state = armed
        nav_state = _NAV_STATES[autopilot.mode]
        writer.sample(STATUS, time_us, arming_state, nav_state, autopilot.is_failsafe)

        battery = autopilot.battery
        voltage_v = battery.voltage_mv / 1000.0
        is_connected = True
        writer.sample(BATTERY, time_us, voltage_v, battery.remaining_frac, _CELLS, is_connected)


def _without_tab(text: StatusText) -> str:
    """Return a text without the tab at its end, which stands for an event of the same content."""
    return text.text.rstrip("\t")
