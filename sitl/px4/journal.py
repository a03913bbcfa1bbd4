"""Texts of a PX4 for ground stations (STATUSTEXT), and events of the same content (EVENT).

`journal.toml` lists all texts and events. A text ends in a tab when there is an event of the same
content, so that a ground station that reads events can drop the text.
"""

from __future__ import annotations

import struct
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Generic, NamedTuple, TypeVar

from sitl.px4.signals import StatusText

_INFO = 6  # MAV_SEVERITY
_AUTOPILOT_NAMESPACE = 1 << 24  # the upper 8 bits of an event's number are its namespace
_STORED = 100  # smallest number of newest entries of each kind that are stored
# Constants of the 32-bit FNV-1a hash.
_FNV_OFFSET = 0x811C9DC5
_FNV_PRIME = 0x01000193

Entry = TypeVar("Entry")


def event_id(name: str) -> int:
    """Return the number of an event: 24 bits of the FNV-1a hash of its name, and the namespace."""
    value = _FNV_OFFSET
    for byte in name.encode("ascii"):
        value = ((value ^ byte) * _FNV_PRIME) & 0xFFFFFFFF
    return value & 0xFFFFFF | _AUTOPILOT_NAMESPACE


class Saying(NamedTuple):
    """One row of the table: a text, an event, or both."""

    severity: int  # severity of the text (MAV_SEVERITY) and external level of the event
    text: str | None  # text with fields for words; None when there is only an event
    event: str | None = None  # name of the event; None when there is only a text
    internal: int = _INFO  # level of the event in PX4's log
    arguments: str = ""  # struct codes of the event's arguments


# Reasons of arming and disarming: PX4's words and numbers.
REASONS: dict[str, tuple[str, int]] = {
    "command": ("external command", 3),
    "landing": ("landing", 5),
    "preflight": ("auto preflight disarming", 6),
    "failsafe": ("failsafe", 14),
}

_TABLE = tomllib.loads(files(__package__).joinpath("journal.toml").read_text())
SAYINGS: dict[str, Saying] = {key: Saying(**values) for key, values in _TABLE.items()}


class Px4Event(NamedTuple):
    """One EVENT."""

    time_s: float
    sequence: int  # number in the vehicle's sequence
    event_id: int
    log_levels: int  # internal level in the upper four bits, external level in the lower
    arguments: bytes


@dataclass(slots=True)
class EntryLog(Generic[Entry]):
    """The newest entries of one kind, and the number of the older ones."""

    newest: list[Entry] = field(default_factory=list)  # oldest first
    forgotten: int = 0  # number of entries that are no longer stored

    @property
    def count(self) -> int:
        """Number of entries so far."""
        return self.forgotten + len(self.newest)

    def add(self, entry: Entry) -> None:
        """Append an entry."""
        if len(self.newest) >= 2 * _STORED:
            del self.newest[:_STORED]
            self.forgotten += _STORED
        self.newest.append(entry)

    def since(self, count: int) -> list[Entry]:
        """Return the entries after the first `count` that are still stored."""
        return self.newest[max(0, count - self.forgotten) :]


@dataclass(slots=True)
class Journal:
    """The newest texts and events of one vehicle."""

    texts: EntryLog[StatusText] = field(default_factory=EntryLog)
    events: EntryLog[Px4Event] = field(default_factory=EntryLog)
    # Severities of texts where the version differs from the table. -1: the text is not sent.
    severities: Mapping[str, int] = field(default_factory=dict)

    @property
    def newest_sequence(self) -> int:
        """Sequence number of the newest event."""
        return self.events.count & 0xFFFF

    def say(self, now_s: float, key: str, *arguments: float, **words: object) -> None:
        """Send the text and the event of a row of :data:`SAYINGS`.

        Args:
            now_s: present time.
            key: key of the row.
            arguments: arguments of the event.
            words: words for the fields of the text.
        """
        saying = SAYINGS[key]

        severity = self.severities.get(key, saying.severity)
        if saying.text is not None and severity >= 0:
            self.texts.add(StatusText(now_s, severity, saying.text.format(**words)))

        if saying.event is not None:
            event = Px4Event(
                time_s=now_s,
                sequence=(self.newest_sequence + 1) & 0xFFFF,
                event_id=event_id(saying.event),
                log_levels=saying.internal << 4 | saying.severity,
                arguments=struct.pack("<" + saying.arguments, *arguments),
            )
            self.events.add(event)
