"""The pipeline's values of one vehicle at a time, while somebody looks at them: nothing is sent for the others."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol

from onboard.bus.codec import Malformed
from onboard.bus.schema import Message, TickBatch, TickSample
from onboard.bus.topics import Topic

KEPT = 1500  # half a minute of a 50 Hz loop


class Ticks(Protocol):
    """Where the vehicle page finds them: a live fleet's or a record's."""

    values: deque[TickSample]

    def follow(self, vehicle: str | None) -> None:
        """Keep this vehicle's values from now on, newest last; None: nobody's."""


class Follows(Protocol):
    """What is needed of the bus."""

    def follow(
        self, topic: Topic, names: Iterable[str], on_message: Callable[[Topic, str, Message | Malformed], None]
    ) -> None: ...


class BusTicks:
    """Heard over the bus. To declare an interest may wait for peers, so it is done beside the event loop, in order."""

    def __init__(self, bus: Follows) -> None:
        self.values: deque[TickSample] = deque(maxlen=KEPT)
        self._bus = bus
        self._vehicle: str | None = None
        self._declarer: ThreadPoolExecutor | None = None

    def follow(self, vehicle: str | None) -> None:
        """Keep this vehicle's values from now on, newest last; None: nobody's."""
        if vehicle == self._vehicle:
            return
        self._vehicle = vehicle
        self.values.clear()
        if self._declarer is None:
            self._declarer = ThreadPoolExecutor(1, "ticks")
        self._declarer.submit(self._bus.follow, Topic.TICK, () if vehicle is None else (vehicle,), self._receive)

    def stop(self) -> None:
        """No more interest is declared."""
        if self._declarer is not None:
            self._declarer.shutdown(wait=False, cancel_futures=True)
            self._declarer = None

    def _receive(self, topic: Topic, name: str, message: Message | Malformed) -> None:
        if isinstance(message, TickBatch) and name == message.vehicle == self._vehicle:
            self.values.extend(message.ticks)
