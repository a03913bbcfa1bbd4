"""The bus itself; the only file of the project that imports zenoh.

Explicit endpoints, no multicast and no gossip scouting: who is not named in the fleet file is not met. Callbacks run on
zenoh's threads and must only hand over (:meth:`asyncio.AbstractEventLoop.call_soon_threadsafe`); calling a session's
method from inside a callback can deadlock.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import zenoh

from onboard.bus.codec import Malformed, decode, encode
from onboard.bus.schema import FaultOrder, Message, Order, OrderReply
from onboard.bus.topics import TOPICS, Delivery, Topic, key, topic_and_name
from onboard.native_threads import keep_thread_state

LEASE_MS = 1000
# One thread for all of the network: by itself zenoh has one that is told of what has arrived and wakes up another that
# reads it, five in all, and to be woken costs more than to read. Read by zenoh when the first session opens.
_RUNTIMES = [f"{name}: (handover: net)" for name in ("rx", "tx", "acc", "app")] + ["net: (worker_threads: 1)"]
os.environ.setdefault("ZENOH_RUNTIME", f"({', '.join(_RUNTIMES)})")
RETRY = {"period_init_ms": 200, "period_max_ms": 500, "period_increase_factor": 1.5}

OnMessage = Callable[[Topic, str, Message | Malformed], None]
OnOrder = Callable[[Order | Malformed, Callable[[OrderReply], None]], None]
OnFault = Callable[[FaultOrder | Malformed, Callable[[OrderReply], None]], None]
OnAlive = Callable[[str, bool], None]
_Ring = tuple[Any, Callable[[Any], None]]  # a subscriber that keeps the newest samples, and who takes them
_MAX_NAMES = 1000
_MOST_FOLLOWED, _MOST_COLLECTED = 16, 1000  # samples that wait: of one name, of all
# What may block has a queue of its own: who waits in a queue for a peer that hangs holds up everybody else who puts
# into it, and the control loop puts what may be dropped.
_PATIENT = zenoh.Priority.INTERACTIVE_HIGH
_PATIENCE_US = 1_000_000  # then the connection to a peer that takes nothing is closed
FAULT = "fault"  # the one thing that an emulator is asked for


class BusError(RuntimeError):
    """The bus could not be opened: a sentence that says where and what to do."""


class BusSession:
    """One node on the fleet's bus.

    Args:
        namespace: key prefix, ``covey/<fleet name>``.
        node: this node's name; its liveliness token is ``alive/<node>``.
        listen: endpoints to listen at, for instance ``["tcp/127.0.0.1:7460"]``; empty for the ground.
        connect: endpoints of the others; retried for ever, so that the order of starting does not matter.
    """

    def __init__(self, *, namespace: str, node: str, listen: Sequence[str] = (), connect: Sequence[str] = ()) -> None:
        self.namespace = namespace
        self.node = node
        self._listen = list(listen)
        self._connect = [endpoint for endpoint in connect if endpoint not in self._listen]
        self._session: zenoh.Session | None = None
        self._publishers: dict[tuple[Topic, str], zenoh.Publisher] = {}
        self._followed: dict[tuple[Topic, str], _Ring] = {}
        self._collected: list[_Ring] = []
        self._rings: tuple[_Ring, ...] = ()
        self._claims: dict[str, Any] = {}
        self._kept: list[Any] = []  # subscribers, queryables and tokens live as long as somebody holds them

    def start(self) -> None:
        """Open the bus and declare the liveliness token; a second call does nothing.

        Raises:
            BusError: an endpoint to listen at is taken or not valid.
        """
        if self._session is not None:
            return
        config = zenoh.Config()
        for path, value in (
            ("mode", "peer"),
            ("listen/endpoints", self._listen),
            ("connect/endpoints", self._connect),
            ("connect/timeout_ms", -1),
            ("connect/exit_on_failure", False),
            ("connect/retry", RETRY),
            ("listen/exit_on_failure", True),
            ("listen/timeout_ms", 0),
            ("scouting/multicast/enabled", False),
            ("scouting/gossip/enabled", False),
            ("transport/link/tx/lease", LEASE_MS),
            ("transport/shared_memory/enabled", False),  # messages are small, and its threads and memory are not free
            # a peer that hangs fills its queue: who publishes drops at once instead of waiting in the control loop
            ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", 0),
            ("transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments", 0),
            ("transport/link/tx/queue/congestion_control/block/wait_before_close", _PATIENCE_US),
        ):
            config.insert_json5(path, json.dumps(value))
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            raise BusError(
                f"The bus cannot listen at {', '.join(self._listen) or 'no endpoint'} ({_reason(error)}). "
                "Is another agent or emulator of this fleet running? Stop it, or change the endpoint in the fleet file."
            ) from None
        token = self._session.liveliness().declare_token(key(self.namespace, Topic.ALIVE, self.node))
        self._kept.append(token)

    def stop(self) -> None:
        """Leave the bus; a second call does nothing."""
        session, self._session = self._session, None
        if session is not None:
            self._publishers.clear()
            self._followed.clear()
            self._collected.clear()
            self._rings = ()
            session.close()  # type: ignore[no-untyped-call]
            self._kept.clear()
            self._claims.clear()

    @property
    def _open(self) -> zenoh.Session:
        if self._session is None:
            raise BusError("The bus is not open: call start() first.")
        return self._session

    def publish(self, topic: Topic, name: str, message: Message) -> None:
        """Send ``message`` on ``topic/name`` to the other nodes; never blocks for LATEST topics."""
        publisher = self._publishers.get((topic, name))
        if publisher is None:
            latest = TOPICS[topic].delivery is Delivery.LATEST
            urgent = topic in (Topic.STATE, Topic.MOCAP)
            publisher = self._publishers[topic, name] = self._open.declare_publisher(
                key(self.namespace, topic, name),
                congestion_control=zenoh.CongestionControl.DROP if latest else zenoh.CongestionControl.BLOCK,
                priority=zenoh.Priority.REAL_TIME if urgent else zenoh.Priority.DATA if latest else _PATIENT,
                allowed_destination=zenoh.Locality.REMOTE,  # who subscribes to all vehicles pays nothing for itself
            )
        publisher.put(encode(message))

    def subscribe(self, topic: Topic, name: str, on_message: OnMessage) -> None:
        """Call ``on_message(topic, name, message)`` on a bus thread for each sample; ``name`` may be ``*``."""
        receive = self._receiver(topic, on_message, "" if name == "*" else name)
        self._kept.append(self._open.declare_subscriber(key(self.namespace, topic, name), _callback(receive)))

    def collect(self, topic: Topic, name: str, on_message: OnMessage, *, most: int = _MOST_COLLECTED) -> None:
        """Like :meth:`subscribe`, but what comes waits for :meth:`deliver`; of too much the newest is kept.

        Who looks at a regular time saves half of what a message costs: no thread has to wake up for it and to wait for
        Python's lock.
        """
        self._collected.append(self._ring(topic, name, on_message, most))
        self._rings = (*self._collected, *self._followed.values())

    def follow(self, topic: Topic, names: Iterable[str], on_message: OnMessage) -> None:
        """Collect ``topic`` of exactly these names: who is new is declared, who is no longer wanted is let go.

        What nobody follows is not sent at all: the publisher's own node knows who listens. Not for the control loop: to
        declare takes a message to every peer. Only one thread may call this.
        """
        wanted = {(topic, name) for name in names}
        gone = [self._followed.pop(pair) for pair in list(self._followed) if pair[0] is topic and pair not in wanted]
        for new in sorted(wanted - self._followed.keys()):
            self._followed[new] = self._ring(topic, new[1], on_message, _MOST_FOLLOWED)
        self._rings = (*self._collected, *self._followed.values())
        for subscriber, _ in gone:
            subscriber.undeclare()

    def deliver(self) -> None:
        """Hand over what :meth:`collect` and :meth:`follow` hold, on the caller's thread; never blocks."""
        for subscriber, receive in self._rings:
            try:
                while (sample := subscriber.try_recv()) is not None:
                    receive(sample)
            except zenoh.ZError:
                continue  # let go by another thread at this very moment

    def _ring(self, topic: Topic, name: str, on_message: OnMessage, most: int) -> _Ring:
        where = key(self.namespace, topic, name)
        subscriber = self._open.declare_subscriber(where, zenoh.handlers.RingChannel(most))
        return subscriber, self._receiver(topic, on_message, "" if name == "*" else name)

    def _receiver(self, topic: Topic, on_message: OnMessage, name: str = "") -> Callable[[zenoh.Sample], None]:
        kind = TOPICS[topic].message
        assert kind is not None, f"{topic} carries no message"
        if name:
            return lambda sample: on_message(topic, name, decode(sample.payload.to_bytes(), kind))
        names: dict[str, str] = {}  # to take keys apart costs more than to decode what they carry

        def receive(sample: zenoh.Sample) -> None:
            text = str(sample.key_expr)
            found = names.get(text)
            if found is None:
                parts = topic_and_name(self.namespace, text)
                if parts is None:
                    return
                found = parts[1]
                if len(names) < _MAX_NAMES:
                    names[text] = found
            on_message(topic, found, decode(sample.payload.to_bytes(), kind))

        return receive

    def serve_orders(self, vehicle: str, on_order: OnOrder) -> None:
        """Answer orders for ``vehicle``: ``on_order(order, reply)`` runs on a bus thread, reply once from any other."""
        self._serve(key(self.namespace, Topic.ORDER, vehicle), Order, on_order)

    def serve_faults(self, on_fault: OnFault) -> None:
        """Answer what is asked of the emulator, in the same way."""
        self._serve(key(self.namespace, Topic.SIM, FAULT), FaultOrder, on_fault)

    def _serve(self, own_key: str, kind: type[Any], on_query: Callable[..., None]) -> None:
        def receive(query: zenoh.Query) -> None:
            payload = query.payload.to_bytes() if query.payload is not None else b""

            def reply(answer: OrderReply) -> None:
                with query:
                    query.reply(own_key, encode(answer))

            on_query(decode(payload, kind), reply)

        self._kept.append(self._open.declare_queryable(own_key, _callback(receive), complete=True))

    def order(
        self,
        vehicle: str,
        order: Order,
        *,
        timeout_s: float,
        on_reply: Callable[[OrderReply | Malformed], None],
        on_end: Callable[[], None],
    ) -> None:
        """Ask one vehicle: ``on_reply`` with its answer, then ``on_end``; only ``on_end`` when nobody answered."""
        self._ask(key(self.namespace, Topic.ORDER, vehicle), order, timeout_s, on_reply, on_end)

    def fault(
        self,
        order: FaultOrder,
        *,
        timeout_s: float,
        on_reply: Callable[[OrderReply | Malformed], None],
        on_end: Callable[[], None],
    ) -> None:
        """Ask the emulator, in the same way; where there is none, nobody answers."""
        self._ask(key(self.namespace, Topic.SIM, FAULT), order, timeout_s, on_reply, on_end)

    def _ask(
        self,
        their_key: str,
        message: Message,
        timeout_s: float,
        on_reply: Callable[[OrderReply | Malformed], None],
        on_end: Callable[[], None],
    ) -> None:
        def receive(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                on_reply(decode(reply.ok.payload.to_bytes(), OrderReply))
            elif reply.err is not None:
                on_reply(Malformed("error reply", 0))

        self._open.get(
            their_key,
            _callback(receive, on_end),
            payload=encode(message),
            timeout=timeout_s,
            consolidation=zenoh.ConsolidationMode.NONE,
            priority=_PATIENT,
        )

    def claim(self, token: str) -> None:
        """Be seen under another name too, as long as this node lives: a role, see :mod:`onboard.bus.authority`."""
        if token not in self._claims:
            self._claims[token] = self._open.liveliness().declare_token(key(self.namespace, Topic.ALIVE, token))

    def release(self, token: str) -> None:
        """Give up such a name."""
        claim = self._claims.pop(token, None)
        if claim is not None:
            claim.undeclare()

    def watch_alive(self, on_alive: OnAlive) -> None:
        """Call ``on_alive(node, is_alive)`` for every node of the fleet, those already there included."""

        def receive(sample: zenoh.Sample) -> None:
            found = topic_and_name(self.namespace, str(sample.key_expr))
            if found is not None:
                on_alive(found[1], sample.kind == zenoh.SampleKind.PUT)

        self._kept.append(
            self._open.liveliness().declare_subscriber(
                key(self.namespace, Topic.ALIVE, "*"), _callback(receive), history=True
            )
        )


def _reason(error: zenoh.ZError) -> str:
    text = str(error)
    return "the address is in use" if "in use" in text else text.split(" at /")[0]


def _callback(function: Callable[[Any], None], on_end: Callable[[], None] | None = None) -> Any:
    """A handler on zenoh's own network thread, without a Python thread for each subscriber and each question."""

    def call(value: Any) -> None:
        keep_thread_state()
        function(value)

    return zenoh.handlers.Callback(call, drop=on_end, indirect=False)
