"""Reads a PX4 log (ULog) into arrays: PX4's estimates, setpoints, battery, status and messages.

The file comes from a card that may have been pulled out in flight, or from an unknown source.
pyulog reads the intact parts and leaves out damaged ones; where it fails, the file is refused with
a sentence. Only the topics that are shown are kept. Times are seconds since PX4's start.
"""

from __future__ import annotations

import contextlib
import io
import math
import re
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pyulog import ULog, ULogException

from onboard.arrays import Array
from onboard.config.file_reading import ULOG, opened
from onboard.config.fleet import ConfigError
from onboard.plain_text import plain_line

MAX_TEXTS = 5_000
MAX_LETTERS = 300
MAX_DROPOUTS = 100_000
LARGEST = 1e9  # largest believable value of any quantity; larger ones become NaN
_HEAD = b"ULog\x01\x12\x35"  # the first bytes of every log
_TOPICS = [
    "vehicle_attitude",
    "vehicle_attitude_setpoint",
    "vehicle_local_position",
    "vehicle_local_position_setpoint",
    "battery_status",
    "vehicle_status",
]
_ANSI = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")  # codes for the colours of a terminal
_ARMED = 2  # value of vehicle_status.arming_state
# PX4's names of levels that are shown under another name
_LEVELS = {"emerg": "error", "alert": "error", "crit": "error", "critical": "error", "err": "error"}
_LEVELS |= {"emergency": "error", "notice": "info", "unknown": "info"}

_DEEPEST = 20  # deepest nesting of types
_MAX_FIELDS = 10_000  # most fields of a topic, nested types included

# Exceptions that pyulog raises on bytes that are not a ULog.
_BROKEN = (
    ULogException,
    ArithmeticError,
    AttributeError,
    LookupError,
    MemoryError,
    OSError,
    RecursionError,
    TypeError,
    ValueError,
    struct.error,
)


class LogRows(NamedTuple):
    """Samples of one topic."""

    time_s: Array  # (n,), rising
    values: Array  # (n, columns)

    @property
    def size(self) -> int:
        """Number of samples."""
        return int(self.time_s.size)


class LoggedText(NamedTuple):
    """One message of PX4."""

    time_s: float
    level: str  # error, warning, info or debug
    text: str


class Px4Log(NamedTuple):
    """One log of PX4."""

    path: str
    size_bytes: int
    begin_s: float
    end_s: float
    about: dict[str, str]  # subject -> information about the vehicle, for instance PX4's version
    parameter_count: int
    attitude: LogRows  # quaternion NED <- FRD, wxyz
    attitude_setpoint: LogRows  # quaternion NED <- FRD, wxyz
    position: LogRows  # x, y, z [m] and vx, vy, vz [m/s], NED, in PX4's local frame
    position_setpoint: LogRows  # x, y, z [m]
    battery: LogRows  # voltage [V], remaining [0..1]
    status: LogRows  # arming_state, nav_state, failsafe
    texts: tuple[LoggedText, ...]
    dropout_s: float  # total time for which nothing was written
    note: str = ""  # sentence on damage of the file; empty if there is none

    @property
    def length_s(self) -> float:
        """Time from the first sample to the last."""
        return max(0.0, self.end_s - self.begin_s)

    @property
    def armed_s(self) -> float:
        """Time for which the vehicle was armed."""
        if self.status.size < 2:
            return 0.0
        is_armed = self.status.values[:-1, 0] == _ARMED
        return float(np.diff(self.status.time_s)[is_armed].sum())


def read_log(path: Path) -> Px4Log:
    """Read a log.

    Args:
        path: the file's path.

    Raises:
        ConfigError: the file is not a log, or nothing in it can be read.
    """
    with opened(path, ULOG) as file:
        size_bytes = file.seek(0, io.SEEK_END)
        file.seek(0)
        if file.read(len(_HEAD)) != _HEAD:
            raise ConfigError(f"{path}: this is no log of PX4 (ULog).")
    log, note = _parsed(path)

    topics: dict[str, Mapping[str, Any]] = {}
    for data in log.data_list:
        if data.multi_id == 0:  # further instances are of second sensors and batteries
            topics.setdefault(data.name, data.data)

    quaternion = [f"q[{part}]" for part in range(4)]
    setpoint_quaternion = [f"q_d[{part}]" for part in range(4)]
    position = ["x", "y", "z"]
    rows = {
        "attitude": _rows(topics, "vehicle_attitude", quaternion),
        "attitude_setpoint": _rows(topics, "vehicle_attitude_setpoint", setpoint_quaternion),
        "position": _rows(topics, "vehicle_local_position", [*position, "vx", "vy", "vz"]),
        "position_setpoint": _rows(topics, "vehicle_local_position_setpoint", position),
        "battery": _rows(topics, "battery_status", ["voltage_v", "remaining"]),
        "status": _rows(topics, "vehicle_status", ["arming_state", "nav_state", "failsafe"]),
    }
    texts = _texts(log)
    times_s = [rows[name].time_s for name in rows if rows[name].size]
    if not times_s:
        raise ConfigError(f"{path}: nothing of a flight can be read. {note}".strip())

    return Px4Log(
        path=str(path),
        size_bytes=size_bytes,
        begin_s=min(float(topic_times_s[0]) for topic_times_s in times_s),
        end_s=max(float(topic_times_s[-1]) for topic_times_s in times_s),
        about=_about(log),
        parameter_count=len(log.initial_parameters),
        texts=texts,
        dropout_s=sum(dropout.duration for dropout in log.dropouts[:MAX_DROPOUTS]) * 1e-3,
        note=note,
        **rows,
    )


