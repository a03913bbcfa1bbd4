"""The wall clock (the time of day) of this ground, compared with the vehicles' computers.

Flights run by monotonic clocks, which cannot be set. For a start at a time of day, this ground
reads the wall clock once to convert that time into one of the monotonic clock. It cannot know
whether its time of day is right, but it can tell whether all computers of the fleet agree.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from onboard.bus.clock_offsets import Clocks

# Number of readings. The quickest one is used, because this process may be interrupted between
# reading one clock and reading the other.
_READING_COUNT = 3


class WallClock:
    """Reads the wall clock of this computer, and compares it with those of other computers.

    Args:
        clocks: function that returns the clocks of the other nodes; None in simulated time.
        now_ns: the ground's monotonic clock [ns].
        wall_ns: this computer's time since 1970 [ns].
    """

    def __init__(
        self,
        clocks: Callable[[], Clocks | None],
        now_ns: Callable[[], int],
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._clocks = clocks
        self._now_ns = now_ns
        self._wall_ns = wall_ns

    @property
    def is_simulated(self) -> bool:
        """Whether time is simulated; then the wall clock has no meaning."""
        return self._clocks() is None

    @property
    def now_ns(self) -> int:
        """The ground's monotonic clock [ns]."""
        return self._now_ns()

    @property
    def wall_ns(self) -> int:
        """This computer's time since 1970 [ns]."""
        return self._wall_ns()

    def offset_ns(self) -> int:
        """Return the wall clock minus the monotonic clock [ns], by the quickest reading."""
        readings = []  # duration and offset of each reading
        for _ in range(_READING_COUNT):
            before_ns = self._now_ns()
            wall_ns = self._wall_ns()
            after_ns = self._now_ns()
            middle_ns = (before_ns + after_ns) // 2
            readings.append((after_ns - before_ns, wall_ns - middle_ns))
        _, offset_ns = min(readings)
        return offset_ns

    def ahead_s(self, vehicle: str) -> tuple[float, float] | None:
        """Return the time by which a vehicle's computer is ahead of this one.

        Args:
            vehicle: name of the vehicle.

        Returns:
            The difference and its largest error [s]; None while it is not measured, and for a
                computer that does not report its time.
        """
        clocks = self._clocks()
        if clocks is None:
            return None
        return clocks.world_ahead_s(vehicle, self._now_ns(), self.offset_ns())
