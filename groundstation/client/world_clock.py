"""The world's clock at this ground, compared with that of the vehicles' computers.

Flights run by monotonic clocks, which nobody sets. A start at a time of day needs the world's clock
once: it becomes an instant of the monotonic clock. Whether this computer has the right time cannot
be known here; what can be known is whether all computers of the fleet have the same one.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from onboard.bus.clock_offsets import Clocks

_READINGS = 3  # of both clocks: between two readings this process may have to wait


class WorldClock:
    """Reads the world's clock, and those of other computers.

    Args:
        clocks: returns the clocks of the other nodes; None in simulated time.
        now_ns: the ground's monotonic clock [ns].
        world_ns: this computer's time since 1970 [ns].
    """

    def __init__(
        self,
        clocks: Callable[[], Clocks | None],
        now_ns: Callable[[], int],
        world_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._clocks = clocks
        self._now_ns = now_ns
        self._world_ns = world_ns

    @property
    def is_simulated(self) -> bool:
        """Whether time is simulated: the world's clock has no meaning then."""
        return self._clocks() is None

    @property
    def now_ns(self) -> int:
        """The ground's monotonic clock [ns]."""
        return self._now_ns()

    @property
    def world_ns(self) -> int:
        """This computer's time since 1970 [ns]."""
        return self._world_ns()

    def offset_ns(self) -> int:
        """Return the world's clock minus the monotonic one [ns], by the quickest of readings."""
        readings = []
        for _ in range(_READINGS):
            before_ns = self._now_ns()
            world_ns = self._world_ns()
            after_ns = self._now_ns()
            readings.append((after_ns - before_ns, world_ns - (before_ns + after_ns) // 2))
        return min(readings)[1]

    def ahead_s(self, vehicle: str) -> tuple[float, float] | None:
        """Return by how much a vehicle's computer is ahead of this one, and the error of that [s].

        Args:
            vehicle: name of the vehicle.

        Returns:
            None while it is not measured, and for a computer that does not tell it.
        """
        clocks = self._clocks()
        if clocks is None:
            return None
        return clocks.world_ahead_s(vehicle, self._now_ns(), self.offset_ns())
