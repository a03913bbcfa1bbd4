"""The bus as the ground uses it: :class:`onboard.bus.session.BusSession`, or one in simulated time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from groundstation.fleet.tick_stream import Follows
from onboard.bus.codec import Malformed
from onboard.bus.schema import FaultOrder, Order, OrderReply
from onboard.bus.session import OnAlive, OnMessage
from onboard.bus.topics import Topic


class Bus(Follows, Protocol):
    """What the client needs of :class:`onboard.bus.session.BusSession`."""

    @property
    def node(self) -> str: ...
    def start(self) -> None: ...
    def stop(self) -> None: ...
    def subscribe(self, topic: Topic, name: str, on_message: OnMessage) -> None: ...
    def watch_alive(self, on_alive: OnAlive) -> None: ...
    def claim(self, token: str) -> None: ...
    def release(self, token: str) -> None: ...
    def order(
        self,
        vehicle: str,
        order: Order,
        *,
        timeout_s: float,
        on_reply: Callable[[OrderReply | Malformed], None],
        on_end: Callable[[], None],
    ) -> None: ...
    def fault(
        self,
        order: FaultOrder,
        *,
        timeout_s: float,
        on_reply: Callable[[OrderReply | Malformed], None],
        on_end: Callable[[], None],
    ) -> None: ...
