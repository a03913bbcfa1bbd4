"""The ground's client of a fleet, which the console, missions, scripts and the live page use.

It folds the messages of the bus into a :class:`FleetState`, plans and sends orders, and fills in
their results. All public methods are for the event loop's thread, unless their text says "callable
from any thread".
"""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from msgspec import structs

from groundstation.client.bus_feed import DELIVERY_PERIOD_S, FOLDED, BusFeed, Sink
from groundstation.client.direct_mavlink import SendDirect, send_in_thread
from groundstation.client.fault_orders import order_fault
from groundstation.client.ground_node import session, user_name
from groundstation.client.open_orders import OpenOrders
from groundstation.client.wall_clock import WallClock
from groundstation.fleet.loop_lateness import LoopLateness
from groundstation.fleet.operator_control import Control
from groundstation.fleet.own_stall import (
    AFTER_LATE_S,
    AFTER_STALL_S,
    LATE_S,
    OwnStall,
    boot_clock_ns,
)
from groundstation.fleet.state import (
    GROUND_STALLED,
    FleetState,
    ReceivedMessage,
    fold_batch,
    initial,
    without_earlier_flights,
    without_silent,
)
from groundstation.fleet.tick_stream import BusTickStream
from groundstation.orders.grammar import OrderError, default_formation, parse
from groundstation.orders.held_formation import HeldFormation
from groundstation.orders.intents import (
    PATH_INTENTS,
    Formation,
    Intent,
    PathVerb,
    Rotate,
    Takeoff,
)
from groundstation.orders.obstruction import explained
from groundstation.orders.other_files import without_other_files
from groundstation.orders.path_orders import path_orders
from groundstation.orders.plan import (
    PlannedOrder,
    check_again,
    of_mission,
    plan_order,
    with_heard_stamps,
)
from groundstation.orders.result import OrderResult, Results
from onboard.bus.control_token import EMERGENCY
from onboard.bus.protocol import Bus
from onboard.bus.schema import Event, FaultOrder, Message, PathOrder
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig
from onboard.message_counts import in_words
from onboard.security.mavlink_key import mavlink_keys

CONTROL_PERIOD_NS = 100_000_000
_STARTS = ("arm", "takeoff")  # kinds of orders after which a vehicle may fly
_LISTEN_S = (
    0.5  # time after the start in which all vehicles are heard: they send ten times a second
)
_AGE_PERIOD_S = 0.2  # period at which conditions are tested even without a message, since ages grow


