"""For how long, and for how many checks in a row, something has held. Pure.

This is the one way in which safety waits before it believes. A process that was not scheduled for a
while finds every message old at its first tick, although nothing else is wrong: so a silence counts
only after several checks in a row have seen it. What may come and go for a moment counts only after
some time.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Held:
    """Memory of one thing that may hold.

    Call :meth:`see` at every check that sees it, :meth:`end` at every other one.
    """

    checks: int = 0  # in a row that have seen it; 0 while it does not hold
    since_ns: int = 0  # the first of them

    def see(self, now_ns: int) -> None:
        """Take a check that has seen it.

        Args:
            now_ns: our clock.
        """
        if self.checks == 0:
            self.since_ns = now_ns
        self.checks += 1

    def end(self) -> None:
        """Take a check that has not seen it."""
        self.checks = 0

    def seconds(self, now_ns: int) -> float:
        """Return the time since the first check that saw it [s]; 0 while it does not hold.

        Args:
            now_ns: our clock.
        """
        if self.checks == 0:
            return 0.0
        return (now_ns - self.since_ns) * 1e-9
