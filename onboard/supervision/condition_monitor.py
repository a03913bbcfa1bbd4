"""Which conditions hold at a tick: the rows of the condition table, each with its memory."""

from __future__ import annotations

import math
from collections.abc import Iterable

from onboard.config.fleet import FleetSection
from onboard.safety.failsafe_table import Condition
from onboard.safety.held import Held
from onboard.supervision.condition_table import ROWS, Cause, ConditionRow
from onboard.supervision.tick_facts import TickFacts

ANY_TIME_S = -math.inf  # of a cause that need not last


class _WatchedCause:
    """One cause of a condition, and for how long it has held."""

    __slots__ = ("cause", "condition", "held", "over_s")

    def __init__(self, condition: Condition, cause: Cause, limits: FleetSection) -> None:
        self.condition = condition
        self.cause = cause
        self.over_s = time_limit_s(cause, limits)
        self.held = Held()


class ConditionMonitor:
    """Judges the facts of every tick of one vehicle; call :meth:`look` at each.

    Args:
        limits: of the fleet file.
        rows: of the condition table.
    """

    def __init__(self, limits: FleetSection, rows: Iterable[ConditionRow] = ROWS) -> None:
        watched = [
            _WatchedCause(row.condition, cause, limits) for row in rows for cause in row.causes
        ]
        self._at_each_tick = [one for one in watched if not one.cause.is_slow]
        self._at_slow_ticks = [one for one in watched if one.cause.is_slow]
        self._slow: dict[Condition, str] = {}  # that hold as of the last slow tick

    def look(self, facts: TickFacts) -> dict[Condition, str]:
        """Return the conditions that hold at this tick, each with its detail for people."""
        active = _holding(self._at_each_tick, facts)
        if facts.is_slow_tick:
            self._slow = _holding(self._at_slow_ticks, facts)

        if self._slow:
            active.update(self._slow)
        return active


def time_limit_s(cause: Cause, limits: FleetSection) -> float:
    """Return the time for longer than which a cause has to hold [s]."""
    if cause.over_s is None:
        return ANY_TIME_S
    if isinstance(cause.over_s, str):
        return float(getattr(limits, cause.over_s))
    return cause.over_s


def _holding(watched: list[_WatchedCause], facts: TickFacts) -> dict[Condition, str]:
    active: dict[Condition, str] = {}
    for one in watched:
        cause, held = one.cause, one.held

        if not cause.holds(facts):
            held.checks = 0  # as Held.update does; nearly all of them, at every tick
            continue

        held.update(True, facts.now_ns)
        has_held_long = held.checks >= cause.checks and held.seconds(facts.now_ns) > one.over_s
        if has_held_long and (cause.given is None or cause.given(facts)):
            active[one.condition] = _detail(cause, facts)
    return active


def _detail(cause: Cause, facts: TickFacts) -> str:
    if isinstance(cause.detail, str):
        return cause.detail
    return cause.detail(facts)