def _parsed(path: Path) -> tuple[ULog, str]:
    """Return a file as pyulog reads it, and a sentence on its damage; empty if there is none."""
    try:
        # pyulog prints its complaints to standard output, and closes the file that it reads.
        with contextlib.redirect_stdout(io.StringIO()):
            with opened(path, ULOG) as file:
                _check_formats(ULog(file, parse_header_only=True), path)
            with opened(path, ULOG) as file:
                log = ULog(file, message_name_filter_list=_TOPICS)
    except ConfigError:  # a refusal of our own, which is a ValueError, too
        raise
    except _BROKEN as error:
        raise ConfigError(
            f"{path}: this log of PX4 cannot be read ({type(error).__name__}). Fetch it once more."
        ) from None
    note = ""
    if log.file_corruption:
        note = "A part of the file is damaged, and left out."
    return log, note


def _check_formats(log: ULog, path: Path) -> None:
    """Refuse topics with absurdly many fields, which types nested in each other can have.

    Args:
        log: the log's header: formats without data.
        path: the file's path.

    Raises:
        ConfigError: a topic has too many fields.
    """
    formats = log.message_formats
    counts: dict[str, int] = {}

    def count(name: str, depth: int) -> int:
        """Return the number of fields of a type; a simple type such as float counts as one."""
        if name not in formats:
            return 1
        if name not in counts:
            # this value is found, and the topic refused, if the type contains itself
            counts[name] = _MAX_FIELDS + 1
            if depth < _DEEPEST:
                counts[name] = sum(
                    max(1, size) * count(kind, depth + 1) for kind, size, _ in formats[name].fields
                )
        return counts[name]

    for name in formats:
        if count(name, 0) > _MAX_FIELDS:
            raise ConfigError(f"{path}: a topic of this log has more than {_MAX_FIELDS} fields.")


def _rows(topics: Mapping[str, Mapping[str, Any]], name: str, fields: list[str]) -> LogRows:
    """Return samples of a topic; none if the topic or one of the fields is missing."""
    no_samples = LogRows(np.zeros(0), np.zeros((0, len(fields))))
    topic = topics.get(name)
    if topic is None or any(field not in topic for field in ("timestamp", *fields)):
        return no_samples

    time_s = np.asarray(topic["timestamp"], dtype=np.float64) * 1e-6
    with np.errstate(all="ignore"):
        values = np.stack([np.asarray(topic[field], dtype=np.float64) for field in fields], axis=-1)
    values[~(np.abs(values) < LARGEST)] = np.nan

    # Timestamps in a damaged file may jump: only samples later than all before are kept.
    is_plain = np.isfinite(time_s) & (time_s < LARGEST)
    time_s, values = time_s[is_plain], values[is_plain]
    latest_before_s = np.concatenate(([-math.inf], np.maximum.accumulate(time_s)[:-1]))
    is_later = time_s > latest_before_s
    return LogRows(time_s[is_later], values[is_later])


def _texts(log: ULog) -> tuple[LoggedText, ...]:
    texts: list[LoggedText] = []
    for message in log.logged_messages[:MAX_TEXTS]:
        words = plain_line(_ANSI.sub("", str(message.message)))[:MAX_LETTERS].strip()
        level = str(message.log_level_str()).lower()
        text = LoggedText(message.timestamp * 1e-6, _LEVELS.get(level, level), words)
        is_new = not texts or texts[-1] != text  # PX4 writes some lines once for each link
        if words and math.isfinite(text.time_s) and is_new:
            texts.append(text)
    return tuple(texts)


def _about(log: ULog) -> dict[str, str]:
    """Return the file's information on its vehicle, for people."""
    infos = log.msg_info_dict
    about: dict[str, str] = {}

    about["version"] = str(infos.get("ver_sw_release_str", ""))
    with contextlib.suppress(*_BROKEN):
        version = log.get_version_info_str()  # "" or None if the log has none
        if version:
            about["version"] = version
    about["board"] = str(infos.get("ver_hw", ""))
    about["commit"] = str(infos.get("ver_sw", ""))[:10]
    about["serial"] = str(infos.get("sys_uuid", ""))
    system_id = log.initial_parameters.get("MAV_SYS_ID")
    if system_id is not None:
        about["MAVLink id"] = f"{system_id}"
    return {key: plain_line(value)[:60] for key, value in about.items() if value}
