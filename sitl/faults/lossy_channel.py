"""One direction of a link with its faults: what goes in is lost, late, twice or in another order.

Anything can travel: a datagram, or in lockstep a call. Without a fault what goes in comes out at
once. The channel is pure and seeded.
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
        seed: seed of the losses; give each wire its own.

    Attributes:
        faults: those of now.
        is_held: nothing comes out.
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
        faults = self.faults
        if self._happens(faults.loss):
            return

        copies = 1
        if self._happens(faults.duplicate):
            copies = 2
        for _ in range(copies):
            if len(self._in_transit) >= _MOST_IN_TRANSIT:
                return

            jitter_s = 0.0
            if faults.jitter_s > 0.0:
                jitter_s = faults.jitter_s * float(self._rng.random())
            arrival_s = now_s + (faults.delay_s + jitter_s)

            if self._happens(faults.reorder):
                arrival_s += faults.reorder_s
            else:
                if faults.jitter_s > 0.0:  # the order is kept
                    arrival_s = max(arrival_s, self._newest_s)
                self._newest_s = arrival_s

            self._count += 1
            heapq.heappush(self._in_transit, (arrival_s, self._count, load))

    def _happens(self, share: float) -> bool:
        """Whether chance chooses the next; it is not asked where the share is 0."""
        return share > 0.0 and self._rng.random() < share

    def pop(self, now_s: float) -> list[Load]:
        """Return what arrives up to now, in order of arrival; nothing while the channel is held."""
        if self.is_held:
            return []

        arrived: list[Load] = []
        while self._in_transit and self._in_transit[0][0] <= now_s + 1e-9:
            _, _, load = heapq.heappop(self._in_transit)
            arrived.append(load)
        return arrived
