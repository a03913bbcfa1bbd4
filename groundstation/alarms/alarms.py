"""Alarms: the rows of the alarm table that hold now, and since when. Pure.

:func:`conditions` returns the alarms of this moment. :class:`Alarms` keeps when each alarm began,
whether it was acknowledged, and past alarms.

A lasting alarm is one line with a duration. A flickering alarm is also one line: it ends only when
it has not held for some seconds. The same alarm of many vehicles is one line as well. An alarm from
a single event, such as a kill, stays until it is acknowledged.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from groundstation.alarms.alarm_table import (
    BY_TEXT,
    COVERED,
    NOT_HEARD_YET,
    RANKS,
    TABLE,
    AlarmSeverity,
    GroundCondition,
    Kind,
    implied_by,
)
from groundstation.fleet.fleet_files import with_other_file
from groundstation.fleet.slot_owners import out_of_service
from groundstation.fleet.state import FleetState, LoggedEvent, VehicleView
from onboard.bus.schema import Telemetry
from onboard.config.fleet import FleetConfig
from onboard.config.flight_space import flight_space_of
from onboard.config.pair_separation import separations_m
from onboard.plain_text import listed, plain_line
from onboard.safety.failsafe_table import TABLE as FAILSAFE_TABLE
from onboard.safety.failsafe_table import WORDS, Action, Condition, Situation
from onboard.types import TICK_S

START_S = 20.0  # in this time after its start, an agent may not have heard everything yet
LINGER_S = 3.0  # an alarm that comes back within this time counts as one that has lasted
MAX_OVER = 100  # past alarms that are kept
_GROUPED = 4  # at least this many vehicles with the same alarm share a line
_SHOWN = 3  # names in a shared line
_MAX_UNKNOWN = 3  # most texts of one vehicle that are shown although the table lacks them
_AND = " – "  # separates the names of a pair

# Alarms whose sentence ends in a number or a mode; a shared line shows the lowest number, or the
# mode that comes first in the alphabet.
_WITH_VALUE = frozenset(
    (
        GroundCondition.CLOSE,
        Condition.BATTERY_LOW,
        Condition.BATTERY_WARNING,
        Condition.LEFT_OFFBOARD,
    )
)
_EVENT_KINDS: dict[str, Kind] = {
    "record_failed": GroundCondition.RECORD_ENDED,
    "process_ended": GroundCondition.PROCESS_ENDED,
    "killed": GroundCondition.KILLED,
}
# in place of what the agent does about a condition, while a pilot flies its vehicle or PX4 lands it
_BY_HAND = "Its pilot flies it: its agent does nothing about it."
_BY_PX4 = "PX4 lands it: its agent does nothing about it."
NOT_RECORDED = "Nothing of it was recorded up to here."  # instead of the advice to start an agent
# Alarms from a single event, which stay until they are acknowledged.
LATCHED = frozenset(_EVENT_KINDS.values())


@dataclass(frozen=True, slots=True)
class Alarm:
    """A condition that holds now."""

    kind: Kind
    subject: str  # a vehicle, a pair, or empty for the fleet
    severity: AlarmSeverity
    sentence: str
    advice: str
    what: str = ""  # number, name or reason in the sentence
    since_ns: int | None = None  # when it began, if the state says so; None: at its first update


@dataclass(frozen=True, slots=True)
class AlarmLine:
    """An alarm over time."""

    alarm: Alarm
    since_ns: int
    is_acknowledged: bool = False
    over_ns: int | None = None  # end of the alarm; None while it holds
    count: int = 1  # number of vehicles that share the line

    def duration_s(self, now_ns: int) -> float:
        """Return the duration of the alarm until now or until its end [s]."""
        end_ns = now_ns
        if self.over_ns is not None:
            end_ns = self.over_ns
        return max(0.0, (end_ns - self.since_ns) * 1e-9)

    def text(self, now_ns: int) -> str:
        """Return one line for people: sentence, duration, advice."""
        length = lasting(self.duration_s(now_ns))
        if self.over_ns is not None:
            length += f", over for {lasting((now_ns - self.over_ns) * 1e-9)}"
        return f"{self.alarm.sentence} ({length}). {self.alarm.advice}".rstrip()


# -- alarms over time ------------------------------------------------------------------------------

_Key = tuple[Kind, str]  # kind and subject


class Alarms:
    """Alarms over time; call :meth:`update` several times a second. Memory is bounded.

    Args:
        fleet: the fleet file.
        is_replay: whether the state is that of a recorded flight, in which nothing can be started.
    """

    def __init__(self, fleet: FleetConfig, *, is_replay: bool = False) -> None:
        self.fleet = fleet
        self.is_replay = is_replay
        self.has_new = False  # whether the last update brought an alarm above NOTE
        # vehicles that raised no alarm at the last update for what they have not heard yet
        self.starting: list[str] = []
        self._lines: dict[_Key, AlarmLine] = {}  # alarms that hold, or held until recently
        self._last_ns: dict[_Key, int] = {}  # last time at which each of them held
        self._over: deque[AlarmLine] = deque(maxlen=MAX_OVER)
        self._last_event: LoggedEvent | None = None
        self._now_ns = 0

    def update(self, state: FleetState, now_ns: int) -> None:
        """Update the alarms with the present state of the fleet.

        Args:
            state: the fleet as known now.
            now_ns: the clock of the state [ns]; if it goes back, all alarms are forgotten.
        """
        is_turned_back = now_ns < self._now_ns  # a replay has jumped back
        if is_turned_back:
            self._lines.clear()
            self._over.clear()
            self._last_event = None
        self._now_ns = now_ns
        self.starting = [
            name
            for name, view in state.vehicles.items()
            if view.is_fresh(now_ns) and _has_not_heard_yet(view)
        ]

        severities_before = {key: line.alarm.severity for key, line in self._lines.items()}

        present: dict[_Key, Alarm] = {}
        for alarm in conditions(state, self.fleet, now_ns):
            if self.is_replay and alarm.kind is GroundCondition.OTHER_FILE:
                continue  # the hashes of a record may be those of another version of Covey
            if self.is_replay and alarm.kind is GroundCondition.WAITING:
                alarm = dataclasses.replace(alarm, advice=NOT_RECORDED)
            present[alarm.kind, alarm.subject] = alarm
        for alarm in self._of_events(state):
            present[alarm.kind, alarm.subject] = alarm

        for key, alarm in present.items():
            if key in self._lines or not self._is_covered(key, now_ns):
                self._begin_or_go_on(key, alarm, now_ns)
        for key in list(self._lines):
            if key not in present:
                self._end_if_over(key, now_ns)

        self.has_new = False
        for key, line in self._lines.items():
            severity_before = severities_before.get(key, AlarmSeverity.NOTE)
            if line.alarm.severity > severity_before:
                self.has_new = True

    @property
    def words_without_alarm(self) -> str:
        """What a line says that has no alarm to show."""
        if self.starting:
            return f"starting: {listed(self.starting, _GROUPED)}"
        return "all well"

    def _begin_or_go_on(self, key: _Key, alarm: Alarm, now_ns: int) -> None:
        """Add the line of an alarm that holds now, or update the line that it already has."""
        self._last_ns[key] = now_ns
        line = self._lines.get(key)
        if line is None:
            since_ns = now_ns
            if alarm.since_ns is not None:
                since_ns = alarm.since_ns
            self._lines[key] = AlarmLine(alarm, since_ns)
            return

        # An alarm that got worse has to be acknowledged again.
        is_worse = alarm.severity > line.alarm.severity
        is_acknowledged = line.is_acknowledged and not is_worse
        self._lines[key] = dataclasses.replace(line, alarm=alarm, is_acknowledged=is_acknowledged)

    def _is_covered(self, key: _Key, now_ns: int) -> bool:
        """Return whether a worse alarm that implies this one holds, or only flickers."""
        kind, subject = key
        worse = COVERED.get(kind)
        if worse is None:
            return False
        last_ns = self._last_ns.get((worse, subject))
        return last_ns is not None and now_ns - last_ns <= LINGER_S * 1e9

    def _end_if_over(self, key: _Key, now_ns: int) -> None:
        """End an alarm that does not hold now.

        A latched alarm ends once it is acknowledged. Any other alarm ends after LINGER_S, because
        it may only be flickering, or at once if a worse one that implies it has begun.
        """
        line = self._lines[key]
        kind, subject = key
        last_ns = self._last_ns[key]
        if kind in LATCHED:
            if line.is_acknowledged:
                self._end(key, now_ns)
            return

        worse = COVERED.get(kind)
        is_covered = worse is not None and self._last_ns.get((worse, subject)) == now_ns
        if is_covered or now_ns - last_ns > LINGER_S * 1e9:
            self._end(key, last_ns)

    def _end(self, key: _Key, over_ns: int) -> None:
        line = self._lines.pop(key)
        self._over.append(dataclasses.replace(line, over_ns=over_ns))
        self._last_ns.pop(key, None)

    def _of_events(self, state: FleetState) -> Iterator[Alarm]:
        """Yield the alarms of events that have come since the last update."""
        for logged in state.events_after(self._last_event):
            kind = _EVENT_KINDS.get(logged.event.code)
            if kind is not None:
                is_flying = bool(state.airborne_names)
                what = plain(logged.event.sentence)
                alarm = _alarm(kind, logged.event.vehicle, is_flying=is_flying, what=what)
                yield dataclasses.replace(alarm, since_ns=logged.received_ns)

        if state.events:
            self._last_event = state.events[-1]

    @property
    def lines(self) -> list[AlarmLine]:
        """Present alarms: unacknowledged ones first, and the worst of each kind first.

        The same alarm of many vehicles is one line.
        """
        groups: dict[tuple[Kind, AlarmSeverity, bool], list[AlarmLine]] = {}
        for line in self._lines.values():
            group = (line.alarm.kind, line.alarm.severity, line.is_acknowledged)
            groups.setdefault(group, []).append(line)

        shown: list[AlarmLine] = []
        for lines in groups.values():
            if len(lines) < _GROUPED:
                shown += lines
            else:
                shown.append(_together(lines))
        return sorted(shown, key=lambda line: (line.is_acknowledged, *_urgency(line.alarm)))

    @property
    def over(self) -> list[AlarmLine]:
        """Past alarms, the newest first."""
        return list(reversed(self._over))

    @property
    def worst(self) -> AlarmLine | None:
        """The line that every screen shows; an acknowledged one only if there is no other."""
        return next(iter(self.lines), None)

    def of(self, vehicle: str) -> list[AlarmLine]:
        """Return the alarms of one vehicle, the worst first."""
        lines = [line for line in self._lines.values() if vehicle in line.alarm.subject.split(_AND)]
        return sorted(lines, key=lambda line: _urgency(line.alarm))

    def acknowledge(self, line: AlarmLine | None = None) -> int:
        """Acknowledge one alarm, or all; they stay in the list.

        Args:
            line: alarm line as shown, perhaps one for many vehicles; None: all lines.

        Returns:
            The number of alarms that were not acknowledged before.
        """
        count = 0
        for key, single in self._lines.items():
            is_selected = line is None or _is_part_of(single, line)
            if is_selected and not single.is_acknowledged:
                self._lines[key] = dataclasses.replace(single, is_acknowledged=True)
                count += 1
        return count


def _is_part_of(single: AlarmLine, shown: AlarmLine) -> bool:
    """Return whether the line of a single alarm is part of a shown line of one or many vehicles."""
    has_kind = single.alarm.kind == shown.alarm.kind
    has_severity = single.alarm.severity == shown.alarm.severity
    has_subject = shown.count > 1 or single.alarm.subject == shown.alarm.subject
    return has_kind and has_severity and has_subject


def _urgency(alarm: Alarm) -> tuple[int, int, str]:
    """Return the sort key by which the worst alarm comes first."""
    return -alarm.severity, RANKS[alarm.kind], alarm.subject


def _together(lines: list[AlarmLine]) -> AlarmLine:
    """Return one line for the same alarm of many vehicles; it began when the oldest one did."""
    oldest = min(lines, key=lambda line: (line.since_ns, line.alarm.subject))
    kind = oldest.alarm.kind

    names = sorted(line.alarm.subject for line in lines)
    first_names = ", ".join(names[:_SHOWN])
    vehicles = f"{len(lines)} of them: {first_names} and {len(names) - _SHOWN} more"

    what = "each for its own reason"
    if kind in _WITH_VALUE:
        what = min((line.alarm.what for line in lines), key=_by_number)

    sentence = TABLE[kind].sentence.format(who=vehicles, what=what)
    alarm = dataclasses.replace(oldest.alarm, subject=_AND.join(names), sentence=sentence)
    return dataclasses.replace(oldest, alarm=alarm, count=len(lines))


def _by_number(what: str) -> tuple[float, str]:
    """Return a sort key for values in sentences: their first number, or infinity without one."""
    match = re.search(r"\d+(\.\d+)?", what)
    if match is None:
        return math.inf, what
    return float(match[0]), what


# -- alarms of this moment -------------------------------------------------------------------------


def conditions(state: FleetState, fleet: FleetConfig, now_ns: int) -> list[Alarm]:
    """List all alarms of this moment.

    Args:
        state: the fleet as known now.
        fleet: the fleet file.
        now_ns: the ground's monotonic clock [ns].

    Returns:
        Alarms of the fleet, of pairs and of each vehicle, the worst first.
    """
    replaced_or_disabled = out_of_service(state)
    alarms = list(_of_fleet(state, fleet, now_ns, replaced_or_disabled))
    is_after_stall = state.is_after_stall(now_ns)
    for view in state.vehicles.values():
        if not view.is_up and view.name in replaced_or_disabled:
            continue  # such a vehicle is being repaired or carried about
        alarms.extend(_of_vehicle(view, fleet, now_ns, is_after_stall))
    return sorted(alarms, key=_urgency)


def _alarm(
    kind: Kind,
    subject: str,
    *,
    is_flying: bool,
    instead: str = "",
    what: str = "",
    names: str = "",
) -> Alarm:
    """Return an alarm with the words of the table.

    Args:
        kind: kind of the alarm.
        subject: a vehicle, a pair, or empty for the fleet.
        is_flying: whether one of them flies.
        instead: said in place of what the agent does about a condition, if not empty.
        what: number, name or reason in the sentence.
        names: replaces the subject in the sentence.
    """
    row = TABLE[kind]
    advice = row.advice
    severity = row.on_ground
    if is_flying:
        advice_in_flight = row.advice_in_flight
        if instead:
            advice_in_flight = instead
        advice = f"{advice_in_flight} {row.advice}".strip()
        severity = row.in_flight
    if not names:
        names = subject

    return Alarm(
        kind=kind,
        subject=subject,
        severity=severity,
        sentence=row.sentence.format(who=names, what=what),
        advice=advice,
        what=what,
    )


def _of_fleet(
    state: FleetState, fleet: FleetConfig, now_ns: int, replaced_or_disabled: set[str]
) -> Iterator[Alarm]:
    """Yield the alarms of pairs of vehicles and of the fleet as a whole."""
    yield from _close_pairs(state, fleet.fleet.safety_distance_m, now_ns)

    for name in state.disabled:
        view = state.vehicles.get(name)
        if view is not None and view.is_armed and view.is_fresh(now_ns):
            yield _alarm(GroundCondition.DISABLED_FLIES, view.name, is_flying=view.is_airborne)

    never_heard = [
        name
        for name, view in state.vehicles.items()
        if view.telemetry is None and name not in replaced_or_disabled
    ]
    if never_heard:
        names = listed(never_heard, _GROUPED)
        yield _alarm(GroundCondition.WAITING, "", is_flying=False, names=names)

    hashes = {
        view.telemetry.config_hash for view in state.vehicles.values() if view.telemetry is not None
    }
    if len(hashes) > 1:
        yield _alarm(GroundCondition.FILES_DIFFER, "", is_flying=bool(state.airborne_names))

    for name in with_other_file(state, state.vehicles, fleet, now_ns):
        view = state.vehicles[name]
        if view.is_up or name not in replaced_or_disabled:
            yield _alarm(GroundCondition.OTHER_FILE, name, is_flying=view.is_up)

    for view in state.unlisted:
        if view.is_up or view.is_fresh(now_ns):
            what = _unlisted_words(view, now_ns)
            name = plain(view.name)
            yield _alarm(GroundCondition.UNLISTED, name, is_flying=view.is_up, what=what)


def _unlisted_words(view: VehicleView, now_ns: int) -> str:
    """Return what a vehicle outside the fleet file does, or did when it was heard last."""
    state = ""
    if view.telemetry is not None:
        state = plain(view.telemetry.state, 20)
    if view.is_fresh(now_ns):
        return f"is {state}"
    return f"is silent, and was {state}"


def _close_pairs(state: FleetState, limit_m: float, now_ns: int) -> Iterator[Alarm]:
    """Yield every pair closer than the limit, if at least one of the two flies."""
    positions_enu_m = {}
    for name, view in state.vehicles.items():
        position = view.position_enu_m(now_ns)
        if position is not None:
            positions_enu_m[name] = position
    if len(positions_enu_m) < 2:
        return

    names = list(positions_enu_m)
    points_enu_m = np.array(list(positions_enu_m.values()))
    is_flying = np.array([state.vehicles[name].is_airborne for name in names])

    distances_m = separations_m(points_enu_m[:, None] - points_enu_m[None], state.height_share)
    is_close = (distances_m < limit_m) & (is_flying[:, None] | is_flying[None])
    for first, second in np.argwhere(np.triu(is_close, 1)):
        subject = _AND.join((names[first], names[second]))
        what = f"{distances_m[first, second]:.2f} m apart, limit {limit_m:.2f} m"
        yield _alarm(GroundCondition.CLOSE, subject, is_flying=True, what=what)


def _of_vehicle(
    view: VehicleView, fleet: FleetConfig, now_ns: int, is_after_stall: bool
) -> Iterator[Alarm]:
    """Yield the alarms of one vehicle.

    Args:
        is_after_stall: whether this program itself has just stood still, so that silence does not
            count.
    """
    name = view.name
    telemetry = view.telemetry
    if view.truth is not None and view.truth.is_collided and view.has_truth(now_ns):
        yield _alarm(GroundCondition.COLLIDED, name, is_flying=True)
    if telemetry is None:
        return

    is_flying = view.is_airborne
    if not view.is_fresh(now_ns):
        if not is_after_stall:
            alarm = _alarm(GroundCondition.SILENT, name, is_flying=is_flying)
            yield dataclasses.replace(alarm, since_ns=view.received_ns)
        return

    if telemetry.state == "failed":
        why = plain(telemetry.reason) or "it does not say why"
        yield _alarm(GroundCondition.FAILED, name, is_flying=is_flying, what=why)

    reported, unknown = _reported(telemetry)
    kinds = reported | _measured(telemetry, fleet)
    if len(kinds) > 1:
        kinds -= implied_by(kinds)
    if kinds and _is_starting(view, telemetry):
        kinds.difference_update(NOT_HEARD_YET)
    for kind in kinds:
        yield _alarm(
            kind,
            name,
            is_flying=is_flying,
            instead=_instead(kind, telemetry),
            what=_what(kind, telemetry),
        )
    if unknown:
        texts = ", ".join(plain(text) for text in unknown)
        yield _alarm(GroundCondition.UNKNOWN, name, is_flying=is_flying, what=texts)

    if is_flying and telemetry.law == "off":
        yield _alarm(GroundCondition.LAW_OFF, name, is_flying=True)
    elif is_flying and telemetry.law_status.lower() in ("relaxed", "infeasible"):
        yield _alarm(GroundCondition.LAW_STRAINED, name, is_flying=True)


def _instead(kind: Kind, telemetry: Telemetry) -> str:
    """Return what is said in place of what the agent does; empty if the agent does it."""
    if not isinstance(kind, Condition):
        return ""
    if telemetry.is_flown_by_hand:
        return "" if kind is Condition.FLOWN_BY_HAND else _BY_HAND
    if telemetry.action != WORDS[Action.PX4_LAND]:
        return ""

    # these have words of their own about PX4, or end its landing
    is_why = FAILSAFE_TABLE[Situation.FLYING, kind] >= Action.PX4_LAND
    return "" if is_why else _BY_PX4


def _has_not_heard_yet(view: VehicleView) -> bool:
    """Return whether a vehicle whose agent starts reports that it has not heard something."""
    telemetry = view.telemetry
    if telemetry is None or not _is_starting(view, telemetry):
        return False
    return any(kind.value in telemetry.conditions for kind in NOT_HEARD_YET)


def _is_starting(view: VehicleView, telemetry: Telemetry) -> bool:
    """Return whether the agent of a vehicle at rest has started within the last START_S.

    The telemetry's number counts the agent's ticks, so that a ground that starts later than the
    agent knows the agent's start as well.
    """
    if view.is_up or view.has_restarted_in_flight:
        return False
    running_s = (telemetry.sequence + telemetry.missed_ticks) * TICK_S
    return running_s < START_S


def _reported(telemetry: Telemetry) -> tuple[set[Kind], list[str]]:
    """Return the conditions that a vehicle reports, and reported texts that are not known."""
    texts = telemetry.conditions
    if not texts:  # the usual case, for speed
        return set(), []

    known: set[Kind] = {BY_TEXT[text] for text in texts if text in BY_TEXT}
    unknown = [text for text in texts if text not in BY_TEXT]
    return known, unknown[:_MAX_UNKNOWN]


def _measured(telemetry: Telemetry, fleet: FleetConfig) -> set[Kind]:
    """Return the conditions that the numbers in the telemetry show, reported or not."""
    kinds: set[Kind] = set()

    charge_pct = telemetry.battery_frac * 100.0
    if math.isfinite(charge_pct) and charge_pct >= 0.0:
        if telemetry.is_airborne and charge_pct <= fleet.fleet.battery_land_pct:
            kinds.add(Condition.BATTERY_LOW)
        elif charge_pct <= fleet.fleet.battery_warning_pct:
            kinds.add(Condition.BATTERY_WARNING)

    if telemetry.is_airborne:
        if not telemetry.is_position_valid:
            kinds.add(Condition.POSITION_LOST)
        elif not flight_space_of(fleet).contains(telemetry.position_enu_m):
            kinds.add(Condition.FENCE_BREACH)
    return kinds


def _what(kind: Kind, telemetry: Telemetry) -> str:
    """Return the number or name in the sentence of a condition; empty if it has none."""
    is_battery = kind in (Condition.BATTERY_LOW, Condition.BATTERY_WARNING)
    if is_battery and math.isfinite(telemetry.battery_frac):
        return f", {telemetry.battery_frac * 100.0:.0f} %"
    if kind is Condition.LEFT_OFFBOARD and telemetry.mode:
        return f" for {plain(telemetry.mode, 20)}"
    return ""


# -- words -----------------------------------------------------------------------------------------


def lasting(seconds: float) -> str:
    """Return a duration in few characters: ``4 s``, ``3 min 20 s``, ``2 h 5 min``."""
    all_seconds = int(seconds)
    if all_seconds < 60:
        return f"{all_seconds} s"
    all_minutes, rest_s = divmod(all_seconds, 60)
    if all_minutes < 60:
        return f"{all_minutes} min {rest_s} s"
    hours, minutes = divmod(all_minutes, 60)
    return f"{hours} h {minutes} min"


def plain(text: str, limit: int = 160) -> str:
    """Return a received text as one line without control characters."""
    return plain_line(text[:limit]).rstrip(".")
