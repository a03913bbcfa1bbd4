"""The client's side of the bus: subscribes, and brings messages to the event loop in batches.

Messages of frequent topics wait on the bus until the loop takes all of them, fifty times a second,
because it costs more to wake up the loop than to handle a message. Callbacks of all other topics
run on threads of the bus: they append to a bounded queue and wake up the loop once per batch.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Hashable, Sequence

from groundstation.fleet.state import NodeSeen, NotUsed, ReceivedMessage
from onboard.bus.clock_offsets import Clocks
from onboard.bus.clock_sync import ClockNode
from onboard.bus.codec import Malformed
from onboard.bus.protocol import Bus, BusError
from onboard.bus.schema import Event, Message
from onboard.bus.topics import Topic

MAX_QUEUED = 20_000
_MAX_HEARD = 2000  # events that are kept to know a repeat; agents repeat up to 24 of each vehicle
DELIVERY_PERIOD_S = 0.02
# Topics whose messages are folded into the fleet's state; with people, the client adds ALL_POSES.
FOLDED = (Topic.TELEMETRY, Topic.EVENT, Topic.TRUTH, Topic.PREFLIGHT)
# frequent topics, whose messages wait on the bus
_COLLECTED = (Topic.TELEMETRY, Topic.TRUTH, Topic.STATE, Topic.TICK, Topic.MOCAP)

Sink = Callable[[Topic, str, Message, int], None]


class BusFeed:
    """Messages of the bus for one client.

    Args:
        bus: bus that is not open yet.
        on_batch: function for all messages since its last call, called on the event loop.
        folded: topics whose messages the client folds into the fleet's state.
        recorded: further topics, whose messages only the sinks receive.
        clock_ns: the ground's monotonic clock [ns].
        on_delivery: function that is called on the event loop before each delivery; never on a
            simulated bus.
    """

    def __init__(
        self,
        bus: Bus,
        on_batch: Callable[[Sequence[ReceivedMessage]], None],
        *,
        folded: Sequence[Topic],
        recorded: Sequence[Topic],
        clock_ns: Callable[[], int],
        on_delivery: Callable[[], object],
    ) -> None:
        self.bus = bus
        self._on_batch = on_batch
        self._folded = frozenset(folded)
        self._topics = (*folded, *(topic for topic in recorded if topic not in folded))
        self._clock_ns = clock_ns
        self._on_delivery = on_delivery
        self._sinks: list[Sink] = []
        # the newest events as they came; an agent repeats them for a ground that has missed them
        self._heard: deque[Event] = deque(maxlen=_MAX_HEARD)

        self._queue: deque[ReceivedMessage] = deque(maxlen=MAX_QUEUED)
        self._dropped = 0  # messages pushed out of the full queue since the last batch
        self._is_scheduled = False  # whether the loop has been woken up for the queue

        self._loop: asyncio.AbstractEventLoop | None = None  # None before the start
        self._opening: asyncio.Task[None] | None = None  # opens the bus; None: the start waited
        self._is_open = False
        self._calls_when_open: dict[Hashable, Callable[[], None]] = {}  # by a key
        self.problem = ""  # why the bus cannot be opened; empty if it is open, or may open yet
        self._delivery: asyncio.TimerHandle | None = None
        self._clock_node = ClockNode(bus)
        self._clock: asyncio.Task[None] | None = None

    @property
    def clocks(self) -> Clocks | None:
        """The clocks of the other nodes; None in simulated time, where all have one clock."""
        if self.bus.is_simulated:
            return None
        return self._clock_node.clocks

    @property
    def is_started(self) -> bool:
        """Whether the feed was started, and not stopped since."""
        return self._loop is not None

    @property
    def is_without_bus(self) -> bool:
        """Whether the feed was started, and its bus is not open, or not yet."""
        return self.is_started and not self._is_open

    def now_ns(self) -> int:
        """Return the ground's monotonic clock [ns], which stamps received messages."""
        return self._clock_ns()

    async def start(self, longest_s: float | None = None) -> None:
        """Open the bus; a second call does nothing.

        Args:
            longest_s: longest wait [s]. If the bus is not open by then, the feed goes on without
                it, and the bus may open later. If it cannot be opened, the feed stays without it,
                and `problem` says why. None waits for the bus.

        Raises:
            BusError: the bus cannot be opened; never with ``longest_s``.
        """
        if self._loop is not None:
            return

        self._loop = asyncio.get_running_loop()
        if longest_s is not None:
            self._opening = self._loop.create_task(self._open_or_note_problem(self._loop))
            await asyncio.wait([self._opening], timeout=longest_s)
            return
        try:
            await self._open_and_deliver(self._loop)
        except BusError:
            self._loop = None
            raise

    async def _open_or_note_problem(self, loop: asyncio.AbstractEventLoop) -> None:
        try:
            await self._open_and_deliver(loop)
        except BusError as error:
            self.problem = str(error)

    async def _open_and_deliver(self, loop: asyncio.AbstractEventLoop) -> None:
        await asyncio.to_thread(self._open)
        self._is_open = True
        if not self.bus.is_simulated:
            # Agents on other hosts need this ground's clock to check the deadline of an order.
            self._clock = loop.create_task(self._clock_node.keep())
            self._deliver_periodically(loop)

        calls = list(self._calls_when_open.values())
        self._calls_when_open.clear()
        for call in calls:
            call()

    def call_when_open(self, key: Hashable, call: Callable[[], None]) -> None:
        """Call a function once the bus is open; of several with one key, only the newest.

        Args:
            key: names what the function does.
            call: the function, called in the event loop.
        """
        self._calls_when_open[key] = call

    async def stop(self) -> None:
        """Leave the bus; a second call does nothing."""
        if self._loop is None:
            return

        if self._opening is not None:
            # A thread opens the bus, and nothing can interrupt it.
            await asyncio.gather(self._opening, return_exceptions=True)
        if self._clock is not None:
            self._clock.cancel()
            await asyncio.gather(self._clock, return_exceptions=True)
        if self._delivery is not None:
            self._delivery.cancel()
        await asyncio.to_thread(self.bus.stop)
        self._loop = None
        self._is_open = False

    def add_sink(self, sink: Sink) -> None:
        """Add a sink for every message.

        Args:
            sink: function for topic, name, message (its stamps on the ground's clock) and time of
                reception [ns], called on any thread.
        """
        self._sinks.append(sink)

    def tell_sinks(self, topic: Topic, name: str, message: Message) -> None:
        """Hand a message to the sinks only; callable from any thread.

        Args:
            topic: the message's topic.
            name: vehicle, body or node that it is about.
            message: the message.
        """
        now_ns = self._clock_ns()
        for sink in self._sinks:
            sink(topic, name, message, now_ns)

    def put(self, item: Message | Malformed | NodeSeen | NotUsed) -> None:
        """Queue an item for the next batch; callable from any thread.

        Args:
            item: a message, a node that appeared or left, or a count of messages not used.
        """
        if len(self._queue) == MAX_QUEUED:
            self._dropped += 1  # the oldest makes room
        self._queue.append((item, self._clock_ns()))

        if self._loop is not None and not self._is_scheduled:
            self._is_scheduled = True
            self.call(self._drain)

    def call(self, function: Callable[..., None], *args: object) -> None:
        """Call a function on the event loop; callable from any thread.

        Nothing is called after the loop has ended.

        Args:
            function: function to call soon.
            args: its arguments.
        """
        loop = self._loop
        if loop is None or loop.is_closed():
            return

        try:
            loop.call_soon_threadsafe(function, *args)
        except RuntimeError:
            return  # the loop closed after the check above

    def read(self) -> None:
        """Take everything that has arrived so far; for the event loop's thread only."""
        self._drain()

    # -- threads of the bus ------------------------------------------------------------------------

    def _open(self) -> None:
        self.bus.start()
        for topic in self._topics:
            if topic in _COLLECTED:
                self.bus.collect(topic, "*", self._receive, most=MAX_QUEUED)
            else:
                self.bus.subscribe(topic, "*", self._receive)
        self.bus.watch_alive(lambda node, is_alive: self.put(NodeSeen(node, is_alive)))

    def _receive(self, topic: Topic, name: str, message: Message | Malformed) -> None:
        """Take a message; refuse it if it names another vehicle than its topic.

        A repeat of an event that was heard is left out.
        """
        if isinstance(message, Malformed):
            self.put(message)
        elif getattr(message, "vehicle", name) != name:
            self.put(NotUsed(refused=1))
        elif not (isinstance(message, Event) and self._has_heard(message)):
            self._tell_sinks_on_own_clock(topic, name, message)
            if topic in self._folded:
                self.put(message)

    def _has_heard(self, event: Event) -> bool:
        """Return whether this very event came before, and note it if it may be repeated."""
        may_be_repeated = event.order_outcome != "" or event.severity == "critical"
        if not may_be_repeated:
            return False
        if event in tuple(self._heard):  # a copy, because threads of the bus may append meanwhile
            return True
        self._heard.append(event)
        return False

    def _tell_sinks_on_own_clock(self, topic: Topic, name: str, message: Message) -> None:
        """Hand a message to the sinks, with its stamp on the ground's clock."""
        if not self._sinks:
            return
        if not self.bus.is_simulated:
            message = self._clock_node.any_message(name, message, self._clock_ns())
        self.tell_sinks(topic, name, message)

    # -- event loop --------------------------------------------------------------------------------

    def _deliver_periodically(self, loop: asyncio.AbstractEventLoop) -> None:
        self._delivery = loop.call_later(DELIVERY_PERIOD_S, self._deliver_periodically, loop)
        self._on_delivery()
        self.bus.deliver()

    def _drain(self) -> None:
        """Hand everything in the queue over as one batch."""
        self.bus.deliver()  # first the messages that wait on the bus

        self._is_scheduled = False
        batch = [self._queue.popleft() for _ in range(len(self._queue))]
        if self._dropped:
            batch.append((NotUsed(dropped=self._dropped), self._clock_ns()))
            self._dropped = 0
        self._on_batch(batch)
