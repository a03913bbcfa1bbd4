"""A timer on an absolute schedule for asyncio: Linux's timerfd, or else asyncio's own clock."""

from __future__ import annotations

import asyncio
import ctypes
import os
import struct
import time
from collections import deque
from collections.abc import Callable

# timerfd_create(2)
_CLOCK_MONOTONIC = 1
_TFD_FLAGS = os.O_NONBLOCK | os.O_CLOEXEC
_TFD_TIMER_ABSTIME = 1

_WINDOW = 500  # number of ticks in the statistics: ten seconds at 50 Hz


class Ticker:
    """Calls ``on_tick`` every ``period_ns``, first at a multiple of the period plus ``offset_ns``.

    ``missed_ticks`` counts the scheduled ticks that were skipped because an earlier tick was still
    running. ``late_ticks`` counts the ticks whose period was longer than ``period_ns`` by more than
    ``late_ns``.
    """

    def __init__(
        self,
        period_ns: int,
        on_tick: Callable[[], None],
        *,
        offset_ns: int = 0,
        late_ns: int = 5_000_000,
    ) -> None:
        self.late_ticks = 0
        self.missed_ticks = 0
        self._period_ns = period_ns
        self._on_tick = on_tick
        self._offset_ns = offset_ns
        self._late_ns = late_ns
        self._fd: int | None = None  # file descriptor of the timerfd
        self._handle: asyncio.TimerHandle | None = None  # used if there is no timerfd
        self._first_ns = 0  # scheduled time of the first tick
        self._last_ns = 0  # start of the last tick; 0 before the first
        self._periods_ms: deque[float] = deque(maxlen=_WINDOW)
        self._lateness_ms: deque[float] = deque(maxlen=_WINDOW)

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Start ticking."""
        now_ns = time.monotonic_ns()
        next_multiple = now_ns // self._period_ns + 1
        self._first_ns = next_multiple * self._period_ns + self._offset_ns
        self._last_ns = 0
        self._loop = loop

        self._fd = _timerfd(self._period_ns, self._first_ns)
        if self._fd is not None:
            loop.add_reader(self._fd, self._readable)
        else:
            self._next_ns = self._first_ns
            self._handle = loop.call_at(self._first_ns * 1e-9, self._timed)

    def stop(self) -> None:
        """Stop ticking; a second call does nothing."""
        if self._fd is not None:
            self._loop.remove_reader(self._fd)
            os.close(self._fd)
            self._fd = None
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None

    def statistics_ms(self) -> tuple[float, float, float]:
        """Return median, 99th percentile and maximum of the period over the last ten seconds."""
        ordered = sorted(self._periods_ms)
        if not ordered:
            return 0.0, 0.0, 0.0

        last_index = len(ordered) - 1
        return ordered[last_index // 2], ordered[round(0.99 * last_index)], ordered[-1]

    def lateness_p99_ms(self) -> float:
        """Return the 99th percentile of the ticks' delay behind the schedule."""
        ordered = sorted(self._lateness_ms)
        if not ordered:
            return 0.0
        return ordered[round(0.99 * (len(ordered) - 1))]

    def _readable(self) -> None:
        """Run one tick for a timerfd that has expired, once or several times."""
        if self._fd is None:
            return
        try:
            # number of expiries since the last read
            (expired,) = struct.unpack("q", os.read(self._fd, 8))
        except BlockingIOError:
            return

        self.missed_ticks += expired - 1
        self._run()

    def _timed(self) -> None:
        """Run one tick on asyncio's clock, and schedule the next."""
        now_ns = time.monotonic_ns()
        missed = max(0, (now_ns - self._next_ns) // self._period_ns)
        self.missed_ticks += missed
        self._next_ns += (missed + 1) * self._period_ns
        self._handle = self._loop.call_at(self._next_ns * 1e-9, self._timed)
        self._run()

    def _run(self) -> None:
        now_ns = time.monotonic_ns()
        if self._last_ns:
            period_ns = now_ns - self._last_ns
            self._periods_ms.append(period_ns * 1e-6)
            if period_ns > self._period_ns + self._late_ns:
                self.late_ticks += 1

        lateness_ns = (now_ns - self._first_ns) % self._period_ns
        self._lateness_ms.append(lateness_ns * 1e-6)
        self._last_ns = now_ns
        self._on_tick()


def _timerfd(period_ns: int, first_ns: int) -> int | None:
    """Return a timerfd that expires every period from a given time; None if the system has no
    timerfd.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if not hasattr(libc, "timerfd_create"):
        return None
    fd: int = libc.timerfd_create(_CLOCK_MONOTONIC, _TFD_FLAGS)
    if fd < 0:
        return None

    # struct itimerspec: seconds and nanoseconds of the interval, then of the first expiry
    spec = struct.pack("qqqq", *divmod(period_ns, 10**9), *divmod(first_ns, 10**9))
    libc.timerfd_settime(fd, _TFD_TIMER_ABSTIME, spec, None)
    return fd
