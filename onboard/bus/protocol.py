"""The interface of the bus, which the Zenoh session and the simulated bus both implement."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal, Protocol

from onboard.bus.codec import Malformed
from onboard.bus.schema import FaultOrder, Message, Order, OrderReply
from onboard.bus.topics import Topic

# Zenoh closes a connection that has been silent for this time. Over QUIC the time is longer
# (onboard/bus/zenoh_settings.py).
LEASE_MS = 1000
MAX_COLLECTED = 1000  # by default, most waiting messages of a collected topic

RefusalCode = Literal[
    "unsigned", "forged", "foreign", "role", "replayed", "late", "other start", "flood"
]


@dataclass(frozen=True, slots=True)
class UntrustedOrder:
    """An order with a signature that a fleet with keys rejects. It is counted and answered, not
    obeyed.

    During a flood of orders, none is answered. A ground that sent a genuine order then gets no
    reply, and sends land and kill directly to PX4.
    """

    code: RefusalCode  # for programs and for counts
    sentence: str  # for people
    order_id: str = ""  # empty if it could not be read

    @property
    def is_answered(self) -> bool:
        """Whether its sender gets a reply that refuses it."""
        return self.code != "flood"


class OrderSignatures(Protocol):
    """Signs the orders that a node sends, and verifies those that it receives."""

    def seal(self, key_expression: str, order: bytes) -> bytes:
        """Return the seal of an order: the bytes of its signature, which are sent beside the order.

        Args:
            key_expression: key of the bus to which the order is sent.
            order: bytes of the order.
        Returns:
            the seal; empty for a node that signs no orders.
        """

    def refusal(self, key_expression: str, order: bytes, seal: bytes) -> UntrustedOrder | None:
        """Verify an order that has just arrived.

        Args:
            key_expression: key of the bus at which the order arrived.
            order: bytes of the order.
            seal: bytes that were sent beside it; empty if there were none.
        Returns:
            what is wrong with the signature; None if it is valid.
        """


class NodeCredentials(Protocol):
    """Certificate and key of a node on a bus with keys, and the access that it grants to others.

    ``onboard/security/credentials.py`` makes them from files; the program that opens the bus passes
    them in.
    """

    @property
    def authority(self) -> str:
        """Path of the certificate of the fleet's certificate authority."""

    @property
    def certificate(self) -> str:
        """Path of the node's certificate; empty if it has none."""

    @property
    def key(self) -> str:
        """Path of the node's private key."""

    @property
    def access(self) -> dict[str, object]:
        """Zenoh's ``access_control``: the messages accepted from the holder of each certificate."""

    def order_signatures(self) -> OrderSignatures:
        """Return the object that signs this node's orders and verifies those that it receives."""


OnMessage = Callable[[Topic, str, Message | Malformed], None]
OnOrder = Callable[[Order | Malformed | UntrustedOrder, Callable[[OrderReply], None]], None]
OnFault = Callable[[FaultOrder | Malformed, Callable[[OrderReply], None]], None]
OnReply = Callable[[OrderReply | Malformed], None]
OnEnd = Callable[[], None]
OnAlive = Callable[[str, bool], None]


class BusError(RuntimeError):
    """The bus could not be opened: a sentence that says what failed, where, and what to do."""


class AddressAbsentError(BusError):
    """This computer does not have the address to listen at; its network may still come."""


class NoRouterError(BusError):
    """The fleet has routers, and none of them answers."""


