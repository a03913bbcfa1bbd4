"""The ground's end of the bus: messages in, :class:`FleetState` out, orders with one result per vehicle.

What comes often waits on the bus until the loop takes all of it, fifty times a second: to be woken for each message
costs more than the messages. Bus threads bring the rest; they only append to a bounded queue and wake the loop once.
Everything else runs on the event loop.
"""

from __future__ import annotations

import asyncio
import getpass
import itertools
import os
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence

from groundstation.client.direct_mavlink import DirectKind, DirectResult, send_direct
from groundstation.fleet import state as fleet_state
from groundstation.fleet.control_authority import Control
from groundstation.fleet.state import DIRECT_DISARMED, FleetState
from groundstation.fleet.tick_stream import BusTicks
from groundstation.orders import grammar as orders_
from groundstation.orders.grammar import Intent, Plan
from groundstation.orders.result import OrderHandle, Phase, VehicleResult
from onboard.bus.clock_sync import ClockNode
from onboard.bus.codec import Malformed
from onboard.bus.protocol import Bus
from onboard.bus.schema import Event, FaultOrder, Message, Order, OrderReply, Telemetry, Truth
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, Vehicle

MAX_QUEUED = 20_000
REPLY_TIMEOUT_S = 1.5
CONTROL_PERIOD_NS = 100_000_000
DELIVERY_PERIOD_S = 0.02
_IN_BATCHES = (Topic.TELEMETRY, Topic.TRUTH, Topic.STATE, Topic.TICK, Topic.MOCAP)
DIRECT_LAND_WATCH_S = 30.0

Sink = Callable[[Topic, str, Message, int], None]
Direct = Callable[..., DirectResult]


class FaultRefused(RuntimeError):
    """A fault was not injected: a sentence that says why."""


