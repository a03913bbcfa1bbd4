"""Exact intervals of a share, by Clopper and Pearson. Pure.

Of n flights k showed something. The interval holds every share for which so many, or so few, are no
surprise. It assumes flights that are drawn independently, and says nothing of what was not drawn.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

CONFIDENCE = 0.95


class Interval(NamedTuple):
    """A share, and where the true one lies with 95 % confidence."""

    events: int
    flights: int
    low: float
    high: float

    def holds(self, share: float) -> bool:
        """Return whether a share lies in it."""
        return self.low <= share <= self.high


def two_sided(events: int, count: int) -> Interval:
    """Return the exact interval with 2.5 % beyond each end.

    Args:
        events: among the flights.
        count: of flights, 0 or more.
    """
    rest = 0.5 * (1.0 - CONFIDENCE)
    low = 0.0
    if events > 0:
        # the share at which so many events or more have a chance of 2.5 %
        low = _share_where(lambda share: 1.0 - _chance_of_at_most(events - 1, count, share) < rest)
    high = 1.0
    if events < count:
        high = _share_where(lambda share: _chance_of_at_most(events, count, share) > rest)
    return Interval(events=events, flights=count, low=low, high=high)


def upper_bound(events: int, count: int) -> float:
    """Return the share that the true one is below with 95 % confidence; one-sided.

    Args:
        events: among the flights.
        count: of flights, 0 or more.
    """
    if events >= count:
        return 1.0
    rest = 1.0 - CONFIDENCE
    return _share_where(lambda share: _chance_of_at_most(events, count, share) > rest)


def _share_where(is_below: Callable[[float], bool]) -> float:
    """Return the share up to which something holds, by bisection."""
    low = 0.0
    high = 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if is_below(middle):
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def _chance_of_at_most(events: int, count: int, share: float) -> float:
    """Return the binomial probability of so many events or fewer."""
    if share <= 0.0:
        return 1.0
    if share >= 1.0:
        return 0.0 if events < count else 1.0

    chance = 0.0
    for k in range(events + 1):
        log_ways = math.lgamma(count + 1) - math.lgamma(k + 1) - math.lgamma(count - k + 1)
        chance += math.exp(log_ways + k * math.log(share) + (count - k) * math.log1p(-share))
    return min(chance, 1.0)
