"""Exact confidence intervals of a share, by Clopper and Pearson. Pure.

An event happened in k of n flights. The interval contains every true share for which k events are
not improbable. The flights have to be independent. The interval says nothing about cases that the
campaign cannot draw.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

CONFIDENCE = 0.95


class Interval(NamedTuple):
    """The events and flights of a share, and the interval of the true share, 95 % confidence."""

    events: int
    flights: int
    low: float
    high: float

    def holds(self, share: float) -> bool:
        """Return whether a share lies in the interval."""
        return self.low <= share <= self.high


def two_sided(events: int, count: int) -> Interval:
    """Return the exact two-sided interval.

    Args:
        events: number of events.
        count: number of flights, 0 or more.
    """
    tail = 0.5 * (1.0 - CONFIDENCE)  # probability beyond each end: 2.5 %
    low = 0.0
    if events > 0:
        # the share at which this many events or more have a probability of 2.5 %
        low = _share_where(
            lambda share: 1.0 - _probability_of_at_most(events - 1, count, share) < tail
        )
    high = 1.0
    if events < count:
        # the share at which this many events or fewer have a probability of 2.5 %
        high = _share_where(lambda share: _probability_of_at_most(events, count, share) > tail)
    return Interval(events=events, flights=count, low=low, high=high)


def exact_interval(events: int, count: int) -> Interval:
    """Return the two-sided interval; without any event, or with events only, a one-sided one.

    Then one end is 0 or 1, and all 5 % lie beyond the other end: 0 of n is below 3/n.

    Args:
        events: number of events.
        count: number of flights, 1 or more.
    """
    if events == 0:
        return Interval(events=events, flights=count, low=0.0, high=upper_bound(0, count))
    if events == count:
        return Interval(events=events, flights=count, low=1.0 - upper_bound(0, count), high=1.0)
    return two_sided(events, count)


def upper_bound(events: int, count: int) -> float:
    """Return the one-sided upper bound of the true share, with 95 % confidence.

    Args:
        events: number of events.
        count: number of flights, 0 or more.
    """
    if events >= count:
        return 1.0
    tail = 1.0 - CONFIDENCE
    return _share_where(lambda share: _probability_of_at_most(events, count, share) > tail)


def _share_where(is_below: Callable[[float], bool]) -> float:
    """Return, by bisection, the share up to which ``is_below`` is true."""
    low = 0.0
    high = 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if is_below(middle):
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def _probability_of_at_most(events: int, count: int, share: float) -> float:
    """Return the binomial probability of this many events or fewer."""
    if share <= 0.0:
        return 1.0
    if share >= 1.0:
        return 0.0 if events < count else 1.0

    probability = 0.0
    for k in range(events + 1):
        log_combinations = math.lgamma(count + 1) - math.lgamma(k + 1) - math.lgamma(count - k + 1)
        probability += math.exp(
            log_combinations + k * math.log(share) + (count - k) * math.log1p(-share)
        )
    return min(probability, 1.0)