class FleetClient:
    """Keeps the state of a fleet up to date, and gives the fleet orders.

    Args:
        fleet: the fleet file.
        author: person or program that orders; written into every order and every record.
        operates: whether to take control of the fleet when no ground has it, or only to watch.
        bus: the bus to use; by default a session that connects to all agents and the emulator, and
            listens on no port.
        extra_topics: further topics, whose messages only the sinks get; a recorder needs some.
        send: function that sends land and kill straight to PX4.
        clock_ns: the ground's monotonic clock [ns].
    """

    def __init__(
        self,
        fleet: FleetConfig,
        *,
        author: str | None = None,
        operates: bool = True,
        bus: Bus | None = None,
        extra_topics: Sequence[Topic] = (),
        send: SendDirect = send_in_thread,
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.fleet_file = fleet  # without the formations of a mission
        self.fleet = fleet
        self.is_recording = False  # whether this ground records, as the vehicles were told
        self._persons_verbs: dict[str, str] = {}  # id of a person's order -> its verb
        self.has_person = False  # whether a person, besides a mission, gives orders through it
        self.persons_stops = 0  # number of orders to land, hold or kill that no mission gave
        self.author = author or user_name()
        self._clock_ns = clock_ns
        self._heard_since_ns: int | None = None  # time of the first telemetry; None: none has come
        bus = bus or session(fleet)

        # The state, and its listeners.
        self._state = initial(fleet)
        self._changed = asyncio.Event()
        self._listeners: list[Callable[[FleetState], None]] = []
        self._event_listeners: list[Callable[[Event], None]] = []
        stall_clock_ns = clock_ns if bus.is_simulated else boot_clock_ns
        self._stall = OwnStall(stall_clock_ns)
        self._short_stall = OwnStall(stall_clock_ns, least_s=LATE_S)  # stalls of a busy computer
        self._loop_lateness = LoopLateness(clock_ns, DELIVERY_PERIOD_S)  # of the deliveries
        folded = list(FOLDED)
        if fleet.people:
            folded.append(Topic.ALL_POSES)
        self._feed = BusFeed(
            bus,
            self._take_batch,
            folded=folded,
            recorded=extra_topics,
            clock_ns=clock_ns,
            on_delivery=self._notice_lateness,
        )
        self.tick_stream = BusTickStream(bus)

        # Orders, and the right to give them.
        self._orders = OpenOrders(
            fleet,
            self._feed,
            send_direct=send,
            publish_event=self.publish_event,
            views=lambda: self._state.vehicles,
            stall_clock_ns=stall_clock_ns,
            mavlink_keys=mavlink_keys(fleet) if operates and not bus.is_simulated else {},
        )
        self._order_count = itertools.count(1)
        self._held = HeldFormation(default_formation(fleet))  # kept by moves of several vehicles
        self._control_due_ns = 0
        self.wall_clock = WallClock(lambda: self._feed.clocks, clock_ns)
        self.control = Control(
            bus,
            self.author,
            takes_control=operates,
            say=lambda severity, sentence: self.publish_event(severity, "operator", sentence),
            clock_ns=clock_ns,
        )

    @property
    def state(self) -> FleetState:
        """The fleet as known now."""
        return self._state

    @property
    def is_started(self) -> bool:
        """Whether the client was started, and not stopped since."""
        return self._feed.is_started

    @property
    def is_without_bus(self) -> bool:
        """Whether the client was started, and its bus is not open, or not yet."""
        return self._feed.is_without_bus

    @property
    def bus_problem(self) -> str:
        """Why the bus cannot be opened; empty if it is open, or may open yet."""
        return self._feed.problem

    def now_ns(self) -> int:
        """Return the time of the monotonic clock that gives the ages in the state [ns]."""
        return self._clock_ns()

    def add_sink(self, sink: Sink) -> None:
        """Add a sink, for instance a recorder, for everything that is received and ordered.

        Args:
            sink: function for topic, name, message and time of reception [ns], called on any
                thread.
        """
        self._feed.add_sink(sink)

    def add_listener(self, listener: Callable[[FleetState], None]) -> None:
        """Add a listener for the state.

        Args:
            listener: function for the newest state, called on the loop after each batch of
                messages.
        """
        self._listeners.append(listener)

    def add_event_listener(self, listener: Callable[[Event], None]) -> None:
        """Add a listener for events.

        Args:
            listener: function for each event, including this ground's own, called on the loop.
        """
        self._event_listeners.append(listener)

    async def start(self, longest_s: float | None = None) -> None:
        """Open the bus; a second call does nothing.

        Args:
            longest_s: longest wait [s]. If the bus is not open by then, the client goes on without
                it: land and kill go straight to PX4, and over the bus once it is open. None waits
                for the bus.

        Raises:
            BusError: the bus cannot be opened; never with ``longest_s``.
        """
        await self._feed.start(longest_s)

    async def stop(self) -> None:
        """Leave the bus; open orders get no more replies. A second call does nothing."""
        if not self._feed.is_started:
            return

        state = self._state
        words = in_words(state.malformed, state.refused, state.dropped, state.late)
        if words:
            sentence = f"Messages that this ground did not use: {words}."
            self.publish_event("info", "messages", sentence)

        await self._orders.stop()
        self.tick_stream.stop()
        await self._feed.stop()

    def announce_recording(self, is_on: bool) -> None:
        """Let the vehicles' preflight see whether this ground records.

        Callable from any thread while the bus is open.

        Args:
            is_on: whether it records now.
        """
        self.is_recording = is_on

        bus = self._feed.bus
        token = f"recorder-{bus.node}"
        if is_on:
            bus.claim(token)
        else:
            bus.release(token)

    # -- orders ------------------------------------------------------------------------------------

    def plan(self, order: Intent | str) -> PlannedOrder:
        """Plan an order and check it against the fleet as known now; nothing is sent.

        Callable from any thread.

        Args:
            order: an intent, or a line of the orders' grammar.

        Returns:
            Orders for the vehicles that may be ordered, refusals for the others.

        Raises:
            OrderError: the line is not an order.
        """
        intent = parse(order, self.fleet) if isinstance(order, str) else order

        refusal = self.control.refusal(intent.verb)
        if refusal is not None:
            refusals = dict.fromkeys(intent.names, refusal)
            return PlannedOrder(intent, orders={}, refusals=refusals, held=self._held)

        planned = plan_order(
            intent,
            self.fleet,
            self._state,
            held=self._held,
            author=self.author,
            node=self._feed.bus.node,
            now_ns=self._clock_ns(),
            new_id=self.new_order_id,
        )
        return self._without_other_files(planned)

    def order_paths(self, kind: PathVerb, paths: Mapping[str, PathOrder]) -> OrderResult:
        """Send each vehicle a part of its path, or the start of its path, for a mission.

        Args:
            kind: whether the paths are loaded or started.
            paths: message for each vehicle, see :mod:`groundstation.orders.path_orders`.

        Returns:
            The results, which are filled in on the event loop.
        """
        intent = PATH_INTENTS[kind](vehicles=tuple(paths))

        refusal = self.control.refusal("move")
        if refusal is not None:
            refusals = dict.fromkeys(paths, refusal)
            refused = PlannedOrder(intent, orders={}, refusals=refusals, held=self._held)
            return self.send(refused, is_by_mission=True)

        node = self._feed.bus.node
        orders = path_orders(kind, paths, self.new_order_id, self.author, node, self._clock_ns())
        orders = with_heard_stamps(orders, self._state)
        planned = PlannedOrder(intent, orders=orders, refusals={}, held=self._held)
        return self.send(self._without_other_files(planned), is_by_mission=True)

    def check_again(self, planned: PlannedOrder) -> PlannedOrder:
        """Check a planned order against the present fleet, and give its messages new stamps.

        The fleet may have moved since the order was planned.

        Args:
            planned: planned order, from :meth:`plan`.

        Returns:
            The same orders with the same goals, ready for :meth:`send`; or refusals instead.
        """
        refusal = self.control.refusal(planned.intent.verb)
        if refusal is not None:
            refusals = {**dict.fromkeys(planned.orders, refusal), **planned.refusals}
            return replace(planned, orders={}, refusals=refusals)
        checked = check_again(planned, self.fleet, self._state, self._clock_ns())
        return self._without_other_files(checked)

    def _without_other_files(self, planned: PlannedOrder) -> PlannedOrder:
        """Return a planned order, refused to vehicles that would fly with another fleet file."""
        return without_other_files(planned, self.fleet, self._state, self._clock_ns())

    def send(self, planned: PlannedOrder, *, is_by_mission: bool = False) -> OrderResult:
        """Send a planned order without a further check; callable from any thread.

        Args:
            planned: planned order, from :meth:`plan` or :meth:`check_again`, not older than the
                orders' deadline.
            is_by_mission: whether a mission, not a person, gives the order. A mission's order
                does not replace a person's order that this ground has not heard of, does not land
                vehicles that a pilot flies by hand, and does not go straight to PX4 when several
                vehicles are silent.

        Returns:
            Its results, which are filled in on the event loop.

        Raises:
            OrderError: a take-off in waves, which is more than one order.
        """
        if planned.orders:  # otherwise it is refused, and its values may be of wrong types
            refusal = waves_refusal(planned.intent)
            if refusal is not None:
                raise OrderError(refusal)

        # Any other order keeps what has been ordered since it was planned.
        if planned.orders and isinstance(planned.intent, Formation | Rotate):
            self._held = planned.held
        if not is_by_mission and planned.intent.verb in EMERGENCY:
            self.persons_stops += 1
        if is_by_mission:
            planned = of_mission(planned)
        else:
            ids = (order.order_id for order in planned.orders.values())
            self._persons_verbs.update(dict.fromkeys(ids, planned.intent.verb))
        return self._orders.send(planned, is_by_mission=is_by_mission)

    def persons_verb(self, order_id: str) -> str:
        """Return the verb of an order that a person gave at this ground; empty: there is none.

        Args:
            order_id: identifier of the order, as in telemetry.
        """
        return self._persons_verbs.get(order_id, "")

    def is_of_mission(self, order_id: str) -> bool:
        """Whether a mission of this ground has given an order.

        Args:
            order_id: identifier of the order, as in telemetry.
        """
        return order_id in self._orders.ids_of_missions

    def is_newest_of_mission(self, vehicle: str, order_id: str) -> bool:
        """Whether an order is the newest one that a mission of this ground has given a vehicle.

        Args:
            vehicle: name of the vehicle.
            order_id: identifier of an order of a mission.
        """
        return self._orders.newest_of_missions.get(vehicle) == order_id

    def newest_order(self, vehicle: str) -> OrderResult | None:
        """Return the newest order that a mission or a person at this ground has given a vehicle.

        Orders beside a flight, such as `pause` or `locate`, do not count.

        Args:
            vehicle: name of the vehicle.
        """
        return self._orders.newest.get(vehicle)

    def is_own(self, order_id: str) -> bool:
        """Whether this ground has given an order.

        Args:
            order_id: identifier of the order, as in telemetry.
        """
        return order_id.startswith(f"{self._feed.bus.node}-")

    def send_again(self, order: OrderResult, names: Sequence[str]) -> None:
        """Send an order once more to vehicles that have not answered it.

        The goals are checked against the present fleet.

        Args:
            order: order, from :meth:`send`.
            names: vehicles without an answer.
        """
        checked = self.check_again(order.planned)
        for name in names:
            if name in checked.refusals:
                order.update(name, "refused", checked.refusals[name])
        messages = {name: checked.orders[name] for name in names if name in checked.orders}
        self._orders.send_again(order, messages)

    def may_start(self, vehicle: str) -> bool:
        """Whether a vehicle may be about to start.

        This is so while an order of this client to arm or take off is open, or while the vehicle
        reports such an order.

        Args:
            vehicle: name of the vehicle.
        """
        view = self._state.vehicles[vehicle]
        telemetry = view.telemetry if view.is_fresh(self._clock_ns()) else None
        if telemetry is not None and telemetry.order_kind in _STARTS:
            return True
        return self._orders.has_open(vehicle, _STARTS)

    def has_open_landing(self, vehicle: str) -> bool:
        """Whether an order of this client to land was sent to a vehicle and has not ended.

        Args:
            vehicle: name of the vehicle.
        """
        return self._orders.has_open(vehicle, ("land",))

    async def submit(self, order: Intent | str, *, is_by_mission: bool = False) -> OrderResult:
        """Plan an order and send it at once.

        Args:
            order: an intent, or a line of the orders' grammar.
            is_by_mission: see :meth:`send`.

        Returns:
            Its results, which are filled in on the event loop.

        Raises:
            OrderError: the line is not an order.
        """
        return self.submit_now(order, is_by_mission=is_by_mission)

    def submit_now(self, order: Intent | str, *, is_by_mission: bool = False) -> OrderResult:
        """Plan an order and send it at once.

        Callable from any thread, even while the event loop is busy.

        Args:
            order: an intent, or a line of the orders' grammar.
            is_by_mission: see :meth:`send`.

        Returns:
            Its results, which are filled in on the event loop.

        Raises:
            OrderError: the line is not an order, or it is a take-off in waves.
        """
        return self.send(self.plan(order), is_by_mission=is_by_mission)

    async def order(
        self, order: Intent | str, timeout_s: float | None = None, *, is_by_mission: bool = False
    ) -> Results:
        """Submit an order and wait for its end.

        Args:
            order: an intent, or a line of the orders' grammar.
            timeout_s: longest wait [s]; None waits for ever.
            is_by_mission: see :meth:`send`.

        Returns:
            One result per vehicle.

        Raises:
            OrderError: the line is not an order.
        """
        sent = self.submit_now(order, is_by_mission=is_by_mission)
        results = await sent.wait(timeout_s)
        return explained(results, sent.planned, self.fleet, self._state, self._clock_ns())

    async def fault(
        self,
        name: str,
        vehicle: str,
        parameters: Mapping[str, float | str],
        *,
        after_s: float = 0.0,
        duration_s: float = 0.0,
        is_rehearsal: bool = False,
    ) -> str:
        """Inject a fault into the emulator.

        Args:
            name: name of the fault, as in the emulator's catalogue.
            vehicle: name of the vehicle.
            parameters: parameters of this fault.
            after_s: time from now until it begins, simulated seconds.
            duration_s: duration of the fault, simulated seconds; 0 for ever.
            is_rehearsal: whether the fault is only checked, and not injected.

        Returns:
            The emulator's sentence about the fault.

        Raises:
            FaultRefused: the fault is impossible, or no emulator answers, as in a real flight.
        """
        order = FaultOrder(
            order_id=self.new_order_id(),
            author=self.author,
            stamp_ns=self._clock_ns(),
            vehicle=vehicle,
            fault=name,
            parameters=dict(parameters),
            after_s=after_s,
            duration_s=duration_s,
            is_rehearsal=is_rehearsal,
        )
        sentence = await order_fault(self._feed, order)
        if not is_rehearsal:
            self.publish_event("warning", "fault", f"Fault ordered: {sentence}.", vehicle)
        return sentence

    def new_order_id(self) -> str:
        """Return an id that no other order has."""
        # no other ground has this node's name
        return f"{self._feed.bus.node}-{next(self._order_count)}"

    # -- the state ---------------------------------------------------------------------------------

    async def listen(self) -> None:
        """Wait until a vehicle that the fleet file lacks would have been heard, too.

        Nothing else waits for such a vehicle. On a simulated bus there is none.
        """
        if self._heard_since_ns is None or self._feed.bus.is_simulated:
            return
        listened_s = (self._clock_ns() - self._heard_since_ns) * 1e-9
        if listened_s < _LISTEN_S:
            await self.wait_for(lambda state: bool(state.unlisted_up), _LISTEN_S - listened_s)

    async def wait_for(self, condition: Callable[[FleetState], bool], timeout_s: float) -> bool:
        """Wait until the state meets a condition.

        Args:
            condition: tested after every batch of messages, and five times a second without one.
            timeout_s: longest wait [s].

        Returns:
            Whether the condition was met in time.
        """
        try:
            async with asyncio.timeout(timeout_s):
                while not condition(self._state):
                    self._changed.clear()
                    try:
                        async with asyncio.timeout(_AGE_PERIOD_S):
                            await self._changed.wait()
                    except TimeoutError:
                        pass
        except TimeoutError:
            return condition(self._state)
        return True

    def notice_own_stall(self) -> None:
        """If this ground itself stood still, publish an event and excuse silent vehicles.

        Before the first telemetry of any vehicle no event is published. Call this method several
        times a second.
        """
        if self._short_stall.stalled_s():
            self._excuse_silence(AFTER_LATE_S)

        gap_s = self._stall.stalled_s()
        if not gap_s:
            return

        self._excuse_silence(AFTER_STALL_S)
        if not self._state.is_anybody_heard:
            return

        sentence = (
            f"This ground itself stood still for {gap_s:.1f} s: the record has a gap, and the "
            "smallest distance of that time is not known. Silent vehicles are waited for, "
            f"{AFTER_STALL_S:g} s."
        )
        self.publish_event("warning", GROUND_STALLED, sentence)

    def _notice_lateness(self) -> None:
        """Note how late this delivery is, and whether this ground stood still."""
        self._loop_lateness.note_delivery()
        late_s = round(self._loop_lateness.worst_s, 2)
        if late_s != self._state.loop_late_s:
            self._state = structs.replace(self._state, loop_late_s=late_s)
        self.notice_own_stall()

    def notice_own_link(self) -> None:
        """Note that this ground's own link is back, so that silence counts only some time later."""
        self._excuse_silence(AFTER_STALL_S)

    def _excuse_silence(self, duration_s: float) -> None:
        """Let silence count again only after this time [s], or after a longer one from before."""
        from_ns = self._clock_ns() + round(duration_s * 1e9)
        if from_ns > self._state.silence_counts_from_ns:
            self._state = structs.replace(self._state, silence_counts_from_ns=from_ns)

    def publish_event(
        self, severity: str, code: str, sentence: str, vehicle: str = "ground"
    ) -> None:
        """Put an event of the ground itself into the state, the log and the record.

        Callable from any thread.

        Args:
            severity: debug, info, warning or critical.
            code: the event's kind.
            sentence: text for people.
            vehicle: name of the vehicle that the event is about.
        """
        event = Event(
            vehicle=vehicle,
            stamp_ns=self._clock_ns(),
            severity=severity,  # type: ignore[arg-type]
            code=code,
            sentence=sentence,
        )
        self.tell(Topic.EVENT, vehicle, event)

    def tell(self, topic: Topic, vehicle: str, message: Message) -> None:
        """Put a message of the ground itself into the state and the record.

        Callable from any thread.
        """
        self._feed.tell_sinks(topic, vehicle, message)
        self._feed.put(message)

    def forget_formation(self) -> None:
        """Hold the first formation of the fleet file again, as before the first order."""
        self._held = HeldFormation(default_formation(self.fleet))

    def hold_formation(self, held: HeldFormation) -> None:
        """Hold a formation that vehicles have taken up along paths.

        Args:
            held: the formation at the end of the paths.
        """
        self._held = held

    def forget_earlier_flights(self) -> None:
        """Forget smallest distances and refused laws so far; a mission counts only its own."""
        self._state = without_earlier_flights(self._state)

    def forget_silent(self, name: str) -> bool:
        """Forget a vehicle that the fleet file lacks, if it is silent; return whether it was.

        Args:
            name: the vehicle's name as it is shown.
        """
        before = self._state
        self._state = without_silent(before, name, self._clock_ns())
        return self._state.unlisted != before.unlisted

    def _take_batch(self, batch: Sequence[ReceivedMessage]) -> None:
        """Fold a batch into the state, update the control, end orders, and call the listeners."""
        now_ns = self._clock_ns()
        state = fold_batch(self._state, batch, now_ns)
        self._state = state
        if self._heard_since_ns is None and state.is_anybody_heard:
            self._heard_since_ns = now_ns
        if now_ns >= self._control_due_ns:
            self._control_due_ns = now_ns + CONTROL_PERIOD_NS
            self.control.update(state)

        self._changed.set()
        for item, _ in batch:
            if isinstance(item, Event):
                self._orders.end(item)
                for event_listener in self._event_listeners:
                    event_listener(item)
        for listener in self._listeners:
            listener(state)


def waves_refusal(intent: Intent) -> str | None:
    """Return why an intent cannot be sent as one order; None if it can.

    Args:
        intent: intent of any verb.
    """
    if isinstance(intent, Takeoff) and len(intent.waves) > 1:
        return (
            "A take-off in waves takes its time: order it in the console, by a step of a "
            "mission, or in Python, or leave 'by' out."
        )
    return None