class FleetClient:
    """Follow a fleet and give it orders.

    Args:
        fleet: the fleet file.
        author: who orders; written into every order and every record.
        bus: for tests; by default a session that connects to all agents and the emulator and listens nowhere.
        operates: take control of the fleet when nobody has it; without, only watch (see
            :mod:`groundstation.fleet.control_authority`).
        extra_topics: topics that only sinks want (the recorder's state, tick and mocap).
        send: for tests; the direct way to PX4.
        clock_ns, new_id: the clock and the names of orders, where time is simulated and nothing may be random.
    """

    def __init__(
        self,
        fleet: FleetConfig,
        *,
        author: str | None = None,
        operates: bool = True,
        bus: Bus | None = None,
        extra_topics: Sequence[Topic] = (),
        send: Direct = send_direct,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        new_id: Callable[[], str] = orders_.random_id,
    ) -> None:
        self.fleet = fleet
        self.author = author or _user()
        self.formation = orders_.default_formation(fleet)
        self.spacing_m: float | None = None
        self._bus = bus or BusSession(
            namespace=fleet.namespace,
            node=f"ground-{os.getpid()}-{orders_.random_id()[:4]}",
            connect=[*(fleet.vehicles[name].agent for name in fleet.enabled_names), fleet.simulator_endpoint],
        )
        self._topics = (Topic.TELEMETRY, Topic.EVENT, Topic.TRUTH, Topic.PREFLIGHT)
        self._extra = tuple(topic for topic in extra_topics if topic not in self._topics)
        self._send = send
        self._clock_ns = clock_ns
        self._new_id = new_id
        self._state = fleet_state.initial(fleet)
        self._inbox: deque[tuple[Message | Malformed | tuple[str, bool], int]] = deque(maxlen=MAX_QUEUED)
        self._is_woken = False
        self._loop: asyncio.AbstractEventLoop | None = None
        self._delivery: asyncio.TimerHandle | None = None
        self._sinks: list[Sink] = []
        self._listeners: list[Callable[[FleetState], None]] = []
        self._event_listeners: list[Callable[[Event], None]] = []
        self._handles: dict[str, OrderHandle] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._changed = asyncio.Event()
        self._fault_count = itertools.count()
        self.control = Control(
            self._bus,
            self.author,
            wants=operates,
            say=lambda severity, sentence: self.publish_event(severity, "operator", sentence),
            clock_ns=clock_ns,
        )
        self._look_ns = 0
        self.ticks = BusTicks(self._bus)

    @property
    def state(self) -> FleetState:
        """The fleet as known now."""
        return self._state

    @property
    def is_started(self) -> bool:
        """Whether the bus is open."""
        return self._loop is not None

    def now_ns(self) -> int:
        """The ground's monotonic clock, which ages in the state are counted on."""
        return self._clock_ns()

    def add_sink(self, sink: Sink) -> None:
        """Call ``sink(topic, name, message, received_ns)`` for everything heard and ordered, on any thread."""
        self._sinks.append(sink)

    def add_listener(self, listener: Callable[[FleetState], None]) -> None:
        """Call ``listener(state)`` on the loop after each batch of messages."""
        self._listeners.append(listener)

    def add_event_listener(self, listener: Callable[[Event], None]) -> None:
        """Call ``listener(event)`` on the loop for each event, the ground's own included."""
        self._event_listeners.append(listener)

    async def start(self) -> None:
        """Open the bus; a second call does nothing. BusError when it cannot be opened."""
        if self._loop is not None:
            return
        self._loop = asyncio.get_running_loop()
        await asyncio.to_thread(self._open)
        if not self._bus.is_simulated:  # agents on other hosts need our clock to judge an order's deadline
            self._tasks.add(self._loop.create_task(ClockNode(self._bus).keep()))
            self._take_delivery(self._bus, self._loop)

    async def stop(self) -> None:
        """Leave the bus; orders still waiting for an answer get none. A second call does nothing."""
        if self._loop is None:
            return
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._delivery is not None:
            self._delivery.cancel()
        self.ticks.stop()
        await asyncio.to_thread(self._bus.stop)
        self._loop = None

    def tell_recording(self, is_on: bool) -> None:
        """Let the vehicles' preflight see that this ground records, or no longer; any thread, while the bus is open."""
        (self._bus.claim if is_on else self._bus.release)(f"recorder-{self._bus.node}")

    def plan(self, order: Intent | str) -> Plan:
        """What an order would send now, or why not; nothing is sent.

        Raises:
            OrderError: the text is no order.
        """
        intent = orders_.parse(order, self.fleet) if isinstance(order, str) else order
        refusal = self.control.refusal(intent.verb)
        if refusal is not None:
            return Plan(intent, {}, dict.fromkeys(intent.vehicles, refusal), self.formation, self.spacing_m)
        return orders_.plan(
            intent,
            self.fleet,
            self._state,
            formation=self.formation,
            spacing_m=self.spacing_m,
            author=self.author,
            node=self._bus.node,
            now_ns=self._clock_ns(),
            new_id=self._new_id,
        )

    async def submit(self, order: Intent | str) -> OrderHandle:
        """Check and send an order; returns at once with a handle whose results fill in.

        Raises:
            OrderError: the text is no order.
        """
        return self.submit_now(order)

    def submit_now(self, order: Intent | str) -> OrderHandle:
        """As :meth:`submit`, from any thread: a loop that is busy holds up only what becomes of the order."""
        plan = self.plan(order)
        self.formation, self.spacing_m = plan.formation, plan.spacing_m
        handle = OrderHandle(plan.intent, plan)
        for vehicle, sent in plan.orders.items():
            self._handles[sent.order_id] = handle
            self._tell_sinks(Topic.ORDER, vehicle, sent)
        # all leave before anybody is waited for: the last of a hundred shall not stand behind the others' bookkeeping
        asked = [(vehicle, sent, self._ask(handle, vehicle, sent)) for vehicle, sent in plan.orders.items()]
        for vehicle, sent, answered in asked:
            self._call(self._begin_watch, handle, vehicle, sent, answered)
        return handle

    async def order(self, order: Intent | str, timeout_s: float | None = None) -> dict[str, VehicleResult]:
        """Submit and wait for the end: one result per vehicle."""
        handle = await self.submit(order)
        return await handle.wait(timeout_s)

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
        """Let something go wrong in the emulator; what it says of it. With `is_rehearsal` only whether it could be.

        Raises:
            FaultRefused: impossible, or no emulator answers: a real flight has no faults to order.
        """
        order = FaultOrder(
            order_id=f"fault-{next(self._fault_count)}",
            author=self.author,
            stamp_ns=self._clock_ns(),
            vehicle=vehicle,
            fault=name,
            parameters=dict(parameters),
            after_s=after_s,
            duration_s=duration_s,
            is_rehearsal=is_rehearsal,
        )
        answered = asyncio.Event()
        replies: list[OrderReply | Malformed] = []

        def on_reply(reply: OrderReply | Malformed) -> None:
            replies.append(reply)
            self._call(answered.set)

        self._bus.fault(order, timeout_s=REPLY_TIMEOUT_S, on_reply=on_reply, on_end=lambda: self._call(answered.set))
        await answered.wait()
        reply = next((reply for reply in replies if isinstance(reply, OrderReply)), None)
        if reply is None:
            raise FaultRefused(
                f"{vehicle}: no emulator answers on the bus, so '{name}' was not injected. Faults are for simulated "
                "flights only: fly with --sitl or in lockstep, or remove the fault from the mission."
            )
        if not reply.is_accepted:
            raise FaultRefused(f"{vehicle}: {reply.reason}")
        if not is_rehearsal:
            self.publish_event("warning", "fault", f"Fault ordered: {reply.reason}.", vehicle)
        return reply.reason

    async def wait_for(self, condition: Callable[[FleetState], bool], timeout_s: float) -> bool:
        """Wait until the state meets a condition; False when it did not within ``timeout_s``."""
        try:
            async with asyncio.timeout(timeout_s):
                while not condition(self._state):
                    self._changed.clear()
                    try:
                        async with asyncio.timeout(0.2):  # ages change the state without any message
                            await self._changed.wait()
                    except TimeoutError:
                        pass
        except TimeoutError:
            return condition(self._state)
        return True

    def publish_event(self, severity: str, code: str, sentence: str, vehicle: str = "ground") -> None:
        """An event of the ground itself: into the state, the log and the record; callable from any thread."""
        event = Event(
            vehicle=vehicle,
            stamp_ns=self._clock_ns(),
            severity=severity,  # type: ignore[arg-type]
            code=code,
            sentence=sentence,
        )
        self._tell_sinks(Topic.EVENT, vehicle, event)
        self._put(event)

    # -- bus threads ---------------------------------------------------------------------------------------------

    def _open(self) -> None:
        self._bus.start()
        for topic in (*self._topics, *self._extra):
            if topic in _IN_BATCHES:
                self._bus.collect(topic, "*", self._receive, most=MAX_QUEUED)
            else:
                self._bus.subscribe(topic, "*", self._receive)
        self._bus.watch_alive(lambda node, is_alive: self._put((node, is_alive)))

    def _receive(self, topic: Topic, name: str, message: Message | Malformed) -> None:
        if not isinstance(message, Malformed):
            if getattr(message, "vehicle", name) != name:
                message = Malformed(f"a message of another vehicle on {topic.value}/{name}", 0)
            else:
                self._tell_sinks(topic, name, message)
        if isinstance(message, Malformed) or topic in self._topics:
            self._put(message)

    def _tell_sinks(self, topic: Topic, name: str, message: Message) -> None:
        now_ns = self._clock_ns()
        for sink in self._sinks:
            sink(topic, name, message, now_ns)

    def _put(self, item: Message | Malformed | tuple[str, bool]) -> None:
        self._inbox.append((item, self._clock_ns()))
        loop = self._loop
        if loop is None or self._is_woken:
            return
        self._is_woken = True
        self._call(self._drain)

    def _call(self, function: Callable[..., None], *args: object) -> None:
        loop = self._loop
        if loop is not None and not loop.is_closed():
            try:
                loop.call_soon_threadsafe(function, *args)
            except RuntimeError:
                return  # the loop closed between the two lines: nobody is left to tell

    # -- event loop ----------------------------------------------------------------------------------------------

    def _take_delivery(self, bus: Bus, loop: asyncio.AbstractEventLoop) -> None:
        self._delivery = loop.call_later(DELIVERY_PERIOD_S, self._take_delivery, bus, loop)
        bus.deliver()

    def _drain(self) -> None:
        self._bus.deliver()  # whoever hears of an order's end finds the state that it led to already there
        self._is_woken = False
        state = self._state
        events: list[Event] = []
        truths: list[Truth] = []
        heard: list[tuple[Telemetry, int]] = []
        for _ in range(len(self._inbox)):
            item, received_ns = self._inbox.popleft()
            if isinstance(item, tuple):
                state = fleet_state.fold_alive(state, *item)
            elif isinstance(item, Malformed):
                state = fleet_state.fold_malformed(state)
            elif isinstance(item, Telemetry):  # of all vehicles at once: there are as many pairs as their square
                heard.append((item, received_ns))
            elif isinstance(item, Truth):
                truths.append(item)
            else:
                state = fleet_state.fold(state, item, received_ns)
                if isinstance(item, Event):
                    events.append(item)
        if heard:
            state = fleet_state.fold_telemetry(state, heard)
        if truths:
            state = fleet_state.fold_truths(state, truths, self._clock_ns())
        self._state = state
        if (now_ns := self._clock_ns()) >= self._look_ns:
            self._look_ns = now_ns + CONTROL_PERIOD_NS
            self.control.look(state)
        self._changed.set()
        for event in events:
            self._end_order(event)
            for listen in self._event_listeners:
                listen(event)
        for listener in self._listeners:
            listener(state)

    def _end_order(self, event: Event) -> None:
        handle = self._handles.get(event.order_id)
        if handle is None or not event.order_outcome or event.vehicle not in handle.plan.orders:
            return
        if handle.plan.orders[event.vehicle].order_id != event.order_id:
            return
        if handle.results[event.vehicle].phase == "direct" and event.order_outcome != "done":
            return  # the agent came back to an order that is PX4's now: what PX4 says ends it
        handle.update(event.vehicle, event.order_outcome, event.sentence)
        if handle.results[event.vehicle].is_final:
            self._handles.pop(event.order_id, None)

    def _ask(self, handle: OrderHandle, vehicle: str, order: Order) -> asyncio.Event:
        answered = asyncio.Event()

        def on_reply(reply: OrderReply | Malformed) -> None:
            if isinstance(reply, OrderReply) and reply.vehicle == vehicle:
                self._tell_sinks(Topic.ORDER, vehicle, reply)
            self._call(self._answer, handle, vehicle, reply, answered)

        def on_end() -> None:
            return

        self._bus.order(vehicle, order, timeout_s=REPLY_TIMEOUT_S, on_reply=on_reply, on_end=on_end)
        return answered

    def _begin_watch(self, handle: OrderHandle, vehicle: str, order: Order, answered: asyncio.Event) -> None:
        task = asyncio.get_running_loop().create_task(self._watch(handle, vehicle, order, answered))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _answer(
        self, handle: OrderHandle, vehicle: str, reply: OrderReply | Malformed, answered: asyncio.Event
    ) -> None:
        if isinstance(reply, Malformed):
            self._put(reply)
        elif reply.vehicle == vehicle and reply.order_id == handle.plan.orders[vehicle].order_id:
            answered.set()
            if handle.results[vehicle].phase == "direct":
                return
            handle.update(vehicle, "accepted" if reply.is_accepted else "refused", reply.reason)

    async def _watch(self, handle: OrderHandle, vehicle: str, order: Order, answered: asyncio.Event) -> None:
        limit_s = self.fleet.fleet.direct_command_timeout_s
        is_urgent = order.kind in ("land", "kill")
        try:
            async with asyncio.timeout(limit_s if is_urgent else max(limit_s, REPLY_TIMEOUT_S)):
                await answered.wait()
            return
        except TimeoutError:
            pass
        config = self.fleet.vehicles[vehicle]
        if order.kind == "land":
            await self._send_directly(handle, config, "land", limit_s)
        elif order.kind == "kill":
            await self._send_directly(handle, config, "kill", limit_s)
        else:
            handle.update(
                vehicle,
                "no answer",
                f"{vehicle}'s agent did not answer within {max(limit_s, REPLY_TIMEOUT_S):g} s. Is it running?",
            )

    async def _send_directly(self, handle: OrderHandle, vehicle: Vehicle, kind: DirectKind, limit_s: float) -> None:
        silence = f"{vehicle.name}'s agent did not answer within {limit_s:g} s"
        if vehicle.direct is None:
            handle.update(
                vehicle.name, "no answer", f"{silence}, and the fleet file gives no direct endpoint. Use the RC switch."
            )
            return
        sentence = f"{silence}; {kind} goes straight to PX4 at {vehicle.direct}."
        handle.update(vehicle.name, "direct", sentence)
        self.publish_event("warning", "direct_command", sentence, vehicle.name)
        watch_s = 2.0 if kind == "kill" else DIRECT_LAND_WATCH_S
        result = await asyncio.to_thread(
            self._send, vehicle.direct, vehicle.system_id, kind, timeout_s=3.0, watch_s=watch_s
        )
        sentence = f"{silence}; {kind} was sent straight to PX4: {result.sentence}."
        is_done = result.is_accepted and result.is_disarmed
        phase: Phase = "done" if is_done else "failed"
        code = DIRECT_DISARMED if result.is_disarmed else "direct_result"
        self.publish_event("warning" if is_done else "critical", code, sentence, vehicle.name)
        handle.update(vehicle.name, phase, sentence)


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return f"uid-{os.getuid()}"
