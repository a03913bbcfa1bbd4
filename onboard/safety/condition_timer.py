"""Counts how long, and for how many checks in a row, a condition has held. Pure.

The whole package uses it to wait before a condition counts. A process that was not scheduled for a
while finds every message old at its first tick, although nothing else is wrong. Therefore a silence
counts only after several checks in a row have seen it. A condition that may come and go quickly
counts only after some time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(slots=True)
class ConditionTimer:
    """Memory of one condition.

    Call :meth:`see` at every check at which it holds, and :meth:`end` at every other check.
    """

    checks: int = 0  # number of checks in a row at which it held; 0 while it does not hold
    since_ns: int = 0  # our time at the first of these checks

    def see(self, now_ns: int) -> None:
        """Count a check at which the condition holds.

        Args:
            now_ns: our clock.
        """
        if self.checks == 0:
            self.since_ns = now_ns
        self.checks += 1

    def end(self) -> None:
        """Note a check at which the condition does not hold."""
        self.checks = 0

    def seconds(self, now_ns: int) -> float:
        """Return how long the condition has held [s]; 0 while it does not hold.

        Args:
            now_ns: our clock.
        """
        if self.checks == 0:
            return 0.0
        return (now_ns - self.since_ns) * 1e-9


@dataclass(slots=True)
class Recurring:
    """Memory of a condition that comes and goes: the summed time for which it has held.

    While the condition does not hold, the sum shrinks. So it grows only if the condition holds for
    more than a share of the time.

    Args:
        forgotten_share: how much the sum shrinks per second without the condition [s].
        largest_s: the sum does not grow beyond this, so that it is forgotten soon.
    """

    forgotten_share: float
    largest_s: float = math.inf
    seconds: float = 0.0  # the sum
    _last_ns: int = 0  # our time at the last check; 0 before the first one

    def update(self, now_ns: int, holds: bool) -> None:
        """Process a check.

        Args:
            now_ns: our clock.
            holds: whether the condition has held since the last check.
        """
        passed_s = 0.0
        if self._last_ns:
            passed_s = max(now_ns - self._last_ns, 0) * 1e-9
        self._last_ns = now_ns

        if holds:
            self.seconds = min(self.seconds + passed_s, self.largest_s)
        else:
            self.seconds = max(self.seconds - self.forgotten_share * passed_s, 0.0)
