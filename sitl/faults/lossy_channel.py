"""One direction of a link with its faults: what goes in comes out lost, late, twice or in another
order. Pure, seeded.

Anything can travel: a datagram, or in lockstep a call. Without a fault what goes in comes out at
once.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

Load = TypeVar("Load")
# a link that is slower than what is sent loses the newest, as a full buffer does
_MOST_IN_TRANSIT = 10_000


@dataclass(frozen=True, slots=True)
class ChannelFaults:
    """Delay, loss and duplication of one direction of a link."""

    loss: float = 0.0  # share that never arrives
    delay_s: float = 0.0  # of everything
    jitter_s: float = 0.0  # at most so much more delay, uniform; the order is kept
    duplicate: float = 0.0  # share that arrives twice
    reorder: float = 0.0  # share that is overtaken by what is sent in the next `reorder_s`
    reorder_s: float = 0.02


NO_FAULTS = ChannelFaults()


class LossyChannel(Generic[Load]):
    """One direction of one link.

    Args:
        seed: of chance; give each wire its own.
    """

    def __init__(self, seed: int | list[int] = 0) -> None:
        self._rng = np.random.default_rng(seed)
        self.faults = NO_FAULTS
        self.is_held = False
        self._in_transit: list[tuple[float, int, Load]] = []
        self._count = 0
        self._newest_s = -math.inf

    @property
    def is_clear(self) -> bool:
        """Whether what goes in comes out at once, and nothing is on the way."""
        return self.faults is NO_FAULTS and not self._in_transit and not self.is_held

    def push(self, now_s: float, load: Load) -> None:
        """Send; :meth:`pop` gives it out when it arrives."""
        f = self.faults
        if f.loss > 0.0 and self._rng.random() < f.loss:
            return
        copies = 2 if f.duplicate > 0.0 and self._rng.random() < f.duplicate else 1
        for _ in range(copies):
            if len(self._in_transit) >= _MOST_IN_TRANSIT:
                return
            late_s = f.delay_s + (
                f.jitter_s * float(self._rng.random()) if f.jitter_s > 0.0 else 0.0
            )
            arrival_s = now_s + late_s
            if f.reorder > 0.0 and self._rng.random() < f.reorder:
                arrival_s += f.reorder_s
            else:
                arrival_s = self._newest_s = max(
                    arrival_s, self._newest_s if f.jitter_s > 0.0 else -math.inf
                )
            self._count += 1
            heapq.heappush(self._in_transit, (arrival_s, self._count, load))

    def pop(self, now_s: float) -> list[Load]:
        """Return the items that arrive up to now, in order of arrival; nothing while the channel is
        held.
        """
        out: list[Load] = []
        while not self.is_held and self._in_transit and self._in_transit[0][0] <= now_s + 1e-9:
            out.append(heapq.heappop(self._in_transit)[2])
        return out
