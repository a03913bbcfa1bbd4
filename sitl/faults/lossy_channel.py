"""One direction of a link with its faults: loss, delay, duplication and a changed order.

A channel carries datagrams, or calls in lockstep. Without a fault a load arrives at once. The
channel is pure and seeded.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

Load = TypeVar("Load")
# A link with more loads in transit loses the newest, as a full buffer does.
_MAX_IN_TRANSIT = 10_000
_TIME_TOLERANCE_S = 1e-9  # times that differ by less count as equal


@dataclass(frozen=True, slots=True)
class ChannelFaults:
    """Loss, delay, duplication and reordering of one direction of a link."""

    loss: float = 0.0  # share of the loads that never arrive
    delay_s: float = 0.0  # delay of all loads
    jitter_s: float = 0.0  # largest additional delay, uniformly distributed; the order is kept
    duplicate: float = 0.0  # share of the loads that arrive twice
    reorder: float = 0.0  # share of the loads that arrive later by `reorder_s`
    reorder_s: float = 0.02  # loads sent within this time overtake a reordered one


NO_FAULTS = ChannelFaults()


class LossyChannel(Generic[Load]):
    """One direction of one link.

    Args:
        seed: seed of the random numbers; it should differ between channels.

    Attributes:
        faults: present faults.
        is_held: whether the channel delivers nothing at present.
    """

    def __init__(self, seed: int | list[int] = 0) -> None:
        self._rng = np.random.default_rng(seed)
        self.faults = NO_FAULTS
        self.is_held = False
        # Heap of arrival time, number and load. The number orders loads with the same time.
        self._in_transit: list[tuple[float, int, Load]] = []
        self._count = 0
        self._newest_s = -math.inf  # latest arrival of a load that keeps the order

    @property
    def is_clear(self) -> bool:
        """Whether loads arrive at once, and none is in transit."""
        return self.faults is NO_FAULTS and not self._in_transit and not self.is_held

    def push(self, now_s: float, load: Load) -> None:
        """Send a load, which :meth:`pop` returns at its arrival."""
        faults = self.faults
        if self._happens(faults.loss):
            return

        copies = 1
        if self._happens(faults.duplicate):
            copies = 2
        for _ in range(copies):
            if len(self._in_transit) >= _MAX_IN_TRANSIT:
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
        """Return whether a fault with this share happens; a share of 0 draws no random number."""
        return share > 0.0 and self._rng.random() < share

    def pop(self, now_s: float) -> list[Load]:
        """Return the loads that have arrived, in order of arrival; none while held."""
        if self.is_held:
            return []

        arrived: list[Load] = []
        while self._in_transit:
            arrival_s, _, load = self._in_transit[0]
            if arrival_s > now_s + _TIME_TOLERANCE_S:
                break
            heapq.heappop(self._in_transit)
            arrived.append(load)
        return arrived
