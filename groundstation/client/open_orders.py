"""Orders that have been sent and have not ended: replies, deadlines, and the direct path to PX4."""

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
_KILL_EFFECT_S = 1.3  # PX4 reports that it is disarmed once a second
_LINK_SILENT_S = 1.0  # age of PX4's last packet at the agent, after which its link counts as dead
_WATCH_PERIOD_S = 0.05
_WATCH_KILL_S, _WATCH_LAND_S = 2.0, 30.0  # wait so long for PX4 to report that it is disarmed
# a vehicle that followed an order, and goes on without it for so long, has ended it
LOST_END_S = 3.0
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
        self._mavlink_keys = mavlink_keys
        self._fleet, self._feed, self._views = fleet, feed, views
        self._send_direct, self._publish_event = send_direct, publish_event
        self._stall_clock_ns = stall_clock_ns
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
        # all leave before the first wait: the last of a hundred must not stand behind the
        # bookkeeping of the others
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
        mine = [result for result in self._open.values() if vehicle in result.planned.orders]
        return any(
            result.planned.orders[vehicle].kind in kinds and not result.results[vehicle].is_final
            for result in mine
        )

    def end(self, event: Event) -> None:
        """Take over the end of an order, where an event reports one.

        Args:
            event: any event of the fleet.
        """
        result = self._open.get(event.order_id)
        if result is None or not event.order_outcome or event.vehicle not in result.planned.orders:
            return
        if result.planned.orders[event.vehicle].order_id != event.order_id:
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

    def _send(self, result: OrderResult, vehicle: str, order: Order) -> asyncio.Event:
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
        if isinstance(reply, Malformed):
            self._feed.put(reply)
        elif reply.vehicle == vehicle and reply.order_id == result.planned.orders[vehicle].order_id:
            replied.set()
            # a kill is refused only where it is not believed: whoever gives it here means it
            is_refused_kill = (
                not reply.is_accepted and result.planned.orders[vehicle].kind == "kill"
            )
            if result.results[vehicle].phase != "direct":
                phase: Phase = (
                    "accepted" if reply.is_accepted else "direct" if is_refused_kill else "refused"
                )
                result.update(vehicle, phase, reply.reason)

    def _begin_wait(self, result: OrderResult, vehicle: str, replied: asyncio.Event) -> None:
        task = asyncio.get_running_loop().create_task(self._follow(result, vehicle, replied))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _follow(self, result: OrderResult, vehicle: str, replied: asyncio.Event) -> None:
        """Wait for the reply, and for the effect of a land or kill; without them the order goes
        straight to PX4.
        """
        direct = _DIRECT.get(result.planned.orders[vehicle].kind)
        limit_s = self._fleet.fleet.direct_command_timeout_s
        if direct is None:
            limit_s = max(limit_s, REPLY_TIMEOUT_S)
        if not await self._has_replied(result, vehicle, replied, limit_s):
            problem = f"{vehicle}'s agent did not answer within {limit_s:g} s"
            # an agent that accepts says this itself
            if direct == "kill" and self._views()[vehicle].is_airborne:
                order = result.planned.orders[vehicle]
                sentence = f"Killed in the air by order of {order.author} (from {order.node})."
                self._publish_event("critical", "killed", sentence, vehicle)
            if direct is None:
                result.update(vehicle, "no answer", f"{problem}. Is it running?")
                return
        else:
            if direct is None:
                await self._watch_for_lost_end(result, vehicle)
                return
            if result.results[vehicle].phase == "direct":
                problem = f"{vehicle}'s agent refused kill ({result.results[vehicle].sentence})"
            else:
                problem = await self._missing_effect(result, vehicle, direct)
        if direct is not None and problem:
            is_silent = not replied.is_set()
            await self._send_to_px4(
                result, self._fleet.vehicles[vehicle], direct, problem, is_silent=is_silent
            )

    async def _has_replied(
        self, result: OrderResult, vehicle: str, replied: asyncio.Event, limit_s: float
    ) -> bool:
        """Wait for a reply; a wait in which this ground itself stood still begins again.

        Returns:
            Whether the agent has replied, or shows by its telemetry that it follows the order: a
                stall loses replies.
        """
        kind, has_stalled = result.planned.orders[vehicle].kind, False
        stall = OwnStall(self._stall_clock_ns)
        stall.look()
        while True:
            begin_ns = self._feed.now_ns()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(limit_s):
                    await replied.wait()
            view = self._views()[vehicle]
            follows = (
                view.telemetry is not None
                and view.received_ns > begin_ns
                and view.telemetry.order_kind == kind
            )
            if replied.is_set() or result.results[vehicle].is_final or (has_stalled and follows):
                return True
            if not stall.look(limit_s):
                return False
            has_stalled = True

    async def _watch_for_lost_end(self, result: OrderResult, vehicle: str) -> None:
        """End an accepted order that its vehicle does not follow any more: a link that broke has
        lost how it ended.
        """
        order_id, has_followed, without_ns = result.planned.orders[vehicle].order_id, False, 0
        while not result.results[vehicle].is_final:
            await asyncio.sleep(0.1 * LOST_END_S)
            view, now_ns = self._views()[vehicle], self._feed.now_ns()
            told = view.telemetry
            if told is None or not view.is_fresh(now_ns):
                # a vehicle that is heard again tells ends that were missed, a second later
                without_ns = 0
                continue
            if told.order_id == order_id:
                has_followed, without_ns = True, 0
                continue
            without_ns = without_ns or now_ns
            if has_followed and (now_ns - without_ns) * 1e-9 >= LOST_END_S:
                doing = f"it is {told.state}. {told.reason}".strip()
                sentence = f"{vehicle} does not follow this order any more, and how it ended was not heard: {doing}"
                result.update(vehicle, "failed", sentence)

    async def _missing_effect(self, result: OrderResult, vehicle: str, kind: DirectKind) -> str:
        """Watch an accepted land or kill.

        A kill has its effect when the agent reports PX4's disarm. A landing takes its time: only a
        dead link between agent and PX4 counts against it.

        Returns:
            The reason to go straight to PX4; empty when the order has ended, or was refused.
        """
        loop, stall = asyncio.get_running_loop(), OwnStall(self._stall_clock_ns)
        accepted_s, accepted_ns = loop.time(), self._feed.now_ns()
        accepted = f"{vehicle}'s agent accepted {kind}"
        stall.look()
        while not result.results[vehicle].is_final:
            await asyncio.sleep(_WATCH_PERIOD_S)
            if stall.look():  # what PX4 showed meanwhile is still to be read
                accepted_s, accepted_ns = loop.time(), self._feed.now_ns()
            view = self._views()[vehicle]
            telemetry = view.telemetry if view.received_ns > accepted_ns else None
            if (
                telemetry is not None
                and telemetry.is_armed
                and telemetry.autopilot_age_s > _LINK_SILENT_S
            ):
                return f"{accepted}, but it has not heard PX4 for {telemetry.autopilot_age_s:.1f} s"
            if kind == "kill" and loop.time() - accepted_s > _KILL_EFFECT_S:
                return f"{accepted}, but the vehicle did not show it within {_KILL_EFFECT_S:g} s"
        if kind == "kill" and result.results[vehicle].phase in ("failed", "timed out"):
            return f"{accepted}, but could not do it"
        return ""

    async def _send_to_px4(
        self,
        result: OrderResult,
        vehicle: Vehicle,
        kind: DirectKind,
        problem: str,
        *,
        is_silent: bool,
    ) -> None:
        name = vehicle.name
        if vehicle.direct is None:
            sentence = f"{problem}, and the fleet file gives no direct endpoint. Use the RC switch."
            result.update(name, "no answer", sentence)
            return
        sentence = f"{problem}; {kind} goes straight to PX4 at {vehicle.direct}."
        result.update(name, "direct", sentence)
        self._publish_event("warning", "direct_command", sentence, name)
        watch_s = (
            _WATCH_KILL_S
            if kind == "kill"
            else _WATCH_LAND_S + descent_s(vehicle, self._views()[name])
        )
        key = {"key": self._mavlink_keys[name]} if name in self._mavlink_keys else {}
        answer = await asyncio.to_thread(
            self._send_direct,
            vehicle.direct,
            vehicle.system_id,
            kind,
            **key,
            timeout_s=3.0,
            watch_s=watch_s,
        )
        sentence = f"{problem}; {kind} was sent straight to PX4: {answer.sentence}."
        phase: Phase = "done" if answer.is_disarmed else "failed"
        code = DIRECT_DISARMED if answer.is_disarmed else "direct_result"
        self._publish_event("warning" if phase == "done" else "critical", code, sentence, name)
        result.update(name, phase, sentence, is_silent=is_silent and not answer.has_answered)
