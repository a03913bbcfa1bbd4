"""Alarms: the rows of the alarm table that hold now, and since when. Pure.

:func:`conditions` returns the alarms of this moment. :class:`Alarms` keeps their begin, whether
they were acknowledged, and the past ones. A lasting alarm is one line with a duration, and so is
one that flickers or that many vehicles have.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from groundstation.alarms.alarm_table import (
    BY_TEXT,
    COVERED,
    RANKS,
    TABLE,
    GroundCondition,
    Kind,
    Severity,
)
from groundstation.fleet.state import FleetState, LoggedEvent, VehicleView
from onboard.bus.schema import Telemetry
from onboard.config.fleet import FleetConfig
from onboard.config.pair_separation import separations_m
from onboard.plain_text import plain_line
from onboard.safety.failsafe_table import Condition

LINGER_S = 3.0  # an alarm that comes back within this time has lasted
MAX_OVER = 100
_GROUPED = 4  # so many vehicles with the same alarm share a line
_SHOWN = 3


_C, _G = Condition, GroundCondition
_NUMBERED = frozenset(
    (_G.CLOSE, _C.BATTERY_LOW, _C.BATTERY_WARNING, _C.LEFT_OFFBOARD)
)  # a shared line shows the lowest number
_EVENT_KINDS: dict[str, Kind] = {
    "record_failed": _G.RECORD_ENDED,
    "process_ended": _G.PROCESS_ENDED,
    "killed": _G.KILLED,
}


@dataclass(frozen=True, slots=True)
class Alarm:
    """A condition that holds now."""

    kind: Kind
    subject: str  # a vehicle, a pair, or empty for the fleet
    severity: Severity
    sentence: str
    advice: str
    what: str = ""  # number, name or reason in the sentence
    since_ns: int | None = None  # begin, where the state has it; None: counts from the first update


@dataclass(frozen=True, slots=True)
class AlarmLine:
    """An alarm over time."""

    alarm: Alarm
    since_ns: int
    is_acknowledged: bool = False
    over_ns: int | None = None  # its end; None while it holds
    count: int = 1  # vehicles that share the line

    def duration_s(self, now_ns: int) -> float:
        """Return its duration [s], until now or until its end."""
        return max(0.0, ((now_ns if self.over_ns is None else self.over_ns) - self.since_ns) * 1e-9)

    def text(self, now_ns: int) -> str:
        """Return one line for people: sentence, duration, advice."""
        length = lasting(self.duration_s(now_ns))
        ended = (
            "" if self.over_ns is None else f", over for {lasting((now_ns - self.over_ns) * 1e-9)}"
        )
        return f"{self.alarm.sentence} ({length}{ended}). {self.alarm.advice}"


def conditions(state: FleetState, fleet: FleetConfig, now_ns: int) -> list[Alarm]:
    """List all alarms of this moment.

    Args:
        state: the fleet as known now.
        fleet: the fleet file.
        now_ns: the ground's monotonic clock [ns].

    Returns:
        Alarms of the fleet, of pairs and of each vehicle, the worst first.
    """
    alarms = list(_of_fleet(state, fleet, now_ns))
    is_after_stall = state.is_after_stall(now_ns)
    for view in state.vehicles.values():
        alarms.extend(_of_vehicle(view, fleet, now_ns, is_after_stall))
    return sorted(alarms, key=_urgency)


class Alarms:
    """Alarms over time; call :meth:`update` several times a second. Memory is bounded.

    Args:
        fleet: the fleet file.
    """

    def __init__(self, fleet: FleetConfig) -> None:
        self.fleet = fleet
        self.has_new = False  # the last update brought an alarm above NOTE
        self._lines: dict[tuple[Kind, str], AlarmLine] = {}
        self._last_ns: dict[tuple[Kind, str], int] = {}
        self._over: deque[AlarmLine] = deque(maxlen=MAX_OVER)
        self._last_event: LoggedEvent | None = None
        self._now_ns = 0

    def update(self, state: FleetState, now_ns: int) -> None:
        """Take over the fleet as it is now.

        Args:
            state: the fleet as known now.
            now_ns: the clock of the state [ns]; going back forgets everything.
        """
        if now_ns < self._now_ns:  # a replay that was turned back
            self._lines.clear()
            self._over.clear()
            self._last_event = None
        self._now_ns = now_ns
        before = {key: line.alarm.severity for key, line in self._lines.items()}
        present = {
            (alarm.kind, alarm.subject): alarm for alarm in conditions(state, self.fleet, now_ns)
        }
        present.update({(alarm.kind, alarm.subject): alarm for alarm in self._of_events(state)})
        for key, alarm in present.items():
            old = self._lines.get(key)
            if old is None:
                self._lines[key] = AlarmLine(
                    alarm, now_ns if alarm.since_ns is None else alarm.since_ns
                )
            else:
                # an alarm that got worse has to be acknowledged again
                is_known = old.is_acknowledged and alarm.severity <= old.alarm.severity
                self._lines[key] = dataclasses.replace(old, alarm=alarm, is_acknowledged=is_known)
            self._last_ns[key] = now_ns
        for key in [key for key in self._lines if key not in present]:
            line = self._lines[key]
            if line.alarm.kind in _LATCHED:
                if line.is_acknowledged:
                    self._end(key, now_ns)
            elif now_ns - self._last_ns[key] > LINGER_S * 1e9:
                self._end(key, self._last_ns[key])
        self.has_new = any(
            line.alarm.severity > max(Severity.NOTE, before.get(key, Severity.NOTE))
            for key, line in self._lines.items()
        )

    @property
    def lines(self) -> list[AlarmLine]:
        """Present alarms: open before acknowledged, the worst first, the same alarm of many
        vehicles as one line.
        """
        shown: list[AlarmLine] = []
        groups: dict[tuple[Kind, Severity, bool], list[AlarmLine]] = {}
        for line in self._lines.values():
            groups.setdefault(
                (line.alarm.kind, line.alarm.severity, line.is_acknowledged), []
            ).append(line)
        for lines in groups.values():
            shown.extend(lines if len(lines) < _GROUPED else [_together(lines)])
        return sorted(shown, key=lambda line: (line.is_acknowledged, *_urgency(line.alarm)))

    @property
    def over(self) -> list[AlarmLine]:
        """Past alarms, the newest first."""
        return list(reversed(self._over))

    @property
    def worst(self) -> AlarmLine | None:
        """The line that every screen shows; an acknowledged one only when no other holds."""
        return next(iter(self.lines), None)

    def of(self, vehicle: str) -> list[AlarmLine]:
        """Return the alarms of one vehicle, the worst first."""
        mine = [line for line in self._lines.values() if vehicle in line.alarm.subject.split(_AND)]
        return sorted(mine, key=lambda line: _urgency(line.alarm))

    def acknowledge(self, line: AlarmLine | None = None) -> int:
        """Acknowledge one alarm, or all; they stay in the list.

        Args:
            line: as shown, also of many vehicles; None for all.

        Returns:
            The number of alarms that were open.
        """
        count = 0
        for key, own in self._lines.items():
            is_meant = line is None or (
                own.alarm.kind == line.alarm.kind
                and own.alarm.severity == line.alarm.severity
                and (line.count > 1 or own.alarm.subject == line.alarm.subject)
            )
            if is_meant and not own.is_acknowledged:
                self._lines[key] = dataclasses.replace(own, is_acknowledged=True)
                count += 1
        return count

    def _end(self, key: tuple[Kind, str], over_ns: int) -> None:
        self._over.append(dataclasses.replace(self._lines.pop(key), over_ns=over_ns))
        self._last_ns.pop(key, None)

    def _of_events(self, state: FleetState) -> Iterator[Alarm]:
        for logged in state.events_after(self._last_event):
            kind = _EVENT_KINDS.get(logged.event.code)
            if kind is not None:
                is_flying = bool(state.airborne_names)
                yield _alarm(
                    kind,
                    logged.event.vehicle,
                    is_flying=is_flying,
                    what=plain(logged.event.sentence),
                )
        if state.events:
            self._last_event = state.events[-1]


_AND = " – "
# reported once by an event: they stay until acknowledged
_LATCHED = frozenset(_EVENT_KINDS.values())


def lasting(seconds: float) -> str:
    """Return a duration in few characters: ``4 s``, ``3 min 20 s``, ``2 h 5 min``."""
    whole = int(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"


def plain(text: str, limit: int = 160) -> str:
    """Return text from outside as one line without control characters."""
    return plain_line(text[:limit]).rstrip(".")


def _urgency(alarm: Alarm) -> tuple[int, int, str]:
    return -alarm.severity, RANKS[alarm.kind], alarm.subject


def _alarm(kind: Kind, subject: str, *, is_flying: bool, what: str = "", names: str = "") -> Alarm:
    row = TABLE[kind]
    severity = row.in_flight if is_flying else row.on_ground
    return Alarm(
        kind,
        subject,
        severity,
        row.sentence.format(who=names or subject, what=what),
        row.advice,
        what,
    )


def _together(lines: list[AlarmLine]) -> AlarmLine:
    """One line for the same alarm of many vehicles; it lasts as long as the oldest of them."""
    first = min(lines, key=lambda line: (line.since_ns, line.alarm.subject))
    names = sorted(line.alarm.subject for line in lines)
    shown = f"{len(lines)} of them: {', '.join(names[:_SHOWN])} and {len(names) - _SHOWN} more"
    what = (
        min(line.alarm.what for line in lines)
        if first.alarm.kind in _NUMBERED
        else "each for its own reason"
    )
    sentence = TABLE[first.alarm.kind].sentence.format(who=shown, what=what)
    return dataclasses.replace(
        first,
        alarm=dataclasses.replace(first.alarm, subject=_AND.join(names), sentence=sentence),
        count=len(lines),
    )


def _of_vehicle(
    view: VehicleView, fleet: FleetConfig, now_ns: int, is_after_stall: bool
) -> Iterator[Alarm]:
    telemetry, name = view.telemetry, view.name
    if view.truth is not None and view.truth.is_collided and view.has_truth(now_ns):
        yield _alarm(_G.COLLIDED, name, is_flying=True)
    if telemetry is None:
        return
    is_flying = view.is_airborne
    if not view.is_fresh(now_ns):
        if is_after_stall:
            return
        yield dataclasses.replace(
            _alarm(_G.SILENT, name, is_flying=is_flying), since_ns=view.received_ns
        )
        return
    if telemetry.state == "failed":
        yield _alarm(
            _G.FAILED,
            name,
            is_flying=is_flying,
            what=plain(telemetry.reason) or "it does not say why",
        )
    held, unknown = _reported(telemetry)
    held |= _measured(telemetry, fleet)
    if len(held) > 1:
        held -= {covered for covered, by in COVERED.items() if by in held}
    for kind in held:
        yield _alarm(kind, name, is_flying=is_flying, what=_what(kind, telemetry))
    for text in unknown:
        yield _alarm(_G.UNKNOWN, name, is_flying=is_flying, what=plain(text))
    if telemetry.law == "off" and is_flying:
        yield _alarm(_G.LAW_OFF, name, is_flying=True)
    elif telemetry.law_status.lower() in ("relaxed", "infeasible") and is_flying:
        yield _alarm(_G.LAW_STRAINED, name, is_flying=True)


def _reported(telemetry: Telemetry) -> tuple[set[Kind], list[str]]:
    """Conditions that the vehicle reports itself, and texts that this table does not have."""
    texts = telemetry.conditions
    if not texts:  # nearly always; this runs ten times a second for a hundred vehicles
        return set(), []
    known: set[Kind] = {BY_TEXT[text] for text in texts if text in BY_TEXT}
    return known, [text for text in texts if text not in BY_TEXT][:3]


def _measured(telemetry: Telemetry, fleet: FleetConfig) -> set[Kind]:
    """Conditions that the numbers of its telemetry show, reported or not."""
    kinds: set[Kind] = set()
    percent = telemetry.battery_frac * 100.0
    if math.isfinite(percent) and percent >= 0.0:
        if telemetry.is_airborne and percent <= fleet.fleet.battery_land_pct:
            kinds.add(_C.BATTERY_LOW)
        elif percent <= fleet.fleet.battery_warning_pct:
            kinds.add(_C.BATTERY_WARNING)
    if telemetry.is_airborne and not telemetry.is_position_valid:
        kinds.add(_C.POSITION_LOST)
    elif telemetry.is_airborne and not fleet.fleet.geofence_m.contains(telemetry.position_enu_m):
        kinds.add(_C.FENCE_BREACH)
    return kinds


def _what(kind: Kind, telemetry: Telemetry) -> str:
    if kind in (_C.BATTERY_LOW, _C.BATTERY_WARNING) and math.isfinite(telemetry.battery_frac):
        return f", {telemetry.battery_frac * 100.0:.0f} %"
    if kind is _C.LEFT_OFFBOARD and telemetry.mode:
        return f" for {plain(telemetry.mode, 20)}"
    return ""


def _of_fleet(state: FleetState, fleet: FleetConfig, now_ns: int) -> Iterator[Alarm]:
    yield from _close_pairs(state, fleet.fleet.safety_distance_m, now_ns)
    for view in (state.vehicles[name] for name in state.disabled if name in state.vehicles):
        if view.is_armed and view.is_fresh(now_ns):
            yield _alarm(_G.DISABLED_FLIES, view.name, is_flying=view.is_airborne)
    silent = [name for name, view in state.vehicles.items() if view.telemetry is None]
    if silent:
        more = f" and {len(silent) - _GROUPED} more" if len(silent) > _GROUPED else ""
        yield _alarm(_G.WAITING, "", is_flying=False, names=", ".join(silent[:_GROUPED]) + more)
    hashes = {
        view.telemetry.config_hash for view in state.vehicles.values() if view.telemetry is not None
    }
    if len(hashes) > 1:
        yield _alarm(_G.FILES_DIFFER, "", is_flying=bool(state.airborne_names))


def _close_pairs(state: FleetState, limit_m: float, now_ns: int) -> Iterator[Alarm]:
    """Every pair below the limit of which at least one flies."""
    positions = {name: view.position_enu_m(now_ns) for name, view in state.vehicles.items()}
    names = [name for name, position in positions.items() if position is not None]
    if len(names) < 2:
        return
    spots = np.array([position for position in positions.values() if position is not None])
    is_flying = np.array([state.vehicles[name].is_airborne for name in names])
    distance_m = separations_m(spots[:, None] - spots[None], state.height_share)
    is_close = (distance_m < limit_m) & (is_flying[:, None] | is_flying[None])
    for one, two in np.argwhere(np.triu(is_close, 1)):
        what = f"{distance_m[one, two]:.2f} m apart, limit {limit_m:.2f} m"
        yield _alarm(_G.CLOSE, _AND.join((names[one], names[two])), is_flying=True, what=what)
