"""Ticks of one vehicle's pipeline, while its page is open; the other vehicles send none."""

from __future__ import annotations

from collections import deque
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol

from onboard.bus.codec import Malformed
from onboard.bus.protocol import Bus
from onboard.bus.schema import Message, TickBatch, TickSample
from onboard.bus.topics import Topic

KEPT = 1500  # half a minute of a 50 Hz loop


class TickStream(Protocol):
    """Ticks of the followed vehicle, live or from a record."""

    values: deque[TickSample]  # newest last

    def follow(self, vehicle: str | None) -> None:
        """Keep the ticks of this vehicle from now on; None: keep no ticks."""


class BusTickStream:
    """Ticks over the bus.

    A change of the followed vehicle is declared on the bus, which may have to wait for other nodes.
    So a thread of its own declares it.

    Args:
        bus: bus, which must be open before :meth:`follow` is called.
    """

    def __init__(self, bus: Bus) -> None:
        self.values: deque[TickSample] = deque(maxlen=KEPT)
        self._bus = bus
        self._vehicle: str | None = None
        self._declarer: ThreadPoolExecutor | None = None

    def follow(self, vehicle: str | None) -> None:
        """Keep the ticks of this vehicle from now on; None: keep no ticks."""
        if vehicle == self._vehicle:
            return

        self._vehicle = vehicle
        self.values.clear()

        names: tuple[str, ...] = ()
        if vehicle is not None:
            names = (vehicle,)
        if self._declarer is None:
            self._declarer = ThreadPoolExecutor(1, "tick-stream")
        self._declarer.submit(self._bus.follow, Topic.TICK, names, self._receive)

    def stop(self) -> None:
        """End the thread; the followed vehicle no longer changes."""
        if self._declarer is not None:
            self._declarer.shutdown(wait=False, cancel_futures=True)
            self._declarer = None

    def _receive(self, topic: Topic, name: str, message: Message | Malformed) -> None:
        if isinstance(message, TickBatch) and name == message.vehicle == self._vehicle:
            self.values.extend(message.ticks)
