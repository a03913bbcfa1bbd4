"""Notices that this ground itself stood still: a stopped process, a laptop with its lid closed.

A silence or a timeout during such a stall says nothing about the vehicles, so it does not count.
"""

from __future__ import annotations

import time
from collections.abc import Callable

OWN_STALL_S = 1.0  # time between two looks after which this ground itself has stood still
AFTER_STALL_S = 6.0  # time after a stall until silence counts again; connections come back first
LATE_S = 0.5  # time between two looks after which this computer is too busy
AFTER_LATE_S = 1.0  # time after that until silence counts again; waiting messages are read first


def boot_clock_ns() -> int:
    """Return the time of a clock that runs while this computer sleeps [ns]."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


class OwnStall:
    """Detects stalls of this process.

    Args:
        clock_ns: a clock that keeps running while this computer sleeps [ns].
        least_s: shortest stall [s].
    """

    def __init__(self, clock_ns: Callable[[], int], *, least_s: float = OWN_STALL_S) -> None:
        self._clock_ns = clock_ns
        self._least_s = least_s
        self._last_call_ns: int | None = None

    def stalled_s(self, waited_s: float = 0.0) -> float:
        """Return the length of a stall that has just ended.

        Call it several times a second, or after each wait.

        Args:
            waited_s: planned time since the last call [s].

        Returns:
            Length of the stall [s]; 0 if there was none, and at the first call.
        """
        last_call_ns = self._last_call_ns
        now_ns = self._clock_ns()
        self._last_call_ns = now_ns
        if last_call_ns is None:
            return 0.0

        gap_s = (now_ns - last_call_ns) * 1e-9 - waited_s
        if gap_s <= self._least_s:
            return 0.0
        return gap_s
