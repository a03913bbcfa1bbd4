"""The bus in simulated time: pairs of nodes delay, lose, reorder and double messages. Seeded.

What the real one promises holds here too. Topics whose newest message matters lose messages;
events, orders and answers travel on a connection, so what is lost is sent again and comes later,
and in order. A pair of nodes that is cut apart notices after the lease; what was on its way until
then arrives when the cut is healed in time, otherwise never.

Everything is a call with a time at which it is due, in one queue. Where nothing can happen to a
message, one call serves all its receivers.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from heapq import heappop, heappush
from typing import Any

import numpy as np

from onboard.bus.protocol import (
    LEASE_MS,
    MAX_COLLECTED,
    OnAlive,
    OnEnd,
    OnFault,
    OnMessage,
    OnOrder,
    OnReply,
)
from onboard.bus.schema import FaultOrder, Message, Order, OrderReply
from onboard.bus.topics import TOPICS, Delivery, Topic
from onboard.config.fleet import RadioConfig
from sitl.lockstep.channel import Channel
from sitl.lockstep.connections import BusSettings, Losses, Pair

_LEASE_NS = LEASE_MS * 1_000_000
_RECONNECT_NS = 300_000_000  # from the end of a cut until the nodes see each other again
_RESEND_NS = 200_000_000  # TCP's shortest time until it sends again
_MAX_RESENDS = 8
_DUPLICATE_AFTER_NS = 3_000_000

# a call for a receiver, and what it is called with
Call = Callable[..., None]
Arguments = tuple[object, ...]

# no connection of the bus: what has it is never cut
_NO_PAIR: Pair = ("", "")


class SimBus:
    """All nodes and what is on its way between them.

    Args:
        settings: of every pair; :meth:`set_link` gives a pair its own.
        now_ns: the simulated time.
        radio: the one channel that all share, and the nodes that have a radio; None without limits.
    """

    def __init__(
        self,
        settings: BusSettings,
        now_ns: Callable[[], int],
        *,
        seed: int,
        radio: tuple[RadioConfig, frozenset[str]] | None = None,
    ) -> None:
        self.now_ns = now_ns
        self.nodes: dict[str, Node] = {}
        self.subscribers: dict[tuple[Topic, str], list[tuple[Node, OnMessage]]] = defaultdict(list)
        self.lost = 0  # messages so far

        # quality: of every pair, and of those that have their own
        self.settings = settings
        self._delay_ns = round(settings.delay_s * 1e9)
        self._links: dict[Pair, BusSettings] = {}
        self._losses = Losses()
        self._rng = np.random.default_rng([seed, 11])

        self.channel: Channel | None = None
        if radio is not None:
            self.channel = Channel(*radio, now_ns, seed=seed)

        # what is on its way, as a heap: when it is due, and a number that keeps the order
        self._queue: list[tuple[int, int, Pair, Call, Arguments]] = []
        self._count = itertools.count()

        # when the newest message of a pair arrives, of LATEST ones and of the others
        self._newest_ns: dict[tuple[Pair, bool], int] = {}

        self._cut: dict[Pair, int] = {}  # since when
        self._held: list[tuple[int, Pair, Call, Arguments]] = []  # since when, in senders' buffers
        self._unseen: set[Pair] = set()  # pairs that have noticed their cut

    def node(self, name: str) -> Node:
        """Return a new node; it takes part from its ``start`` on."""
        return Node(self, name)

    def change_settings(self, settings: BusSettings) -> None:
        """Give all pairs that have no quality of their own another one from now on."""
        self.settings = settings
        self._delay_ns = round(settings.delay_s * 1e9)

    def set_link(self, first: str, second: str, settings: BusSettings) -> None:
        """Give both directions between two nodes their own quality."""
        self._links[first, second] = settings
        self._links[second, first] = settings

    def reset_link(self, first: str, second: str) -> None:
        """Give two nodes the quality of every pair again."""
        for pair in ((first, second), (second, first)):
            self._links.pop(pair, None)

    def partition(self, *groups: Iterable[str], bridging: Iterable[str] = ()) -> None:
        """Cut groups of nodes apart.

        Args:
            groups: names of nodes; the nodes that are in none form one group more.
            bridging: names of nodes whom all groups still hear.
        """
        sets = [set(group) for group in groups]
        named = set().union(*sets, bridging)
        sets.append({name for name in self.nodes if name not in named})

        for one, two in itertools.combinations(sets, 2):
            for first, second in itertools.product(sorted(one), sorted(two)):
                self.cut(first, second)

    def cut(self, first: str, second: str) -> None:
        """Let nothing pass between two nodes until :meth:`heal`."""
        now_ns = self.now_ns()
        for pair in ((first, second), (second, first)):
            if pair not in self._cut:
                self._cut[pair] = now_ns
                self.call_at(now_ns + _LEASE_NS, self._expire, pair, now_ns)

    def heal(self, *pairs: Pair) -> None:
        """End the cuts between these pairs of nodes; without any, all cuts."""
        now_ns = self.now_ns()

        healed = set(self._cut)
        if pairs:
            healed = {*pairs, *((second, first) for first, second in pairs)}

        # what the senders have kept arrives, unless their connection has ended meanwhile
        held = self._held
        self._held = [entry for entry in held if entry[1] not in healed]
        for sent_ns, pair, function, args in held:
            if pair in healed and now_ns - sent_ns < _LEASE_NS:
                delay_ns = round(self._of(pair).delay_s * 1e9)
                self._push(now_ns + delay_ns, pair, function, args)

        for pair in healed:
            self._cut.pop(pair, None)
        for pair in sorted(self._unseen & healed):
            self.call_at(now_ns + _RECONNECT_NS, self._rejoin, pair)

    def is_cut(self, first: str, second: str) -> bool:
        """Return whether nothing passes between two nodes."""
        return (first, second) in self._cut

    def call_at(self, due_ns: int, function: Call, *args: object) -> None:
        """Call a function at a time, whatever the faults of the bus are."""
        self._push(due_ns, _NO_PAIR, function, args)

    def deliver(self) -> None:
        """Call everything that is due now, in the order of arrival."""
        now_ns = self.now_ns()
        if self.channel is not None:
            self.channel.advance(now_ns)

        queue = self._queue
        cut = self._cut
        while queue and queue[0][0] <= now_ns:
            _, _, pair, function, args = heappop(queue)
            if cut and pair in cut:
                self._held.append((now_ns, pair, function, args))
            else:
                function(*args)

    def send(self, pair: Pair, delivery: Delivery, function: Call, *args: object) -> None:
        """Put a call for the receiver on its way from ``pair[0]`` to ``pair[1]``."""
        now_ns = self.now_ns()
        settings = self._of(pair)
        is_latest = delivery is Delivery.LATEST
        is_cut = bool(self._cut) and pair in self._cut

        # nobody keeps a message that matters only while it is new
        if is_cut and is_latest:
            return

        due_ns = now_ns + round(settings.delay_s * 1e9)

        # four numbers for each message, whatever it is, so that one fault changes no other
        draw = None
        if settings.is_random:
            draw = self._rng.random(4)

        if draw is not None:
            due_ns += round(-math.log1p(-draw[0]) * settings.jitter_s * 1e9)

            if is_latest and self._losses.takes(pair, settings, draw[1], now_ns):
                self.lost += 1
                return

            if is_latest and draw[2] < settings.reorder:
                self._push(due_ns + round(settings.reorder_s * 1e9), pair, function, args)
                return

            if not is_latest:
                due_ns += _RESEND_NS * self._resends(settings.loss)

            # what is not reordered on purpose keeps its order
            due_ns = max(due_ns, self._newest_ns.get((pair, is_latest), 0))
            self._newest_ns[pair, is_latest] = due_ns

        if is_cut:
            self._held.append((now_ns, pair, function, args))
            return

        if self.channel is not None:

            def leave_channel(end_ns: int) -> None:
                """Go on with the delay of the connection."""
                self._push(end_ns + due_ns - now_ns, pair, function, args)

            self.channel.send(pair, args, leave_channel, is_latest)
            return

        self._push(due_ns, pair, function, args)
        if draw is not None and is_latest and draw[3] < settings.duplicate:
            self._push(due_ns + _DUPLICATE_AFTER_NS, pair, function, args)

    @property
    def is_quiet(self) -> bool:
        """Whether all messages arrive, each after the same time."""
        has_fault = self._cut or self._links or self.settings.is_random
        return not has_fault and self.channel is None

    def send_latest(
        self, sender: str, receivers: list[tuple[Node, OnMessage]], args: Arguments
    ) -> None:
        """Send a LATEST message to its subscribers, by one call where nothing can happen to it."""
        if self.is_quiet:
            due_ns = self.now_ns() + self._delay_ns
            all_at_once = (sender, tuple(receivers), args)
            self._push(due_ns, (sender, ""), self._fan_out, all_at_once)
            return

        topic, name, *_ = args
        for node, on_message in receivers:
            if node.name != sender and node.is_interested(topic, name):
                self.send((sender, node.name), Delivery.LATEST, on_message, *args)

    def _fan_out(self, sender: str, receivers: Iterable[tuple[Node, OnMessage]], args: Any) -> None:
        """Deliver a message that all receivers get at this instant."""
        cut = self._cut
        topic, name, message = args
        for node, on_message in receivers:
            if node.name == sender:
                continue

            # the cut may have come while the message was on its way
            if cut and (sender, node.name) in cut:
                self._held.append((self.now_ns(), (sender, node.name), on_message, args))
            else:
                on_message(topic, name, message)

    def leave(self, node: Node) -> None:
        """Forget a node."""
        self.nodes.pop(node.name, None)
        for listeners in self.subscribers.values():
            listeners[:] = [entry for entry in listeners if entry[0] is not node]

    def _resends(self, loss: float) -> int:
        """Return how often a connection sends a message again until it is there."""
        count = 0
        while count < _MAX_RESENDS and self._rng.random() < loss:
            count += 1
        return count

    def _of(self, pair: Pair) -> BusSettings:
        """Return the quality between two nodes."""
        if not self._links:
            return self.settings
        return self._links.get(pair, self.settings)

    def _push(self, due_ns: int, pair: Pair, function: Call, args: Arguments) -> None:
        heappush(self._queue, (due_ns, next(self._count), pair, function, args))

    def _expire(self, pair: Pair, since_ns: object) -> None:
        """Let a pair notice its cut, unless the cut has ended and another begun meanwhile."""
        if self._cut.get(pair) == since_ns and pair not in self._unseen:
            self._unseen.add(pair)
            self._notify_of_all_names(pair, False)

    def _rejoin(self, pair: Pair) -> None:
        """Let a pair see each other again, unless it has been cut once more."""
        if pair not in self._cut and pair in self._unseen:
            self._unseen.discard(pair)
            if pair[0] in self.nodes:
                self._notify_of_all_names(pair, True)

    def _notify_of_all_names(self, pair: Pair, is_alive: bool) -> None:
        """Let the second node learn that the first one is there or gone, under all its names."""
        seen, listener = pair
        names = [seen]
        if seen in self.nodes:
            names += sorted(self.nodes[seen].claims)

        for name in names:
            self.notify(listener, name, is_alive)

    def notify(self, listener: str, node: str, is_alive: bool) -> None:
        """Let one node learn that another is there or gone."""
        receiver = self.nodes.get(listener)
        if receiver is not None:
            for on_alive in receiver.alive_listeners:
                on_alive(node, is_alive)


class Node:
    """One node, as :class:`onboard.bus.protocol.Bus` describes."""

    is_simulated = True

    def __init__(self, bus: SimBus, name: str) -> None:
        self.bus = bus
        self.name = name
        self.claims: set[str] = set()
        self.alive_listeners: list[OnAlive] = []
        self.order_server: OnOrder | None = None
        self.fault_server: OnFault | None = None

        # by topic and name: false where a real node would not have subscribed; its subscriptions
        # here are wider, because changing them costs time
        self.is_interested: Callable[[object, object], bool] = lambda topic, name: True

        self._is_open = False

    @property
    def node(self) -> str:
        """Its name."""
        return self.name

    def start(self) -> None:
        """Join; the others learn of it."""
        if self._is_open:
            return
        self._is_open = True
        self.bus.nodes[self.name] = self
        self._notify_others(self.name, True)

    def stop(self) -> None:
        """Leave as a process that ends: its connections close, and the others notice at once."""
        if not self._is_open:
            return

        self._is_open = False
        self.bus.leave(self)
        for name in (*sorted(self.claims), self.name):
            self._notify_others(name, False)

        self.claims.clear()
        self.alive_listeners.clear()
        self.order_server = None

    def publish(self, topic: Topic, name: str, message: Message) -> None:
        """Send to all who subscribed."""
        delivery = TOPICS[topic].delivery
        for key in ((topic, "*"), (topic, name)):
            receivers = self.bus.subscribers.get(key)
            if not receivers:
                continue

            if delivery is Delivery.LATEST:
                self.bus.send_latest(self.name, receivers, (topic, name, message))
                continue

            for node, on_message in receivers:
                if node is not self:
                    pair = (self.name, node.name)
                    self.bus.send(pair, delivery, on_message, topic, name, message)

    def subscribe(self, topic: Topic, name: str, on_message: OnMessage) -> None:
        """Hear ``topic/name``; ``name`` may be ``*``."""
        self.bus.subscribers[topic, name].append((self, on_message))

    def collect(
        self, topic: Topic, name: str, on_message: OnMessage, *, most: int = MAX_COLLECTED
    ) -> None:
        """Hear ``topic/name`` as with :meth:`subscribe`: here nothing waits to be collected."""
        self.subscribe(topic, name, on_message)

    def deliver(self) -> None:
        """Do nothing: the simulation delivers."""

    def follow(self, topic: Topic, names: Iterable[str], on_message: OnMessage) -> None:
        """Hear ``topic`` of exactly these names, of each once."""
        for (other, _), listeners in self.bus.subscribers.items():
            if other is topic:
                listeners[:] = [entry for entry in listeners if entry != (self, on_message)]

        for name in names:
            self.subscribe(topic, name, on_message)

    def serve_orders(self, vehicle: str, on_order: OnOrder) -> None:
        """Answer orders for this node's vehicle."""
        self.order_server = on_order

    def order(
        self, vehicle: str, order: Order, *, timeout_s: float, on_reply: OnReply, on_end: OnEnd
    ) -> None:
        """Send an order to one vehicle; answers after the timeout are not heard."""
        deadline_ns = self.bus.now_ns() + round(timeout_s * 1e9)

        def reply_arrived(reply: OrderReply) -> None:
            if self.bus.now_ns() <= deadline_ns:
                on_reply(reply)

        def send_back(reply: OrderReply) -> None:
            self.bus.send((vehicle, self.name), Delivery.QUERY, reply_arrived, reply)

        def deliver() -> None:
            node = self.bus.nodes.get(vehicle)
            if node is not None and node.order_server is not None:
                node.order_server(order, send_back)

        self.bus.send((self.name, vehicle), Delivery.QUERY, deliver)
        self.bus.call_at(deadline_ns, on_end)

    def serve_faults(self, on_fault: OnFault) -> None:
        """Answer orders that inject faults into the emulator."""
        self.fault_server = on_fault

    def fault(
        self, order: FaultOrder, *, timeout_s: float, on_reply: OnReply, on_end: OnEnd
    ) -> None:
        """Order a fault from the emulator, whichever node it is; no fault of the bus delays it."""
        now_ns = self.bus.now_ns()

        def send_back(reply: OrderReply) -> None:
            self.bus.call_at(now_ns, on_reply, reply)

        for node in self.bus.nodes.values():
            if node.fault_server is not None:
                self.bus.call_at(now_ns, node.fault_server, order, send_back)
                break

        self.bus.call_at(now_ns + round(timeout_s * 1e9), on_end)

    def watch_alive(self, on_alive: OnAlive) -> None:
        """Hear of every node, those already there included."""
        self.alive_listeners.append(on_alive)

        for other in list(self.bus.nodes):
            if other == self.name or self.bus.is_cut(other, self.name):
                continue
            for name in (other, *sorted(self.bus.nodes[other].claims)):
                self.bus.send((other, self.name), Delivery.TOKEN, on_alive, name, True)

    def claim(self, token: str) -> None:
        """Be seen under another name too."""
        if token not in self.claims:
            self.claims.add(token)
            self._notify_others(token, True)

    def release(self, token: str) -> None:
        """Give up such a name."""
        if token in self.claims:
            self.claims.remove(token)
            self._notify_others(token, False)

    def _notify_others(self, name: str, is_alive: bool) -> None:
        for other in list(self.bus.nodes):
            if other != self.name:
                pair = (self.name, other)
                self.bus.send(pair, Delivery.TOKEN, self.bus.notify, other, name, is_alive)
