"""A wall clock that a test sets."""

from __future__ import annotations

from typing import Any

from groundstation.client.wall_clock import WallClock
from groundstation.mission_files.wall_time import WallTime, local_now
from onboard.bus.clock_offsets import Clocks

_S = 1_000_000_000
NOW_NS = 1_795_000_000 * _S  # of the wall clock


class MovableClock(WallClock):
    """Clocks that a test sets; the vehicles' computers have the same time unless it says so."""

    def __init__(self, now_ns: Any = None) -> None:
        self.shift_ns = 0  # of this computer's clock
        self.mono_ns = 1000 * _S
        self.ahead: dict[str, tuple[float, float] | None] = {}
        read = now_ns or (lambda: self.mono_ns)
        begin_ns = read()
        super().__init__(
            lambda: Clocks("own", 1), read, lambda: NOW_NS + read() - begin_ns + self.shift_ns
        )

    def ahead_s(self, vehicle: str) -> tuple[float, float] | None:
        return self.ahead.get(vehicle, (0.001, 0.002))

    def pass_time(self, seconds: float) -> None:
        self.mono_ns += round(seconds * 1e9)

    def after(self, seconds: float) -> WallTime:
        """A time so long from now."""
        wall_ns = self.wall_ns + round(seconds * 1e9)
        return WallTime(f"{local_now(wall_ns):%H:%M:%S}", wall_ns)
