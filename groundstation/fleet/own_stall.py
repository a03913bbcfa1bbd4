"""Notice that this ground itself stood still: a stopped process, a closed lid.

Silence and time limits that such a time contains say nothing about the vehicles.
"""

from __future__ import annotations

import time
from collections.abc import Callable

OWN_STALL_S = 1.0  # between two looks, after which this ground itself stood still
AFTER_STALL_S = 6.0  # until silence counts again: connections come back first


def boot_clock_ns() -> int:
    """Return a clock that goes on while this computer sleeps [ns]."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


class OwnStall:
    """Stalls of one ground.

    Args:
        clock_ns: a clock that goes on while this computer sleeps [ns].
    """

    def __init__(self, clock_ns: Callable[[], int]) -> None:
        self._clock_ns = clock_ns
        self._look_ns: int | None = None  # last look
        self._end_ns: int | None = None  # end of the last stall

    def look(self) -> float:
        """Return the length of the stall that has just ended [s]; 0 without one. Call it several times a second."""
        now_ns, last_ns = self._clock_ns(), self._look_ns
        self._look_ns = now_ns
        gap_s = 0.0 if last_ns is None else (now_ns - last_ns) * 1e-9
        if gap_s <= OWN_STALL_S:
            return 0.0
        self._end_ns = now_ns
        return gap_s

    @property
    def is_recent(self) -> bool:
        """Whether the last stall ended less than AFTER_STALL_S ago."""
        return self._end_ns is not None and self._clock_ns() - self._end_ns < AFTER_STALL_S * 1e9