class Bus(Protocol):
    """One node on the fleet's bus.

    Callbacks may run on a thread of the bus: they must only hand over to another thread, and must
    not call the bus. Only :meth:`deliver` runs callbacks on the caller's thread.
    """

    @property
    def node(self) -> str:
        """Return this node's name, which other nodes see while this node is on the bus."""

    @property
    def is_simulated(self) -> bool:
        """Whether time on this bus is simulated; then there are no other clocks to measure."""

    def start(self) -> None:
        """Open the bus and declare the liveliness token; a second call does nothing.

        Raises:
            BusError: an endpoint to listen at is taken or not valid.
        """

    def stop(self) -> None:
        """Leave the bus; a second call does nothing."""

    def publish(self, topic: Topic, name: str, message: Message) -> None:
        """Send a message on ``topic/name`` to the other nodes.

        This never blocks for topics with LATEST delivery.

        Args:
            topic: row of the table of topics, which also determines the delivery.
            name: vehicle, mocap body or node that the message is about.
            message: value of the topic's type.
        """

    def subscribe(self, topic: Topic, name: str, on_message: OnMessage) -> None:
        """Call back for each message, on a thread of the bus.

        Args:
            topic: row of the table of topics.
            name: one name, or ``*`` for all.
            on_message: called with topic, name and the message, or :class:`Malformed`.
        """

    def collect(
        self, topic: Topic, name: str, on_message: OnMessage, *, most: int = MAX_COLLECTED
    ) -> None:
        """Keep messages until :meth:`deliver` is called.

        This costs half as much as :meth:`subscribe`, because no thread wakes up for each message.

        Args:
            topic: row of the table of topics.
            name: one name, or ``*`` for all.
            on_message: called with topic, name and the message, or :class:`Malformed`.
            most: at most this many messages are kept: the newest.
        """

    def follow(self, topic: Topic, names: Iterable[str], on_message: OnMessage) -> None:
        """Collect a topic of exactly these names. Subscribe to new names, and drop all others.

        A publisher does not even send a message that no node follows. Each change of the names is
        sent to every peer, so do not change them in the control loop. Only one thread may call
        this.

        Args:
            topic: row of the table of topics.
            names: all names to follow from now on.
            on_message: called by :meth:`deliver` with topic, name and the message, or
                :class:`Malformed`.
        """

    def deliver(self) -> None:
        """Call back for everything collected or followed, on the caller's thread. Never blocks."""

    def serve_orders(self, vehicle: str, on_order: OnOrder) -> None:
        """Answer the orders for a vehicle.

        Args:
            vehicle: name of the vehicle.
            on_order: called on a thread of the bus. Its arguments are the order, or an object that
                says what is wrong with the order, and a function that sends the reply. That
                function must be called once, from another thread.
        """

    def serve_faults(self, on_fault: OnFault) -> None:
        """Answer the fault orders for the emulator.

        Args:
            on_fault: function like ``on_order`` of :meth:`serve_orders`.
        """

    def order(
        self, vehicle: str, order: Order, *, timeout_s: float, on_reply: OnReply, on_end: OnEnd
    ) -> None:
        """Send an order to one vehicle.

        Args:
            vehicle: name of the vehicle.
            order: the order.
            timeout_s: time [s] to wait for the reply.
            on_reply: called with the reply; not called if no reply comes.
            on_end: called last, in any case.
        """

    def fault(
        self, order: FaultOrder, *, timeout_s: float, on_reply: OnReply, on_end: OnEnd
    ) -> None:
        """Send a fault order to the emulator. Without an emulator, no reply comes.

        Args:
            order: the fault order.
            timeout_s: time [s] to wait for the reply.
            on_reply: called with the reply; not called if no reply comes.
            on_end: called last, in any case.
        """

    def claim(self, token: str) -> None:
        """Declare another liveliness token of this node, for a role.

        :mod:`onboard.bus.control_token` describes the roles.

        Args:
            token: name of the token; a second claim of the same token does nothing.
        """

    def release(self, token: str) -> None:
        """Withdraw a token of :meth:`claim`.

        Args:
            token: name of the token; a token that is not claimed is ignored.
        """

    def watch_alive(self, on_alive: OnAlive) -> None:
        """Call back for every name of a node or role that appears or vanishes.

        Args:
            on_alive: called with the name and whether a node has it; first for all names that are
                present already.
        """
