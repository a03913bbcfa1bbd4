"""The alarm table, read from table.toml: condition -> severities, sentence, advice."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence, Set
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
    UNLISTED = "not in this ground's fleet file"
    OTHER_FILE = "other fleet file than this ground"


Kind = Condition | GroundCondition


@dataclass(frozen=True, slots=True)
class AlarmRow:
    """One row of the table."""

    in_flight: AlarmSeverity  # while the vehicle flies
    on_ground: AlarmSeverity  # while it does not
    sentence: str  # {who} is a vehicle or several, {what} a number, name or reason
    advice_in_flight: str  # what the vehicle does by itself, and what to do at once
    advice: str  # what to look into, in flight and on the ground


_FILE = tomllib.loads(files(__package__).joinpath("table.toml").read_text(encoding="utf-8"))
_KINDS: dict[str, Kind] = {kind.name: kind for kind in (*Condition, *GroundCondition)}


def _row(
    in_flight: str, on_ground: str, sentence: str, advice_in_flight: str, advice: str
) -> AlarmRow:
    """Return one row of the file."""
    return AlarmRow(
        in_flight=AlarmSeverity[in_flight.upper()],
        on_ground=AlarmSeverity[on_ground.upper()],
        sentence=sentence,
        advice_in_flight=advice_in_flight,
        advice=advice,
    )


TABLE: dict[Kind, AlarmRow] = {_KINDS[name]: _row(*row) for name, row in _FILE["alarms"].items()}
# Rank of each kind: its position in the file, which begins with the most urgent alarm.
RANKS = {kind: rank for rank, kind in enumerate(TABLE)}
# Text with which a vehicle reports a condition -> condition.
BY_TEXT = {condition.value: condition for condition in Condition}
# Alarm -> worse alarm that implies it. A vehicle that has both shows only the worse alarm.
COVERED: dict[Kind, Kind] = {
    _KINDS[name]: _KINDS[worse] for name, worse in _FILE["covered_by"].items()
}
# Conditions that may only say that an agent has not heard something yet since its start.
NOT_HEARD_YET = tuple(Condition[name] for name in _FILE["not_heard_yet"]["conditions"])


def without_implied(texts: Sequence[str]) -> list[str]:
    """Return the conditions that a vehicle reports, without those that a worse one implies.

    Args:
        texts: conditions as the telemetry has them, known to this ground or not.
    """
    if len(texts) < 2:
        return list(texts)

    implied = implied_by({BY_TEXT[text] for text in texts if text in BY_TEXT})
    return [text for text in texts if BY_TEXT.get(text) not in implied]


def implied_by(kinds: Set[Kind]) -> set[Kind]:
    """Return the alarms that a worse one among ``kinds``, all of one vehicle, implies."""
    return {covered for covered, worse in COVERED.items() if worse in kinds}
