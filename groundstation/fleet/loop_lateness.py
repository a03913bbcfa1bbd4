"""Lateness of this ground's event loop, which shows whether its computer is too busy."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

WINDOW_S = 10.0  # time for which a late call counts
_MIN_LATE_S = 0.03  # lateness that a computer with time to spare does not reach
_MAX_KEPT = 500  # calls in the window, at 50 a second


class LoopLateness:
    """Lateness of calls at a fixed period.

    Args:
        clock_ns: the ground's monotonic clock [ns].
        period_s: planned time between two calls [s].
    """

    def __init__(self, clock_ns: Callable[[], int], period_s: float) -> None:
        self._clock_ns = clock_ns
        self._period_s = period_s
        self._last_ns: int | None = None
        # time [ns] and lateness [s] of late calls, the oldest first
        self._late: deque[tuple[int, float]] = deque(maxlen=_MAX_KEPT)

    def note_delivery(self) -> None:
        """Note how late this call is."""
        now_ns = self._clock_ns()
        if self._last_ns is not None:
            late_s = (now_ns - self._last_ns) * 1e-9 - self._period_s
            if late_s > _MIN_LATE_S:
                self._late.append((now_ns, late_s))
        self._last_ns = now_ns

    @property
    def worst_s(self) -> float:
        """The largest lateness within the window [s]; 0 if no call was late."""
        oldest_ns = self._clock_ns() - round(WINDOW_S * 1e9)
        return max((late_s for time_ns, late_s in self._late if time_ns >= oldest_ns), default=0.0)
