"""Confirms PX4's reports. A surprising report counts only when later ones agree. Pure.

Anybody who can reach the agent's port can send a MAVLink packet in PX4's name, so a single packet
must not decide anything irreversible. A surprising report waits for the next report of its kind.
Until then, the earlier report counts. If the next report does not agree with the waiting report,
that is a contradiction.

:data:`KINDS` lists the three kinds of reports. It says which fields belong together, which report
is a surprise, and how many reports must agree over what time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from msgspec.structs import replace

from onboard.autopilot import Landed, Snapshot

CONTRADICTED_S = 2.0  # a contradiction counts as a condition for this time
_ONE_RUN_S = 3.0  # contradictions that follow each other within this time belong together
_IMPOSSIBLE_NS = 1_000_000_000  # a dropped snapshot counts for this time
_ASK_EVERY_NS = 60_000_000  # shortest time between two requests for a heartbeat

# Two reports agree if they differ by no more than this.
_CLOCK_MS = 500  # of PX4's clock against the time that has passed
_SAME_TURN_COS = math.cos(math.radians(0.5 * 45.0))  # cosine of half the angle of two attitudes
_TURN_WITHIN_NS = 100_000_000  # after a longer gap two attitudes may differ by any angle
_BATTERY_FRAC = 0.10
_BATTERY_VOLTAGE_SHARE = 0.10


class Expected(NamedTuple):
    """Reports that a flight expects from PX4 while only this agent controls the vehicle."""

    is_armed: bool = False  # True: a report that PX4 is disarmed would end the flight
    mode: str = ""  # mode of PX4; empty: any mode, on the ground


class ReportKind(NamedTuple):
    """One kind of report: fields of the snapshot that arrive together."""

    name: str
    fields: tuple[str, ...]
    stamp: str  # name of the field with the time of arrival
    needed: int  # number of reports that must agree, including the surprising one
    least_ns: int  # shortest time from the first to the last of them
    # whether the new report is a surprise; arguments: believed report, new report, expectation
    surprises: Callable[[Snapshot, Snapshot, Expected], bool]
    # whether the new report confirms the waiting one; arguments: waiting report, new report
    agrees: Callable[[Snapshot, Snapshot], bool]


def _heartbeat_surprises(believed: Snapshot, new: Snapshot, expected: Expected) -> bool:
    """Return whether PX4 reports that it is disarmed in flight, or has left the flight's mode."""
    if expected.is_armed and believed.is_armed and not new.is_armed:
        return True

    was_in_mode = expected.mode != "" and believed.mode == expected.mode
    has_left_mode = was_in_mode and new.mode != expected.mode
    has_landed = not new.is_armed and new.landed is Landed.ON_GROUND
    return has_left_mode and not has_landed


def _heartbeat_agrees(known: Snapshot, new: Snapshot) -> bool:
    return known.is_armed == new.is_armed and known.mode == new.mode


def _attitude_surprises(believed: Snapshot, new: Snapshot, _: Expected) -> bool:
    return not _attitude_agrees(believed, new)


def _attitude_agrees(known: Snapshot, new: Snapshot) -> bool:
    if abs(_clock_error_ms(known, new)) > _CLOCK_MS:
        return False

    # the quaternions' product is the cosine of half the angle between them
    pairs = zip(known.quaternion_enu_flu_wxyz, new.quaternion_enu_flu_wxyz, strict=True)
    is_near = abs(sum(a * b for a, b in pairs)) > _SAME_TURN_COS
    is_after_a_gap = new.attitude_ns - known.attitude_ns > _TURN_WITHIN_NS
    return is_near or is_after_a_gap


def _clock_error_ms(known: Snapshot, new: Snapshot) -> float:
    """Return by how much PX4's clock went back (negative) or gained on ours (positive) [ms]."""
    moved_ms = new.px4_boot_ms - known.px4_boot_ms
    if moved_ms < 0:
        return float(moved_ms)
    passed_ms = (new.attitude_ns - known.attitude_ns) * 1e-6
    return max(0.0, moved_ms - passed_ms)


def _battery_surprises(believed: Snapshot, new: Snapshot, expected: Expected) -> bool:
    """Return whether charge or voltage jumped.

    On the ground this is not a surprise, because a battery may be exchanged, and a simulated one
    fills up.
    """
    may_change = not expected.is_armed and new.landed is Landed.ON_GROUND
    return not may_change and not _battery_agrees(believed, new)


def _battery_agrees(known: Snapshot, new: Snapshot) -> bool:
    voltage_v = max(abs(known.battery_voltage_v), abs(new.battery_voltage_v))
    is_charge_near = _is_near(known.battery_frac, new.battery_frac, _BATTERY_FRAC)
    is_voltage_near = _is_near(
        known.battery_voltage_v, new.battery_voltage_v, _BATTERY_VOLTAGE_SHARE * voltage_v
    )
    return is_charge_near and is_voltage_near


def _is_near(a: float, b: float, limit: float) -> bool:
    """Return whether two numbers differ by at most the limit, or are both unknown."""
    return abs(a - b) <= limit or (math.isnan(a) and math.isnan(b))


KINDS = (
    ReportKind(
        name="heartbeat",
        fields=("heartbeat_ns", "is_armed", "mode", "is_failsafe"),
        stamp="heartbeat_ns",
        needed=2,
        least_ns=100_000_000,
        surprises=_heartbeat_surprises,
        agrees=_heartbeat_agrees,
    ),
    ReportKind(
        name="attitude",
        fields=("quaternion_enu_flu_wxyz", "attitude_ns", "px4_boot_ms"),
        stamp="attitude_ns",
        needed=5,
        least_ns=0,
        surprises=_attitude_surprises,
        agrees=_attitude_agrees,
    ),
    ReportKind(
        name="battery",
        fields=("battery_frac", "battery_voltage_v", "battery_ns"),
        stamp="battery_ns",
        needed=2,
        least_ns=300_000_000,
        surprises=_battery_surprises,
        agrees=_battery_agrees,
    ),
)
_HEARTBEAT = 0  # index in KINDS


