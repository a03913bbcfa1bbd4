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


class _Watched:
    """A fact that the table watches, for how long it has held, and the causes that wait for it."""

    __slots__ = ("above", "causes", "equals", "fact", "held")

    def __init__(self, cause: Cause) -> None:
        self.fact = cause.fact
        self.above = cause.above
        self.equals = cause.equals
        self.held = Held()
        # condition, cause, and the time for longer than which the fact has to hold [s]
        self.causes: list[tuple[Condition, Cause, float]] = []


class ConditionMonitor:
    """Judges the facts of every tick of one vehicle; call :meth:`look` at each.

    Args:
        limits: of the fleet file.
        rows: of the condition table.
    """

    def __init__(self, limits: FleetSection, rows: Iterable[ConditionRow] = ROWS) -> None:
        causes = [(row.condition, cause) for row in rows for cause in row.causes]
        at_each_tick = [one for one in causes if not one[1].is_slow]
        at_slow_ticks = [one for one in causes if one[1].is_slow]
        self._at_each_tick = _watched(at_each_tick, limits)
        self._at_slow_ticks = _watched(at_slow_ticks, limits)
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


def _watched(
    causes: Iterable[tuple[Condition, Cause]], limits: FleetSection
) -> tuple[_Watched, ...]:
    """Return each fact once, with its causes: a bus that is silent, and is so for long."""
    watched: dict[object, _Watched] = {}
    for condition, cause in causes:
        what = (cause.fact, cause.above, cause.equals)
        one = watched.setdefault(what, _Watched(cause))
        one.causes.append((condition, cause, time_limit_s(cause, limits)))
    return tuple(watched.values())


def _holding(watched: Iterable[_Watched], facts: TickFacts) -> dict[Condition, str]:
    active: dict[Condition, str] = {}
    for one in watched:
        holds = one.fact(facts)
        if one.above is not None:
            holds = holds > one.above
        elif one.equals is not None:
            holds = holds == one.equals

        held = one.held
        if not holds:
            held.checks = 0  # as Held.end does; for nearly all of them, at every tick
            continue

        held.see(facts.now_ns)
        held_s = held.seconds(facts.now_ns)
        for condition, cause, over_s in one.causes:
            has_held_long = held.checks >= cause.checks and held_s > over_s
            if has_held_long and (cause.given is None or cause.given(facts)):
                active[condition] = _detail(cause, facts)
    return active


def _detail(cause: Cause, facts: TickFacts) -> str:
    if isinstance(cause.detail, str):
        return cause.detail
    return cause.detail(facts)
