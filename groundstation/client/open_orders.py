"""Orders that have been sent and have not ended: replies, deadlines, and the direct path to PX4.

An order goes to the vehicle's agent, which replies at once and reports the end later by an event.
Three things can be missing, and each has its own watch:

* The reply. Most orders then have no answer. Land and kill go straight to PX4 instead.
* The effect of a land or a kill that was accepted. Then, too, they go straight to PX4.
* The event about the end, because a link broke. Then telemetry shows that the vehicle does not
  follow the order any more.

Time in which this ground itself stood still counts for none of them.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Collection, Mapping

from groundstation.client.bus_feed import BusFeed
from groundstation.client.direct_mavlink import DirectKind, DirectResult
from groundstation.fleet.descent import descent_s
from groundstation.fleet.own_stall import OwnStall
from groundstation.fleet.state import DIRECT_DISARMED, VehicleView
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.result import OrderResult, Phase
from onboard.bus.codec import Malformed
from onboard.bus.schema import Event, Order, OrderReply
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, Vehicle

REPLY_TIMEOUT_S = 1.5
# a vehicle that followed an order, and goes on without it for so long, has ended it
LOST_END_S = 3.0
_KILL_EFFECT_S = 1.3  # PX4 reports that it is disarmed once a second
_LINK_SILENT_S = 1.0  # age of PX4's last packet at the agent, after which its link counts as dead
_WATCH_PERIOD_S = 0.05
_SEND_S = 3.0  # longest wait for PX4's own acknowledgement
_WATCH_KILL_S = 2.0  # longest wait for PX4's own report that it is disarmed
_WATCH_LAND_S = 30.0  # the same, beyond the time of the descent
_DIRECT: dict[str, DirectKind] = {"land": "land", "kill": "kill"}

SendDirect = Callable[..., DirectResult]  # as direct_mavlink.send_direct
PublishEvent = Callable[[str, str, str, str], None]  # severity, code, sentence, vehicle


class OpenOrders:
    """The orders of one client.

    Args:
        fleet: the fleet file.
        feed: the client's side of the bus.
        send_direct: sends a land or kill command straight to PX4.
        publish_event: publishes an event of the ground.
        views: returns the vehicles as known now.
        stall_clock_ns: a clock that goes on while this computer sleeps [ns].
        mavlink_keys: of the vehicles whose MAVLink is signed.
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
        self._tasks: set[asyncio.Task[None]] = set()

    def send(self, planned: PlannedOrder) -> OrderResult:
        """Send the messages of a planned order; callable from any thread.

        Args:
            planned: checked just now.

        Returns:
            Its results, which fill in on the event loop.
        """
        result = OrderResult(planned)
        for vehicle, order in planned.orders.items():
            self._open[order.order_id] = result
            self._feed.tell_sinks(Topic.ORDER, vehicle, order)

        # All leave before the first wait: the last of a hundred must not stand behind the
        # bookkeeping of the others.
        replied = {
            vehicle: self._send(result, vehicle, order) for vehicle, order in planned.orders.items()
        }
        for vehicle, event in replied.items():
            self._feed.call(self._begin_wait, result, vehicle, event)
        return result

    def has_open(self, vehicle: str, kinds: Collection[str]) -> bool:
        """Whether an order of one of these kinds was sent to a vehicle and has not ended.

        Args:
            vehicle: its name.
            kinds: of orders, as on the bus.
        """
        for result in self._open.values():
            order = result.planned.orders.get(vehicle)
            if order is None or order.kind not in kinds:
                continue
            if not result.results[vehicle].is_final:
                return True
        return False

    def end(self, event: Event) -> None:
        """Take over the end of an order, where an event reports one.

        Args:
            event: any event of the fleet.
        """
        result = self._open.get(event.order_id)
        if result is None or not event.order_outcome:
            return
        order = result.planned.orders.get(event.vehicle)
        if order is None or order.order_id != event.order_id:
            return
        if result.results[event.vehicle].phase == "direct" and event.order_outcome != "done":
            return  # a late agent: the order is PX4's now, and PX4's answer ends it

        result.update(event.vehicle, event.order_outcome, event.sentence)
        if result.results[event.vehicle].is_final:
            self._open.pop(event.order_id, None)

    async def stop(self) -> None:
        """Wait for no more replies."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    # -- the reply ---------------------------------------------------------------------------------

    def _send(self, result: OrderResult, vehicle: str, order: Order) -> asyncio.Event:
        """Send one message; return the event that its reply sets."""
        replied = asyncio.Event()

        def on_reply(reply: OrderReply | Malformed) -> None:
            if isinstance(reply, OrderReply) and reply.vehicle == vehicle:
                self._feed.tell_sinks(Topic.ORDER, vehicle, reply)
            self._feed.call(self._take_reply, result, vehicle, reply, replied)

        self._feed.bus.order(
            vehicle, order, timeout_s=REPLY_TIMEOUT_S, on_reply=on_reply, on_end=lambda: None
        )
        return replied

    def _take_reply(
        self,
        result: OrderResult,
        vehicle: str,
        reply: OrderReply | Malformed,
        replied: asyncio.Event,
    ) -> None:
        """Take over an agent's answer: accepted or refused."""
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
            # A kill is refused only where it is not believed: whoever gives it here means it.
            phase = "direct"
        result.update(vehicle, phase, reply.reason)

    def _begin_wait(self, result: OrderResult, vehicle: str, replied: asyncio.Event) -> None:
        task = asyncio.get_running_loop().create_task(self._follow(result, vehicle, replied))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _follow(self, result: OrderResult, vehicle: str, replied: asyncio.Event) -> None:
        """Wait for the reply, and for the effect of a land or kill.

        Without them a land or kill goes straight to PX4.
        """
        direct = _DIRECT.get(result.planned.orders[vehicle].kind)
        if direct is None:
            await self._follow_order(result, vehicle, replied)
        else:
            await self._follow_direct(result, vehicle, replied, direct)

    async def _follow_order(
        self, result: OrderResult, vehicle: str, replied: asyncio.Event
    ) -> None:
        """Wait for the reply to an order that has no direct path, then watch for its end."""
        limit_s = max(self._fleet.fleet.direct_command_timeout_s, REPLY_TIMEOUT_S)
        if await self._has_replied(result, vehicle, replied, limit_s):
            await self._watch_for_lost_end(result, vehicle)
        else:
            problem = _no_answer_words(vehicle, limit_s)
            result.update(vehicle, "no answer", f"{problem}. Is it running?")

    async def _follow_direct(
        self, result: OrderResult, vehicle: str, replied: asyncio.Event, kind: DirectKind
    ) -> None:
        """Wait for the reply to a land or kill and for its effect, else send it to PX4 itself."""
        limit_s = self._fleet.fleet.direct_command_timeout_s
        if not await self._has_replied(result, vehicle, replied, limit_s):
            problem = _no_answer_words(vehicle, limit_s)
            # An agent that accepts a kill says this itself.
            if kind == "kill" and self._views()[vehicle].is_airborne:
                order = result.planned.orders[vehicle]
                sentence = f"Killed in the air by order of {order.author} (from {order.node})."
                self._publish_event("critical", "killed", sentence, vehicle)
        elif result.results[vehicle].phase == "direct":
            problem = f"{vehicle}'s agent refused kill ({result.results[vehicle].sentence})"
        else:
            problem = await self._missing_effect(result, vehicle, kind)

        if problem:
            await self._send_to_px4(
                result,
                self._fleet.vehicles[vehicle],
                kind,
                problem,
                is_silent=not replied.is_set(),
            )

    async def _has_replied(
        self, result: OrderResult, vehicle: str, replied: asyncio.Event, limit_s: float
    ) -> bool:
        """Wait for a reply; a wait in which this ground itself stood still begins again.

        Returns:
            Whether the agent has replied, or shows by its telemetry that it follows the order: a
                stall loses replies.
        """
        kind = result.planned.orders[vehicle].kind
        has_stalled = False
        stall = OwnStall(self._stall_clock_ns)
        stall.look()

        while True:
            begin_ns = self._feed.now_ns()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(limit_s):
                    await replied.wait()
            if replied.is_set() or result.results[vehicle].is_final:
                return True

            view = self._views()[vehicle]
            telemetry = view.telemetry if view.received_ns > begin_ns else None
            if has_stalled and telemetry is not None and telemetry.order_kind == kind:
                return True

            if not stall.look(limit_s):
                return False
            has_stalled = True

    # -- the effect, and the end -------------------------------------------------------------------

    async def _watch_for_lost_end(self, result: OrderResult, vehicle: str) -> None:
        """End an accepted order that its vehicle does not follow any more.

        A link that broke has lost how it ended.
        """
        order_id = result.planned.orders[vehicle].order_id
        has_followed = False
        without_ns = 0  # since when the vehicle is heard without the order; 0: it is not

        while not result.results[vehicle].is_final:
            await asyncio.sleep(0.1 * LOST_END_S)
            now_ns = self._feed.now_ns()
            view = self._views()[vehicle]
            telemetry = view.telemetry

            if telemetry is None or not view.is_fresh(now_ns):
                # A vehicle that is heard again reports ends that were missed, a second later.
                without_ns = 0
                continue
            if telemetry.order_id == order_id:
                has_followed = True
                without_ns = 0
                continue

            if without_ns == 0:
                without_ns = now_ns
            if has_followed and (now_ns - without_ns) * 1e-9 >= LOST_END_S:
                doing = f"it is {telemetry.state}. {telemetry.reason}".strip()
                sentence = (
                    f"{vehicle} does not follow this order any more, "
                    f"and how it ended was not heard: {doing}"
                )
                result.update(vehicle, "failed", sentence)

    async def _missing_effect(self, result: OrderResult, vehicle: str, kind: DirectKind) -> str:
        """Watch an accepted land or kill.

        A kill has its effect when the agent reports PX4's disarm. A landing takes its time: only a
        dead link between agent and PX4 counts against it.

        Returns:
            The reason to go straight to PX4; empty when the order has ended, or was refused.
        """
        loop = asyncio.get_running_loop()
        stall = OwnStall(self._stall_clock_ns)
        accepted = f"{vehicle}'s agent accepted {kind}"
        accepted_s = loop.time()
        accepted_ns = self._feed.now_ns()
        stall.look()

        while not result.results[vehicle].is_final:
            await asyncio.sleep(_WATCH_PERIOD_S)
            if stall.look():  # what PX4 showed meanwhile is still to be read
                accepted_s = loop.time()
                accepted_ns = self._feed.now_ns()

            view = self._views()[vehicle]
            telemetry = view.telemetry if view.received_ns > accepted_ns else None
            if telemetry is not None and telemetry.is_armed:
                px4_age_s = telemetry.autopilot_age_s
                if px4_age_s > _LINK_SILENT_S:
                    return f"{accepted}, but it has not heard PX4 for {px4_age_s:.1f} s"

            if kind == "kill" and loop.time() - accepted_s > _KILL_EFFECT_S:
                return f"{accepted}, but the vehicle did not show it within {_KILL_EFFECT_S:g} s"

        if kind == "kill" and result.results[vehicle].phase in ("failed", "timed out"):
            return f"{accepted}, but could not do it"
        return ""

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
        self._publish_event("warning", "direct_command", sentence, name)

        watch_s = _WATCH_KILL_S
        if kind == "land":
            watch_s = _WATCH_LAND_S + descent_s(vehicle, self._views()[name])
        key_option = {}
        if name in self._mavlink_keys:
            key_option = {"key": self._mavlink_keys[name]}
        answer = await asyncio.to_thread(
            self._send_direct,
            vehicle.direct,
            vehicle.system_id,
            kind,
            **key_option,
            timeout_s=_SEND_S,
            watch_s=watch_s,
        )

        sentence = f"{problem}; {kind} was sent straight to PX4: {answer.sentence}."
        phase: Phase
        if answer.is_disarmed:
            phase = "done"
            self._publish_event("warning", DIRECT_DISARMED, sentence, name)
        else:
            phase = "failed"
            self._publish_event("critical", "direct_result", sentence, name)
        result.update(name, phase, sentence, is_silent=is_silent and not answer.has_answered)


def _no_answer_words(vehicle: str, limit_s: float) -> str:
    return f"{vehicle}'s agent did not answer within {limit_s:g} s"
