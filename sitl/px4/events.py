"""Messages of a PX4 for people: STATUSTEXTs (for ground stations) and the EVENTs with the same content.

PX4's texts end in a tab when an event says the same, so that a ground station that reads events can drop them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

from sitl.px4.signals import Text

_CRITICAL, _ERROR, _WARNING, _INFO = 2, 3, 4, 6
_EMERGENCY = 0
_AUTOPILOT_NAMESPACE = 1 << 24
_KEPT = 100
Entry = TypeVar("Entry")


def event_id(name: str) -> int:
    """The number of an event: 24 bits of the FNV-1a hash of its name, within the autopilot's namespace."""
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

SAYINGS: dict[str, Saying] = {
    "armed": Saying(_INFO, "Armed by {why}\t", "commander_armed_by", arguments="B"),
    "disarmed": Saying(_INFO, "Disarmed by {why}\t", "commander_disarmed_by", arguments="B"),
    "arm denied": Saying(
        _CRITICAL,
        "Arming denied: Resolve system health failures first\t",
        "commander_arm_denied_resolve_failures",
    ),
    "disarm denied": Saying(_CRITICAL, "Disarming denied: not landed\t", "commander_disarm_denied_not_landed"),
    "takeoff height": Saying(_INFO, "Using default takeoff altitude: {height:.1f} m\t"),
    "least takeoff height": Saying(_CRITICAL, "Using minimum takeoff altitude: {height:.2f} m\t"),
    "takeoff": Saying(_INFO, "Takeoff detected\t", "commander_takeoff_detected"),
    "landed": Saying(_INFO, "Landing detected\t", "commander_landing_detected"),
    "landing": Saying(_INFO, "Landing at current position\t", "commander_landing_current_pos"),
    "returning": Saying(_INFO, "Returning to launch\t", "commander_rtl"),
    "no such mode": Saying(_CRITICAL, "Unsupported auto mode\t", "commander_unsupported_auto_mode", _ERROR),
    "bad arm": Saying(
        _CRITICAL,
        "Unsupported ARM_DISARM param: {value:.3f}\t",
        "commander_unsupported_arm_disarm_param",
        arguments="f",
    ),
    "failsafe": Saying(_CRITICAL, "Failsafe activated\t", "commander_failsafe_enter_generic", _WARNING, arguments="IB"),
    "failsafe hold": Saying(
        _CRITICAL,
        "Failsafe activated: entering Hold for {seconds:.0f} seconds\t",
        "commander_failsafe_enter_generic_hold",
        _WARNING,
        arguments="IBH",
    ),
    "battery low": Saying(_EMERGENCY, "Low battery\t", "commander_failsafe_enter_low_bat", _WARNING),
    "battery critical": Saying(_EMERGENCY, "Critical battery\t", "commander_failsafe_enter_crit_bat_warn", _WARNING),
    "battery emergency": Saying(
        _EMERGENCY, "Emergency battery level\t", "commander_failsafe_enter_crit_low_bat_warn", _WARNING
    ),
    "no shutdown": Saying(_EMERGENCY, "System does not support shutdown\t"),
    "roll failure": Saying(_CRITICAL, "Preflight Fail: Attitude failure (roll)\t", "check_failure_detector_roll"),
    "pitch failure": Saying(_CRITICAL, "Preflight Fail: Attitude failure (pitch)\t", "check_failure_detector_pitch"),
    "bad frame": Saying(
        _CRITICAL,
        "SET_POSITION_TARGET_LOCAL_NED coordinate frame {frame} unsupported\t",
        "mavlink_rcv_sp_local_unsup_coord",
        _ERROR,
        arguments="B",
    ),
    "empty setpoint": Saying(
        _CRITICAL, "SET_POSITION_TARGET_LOCAL_NED invalid\t", "mavlink_rcv_sp_local_invalid", _ERROR
    ),
}


class Event(NamedTuple):
    """One EVENT: when, its number in the vehicle's sequence, what, how loud, and its arguments."""

    time_s: float
    sequence: int
    event_id: int
    log_levels: int
    arguments: bytes


@dataclass(slots=True)
class Log(Generic[Entry]):
    """The newest entries of one kind; older ones are forgotten, their count is not."""

    newest: list[Entry] = field(default_factory=list)  # oldest first
    forgotten: int = 0

    @property
    def count(self) -> int:
        """Number of entries so far."""
        return self.forgotten + len(self.newest)

    def add(self, entry: Entry) -> None:
        """Append one."""
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

    texts: Log[Text] = field(default_factory=Log)
    events: Log[Event] = field(default_factory=Log)

    @property
    def newest_sequence(self) -> int:
        """Sequence number of the newest event."""
        return self.events.count & 0xFFFF

    def say(self, now_s: float, what: str, *arguments: float, **words: object) -> None:
        """Say one of :data:`SAYINGS`.

        Args:
            now_s: simulated time.
            what: key of the table.
            arguments: of the event.
            words: of the text.
        """
        saying = SAYINGS[what]
        if saying.text is not None:
            self.texts.add(Text(now_s, saying.severity, saying.text.format(**words)))
        if saying.event is not None:
            packed = struct.pack("<" + saying.arguments, *arguments)
            levels = saying.internal << 4 | saying.severity
            sequence = (self.newest_sequence + 1) & 0xFFFF
            self.events.add(Event(now_s, sequence, event_id(saying.event), levels, packed))
