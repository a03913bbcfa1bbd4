"""Decides which conditions hold at a tick, by evaluating the condition table with a memory per
fact.

:mod:`failsafe_supervisor` calls it at every tick.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from onboard.config.fleet import FleetSection
from onboard.safety.condition_timer import ConditionTimer
from onboard.safety.failsafe_table import Condition
from onboard.supervision.condition_table import ROWS, Cause, ConditionRow
from onboard.supervision.tick_facts import TickFacts

ANY_TIME_S = -math.inf  # limit of a cause that counts at once, because any duration is longer


class _Watched:
    """One fact of the table, how long it has held, and the causes that depend on it.

    The fact holds if its value is above ``above`` or equals ``equals``; if both are None, the value
    itself is True or False.
    """

    __slots__ = ("above", "causes", "equals", "fact", "held")

    def __init__(self, cause: Cause) -> None:
        self.fact = cause.fact
        self.above = cause.above
        self.equals = cause.equals
        self.held = ConditionTimer()
        # condition, cause, and the time [s] that the fact's duration must exceed
        self.causes: list[tuple[Condition, Cause, float]] = []


class ConditionMonitor:
    """Decides which conditions of one vehicle hold; call :meth:`update` at each tick.

    Args:
        limits: section [fleet] of the fleet file.
        rows: rows of the condition table.
    """

    def __init__(self, limits: FleetSection, rows: Iterable[ConditionRow] = ROWS) -> None:
        at_each_tick: list[tuple[Condition, Cause]] = []
        at_slow_ticks: list[tuple[Condition, Cause]] = []
        for row in rows:
            for cause in row.causes:
                if cause.is_slow:
                    at_slow_ticks.append((row.condition, cause))
                else:
                    at_each_tick.append((row.condition, cause))
        self._at_each_tick = _watched(at_each_tick, limits)
        self._at_slow_ticks = _watched(at_slow_ticks, limits)
        self._slow: dict[Condition, str] = {}  # slow conditions that held at the last slow tick

    def update(self, facts: TickFacts) -> dict[Condition, str]:
        """Return the conditions that hold at this tick, each with its detail for people."""
        active = _holding(self._at_each_tick, facts)
        if facts.is_slow_tick:
            self._slow = _holding(self._at_slow_ticks, facts)

        if self._slow:
            active.update(self._slow)
        return active


def time_limit_s(cause: Cause, limits: FleetSection) -> float:
    """Return the time [s] that the duration of a cause must exceed."""
    if cause.over_s is None:
        return ANY_TIME_S
    if isinstance(cause.over_s, str):
        return float(getattr(limits, cause.over_s))
    return cause.over_s


def _watched(
    causes: Iterable[tuple[Condition, Cause]], limits: FleetSection
) -> tuple[_Watched, ...]:
    """Return each fact once, with all its causes.

    Two conditions may share a fact. For example, BUS_LOST and BUS_LOST_LONG differ only in their
    duration.
    """
    by_fact: dict[object, _Watched] = {}
    for condition, cause in causes:
        fact_and_limit = (cause.fact, cause.above, cause.equals)
        watched = by_fact.setdefault(fact_and_limit, _Watched(cause))
        watched.causes.append((condition, cause, time_limit_s(cause, limits)))
    return tuple(by_fact.values())


def _holding(all_watched: Iterable[_Watched], facts: TickFacts) -> dict[Condition, str]:
    """Return the conditions that hold, each with its detail."""
    active: dict[Condition, str] = {}
    for watched in all_watched:
        value = watched.fact(facts)
        if watched.above is not None:
            holds = value > watched.above
        elif watched.equals is not None:
            holds = value == watched.equals
        else:
            holds = value

        held = watched.held
        if not holds:
            # like ConditionTimer.end, but inlined for speed, because most facts do not hold
            held.checks = 0
            continue

        held.see(facts.now_ns)
        held_s = held.seconds(facts.now_ns)
        for condition, cause, over_s in watched.causes:
            has_held_long = held.checks >= cause.checks and held_s > over_s
            if has_held_long and (cause.given is None or cause.given(facts)):
                active[condition] = _detail(cause, facts)
    return active


def _detail(cause: Cause, facts: TickFacts) -> str:
    if isinstance(cause.detail, str):
        return cause.detail
    return cause.detail(facts)
