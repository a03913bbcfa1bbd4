"""Orders that have been sent and have not ended: replies, deadlines, and the direct path to PX4.

An order goes to the vehicle's agent, which replies at once and reports the end later by an event.
Three things can be missing, and each is watched for:

* The reply. Most orders end with "no answer". Land and kill go straight to PX4 instead: a kill
  soon, a landing only after it was sent to the agent several times, because vehicles that PX4 lands
  alone do not avoid each other. A mission's landing goes to PX4 only if a single vehicle is silent;
  two that fall silent at once show that this ground has lost its own link. An agent that is heard
  lives, and only its link is bad: a mission repeats the landing to it for longer.
* The effect of a land or a kill that was accepted. Such an order then goes straight to PX4, too. It
  goes at once if the agent reports that it does not hear PX4.
* The event about the end, because a link broke. Telemetry then shows that the vehicle no longer
  follows the order.

Time in which this ground itself stood still does not count, and neither does time in which its
computer was too busy to run it.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Callable, Collection, Mapping
from functools import partial

from groundstation.client.bus_feed import BusFeed
from groundstation.client.direct_mavlink import DirectCommand, DirectKind, SendDirect
from groundstation.client.scheduled_wait import LONGEST_LATE_S, wait_scheduled
from groundstation.fleet.descent import descent_s
from groundstation.fleet.own_stall import OwnStall
from groundstation.fleet.state import DIRECT_DISARMED, VehicleView
from groundstation.orders.plan import PlannedOrder, stamped_anew
from groundstation.orders.result import OrderResult, Phase, VehicleResult
from onboard.bus.codec import Malformed
from onboard.bus.schema import BESIDE, Event, Order, OrderReply
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.safety.failsafe_table import Condition

REPLY_TIMEOUT_S = 1.5
# If the telemetry of a vehicle that followed an order does not name the order for this time, the
# order has ended.
LOST_END_S = 3.0
_LAND_REPLY_S = 1.0  # shortest wait for the reply to a landing
_WAIT_ROUND_TRIPS = 3.0  # a landing waits for its reply for at least this many round trips
_AGAIN_ROUND_TRIPS = 1.5  # a landing is sent again after at least this many round trips
_MAX_ROUND_TRIPS = 8  # newest round trips of a vehicle that are kept
# Longest time that a mission's landing is repeated to an agent that is heard and does not answer.
_REPEAT_TO_HEARD_S = 6.0
_HEARD_S = 1.0  # age of telemetry up to which an agent counts as heard, over a link that loses much
_QUIET_S = 0.5  # age of telemetry from which another vehicle in flight counts as silent as well
_AT_ONCE_S = 1.0  # vehicles that fall silent within this time do so for the same reason
_KILL_EFFECT_S = 1.3  # longest wait for the disarm, which PX4 reports once a second
_LINK_SILENT_S = 1.0  # age of PX4's last packet at the agent, after which its link counts as dead
_NOTHING_S = 1e-6  # remaining wait that is only a rounding error
_WATCH_PERIOD_S = 0.05
_READ_AGAIN_S = 0.2  # time in which threads of the bus deliver waiting messages after a late wait
_SEND_S = 3.0  # longest wait for PX4's own acknowledgement
_WATCH_KILL_S = 2.0  # longest wait for PX4's own report that it is disarmed
_WATCH_LAND_S = 30.0  # longest wait for that report after a landing, plus the time of the descent
_MAX_UNANSWERED = 1000  # orders without an answer whose late reply still counts
_DIRECT: dict[str, DirectKind] = {"land": "land", "kill": "kill"}
_WITHOUT_GROUND = (
    "Its agent goes on without the ground; one that hangs has left the landing to PX4."
)

PublishEvent = Callable[[str, str, str, str], None]  # severity, code, sentence, vehicle


class OpenOrders:
    """The orders of one client.

    Args:
        fleet: the fleet file.
        feed: the client's side of the bus.
        send_direct: coroutine function that sends a command straight to PX4.
        publish_event: function that publishes an event of the ground.
        views: function that returns the vehicles as known now.
        stall_clock_ns: a clock that keeps running while this computer sleeps [ns].
        mavlink_keys: keys of the vehicles whose MAVLink is signed.
    """

    def __init__(
        self,
        fleet: FleetConfig,
        feed: BusFeed,
        *,
        send_direct: SendDirect,
        publish_event: PublishEvent,
        views: Callable[[], Mapping[str, VehicleView]],
        stall_clock_ns: Callable[[], int],
        mavlink_keys: Mapping[str, bytes] = {},
    ) -> None:
        self._fleet = fleet
        self._feed = feed
        self._send_direct = send_direct
        self._publish_event = publish_event
        self._views = views
        self._stall_clock_ns = stall_clock_ns
        self._mavlink_keys = mavlink_keys
        self._open: dict[str, OrderResult] = {}  # order id -> result
        self._unanswered: deque[str] = deque()  # ids of orders that ended with "no answer"
        # vehicle -> times from an order to its reply [s], the newest last
        self._round_trips_s: dict[str, tuple[float, ...]] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        # vehicle -> sentences said about landings that a mission sent straight to PX4; kept until
        # the vehicle is down
        self._said_of_direct: dict[str, set[str]] = {}
        self._unable: dict[str, str] = {}  # id of a land or kill -> why its agent cannot do it
        self.ids_of_missions: set[str] = set()  # ids of all orders of this ground's missions
        # vehicle -> newest order here that ends others, and id of the newest one of missions
        self.newest: dict[str, OrderResult] = {}
        self.newest_of_missions: dict[str, str] = {}

    def send(self, planned: PlannedOrder, *, is_by_mission: bool = False) -> OrderResult:
        """Send the messages of a planned order; callable from any thread.

        Args:
            planned: order that was checked just now.
            is_by_mission: whether a mission, not a person, gives it.

        Returns:
            Its results, which are filled in on the event loop.
        """
        result = OrderResult(planned, is_by_mission=is_by_mission)
        if is_by_mission:
            self.ids_of_missions.update(order.order_id for order in planned.orders.values())
        for vehicle, order in planned.orders.items():
            if order.kind not in BESIDE:
                self.newest[vehicle] = result
                if is_by_mission:
                    self.newest_of_missions[vehicle] = order.order_id
            self._open[order.order_id] = result
            self._feed.tell_sinks(Topic.ORDER, vehicle, order)

        # All messages are sent before the first wait begins, so that the last of a hundred is not
        # delayed by the bookkeeping for the others.
        replied = {}
        for vehicle, order in planned.orders.items():
            replied[vehicle] = asyncio.Event()
            self._send(result, vehicle, order, replied[vehicle])
        for vehicle, event in replied.items():
            self._feed.call(self._begin_wait, result, vehicle, event)
        return result

    def send_again(self, result: OrderResult, orders: Mapping[str, Order]) -> None:
        """Send orders without an answer once more.

        An agent that has the order already does not begin it a second time.

        Args:
            result: result of the order.
            orders: vehicle without an answer -> the same message with a new stamp.
        """
        for vehicle, order in orders.items():
            result.update(vehicle, "sent", "sent again")
            self._open[order.order_id] = result
            self._feed.tell_sinks(Topic.ORDER, vehicle, order)
            replied = asyncio.Event()
            self._send(result, vehicle, order, replied)
            self._begin_wait(result, vehicle, replied)

    def has_open(self, vehicle: str, kinds: Collection[str]) -> bool:
        """Whether an order of one of these kinds was sent to a vehicle and has not ended.

        Args:
            vehicle: name of the vehicle.
            kinds: kinds of orders, as on the bus.
        """
        # a copy, because the thread that reads the terminal may send an order meanwhile
        for result in list(self._open.values()):
            order = result.planned.orders.get(vehicle)
            if order is None or order.kind not in kinds:
                continue
            if not result.results[vehicle].is_final:
                return True
        return False

    def end(self, event: Event) -> None:
        """Note the end of an order if an event reports one.

        Args:
            event: any event of the fleet.
        """
        result = self._open.get(event.order_id)
        if result is None or not event.order_outcome:
            return
        order = result.planned.orders.get(event.vehicle)
        if order is None or order.order_id != event.order_id:
            return
        before = result.results[event.vehicle]
        if before.phase == "direct" and event.order_outcome != "done":
            return  # the agent is late: PX4 has the order now, and PX4's answer ends it
        has_failed = event.order_outcome == "failed" and not before.is_final
        if has_failed and self._has_lost_px4(event.vehicle, order):
            self._unable[order.order_id] = event.sentence
            return  # the order goes straight to PX4

        result.update(event.vehicle, event.order_outcome, event.sentence)
        if result.results[event.vehicle].is_final:
            self._open.pop(event.order_id, None)

    def _view(self, vehicle: str) -> VehicleView:
        """Return a vehicle as known now, even a silent one that the fleet file disables."""
        return self._views().get(vehicle, VehicleView(vehicle))

    def _has_lost_px4(self, vehicle: str, order: Order) -> bool:
        """Whether an armed vehicle's agent does not hear PX4, although PX4 can take the order."""
        telemetry = self._view(vehicle).telemetry
        if telemetry is None or order.kind not in _DIRECT:
            return False
        if not telemetry.is_armed:
            return False
        is_silent = Condition.AUTOPILOT_SILENT.value in telemetry.conditions
        return is_silent or telemetry.autopilot_age_s > _LINK_SILENT_S

    async def stop(self) -> None:
        """Stop waiting for replies."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    # -- the reply ---------------------------------------------------------------------------------

    def _send(
        self,
        result: OrderResult,
        vehicle: str,
        order: Order,
        replied: asyncio.Event,
        *,
        does_refusal_count: bool = True,
    ) -> None:
        """Send one message, whose reply sets the event, and measure its round trip."""
        if self._feed.is_without_bus:
            send = partial(self._send_late, result, vehicle, replied)
            self._feed.call_when_open((order.order_id, vehicle), send)
            return
        sent_ns = self._feed.now_ns()

        def on_reply(reply: OrderReply | Malformed) -> None:
            round_trip_s = (self._feed.now_ns() - sent_ns) * 1e-9
            if isinstance(reply, OrderReply) and reply.vehicle == vehicle:
                self._feed.tell_sinks(Topic.ORDER, vehicle, reply)
                self._feed.call(self._note_round_trip, vehicle, round_trip_s)
                if not reply.is_accepted and not does_refusal_count:
                    # The agent may refuse because it has the order already; telemetry shows that.
                    return
            self._feed.call(self._take_reply, result, vehicle, reply, replied)

        self._feed.bus.order(
            vehicle,
            order,
            timeout_s=max(REPLY_TIMEOUT_S, self._land_limit_s(vehicle)) + LONGEST_LATE_S,
            on_reply=on_reply,
            on_end=lambda: None,
        )

    def _send_late(self, result: OrderResult, vehicle: str, replied: asyncio.Event) -> None:
        """Send an order that was given before the bus was open, unless it has ended."""
        if not result.results[vehicle].is_final:
            order = stamped_anew(result.planned.orders[vehicle], self._feed.now_ns())
            self._send(result, vehicle, order, replied, does_refusal_count=False)

    def _note_round_trip(self, vehicle: str, round_trip_s: float) -> None:
        earlier_s = self._round_trips_s.get(vehicle, ())
        # Other threads read the tuple, so it is replaced as a whole.
        self._round_trips_s[vehicle] = (*earlier_s, round_trip_s)[-_MAX_ROUND_TRIPS:]

    def _longest_round_trip_s(self, vehicle: str) -> float:
        """Return the longest of the newest round trips [s]; 0 without an answer so far."""
        return max(self._round_trips_s.get(vehicle, ()), default=0.0)

    def _land_limit_s(self, vehicle: str) -> float:
        """Return the time that a landing waits for the agent before it goes straight to PX4 [s]."""
        return max(
            _LAND_REPLY_S,
            self._fleet.fleet.direct_command_timeout_s,
            _WAIT_ROUND_TRIPS * self._longest_round_trip_s(vehicle),
        )

    def _take_reply(
        self,
        result: OrderResult,
        vehicle: str,
        reply: OrderReply | Malformed,
        replied: asyncio.Event,
    ) -> None:
        """Note an agent's reply: accepted or refused."""
        if isinstance(reply, Malformed):
            self._feed.put(reply)
            return
        order = result.planned.orders[vehicle]
        if reply.vehicle != vehicle or reply.order_id != order.order_id:
            return

        replied.set()
        if result.results[vehicle].phase == "direct":
            return

        phase: Phase = "refused"
        if reply.is_accepted:
            phase = "accepted"
        elif order.kind == "kill":
            # An agent refuses a kill only if it does not trust the order. The order is from this
            # ground, so it goes straight to PX4.
            phase = "direct"
        result.update(vehicle, phase, reply.reason)

    def _begin_wait(self, result: OrderResult, vehicle: str, replied: asyncio.Event) -> None:
        task = asyncio.get_running_loop().create_task(self._watch_to_end(result, vehicle, replied))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _watch_to_end(
        self, result: OrderResult, vehicle: str, replied: asyncio.Event
    ) -> None:
        """Wait for the reply to an order, then for its end.

        A land or kill goes straight to PX4 if its reply or its effect is missing.
        """
        order = result.planned.orders[vehicle]
        direct = _DIRECT.get(order.kind)
        if direct is None:
            await self._watch_other_order(result, vehicle, replied)
        else:
            await self._watch_land_or_kill(result, vehicle, replied, direct)
        self._forget(order.order_id, result.results[vehicle])

    def _forget(self, order_id: str, result: VehicleResult) -> None:
        """Forget an order that has ended; of those without an answer, forget only the oldest.

        A late reply may still replace "no answer".
        """
        if result.phase != "no answer":
            self._open.pop(order_id, None)
            return

        self._unanswered.append(order_id)
        if len(self._unanswered) > _MAX_UNANSWERED:
            oldest_id = self._unanswered.popleft()
            self._open.pop(oldest_id, None)

    async def _watch_other_order(
        self, result: OrderResult, vehicle: str, replied: asyncio.Event
    ) -> None:
        """Wait for the reply to an order that has no direct path, then watch for its end."""
        limit_s = max(self._fleet.fleet.direct_command_timeout_s, REPLY_TIMEOUT_S)
        if await self._wait_for_reply(result, vehicle, replied, limit_s):
            await self._watch_for_lost_end(result, vehicle)
        else:
            problem = _no_answer_words(vehicle, limit_s)
            result.update(vehicle, "no answer", f"{problem}. Is it running?")

    async def _watch_land_or_kill(
        self, result: OrderResult, vehicle: str, replied: asyncio.Event, kind: DirectKind
    ) -> None:
        """Wait for reply and effect of a land or kill; if one is missing, send it to PX4."""
        if kind == "land":
            has_reply, waited_s = await self._wait_for_reply_to_land(result, vehicle, replied)
        else:
            waited_s = self._fleet.fleet.direct_command_timeout_s
            has_reply = await self._wait_for_reply(result, vehicle, replied, waited_s)

        if not has_reply:
            problem = self._problem_of_silence(result, vehicle, kind, waited_s)
        elif result.results[vehicle].phase == "direct":
            problem = f"{vehicle}'s agent refused kill ({result.results[vehicle].sentence})"
        else:
            if not replied.is_set():
                result.update(vehicle, "accepted", "")  # telemetry shows it, without a reply
            problem = await self._missing_effect(result, vehicle, kind)

        if problem:
            await self._send_to_px4(
                result,
                self._fleet.vehicles[vehicle],
                kind,
                problem,
                is_silent=not replied.is_set(),
            )

    async def _wait_for_reply_to_land(
        self, result: OrderResult, vehicle: str, replied: asyncio.Event
    ) -> tuple[bool, float]:
        """Wait for the reply to a landing, longer if a mission gave it to an agent that is heard.

        Returns:
            Whether the agent has replied, and the time that the landing has waited for it [s].
        """
        limit_s = self._land_limit_s(vehicle)
        waited_s = limit_s
        has_reply = await self._wait_for_reply(result, vehicle, replied, limit_s)

        while not has_reply and waited_s < _REPEAT_TO_HEARD_S:
            if not self._is_heard_by_mission(result, vehicle):
                break
            waited_s += limit_s
            has_reply = await self._wait_for_reply(result, vehicle, replied, limit_s)
        return has_reply, waited_s

    def _problem_of_silence(
        self, result: OrderResult, vehicle: str, kind: DirectKind, waited_s: float
    ) -> str:
        """Return why a land or kill without a reply goes straight to PX4.

        It is empty if this ground has lost its own link: then the order ends here.
        """
        problem = _no_answer_words(vehicle, waited_s)
        if kind == "land" and self._is_own_link_dead(result, vehicle):
            sentence = (
                f"{problem}, nor is another vehicle heard: this ground's own link is down. "
                f"{_WITHOUT_GROUND}"
            )
            result.update(vehicle, "no answer", sentence)
            return ""

        # An agent that accepts a kill publishes this event itself.
        if kind == "kill" and self._view(vehicle).is_airborne:
            order = result.planned.orders[vehicle]
            sentence = f"Killed in the air by order of {order.author} (from {order.node})."
            self._publish_event("critical", "killed", sentence, vehicle)
        return problem

    async def _wait_for_reply(
        self, result: OrderResult, vehicle: str, replied: asyncio.Event, limit_s: float
    ) -> bool:
        """Wait for a reply.

        The wait restarts if this ground itself stalled during it. If this ground was late, it reads
        the bus once more at the end of the wait. It does not do so for a kill, which must not wait.

        Returns:
            Whether the agent has replied, by a reply or by its telemetry.
        """
        kind = result.planned.orders[vehicle].kind
        has_stalled = False
        stall = OwnStall(self._stall_clock_ns)
        stall.stalled_s()  # stalls count from here

        while True:
            begin_ns = self._feed.now_ns()
            late_s = 0.0
            if kind == "land":
                late_s = await self._repeat_until_reply(result, vehicle, replied, limit_s)
            elif kind == "kill":
                await _wait_for(replied, limit_s)
            else:
                late_s = await wait_scheduled(replied, limit_s)

            if late_s > 0.0:
                has_stalled = True
                await self._read_bus_again(replied)
            if self._has_answered(result, vehicle, replied):
                return True

            # After a stall, newer telemetry that shows an order of this kind counts as a reply.
            view = self._view(vehicle)
            telemetry = view.telemetry if view.received_ns > begin_ns else None
            if has_stalled and telemetry is not None and telemetry.order_kind == kind:
                return True

            if not stall.stalled_s(limit_s + late_s):
                return False
            has_stalled = True

    async def _repeat_until_reply(
        self, result: OrderResult, vehicle: str, replied: asyncio.Event, limit_s: float
    ) -> float:
        """Wait for the reply to a landing, and send it again while there is none.

        Returns:
            Time in which this ground was not scheduled [s].
        """
        left_s = limit_s
        late_s = 0.0
        again_s = max(
            self._fleet.fleet.direct_command_timeout_s,
            _AGAIN_ROUND_TRIPS * self._longest_round_trip_s(vehicle),
        )
        is_announced = False

        while True:
            wait_s = min(again_s, left_s)
            late_s += await wait_scheduled(replied, wait_s)
            left_s -= wait_s
            if self._has_answered(result, vehicle, replied) or left_s <= _NOTHING_S:
                return late_s

            if not is_announced:
                is_announced = True
                self._announce_repeat(result, vehicle, again_s, left_s)
            order = stamped_anew(result.planned.orders[vehicle], self._feed.now_ns())
            self._send(result, vehicle, order, replied, does_refusal_count=False)

    async def _read_bus_again(self, replied: asyncio.Event) -> None:
        """Take the messages that have arrived while this ground was not scheduled."""
        self._feed.read()
        await wait_scheduled(replied, _READ_AGAIN_S)
        self._feed.read()

    def _announce_repeat(
        self, result: OrderResult, vehicle: str, waited_s: float, left_s: float
    ) -> None:
        """Say that a landing is sent again, and when it goes straight to PX4."""
        sentence = f"{_no_answer_words(vehicle, waited_s)}: land is sent again"
        if not result.is_by_mission and self._fleet.vehicles[vehicle].direct is not None:
            sentence += f", and goes straight to PX4 in {left_s:.1f} s"
        self._publish_event("warning", "land_repeated", f"{sentence}.", vehicle)

    def _has_answered(self, result: OrderResult, vehicle: str, replied: asyncio.Event) -> bool:
        """Whether the agent has replied, or the order has ended.

        Telemetry that shows that the agent follows the order counts as a reply, because a stall of
        this ground can lose the reply itself.
        """
        if replied.is_set() or result.results[vehicle].is_final:
            return True
        telemetry = self._view(vehicle).telemetry
        return telemetry is not None and telemetry.order_id == result.results[vehicle].order_id

    def _is_heard_by_mission(self, result: OrderResult, vehicle: str) -> bool:
        """Whether a mission gave the order, and the agent is heard although it does not answer."""
        return result.is_by_mission and self._view(vehicle).age_s(self._feed.now_ns()) <= _HEARD_S

    def _is_own_link_dead(self, result: OrderResult, vehicle: str) -> bool:
        """Whether this ground's own link is probably the reason of a silence.

        Then a mission's landing is left to the agents, which avoid each other without this ground;
        PX4s that land by themselves do not. There are two signs of a dead own link: another vehicle
        fell silent at the same time, in flight or before its take-off, or no other vehicle in
        flight is heard.
        """
        if not result.is_by_mission:
            return False

        now_ns = self._feed.now_ns()
        age_s = self._view(vehicle).age_s(now_ns)
        others = [view for name, view in self._views().items() if name != vehicle]
        is_another_up = any(view.is_armed for view in others)
        is_another_heard = any(view.age_s(now_ns) <= _QUIET_S for view in others)
        if is_another_up and not is_another_heard:
            return True

        for name, view in self._views().items():
            if name == vehicle:
                continue

            other_age_s = view.age_s(now_ns)
            other = result.results.get(name)
            has_no_reply = other is not None and other.phase in ("sent", "no answer")
            is_silent = has_no_reply or other_age_s > _QUIET_S
            if is_silent and abs(other_age_s - age_s) < _AT_ONCE_S:
                return True
        return False

    # -- the effect, and the end -------------------------------------------------------------------

    async def _watch_for_lost_end(self, result: OrderResult, vehicle: str) -> None:
        """End an accepted order when its vehicle no longer follows it.

        A link that broke may have lost the event about the end.
        """
        lost_end = _LostEnd(result.planned.orders[vehicle].order_id)
        while not result.results[vehicle].is_final:
            await asyncio.sleep(0.1 * LOST_END_S)
            sentence = lost_end.noticed(self._view(vehicle), self._feed.now_ns())
            if sentence:
                result.update(vehicle, "failed", sentence)

    async def _missing_effect(self, result: OrderResult, vehicle: str, kind: DirectKind) -> str:
        """Watch an accepted land or kill until it has ended, or has to go straight to PX4.

        A kill must soon show its effect: the agent reports PX4's disarm. A landing may take long,
        so it goes to PX4 only if the link between agent and PX4 is dead. It has failed if the
        vehicle no longer follows it and is still armed, for instance because its agent restarted.

        Returns:
            The reason to go straight to PX4; empty when the order has ended, or was refused.
        """
        loop = asyncio.get_running_loop()
        stall = OwnStall(self._stall_clock_ns)
        accepted = f"{vehicle}'s agent accepted {kind}"
        accepted_s = loop.time()
        accepted_ns = self._feed.now_ns()
        lost_end = _LostEnd(result.planned.orders[vehicle].order_id)
        stall.stalled_s()  # stalls count from here

        while not result.results[vehicle].is_final:
            unable = self._unable.pop(result.results[vehicle].order_id, "")
            if unable:
                return f"{accepted} and cannot do it ({unable.rstrip('.')})"

            await asyncio.sleep(_WATCH_PERIOD_S)
            if stall.stalled_s():  # the telemetry of that time may not be read yet, so begin again
                accepted_s = loop.time()
                accepted_ns = self._feed.now_ns()

            view = self._view(vehicle)
            telemetry = view.telemetry if view.received_ns > accepted_ns else None
            px4_age_s = 0.0
            if telemetry is not None and telemetry.is_armed:
                px4_age_s = telemetry.autopilot_age_s
            if px4_age_s > _LINK_SILENT_S:
                return f"{accepted}, but it does not hear PX4"

            if kind == "kill" and loop.time() - accepted_s > _KILL_EFFECT_S:
                return f"{accepted}, but the vehicle did not show it within {_KILL_EFFECT_S:g} s"
            if kind == "land":
                self._end_if_lost(result, view, lost_end)

        if kind == "kill" and result.results[vehicle].phase in ("failed", "timed out"):
            return f"{accepted}, but could not do it"
        return ""

    def _end_if_lost(self, result: OrderResult, view: VehicleView, lost_end: _LostEnd) -> None:
        """End an accepted landing that its vehicle no longer follows."""
        sentence = lost_end.noticed(view, self._feed.now_ns())
        if not sentence:
            return
        phase: Phase = "failed"
        if not view.is_armed:
            phase = "done"
            sentence = f"{view.name} is disarmed; how its landing ended was not heard."
        result.update(view.name, phase, sentence)

    # -- the direct path ---------------------------------------------------------------------------

    async def _send_to_px4(
        self,
        result: OrderResult,
        vehicle: Vehicle,
        kind: DirectKind,
        problem: str,
        *,
        is_silent: bool,
    ) -> None:
        """Send a land or kill straight to PX4, and end the order with PX4's own answer."""
        name = vehicle.name
        if vehicle.direct is None:
            sentence = f"{problem}, and the fleet file gives no direct endpoint. Use the RC switch."
            result.update(name, "no answer", sentence)
            return

        sentence = f"{problem}; {kind} goes straight to PX4 at {vehicle.direct}."
        result.update(name, "direct", sentence)
        self._say_of_direct(result, "warning", "direct_command", sentence, name)

        watch_s = _WATCH_KILL_S
        if kind == "land":
            watch_s = _WATCH_LAND_S + descent_s(vehicle, self._view(name))
        # A landing with a reason is from a mission, or to all. Only a person who names the vehicle
        # lands it although a pilot flies it.
        telemetry = self._view(name).telemetry
        command = DirectCommand(
            endpoint=vehicle.direct,
            system_id=vehicle.system_id,
            kind=kind,
            key=self._mavlink_keys.get(name),
            timeout_s=_SEND_S,
            watch_s=watch_s,
            spares_pilot=kind == "land" and bool(result.planned.orders[name].reason),
            was_flown_by_hand=telemetry is not None and telemetry.is_flown_by_hand,
        )
        answer = await self._send_direct(command)

        sentence = f"{problem}; {kind} was sent straight to PX4: {answer.sentence}."
        phase: Phase
        if answer.is_flown_by_hand:
            sentence = f"{problem}. {name} is flown by hand: `land {name}` takes it."
            phase = "refused"
            self._publish_event("warning", "flown-by-hand", sentence, name)
        elif answer.is_disarmed:
            phase = "done"
            self._publish_event("warning", DIRECT_DISARMED, sentence, name)
            self._said_of_direct.pop(name, None)
        else:
            phase = "failed"
            self._say_of_direct(result, "critical", "direct_result", sentence, name)
        result.update(name, phase, sentence, is_silent=is_silent and not answer.has_answered)

    def _say_of_direct(
        self, result: OrderResult, severity: str, code: str, sentence: str, vehicle: str
    ) -> None:
        """Publish an event, unless a mission that lands a vehicle again has said the same."""
        if result.is_by_mission:
            said = self._said_of_direct.setdefault(vehicle, set())
            if sentence in said:
                return
            said.add(sentence)
        self._publish_event(severity, code, sentence, vehicle)


