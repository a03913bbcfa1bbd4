"""A timer on an absolute schedule that asyncio can watch: timerfd, or asyncio's own clock where
there is none.
"""

from __future__ import annotations

import asyncio
import ctypes
import os
import struct
import time
from collections import deque
from collections.abc import Callable

_CLOCK_MONOTONIC, _TFD_FLAGS, _TFD_TIMER_ABSTIME = 1, os.O_NONBLOCK | os.O_CLOEXEC, 1
_WINDOW = 500  # ten seconds at 50 Hz


class Ticker:
    """Calls ``on_tick`` every ``period_ns``, first at a multiple of the period plus ``offset_ns``.

    Ticks that were missed are not made up for but counted: ``missed_ticks``. ``late_ticks`` counts
    those whose period was longer than it should be by ``late_ns``.
    """

    def __init__(
        self,
        period_ns: int,
        on_tick: Callable[[], None],
        *,
        offset_ns: int = 0,
        late_ns: int = 5_000_000,
    ) -> None:
        self._period_ns, self._on_tick, self._offset_ns, self._late_ns = (
            period_ns,
            on_tick,
            offset_ns,
            late_ns,
        )
        self._fd: int | None = None
        self._handle: asyncio.TimerHandle | None = None
        self._periods_ms: deque[float] = deque(maxlen=_WINDOW)
        self._lateness_ms: deque[float] = deque(maxlen=_WINDOW)
        self._last_ns = self._first_ns = 0
        self.late_ticks = self.missed_ticks = 0

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Begin to tick."""
        now_ns = time.monotonic_ns()
        first_ns = self._first_ns = (
            now_ns // self._period_ns + 1
        ) * self._period_ns + self._offset_ns
        self._last_ns = 0
        self._loop = loop
        libc = ctypes.CDLL(None, use_errno=True)
        if hasattr(libc, "timerfd_create"):
            fd = libc.timerfd_create(_CLOCK_MONOTONIC, _TFD_FLAGS)
            if fd >= 0:
                spec = struct.pack(
                    "qqqq", *divmod(self._period_ns, 10**9), *divmod(first_ns, 10**9)
                )
                libc.timerfd_settime(fd, _TFD_TIMER_ABSTIME, spec, None)
                self._fd = fd
                loop.add_reader(fd, self._readable)
                return
        self._next_ns = first_ns
        self._handle = loop.call_at(first_ns * 1e-9, self._timed)

    def stop(self) -> None:
        """Tick no more; a second call does nothing."""
        fd, self._fd = self._fd, None
        if fd is not None:
            self._loop.remove_reader(fd)
            os.close(fd)
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None

    def statistics_ms(self) -> tuple[float, float, float]:
        """Median, 99th percentile and maximum of the period over the last ten seconds."""
        ordered = sorted(self._periods_ms)
        if not ordered:
            return 0.0, 0.0, 0.0
        last = len(ordered) - 1
        return ordered[last // 2], ordered[round(0.99 * last)], ordered[-1]

    def lateness_p99_ms(self) -> float:
        """99th percentile of how far behind the schedule the ticks of the last ten seconds began."""
        ordered = sorted(self._lateness_ms)
        return ordered[round(0.99 * (len(ordered) - 1))] if ordered else 0.0

    def _readable(self) -> None:
        if self._fd is None:
            return
        try:
            (expired,) = struct.unpack("q", os.read(self._fd, 8))
        except BlockingIOError:
            return
        self.missed_ticks += expired - 1
        self._run()

    def _timed(self) -> None:
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
            self.late_ticks += period_ns > self._period_ns + self._late_ns
        self._lateness_ms.append((now_ns - self._first_ns) % self._period_ns * 1e-6)
        self._last_ns = now_ns
        self._on_tick()
