"""The bus in simulated time: it delays, loses, reorders and duplicates messages between nodes.

It keeps the promises of the real bus. A topic is LATEST if only its newest message matters; its
messages can be lost. Events, orders and replies travel on a connection: a lost one is sent again,
so it comes later, and in order. Two nodes that are cut apart notice the cut after a time, the
lease. Messages on their way arrive if the cut is healed within the lease, and otherwise never.

Every message is a call with a due time, and all calls wait in one queue. Where no fault can touch a
message, a single call serves all its receivers. The random numbers are seeded.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from heapq import heappop, heappush
from typing import Any, NamedTuple

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
from sitl.physics.random_streams import Stream

_LEASE_NS = LEASE_MS * 1_000_000
_RECONNECT_NS = 300_000_000  # time from the end of a cut until the nodes see each other again
_RESEND_NS = 200_000_000  # TCP's shortest retransmission timeout
_MAX_RESENDS = 8
_DUPLICATE_AFTER_NS = 3_000_000

# a call at a receiver, and its arguments
Call = Callable[..., None]
Arguments = tuple[object, ...]

# stands for "no connection of the bus": a call with this pair is never cut
_NO_PAIR: Pair = ("", "")


class _Arrival(NamedTuple):
    """The arrival of a message at its receiver."""

    due_ns: int
    is_duplicated: bool = False


class _HeldCall(NamedTuple):
    """A call that waits in its sender's buffer for the end of a cut."""

    since_ns: int
    pair: Pair
    function: Call
    args: Arguments