@dataclass(slots=True)
class _Waiting:
    """Memory of one kind of report."""

    seen_ns: int = 0  # arrival of the newest report that was checked
    report: Snapshot | None = None  # newest surprising report, which waits for others that agree
    first_ns: int = 0  # arrival of the first of the reports that agree
    count: int = 0  # number of reports that agree


@dataclass(slots=True)
class ReportConfirmation:
    """Memory of one PX4's reports. Pass it every snapshot."""

    contradicted: str = ""  # last contradicted kind of report
    is_heartbeat_wanted: bool = False  # True: the flight must know PX4's present mode
    _believed: Snapshot = field(default_factory=Snapshot)
    _waiting: tuple[_Waiting, ...] = field(default_factory=lambda: tuple(_Waiting() for _ in KINDS))

    _run_begin_ns: int = 0  # time of the first contradiction in the current series
    _contradicted_ns: int = 0  # time of the last contradiction; 0 never
    _requested_ns: int = 0  # time of the last request for a heartbeat

    _dropped_sentence: str = ""  # what was wrong with the newest dropped snapshot
    _dropped_ns: int = 0

    def believe(self, snapshot: Snapshot, expected: Expected) -> Snapshot:
        """Return the snapshot with the earlier values of all reports that wait for confirmation.

        Args:
            snapshot: newest snapshot of the link.
            expected: reports that the flight expects.
        """
        withheld: dict[str, object] = {}
        for kind, waiting in zip(KINDS, self._waiting, strict=True):
            if self._is_withheld(kind, waiting, snapshot, expected):
                withheld.update((name, getattr(self._believed, name)) for name in kind.fields)

        self._believed = snapshot
        if withheld:
            self._believed = replace(snapshot, **withheld)
        return self._believed

    def drop(self, sentence: str, now_ns: int) -> None:
        """Remember that a snapshot with impossible numbers was dropped.

        Args:
            sentence: what is wrong with it.
            now_ns: our clock.
        """
        self._dropped_sentence = sentence
        self._dropped_ns = now_ns

    def impossible(self, now_ns: int) -> str:
        """Return a sentence that says what is wrong with PX4's newest numbers.

        The sentence is empty if no snapshot was dropped within the last second.

        Args:
            now_ns: our clock.
        """
        if now_ns - self._dropped_ns < _IMPOSSIBLE_NS:
            return self._dropped_sentence
        return ""

    def is_heartbeat_due(self, now_ns: int) -> bool:
        """Return whether to request a heartbeat from PX4 now; called at each tick.

        A heartbeat is due while a surprising heartbeat waits for confirmation, and while the flight
        must know the present mode. Two requests are at least ``_ASK_EVERY_NS`` apart.

        Args:
            now_ns: our clock.
        """
        is_needed = self.is_heartbeat_wanted or self._waiting[_HEARTBEAT].report is not None
        if not is_needed or now_ns - self._requested_ns < _ASK_EVERY_NS:
            return False
        self._requested_ns = now_ns
        return True

    def has_contradiction(self, now_ns: int) -> bool:
        """Return whether two reports have just contradicted each other.

        Args:
            now_ns: our clock.
        """
        is_recent = now_ns - self._contradicted_ns <= 1e9 * CONTRADICTED_S
        return self._contradicted_ns != 0 and is_recent

    def contradicted_s(self, now_ns: int) -> float:
        """Return the time from the first contradiction to the last one [s].

        It is 0 after a single contradiction, and without one.

        Args:
            now_ns: our clock.
        """
        if not self.has_contradiction(now_ns):
            return 0.0
        return (self._contradicted_ns - self._run_begin_ns) * 1e-9

    def _is_withheld(
        self, kind: ReportKind, waiting: _Waiting, new: Snapshot, expected: Expected
    ) -> bool:
        """Return whether the earlier values count instead of the new report of this kind."""
        stamp_ns = getattr(new, kind.stamp)
        is_new = stamp_ns != waiting.seen_ns
        waiting.seen_ns = stamp_ns
        unconfirmed = waiting.report
        if not is_new and unconfirmed is None:
            return False  # this report was accepted already

        is_first_ever = not getattr(self._believed, kind.stamp)
        if is_first_ever or not kind.surprises(self._believed, new, expected):
            # the new report repeats what is believed, so it does not confirm the waiting report
            if is_new and unconfirmed is not None and not kind.agrees(unconfirmed, new):
                self._contradict(kind.name, stamp_ns)
            waiting.report = None
            return False

        if not is_new:
            return True  # this report is the one that waits
        if unconfirmed is None:
            waiting.first_ns = stamp_ns
            waiting.count = 0
        elif not kind.agrees(unconfirmed, new):
            self._contradict(kind.name, stamp_ns)
            waiting.first_ns = stamp_ns
            waiting.count = 0

        waiting.report = new
        waiting.count += 1
        if waiting.count < kind.needed or stamp_ns - waiting.first_ns < kind.least_ns:
            return True
        waiting.report = None
        return False

    def _contradict(self, kind: str, now_ns: int) -> None:
        """Remember a contradiction between two reports of a kind."""
        if not self._contradicted_ns or now_ns - self._contradicted_ns > 1e9 * _ONE_RUN_S:
            self._run_begin_ns = now_ns
        self._contradicted_ns = now_ns
        self.contradicted = kind
