"""What a PX4 says to people: STATUSTEXTs for ground stations, and EVENTs with the same content.

`journal.toml` lists everything that it can say. A text ends in a tab when an event says the same,
so that a ground station that reads events can drop the text.
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
_AUTOPILOT_NAMESPACE = 1 << 24
_KEPT = 100  # newest entries of each kind, at least
Entry = TypeVar("Entry")


def event_id(name: str) -> int:
    """Return the number of an event: 24 bits of the FNV-1a hash of its name, and the namespace."""
    value = 0x811C9DC5
    for byte in name.encode("ascii"):
        value = ((value ^ byte) * 0x01000193) & 0xFFFFFFFF
    return value & 0xFFFFFF | _AUTOPILOT_NAMESPACE


class Saying(NamedTuple):
    """One thing that PX4 says."""

    severity: int  # of the text (MAV_SEVERITY), also the event's external level
    text: str | None  # with places for arguments; None when there is only an event
    event: str | None = None  # the event's name; None when there is only a text
    internal: int = _INFO  # level of the event in PX4's own log
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
    """The newest entries of one kind; of older ones only their number is kept."""

    newest: list[Entry] = field(default_factory=list)  # oldest first
    forgotten: int = 0

    @property
    def count(self) -> int:
        """Number of entries so far."""
        return self.forgotten + len(self.newest)

    def add(self, entry: Entry) -> None:
        """Append an entry."""
        if len(self.newest) >= 2 * _KEPT:
            del self.newest[:_KEPT]
            self.forgotten += _KEPT
        self.newest.append(entry)

    def since(self, count: int) -> list[Entry]:
        """Return the entries after the first `count` ever, as far as they are kept."""
        return self.newest[max(0, count - self.forgotten) :]


@dataclass(slots=True)
class Journal:
    """The newest texts and events of one vehicle."""

    texts: EntryLog[StatusText] = field(default_factory=EntryLog)
    events: EntryLog[Px4Event] = field(default_factory=EntryLog)
    # of texts for which the version has another one than the table; -1: the text is not sent
    severities: Mapping[str, int] = field(default_factory=dict)

    @property
    def newest_sequence(self) -> int:
        """Sequence number of the newest event."""
        return self.events.count & 0xFFFF

    def say(self, now_s: float, what: str, *arguments: float, **words: object) -> None:
        """Say one of :data:`SAYINGS`.

        Args:
            now_s: simulated time.
            what: key of the table.
            arguments: arguments of the event.
            words: words of the text.
        """
        saying = SAYINGS[what]

        severity = self.severities.get(what, saying.severity)
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