class SimBus:
    """All nodes, and the messages on their way between them.

    Args:
        settings: quality of every connection; :meth:`set_link` gives a connection its own.
        now_ns: returns the simulated time.
        seed: the seed of all random numbers.
        radio: the radio channel that the fleet shares, and the names of the nodes that have a
            radio; None if the bit rate has no limit.
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
        self.lost = 0  # number of messages lost so far

        # quality of every pair, and of the pairs that have their own
        self.settings = settings
        self._delay_ns = round(settings.delay_s * 1e9)
        self._links: dict[Pair, BusSettings] = {}
        self._losses = Losses()
        self._rng = np.random.default_rng([seed, Stream.BUS])

        self.channel: Channel | None = None
        if radio is not None:
            radio_config, nodes_with_radio = radio
            self.channel = Channel(radio_config, nodes_with_radio, now_ns, seed=seed)

        # messages on their way, as a heap: the due time [ns], a number that orders calls due at the
        # same time, and the call
        self._queue: list[tuple[int, int, Pair, Call, Arguments]] = []
        self._count = itertools.count()

        # pair, and whether the message is a LATEST one -> arrival [ns] of the newest such message
        self._newest_ns: dict[tuple[Pair, bool], int] = {}

        self._cut: dict[Pair, int] = {}  # pair -> time [ns] at which it was cut

        self._held: list[_HeldCall] = []
        # pairs that have noticed their cut, because it has lasted longer than the lease
        self._noticed_cuts: set[Pair] = set()

    def node(self, name: str) -> Node:
        """Return a new node, which joins the bus when its ``start`` is called."""
        return Node(self, name)

    def change_settings(self, settings: BusSettings) -> None:
        """Change the quality of all pairs that have none of their own, from now on."""
        self.settings = settings
        self._delay_ns = round(settings.delay_s * 1e9)

    def set_link(self, first: str, second: str, settings: BusSettings) -> None:
        """Give both directions between two nodes their own quality."""
        self._links[first, second] = settings
        self._links[second, first] = settings

    def reset_link(self, first: str, second: str) -> None:
        """Give the connection of two nodes the common quality again."""
        for pair in ((first, second), (second, first)):
            self._links.pop(pair, None)

    def partition(self, *groups: Iterable[str], bridging: Iterable[str] = ()) -> None:
        """Cut groups of nodes apart.

        Args:
            groups: names of nodes; all unnamed nodes form one more group.
            bridging: names of nodes that stay connected with all groups.
        """
        parts = [set(group) for group in groups]
        named = set().union(*parts, bridging)
        parts.append({name for name in self.nodes if name not in named})

        for one_part, other_part in itertools.combinations(parts, 2):
            for first, second in itertools.product(sorted(one_part), sorted(other_part)):
                self.cut(first, second)

    def cut(self, first: str, second: str) -> None:
        """Let nothing pass between two nodes until :meth:`heal`."""
        now_ns = self.now_ns()
        for pair in ((first, second), (second, first)):
            if pair not in self._cut:
                self._cut[pair] = now_ns
                self.call_at(now_ns + _LEASE_NS, self._notice_cut, pair, now_ns)

    def heal(self, *pairs: Pair) -> None:
        """End the cuts of these pairs of nodes; without an argument, end all cuts."""
        now_ns = self.now_ns()

        healed = set(self._cut)
        if pairs:
            healed = {*pairs, *((second, first) for first, second in pairs)}

        # messages that the senders have kept arrive, unless the lease has ended meanwhile
        held = self._held
        self._held = []
        for call in held:
            if call.pair not in healed:
                self._held.append(call)
            elif now_ns - call.since_ns < _LEASE_NS:
                delay_ns = round(self.quality(call.pair).delay_s * 1e9)
                self._push(now_ns + delay_ns, call.pair, call.function, call.args)

        for pair in healed:
            self._cut.pop(pair, None)
        for pair in sorted(self._noticed_cuts & healed):
            self.call_at(now_ns + _RECONNECT_NS, self._rejoin, pair)

    def is_cut(self, first: str, second: str) -> bool:
        """Return whether nothing passes between two nodes."""
        return (first, second) in self._cut

    def quality(self, pair: Pair) -> BusSettings:
        """Return the quality between two nodes."""
        if not self._links:
            return self.settings
        return self._links.get(pair, self.settings)

    def call_at(self, due_ns: int, function: Call, *args: object) -> None:
        """Call a function at a time [ns]; faults of the bus do not affect the call."""
        self._push(due_ns, _NO_PAIR, function, args)

    def deliver(self) -> None:
        """Make all calls that are due now, in the order of their due times."""
        now_ns = self.now_ns()
        if self.channel is not None:
            self.channel.advance(now_ns)

        queue = self._queue
        cut = self._cut
        while queue:
            due_ns, _, pair, function, args = queue[0]
            if due_ns > now_ns:
                break
            heappop(queue)
            if cut and pair in cut:
                self._held.append(_HeldCall(now_ns, pair, function, args))
            else:
                function(*args)

    def send(self, pair: Pair, delivery: Delivery, function: Call, *args: object) -> None:
        """Send a message from one node to another.

        Args:
            pair: names of sender and receiver.
            delivery: whether the message may be lost.
            function: function that is called when the message arrives.
            args: arguments of that call.
        """
        now_ns = self.now_ns()
        is_latest = delivery is Delivery.LATEST
        is_cut = bool(self._cut) and pair in self._cut

        # senders do not keep LATEST messages
        if is_cut and is_latest:
            return

        arrival = self._arrival(pair, now_ns, is_latest=is_latest)
        if arrival is None:
            self.lost += 1
            return

        if is_cut:
            self._held.append(_HeldCall(now_ns, pair, function, args))
            return

        if self.channel is not None:

            def leave_channel(end_ns: int) -> None:
                """Add the delay of the connection to the time on the channel."""
                self._push(end_ns + arrival.due_ns - now_ns, pair, function, args)

            self.channel.send(pair, args, leave_channel, is_latest)
            return

        self._push(arrival.due_ns, pair, function, args)
        if arrival.is_duplicated:
            self._push(arrival.due_ns + _DUPLICATE_AFTER_NS, pair, function, args)

    def _arrival(self, pair: Pair, now_ns: int, *, is_latest: bool) -> _Arrival | None:
        """Return the arrival of a message that is sent now; None if it is lost."""
        settings = self.quality(pair)
        due_ns = now_ns + round(settings.delay_s * 1e9)
        if not settings.is_random:
            return _Arrival(due_ns)

        # every message draws four numbers, so that a change of one fault (loss, say) leaves the
        # random numbers of the other faults as they are
        jitter_draw, loss_draw, reorder_draw, duplicate_draw = self._rng.random(4)

        # an exponential distribution from a uniform number
        due_ns += round(-math.log1p(-jitter_draw) * settings.jitter_s * 1e9)

        if not is_latest:
            due_ns += _RESEND_NS * self._resends(settings.loss)
            return _Arrival(self._due_in_order(pair, due_ns, is_latest=False))

        if self._losses.takes(pair, settings, loss_draw, now_ns):
            return None
        if reorder_draw < settings.reorder:
            return _Arrival(due_ns + round(settings.reorder_s * 1e9))

        return _Arrival(
            due_ns=self._due_in_order(pair, due_ns, is_latest=True),
            is_duplicated=duplicate_draw < settings.duplicate,
        )

    def _due_in_order(self, pair: Pair, due_ns: int, *, is_latest: bool) -> int:
        """Return the time at which a message arrives after the earlier ones of its kind."""
        newest_ns = max(due_ns, self._newest_ns.get((pair, is_latest), 0))
        self._newest_ns[pair, is_latest] = newest_ns
        return newest_ns

    @property
    def is_quiet(self) -> bool:
        """Whether no fault can touch a message: all arrive, each after the same time."""
        has_fault = self._cut or self._links or self.settings.is_random
        return not has_fault and self.channel is None

    def send_latest(
        self, sender: str, receivers: list[tuple[Node, OnMessage]], args: Arguments
    ) -> None:
        """Send a LATEST message to its subscribers.

        On a quiet bus one call serves all of them.
        """
        if self.is_quiet:
            due_ns = self.now_ns() + self._delay_ns
            no_receiver = ""  # so that no cut of a pair holds the call
            fan_out_args = (sender, tuple(receivers), args)
            self._push(due_ns, (sender, no_receiver), self._fan_out, fan_out_args)
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

            # the pair may have been cut while the message was on its way
            if cut and (sender, node.name) in cut:
                self._held.append(_HeldCall(self.now_ns(), (sender, node.name), on_message, args))
            else:
                on_message(topic, name, message)

    def leave(self, node: Node) -> None:
        """Forget a node."""
        self.nodes.pop(node.name, None)
        for listeners in self.subscribers.values():
            listeners[:] = [(other, call) for other, call in listeners if other is not node]

    def _resends(self, loss: float) -> int:
        """Return how often a connection sends a message again until it arrives."""
        count = 0
        while count < _MAX_RESENDS and self._rng.random() < loss:
            count += 1
        return count

    def _push(self, due_ns: int, pair: Pair, function: Call, args: Arguments) -> None:
        heappush(self._queue, (due_ns, next(self._count), pair, function, args))

    def _notice_cut(self, pair: Pair, since_ns: object) -> None:
        """Let a pair notice its cut, unless that cut has ended meanwhile.

        Args:
            pair: the pair that was cut.
            since_ns: the time of the cut, which distinguishes this cut from a later one.
        """
        if self._cut.get(pair) == since_ns and pair not in self._noticed_cuts:
            self._noticed_cuts.add(pair)
            self._notify_of_all_names(pair, is_alive=False)

    def _rejoin(self, pair: Pair) -> None:
        """Let a pair see each other again, unless it has been cut again."""
        if pair not in self._cut and pair in self._noticed_cuts:
            self._noticed_cuts.discard(pair)
            node, _ = pair
            if node in self.nodes:
                self._notify_of_all_names(pair, is_alive=True)

    def _notify_of_all_names(self, pair: Pair, *, is_alive: bool) -> None:
        """Tell the second node of a pair, for each name of the first, that it is alive or gone."""
        node, listener = pair
        names = [node]
        if node in self.nodes:
            names += sorted(self.nodes[node].claims)

        for name in names:
            self.notify(listener, name, is_alive)

    def notify(self, listener: str, node: str, is_alive: bool) -> None:
        """Tell one node that another one is alive or gone."""
        receiver = self.nodes.get(listener)
        if receiver is not None:
            for on_alive in receiver.alive_listeners:
                on_alive(node, is_alive)


class Node:
    """One node; it has the methods of :class:`onboard.bus.protocol.Bus`."""

    is_simulated = True

    def __init__(self, bus: SimBus, name: str) -> None:
        self.bus = bus
        self.name = name
        self.claims: set[str] = set()  # further names under which other nodes see this one
        self.alive_listeners: list[OnAlive] = []
        self.order_server: OnOrder | None = None
        self.fault_server: OnFault | None = None

        # Returns for a topic and a name whether a real node would have subscribed to them. In
        # lockstep a node subscribes to more than that, because changing subscriptions costs time.
        self.is_interested: Callable[[object, object], bool] = lambda topic, name: True

        self._is_open = False

    @property
    def node(self) -> str:
        """Its name."""
        return self.name

    def start(self) -> None:
        """Join the bus; the other nodes learn of it."""
        if self._is_open:
            return
        self._is_open = True
        self.bus.nodes[self.name] = self
        self._notify_others(self.name, True)

    def stop(self) -> None:
        """Leave the bus as an ending process does; the other nodes notice at once."""
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
        """Send a message to all subscribers."""
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
        """Receive the messages of ``topic/name``; ``name`` may be ``*``."""
        self.bus.subscribers[topic, name].append((self, on_message))

    def collect(
        self, topic: Topic, name: str, on_message: OnMessage, *, most: int = MAX_COLLECTED
    ) -> None:
        """Do the same as :meth:`subscribe`, because in lockstep messages are not queued."""
        self.subscribe(topic, name, on_message)

    def deliver(self) -> None:
        """Do nothing: the simulation delivers the messages."""

    def follow(self, topic: Topic, names: Iterable[str], on_message: OnMessage) -> None:
        """Receive the messages of ``topic`` under exactly these names, and no others."""
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
        """Send an order to one vehicle; replies after the timeout are dropped."""
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
        """Send an order for a fault to the emulator's node; no fault of the bus delays it."""
        now_ns = self.bus.now_ns()

        def send_back(reply: OrderReply) -> None:
            self.bus.call_at(now_ns, on_reply, reply)

        for node in self.bus.nodes.values():
            if node.fault_server is not None:
                self.bus.call_at(now_ns, node.fault_server, order, send_back)
                break

        self.bus.call_at(now_ns + round(timeout_s * 1e9), on_end)

    def watch_alive(self, on_alive: OnAlive) -> None:
        """Report every node that joins or leaves, and those that are there already."""
        self.alive_listeners.append(on_alive)

        for other in list(self.bus.nodes):
            if other == self.name or self.bus.is_cut(other, self.name):
                continue
            for name in (other, *sorted(self.bus.nodes[other].claims)):
                self.bus.send((other, self.name), Delivery.TOKEN, on_alive, name, True)

    def claim(self, token: str) -> None:
        """Let the other nodes see this node under a further name, too."""
        if token not in self.claims:
            self.claims.add(token)
            self._notify_others(token, True)

    def release(self, token: str) -> None:
        """Give up a name that was claimed."""
        if token in self.claims:
            self.claims.remove(token)
            self._notify_others(token, False)

    def _notify_others(self, name: str, is_alive: bool) -> None:
        for other in list(self.bus.nodes):
            if other != self.name:
                pair = (self.name, other)
                self.bus.send(pair, Delivery.TOKEN, self.bus.notify, other, name, is_alive)
