"""The bus over Zenoh; the only file of the project that imports zenoh.

Callbacks run on zenoh's threads. They must only hand their message over to another thread
(:meth:`asyncio.AbstractEventLoop.call_soon_threadsafe`), because calling a session's method inside
a callback can deadlock.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import secrets
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import zenoh

from onboard.bus.codec import Malformed, decode, encode
from onboard.bus.presence import Presence
from onboard.bus.protocol import (
    MAX_COLLECTED,
    AddressAbsentError,
    BusError,
    NodeCredentials,
    NoRouterError,
    OnAlive,
    OnEnd,
    OnFault,
    OnMessage,
    OnOrder,
    OnReply,
    OrderSignatures,
    UntrustedOrder,
)
from onboard.bus.schema import FaultOrder, Message, Order, OrderReply
from onboard.bus.sockets import PromptSockets
from onboard.bus.topics import TOPICS, Delivery, Topic, key, topic_and_name
from onboard.bus.zenoh_settings import Setting, of_client, of_node
from onboard.native_threads import keep_thread_state

# One thread does all network work, because zenoh's other runtimes hand their work over to `net`.
# With a thread for each runtime, every message would wake up another thread. Zenoh reads the
# variable ZENOH_RUNTIME when the first session opens.
_RUNTIMES = (
    "rx: (handover: net)",
    "tx: (handover: net)",
    "acc: (handover: net)",
    "app: (handover: net)",
    "net: (worker_threads: 1)",
)
os.environ.setdefault("ZENOH_RUNTIME", f"({', '.join(_RUNTIMES)})")

_MAX_NAMES = 1000  # number of names of one topic that are cached by key
_MAX_FOLLOWED = 16  # at most this many samples of a followed name wait for delivery
# words of zenoh's errors about an address that this computer does not have, or not yet
_NO_ADDRESS = (f"(os error {errno.EADDRNOTAVAIL})", "failed to lookup address")
_FAULT_NAME = "fault"  # last part of the key for fault orders
_EVERY_NAME = "*"

# Priority of messages whose sender may block. Zenoh has a queue for each priority. So if a peer
# hangs, such a message to it does not hold up the control loop's messages.
_BLOCKING_PRIORITY = zenoh.Priority.INTERACTIVE_HIGH

# Topics with the highest priority on a link.
_URGENT = (Topic.STATE, Topic.MOCAP)

# Topics with the lowest priority. A saturated radio drops them first.
_LAST = (Topic.CORRECTIONS, Topic.LOG_PIECES)

# Topics with messages that fit into one datagram. Over QUIC, a larger message would not arrive in a
# datagram, so all other topics, such as ticks and preflight reports, are sent in streams. In a
# stream, too, a publisher with LATEST delivery drops a message if it would have to wait.
_IN_DATAGRAMS = (Topic.STATE, Topic.FAR, Topic.MOCAP, Topic.ALL_POSES, Topic.TRUTH)


class _Collector(NamedTuple):
    """A subscriber whose samples wait until they are delivered."""

    subscriber: Any  # keeps the newest samples
    receive: Callable[[Any], None]  # called for each sample
    most: int  # number of samples that it keeps


class BusSession:
    """One node on the fleet's bus, as :class:`onboard.bus.protocol.Bus` describes.

    Args:
        namespace: key prefix, ``covey/<fleet name>``.
        node: this node's name; its liveliness token is ``alive/<node>/<number>``, with a random
            number.
        listen: endpoints to listen at, for instance ``["tcp/127.0.0.1:7460"]``; empty for the
            ground.
        connect: endpoints of the others; retried forever, so that nodes may start in any order.
        credentials: credentials of this node, for ``quic/`` and ``tls/``; None for a bus without
            keys.
        routers: endpoints of the fleet's routers; if there are any, the node connects only to one
            of them, and listens nowhere.
        router_timeout_s: time for which :meth:`start` looks for a router.
    """

    is_simulated = False

    def __init__(
        self,
        *,
        namespace: str,
        node: str,
        listen: Sequence[str] = (),
        connect: Sequence[str] = (),
        credentials: NodeCredentials | None = None,
        routers: Sequence[str] = (),
        router_timeout_s: float = 10.0,
    ) -> None:
        self.namespace = namespace
        self.node = node

        self._listen = list(listen)
        self._connect = [endpoint for endpoint in connect if endpoint not in self._listen]
        self._routers = tuple(routers)
        self._router_timeout_s = router_timeout_s

        self._credentials = credentials
        self._signatures: OrderSignatures | None = None
        if credentials is not None:
            self._signatures = credentials.order_signatures()

        self._session: zenoh.Session | None = None
        self._sockets = PromptSockets()
        self._instance = secrets.token_hex(4)  # distinguishes two nodes with the same name
        self._token: Any = None  # liveliness token of the node, while the bus is open

        self._publishers: dict[tuple[Topic, str], zenoh.Publisher] = {}
        self._followed: dict[tuple[Topic, str], _Collector] = {}
        self._collected: list[_Collector] = []
        self._collectors: tuple[_Collector, ...] = ()  # followed and collected, for :meth:`deliver`
        self._claims: dict[str, Any] = {}  # further liveliness tokens of this node, by their names

        # subscribers and queryables; zenoh ends them once nothing refers to them
        self._declared: list[Any] = []

    def start(self) -> None:
        """Open the bus and declare the liveliness token; a second call does nothing.

        Raises:
            BusError: an endpoint to listen at is taken or not valid, or no router answers.
        """
        if self._session is not None:
            return
        self._session = self._open_session()
        self._sockets.start()
        self._token = self._declare_token(self.node)

    def _open_session(self) -> zenoh.Session:
        if self._routers:
            return open_zenoh(of_client(self._routers, self._router_timeout_s, self._credentials))
        return open_zenoh(of_node(self._listen, self._connect, self._credentials))

    def stop(self) -> None:
        """Leave the bus; a second call does nothing."""
        session = self._session
        if session is None:
            return
        self._session = None

        self._publishers.clear()
        self._followed.clear()
        self._collected.clear()
        self._collectors = ()

        # Over QUIC, `close` waits for attempts to reach absent nodes. So the tokens are withdrawn
        # first, and the others learn at once that this node leaves.
        for token in (self._token, *self._claims.values()):
            token.undeclare()
        self._claims.clear()

        self._sockets.stop()
        session.close()  # type: ignore[no-untyped-call]

        self._declared.clear()

    @property
    def _open(self) -> zenoh.Session:
        if self._session is None:
            raise BusError("The bus is not open: call start() first.")
        return self._session

    def publish(self, topic: Topic, name: str, message: Message) -> None:
        """Send ``message`` on ``topic/name`` to the other nodes; never blocks for LATEST topics."""
        publisher = self._publishers.get((topic, name))
        if publisher is None:
            publisher = self._declare_publisher(topic, name)
            self._publishers[topic, name] = publisher
        publisher.put(encode(message))

    def _declare_publisher(self, topic: Topic, name: str) -> zenoh.Publisher:
        """Return a publisher with the delivery of its topic."""
        if TOPICS[topic].delivery is Delivery.LATEST:
            congestion_control = zenoh.CongestionControl.DROP
            priority = zenoh.Priority.DATA
        else:
            congestion_control = zenoh.CongestionControl.BLOCK
            priority = _BLOCKING_PRIORITY

        if topic in _URGENT:
            priority = zenoh.Priority.REAL_TIME
        elif topic in _LAST:
            priority = zenoh.Priority.BACKGROUND

        reliability = zenoh.Reliability.RELIABLE
        if topic in _IN_DATAGRAMS:
            reliability = zenoh.Reliability.BEST_EFFORT

        return self._open.declare_publisher(
            key(self.namespace, topic, name),
            congestion_control=congestion_control,
            reliability=reliability,
            priority=priority,
            # a node that subscribes to all names must not receive its own messages
            allowed_destination=zenoh.Locality.REMOTE,
        )

    def subscribe(self, topic: Topic, name: str, on_message: OnMessage) -> None:
        """Call ``on_message(topic, name, message)`` on a bus thread for each sample.

        ``name`` may be ``*``.
        """
        receive = self._receiver(topic, name, on_message)
        self._declared.append(
            self._open.declare_subscriber(key(self.namespace, topic, name), _callback(receive))
        )

    def collect(
        self, topic: Topic, name: str, on_message: OnMessage, *, most: int = MAX_COLLECTED
    ) -> None:
        """Keep messages, at most the newest ``most``, until :meth:`deliver`."""
        self._collected.append(self._collector(topic, name, on_message, most))
        self._collectors = (*self._collected, *self._followed.values())

    def follow(self, topic: Topic, names: Iterable[str], on_message: OnMessage) -> None:
        """Collect ``topic`` of exactly these names.

        Publishers learn of each change, and do not send what no node follows.
        """
        followed = {(topic, name) for name in names}

        dropped: list[_Collector] = []
        for followed_topic, name in list(self._followed):
            pair = (followed_topic, name)
            if followed_topic is topic and pair not in followed:
                dropped.append(self._followed.pop(pair))

        for pair in sorted(followed - self._followed.keys()):
            _, name = pair
            self._followed[pair] = self._collector(topic, name, on_message, _MAX_FOLLOWED)

        # replace the collectors before undeclaring the dropped ones, because another thread may
        # call `deliver`
        self._collectors = (*self._collected, *self._followed.values())

        for collector in dropped:
            collector.subscriber.undeclare()

    def deliver(self) -> None:
        """Call back for everything collected or followed, on the caller's thread; never blocks."""
        for collector in self._collectors:
            # No more than can wait at once: a sender that is faster than this loop would keep the
            # caller here for ever.
            with contextlib.suppress(zenoh.ZError):  # another thread is just undeclaring it
                for _ in range(collector.most):
                    sample = collector.subscriber.try_recv()
                    if sample is None:
                        break
                    collector.receive(sample)

    def _collector(self, topic: Topic, name: str, on_message: OnMessage, most: int) -> _Collector:
        key_expression = key(self.namespace, topic, name)
        subscriber = self._open.declare_subscriber(key_expression, zenoh.handlers.RingChannel(most))
        return _Collector(subscriber, self._receiver(topic, name, on_message), most)

    def _receiver(
        self, topic: Topic, name: str, on_message: OnMessage
    ) -> Callable[[zenoh.Sample], None]:
        """Return a function that decodes a sample and calls back, for one name or for all."""
        kind = TOPICS[topic].message
        assert kind is not None, f"{topic} carries no message"

        def receive_of_one_name(sample: zenoh.Sample) -> None:
            on_message(topic, name, decode(sample.payload.to_bytes(), kind))

        if name != _EVERY_NAME:
            return receive_of_one_name

        # key expression -> name: parsing a key costs more than decoding its message
        names: dict[str, str] = {}

        def receive(sample: zenoh.Sample) -> None:
            key_expression = str(sample.key_expr)
            sender = names.get(key_expression)
            if sender is None:
                parts = topic_and_name(self.namespace, key_expression)
                if parts is None:
                    return
                _, sender = parts
                if len(names) < _MAX_NAMES:
                    names[key_expression] = sender
            on_message(topic, sender, decode(sample.payload.to_bytes(), kind))

        return receive

    def serve_orders(self, vehicle: str, on_order: OnOrder) -> None:
        """Answer orders for ``vehicle``.

        ``on_order(order, reply)`` runs on a bus thread; call ``reply`` on another thread.
        """
        self._serve(key(self.namespace, Topic.ORDER, vehicle), Order, on_order, self._signatures)

    def serve_faults(self, on_fault: OnFault) -> None:
        """Answer fault orders for the emulator, like :meth:`serve_orders`."""
        self._serve(key(self.namespace, Topic.SIM, _FAULT_NAME), FaultOrder, on_fault)

    def _serve(
        self,
        own_key: str,
        kind: type[Any],
        on_query: Callable[..., None],
        signatures: OrderSignatures | None = None,
    ) -> None:
        """Answer queries of one kind; with ``signatures``, each query needs a valid signature."""

        def receive(query: zenoh.Query) -> None:
            payload = _bytes_of(query.payload)

            def reply(answer: OrderReply) -> None:
                with query:
                    query.reply(own_key, encode(answer))

            untrusted: UntrustedOrder | None = None
            if signatures is not None:
                untrusted = signatures.refusal(own_key, payload, _bytes_of(query.attachment))
            if untrusted is not None:
                on_query(untrusted, reply)
            else:
                on_query(decode(payload, kind), reply)

        self._declared.append(
            self._open.declare_queryable(own_key, _callback(receive), complete=True)
        )

    def order(
        self, vehicle: str, order: Order, *, timeout_s: float, on_reply: OnReply, on_end: OnEnd
    ) -> None:
        """Send an order to one vehicle.

        ``on_reply`` is called with the reply, then ``on_end``. Without a reply, only ``on_end`` is
        called.
        """
        their_key = key(self.namespace, Topic.ORDER, vehicle)
        self._query(their_key, order, timeout_s, on_reply, on_end, self._signatures)

    def fault(
        self, order: FaultOrder, *, timeout_s: float, on_reply: OnReply, on_end: OnEnd
    ) -> None:
        """Send a fault order to the emulator, like :meth:`order`."""
        self._query(key(self.namespace, Topic.SIM, _FAULT_NAME), order, timeout_s, on_reply, on_end)

    def _query(
        self,
        their_key: str,
        message: Message,
        timeout_s: float,
        on_reply: OnReply,
        on_end: OnEnd,
        signatures: OrderSignatures | None = None,
    ) -> None:
        """Send a query; with ``signatures``, its signature is sent beside it."""
        payload = encode(message)
        seal: bytes | None = None
        if signatures is not None:
            seal = signatures.seal(their_key, payload)

        def receive(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                on_reply(decode(reply.ok.payload.to_bytes(), OrderReply))
            elif reply.err is not None:
                on_reply(Malformed("error reply", 0))

        self._open.get(
            their_key,
            _callback(receive, on_end),
            payload=payload,
            attachment=seal,
            timeout=timeout_s,
            consolidation=zenoh.ConsolidationMode.NONE,
            priority=_BLOCKING_PRIORITY,
        )

    def claim(self, token: str) -> None:
        """Declare another liveliness token of this node, unless it is claimed already."""
        if token not in self._claims:
            self._claims[token] = self._declare_token(token)

    def release(self, token: str) -> None:
        """Withdraw a token of :meth:`claim`."""
        claim = self._claims.pop(token, None)
        if claim is not None:
            claim.undeclare()

    def watch_alive(self, on_alive: OnAlive) -> None:
        """Call ``on_alive(name, is_alive)`` for every name on the bus.

        The names that are present already are reported first.
        """
        presence = Presence(on_alive)
        prefix = key(self.namespace, Topic.ALIVE, "")

        def receive(sample: zenoh.Sample) -> None:
            token = str(sample.key_expr).removeprefix(prefix)
            presence.see(token, sample.kind == zenoh.SampleKind.PUT)

        self._declared.append(
            self._open.liveliness().declare_subscriber(
                f"{prefix}**", _callback(receive), history=True
            )
        )

    def _declare_token(self, name: str) -> Any:
        """Declare a liveliness token of this node.

        Nodes with the same name declare different tokens. A common token would vanish when the
        first of these nodes leaves.
        """
        return self._open.liveliness().declare_token(
            key(self.namespace, Topic.ALIVE, f"{name}/{self._instance}")
        )


def open_zenoh(settings: Iterable[Setting]) -> zenoh.Session:
    """Open a session of zenoh.

    Args:
        settings: settings from :mod:`onboard.bus.zenoh_settings`.
    Raises:
        BusError: an endpoint to listen at is taken or not valid, this computer does not have its
            address, or no router answers.
    """
    by_path = dict(settings)
    config = zenoh.Config()
    for path, value in by_path.items():
        config.insert_json5(path, json.dumps(value))

    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        if by_path["mode"] == "client":
            raise NoRouterError(
                f"No router of this fleet answers at {_listed(by_path['connect/endpoints'])}. "
                "Start one with covey router, or correct [fleet] routers; with keys, both ends "
                "need those of one authority (covey keys list)."
            ) from None

        refused = (
            f"The bus cannot listen at {_listed(by_path['listen/endpoints'])} ({_reason(error)})."
        )
        if any(words in str(error) for words in _NO_ADDRESS):
            raise AddressAbsentError(
                f"{refused} No network interface of this computer has this address: connect the "
                "network, or change the endpoint in the fleet file."
            ) from None
        raise BusError(
            f"{refused} Another agent or emulator, perhaps of another fleet, may be running: stop "
            "it, or change the endpoint in the fleet file. The simulator's is one port below the "
            "lowest of the agents, unless fleet.simulator names it."
        ) from None


def _listed(endpoints: Sequence[str]) -> str:
    """Return endpoints as words for a sentence, as the fleet file writes them."""
    shown = []
    for endpoint in endpoints:
        without_options, _, _ = endpoint.partition("?")
        shown.append(without_options)
    if not shown:
        return "no endpoint"
    return ", ".join(shown)


def _reason(error: zenoh.ZError) -> str:
    """Return the reason of a zenoh error, without its line in zenoh's source."""
    text = str(error)
    if "in use" in text:
        return "the address is in use"
    return text.split(" at /")[0]


def _bytes_of(payload: zenoh.ZBytes | None) -> bytes:
    if payload is None:
        return b""
    return payload.to_bytes()


def _callback(function: Callable[[Any], None], on_end: Callable[[], None] | None = None) -> Any:
    """Return a handler that zenoh calls on its own network thread.

    Otherwise there would be a Python thread for each subscriber and each query.
    """

    def call(value: Any) -> None:
        keep_thread_state()
        function(value)

    return zenoh.handlers.Callback(call, drop=on_end, indirect=False)
