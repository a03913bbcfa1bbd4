"""The alarm table, read from table.toml: condition -> severity, sentence, advice."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from enum import Enum, IntEnum
from importlib.resources import files

from onboard.safety.failsafe_table import Condition


class AlarmSeverity(IntEnum):
    """Urgency of an alarm."""

    NOTE = 0  # for information
    WARNING = 1  # look into it
    CRITICAL = 2  # act now


class GroundCondition(Enum):
    """Conditions that the ground itself detects, in addition to those that a vehicle reports."""

    SILENT = "vehicle silent"
    FAILED = "vehicle failed"
    UNKNOWN = "condition unknown to this console"
    CLOSE = "too close"
    COLLIDED = "collided"
    LAW_STRAINED = "avoidance at its limit"
    LAW_OFF = "avoidance off"
    WAITING = "waiting for vehicles"
    FILES_DIFFER = "fleet files differ"
    RECORD_ENDED = "record ended"
    PROCESS_ENDED = "process ended"
    KILLED = "killed in the air"
    DISABLED_FLIES = "flies though disabled"


Kind = Condition | GroundCondition


@dataclass(frozen=True, slots=True)
class AlarmRow:
    """One row of the table."""

    in_flight: AlarmSeverity  # while the vehicle flies
    on_ground: AlarmSeverity  # while it does not
    sentence: str  # {who} is a vehicle or several, {what} a number, name or reason
    advice: str


_FILE = tomllib.loads(files(__package__).joinpath("table.toml").read_text(encoding="utf-8"))
_KINDS: dict[str, Kind] = {kind.name: kind for kind in (*Condition, *GroundCondition)}


def _row(in_flight: str, on_ground: str, sentence: str, advice: str) -> AlarmRow:
    """Return one row of the file."""
    return AlarmRow(
        in_flight=AlarmSeverity[in_flight.upper()],
        on_ground=AlarmSeverity[on_ground.upper()],
        sentence=sentence,
        advice=advice,
    )


TABLE: dict[Kind, AlarmRow] = {_KINDS[name]: _row(*row) for name, row in _FILE["alarms"].items()}
# Rank of each kind: its position in the file, which begins with the most urgent alarm.
RANKS = {kind: rank for rank, kind in enumerate(TABLE)}
# Text with which a vehicle reports a condition -> condition.
BY_TEXT = {condition.value: condition for condition in Condition}
# Alarm -> worse alarm; the first is not shown if the same vehicle has the second, which implies it.
COVERED: dict[Kind, Kind] = {
    _KINDS[name]: _KINDS[worse] for name, worse in _FILE["covered_by"].items()
}