class _LostEnd:
    """Notices in telemetry that a vehicle no longer follows an order.

    Args:
        order_id: id of the order.
    """

    def __init__(self, order_id: str) -> None:
        self._order_id = order_id
        self._has_followed = False
        # time since which the telemetry does not name the order; 0: it does, or nothing is heard
        self._unfollowed_ns = 0

    def noticed(self, view: VehicleView, now_ns: int) -> str:
        """Return why an accepted order has ended without an event; empty if it has not.

        Args:
            view: the vehicle as known now.
            now_ns: the ground's clock.
        """
        telemetry = view.telemetry
        if telemetry is None or not view.is_fresh(now_ns):
            # When a vehicle is heard again, it reports missed ends a second later.
            self._unfollowed_ns = 0
            return ""
        if telemetry.order_id == self._order_id:
            self._has_followed = True
            self._unfollowed_ns = 0
            return ""

        if self._unfollowed_ns == 0:
            self._unfollowed_ns = now_ns
        unfollowed_s = (now_ns - self._unfollowed_ns) * 1e-9
        if not self._has_followed or unfollowed_s < LOST_END_S:
            return ""
        doing = f"it is {telemetry.state}. {telemetry.reason}".strip()
        return (
            f"{view.name} does not follow this order any more, "
            f"and how it ended was not heard: {doing}"
        )


async def _wait_for(event: asyncio.Event, limit_s: float) -> None:
    """Wait until an event is set, at most for a time [s]."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(limit_s):
            await event.wait()


def _no_answer_words(vehicle: str, limit_s: float) -> str:
    return f"{vehicle}'s agent did not answer within {round(limit_s, 2):g} s"
