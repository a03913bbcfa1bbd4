"""The agent's shell: moves bytes and time between PX4, the bus and the core, and decides nothing.

One thread runs the core: a timer on an absolute schedule calls it 50 times a second. What comes from MAVSDK's and
Zenoh's threads waits for the next tick, orders excepted. Blocking calls (parameters, discovery,
reliable messages, whom to listen to) have threads of their own, so that nothing can stand between a tick and the wire.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from onboard import events as ev
from onboard.agent.core import AgentCore
from onboard.agent.ticker import Ticker
from onboard.agent.warm_up import warm_up
from onboard.autopilot import LinkError
from onboard.bus.clock_sync import ClockNode
from onboard.bus.codec import Malformed
from onboard.bus.protocol import BusError
from onboard.bus.schema import Message, MocapPose, Order, OrderReply, StateMessage, Telemetry
from onboard.bus.session import BusSession
from onboard.bus.topics import TOPICS, Delivery, Topic
from onboard.config.fleet import FleetConfig, MocapConfig
from onboard.exit_status import EXIT_INTERRUPTED, EXIT_OK, EXIT_WRONG_INPUT
from onboard.mocap.factory import source_of
from onboard.mocap.source import MocapSource, OnMalformed, OnPose
from onboard.process import realtime
from onboard.process.background_queue import Outbox
from onboard.process.systemd import Notifier
from onboard.px4.mavsdk_link import Px4Link
from onboard.px4.required_params import differences, required_params
from onboard.safety.failsafe_table import Situation

PERIOD_NS = 20_000_000
_WATCHED_HZ = 10.0
_MAX_EVENTS = 2000
_STATISTICS_TICKS = 25
_FAILED_TICKS_TO_LAND = 25
_PARAM_REPEAT_S, _PARAM_AGAIN_NS = 5.0, 15_000_000_000
_TIDY_TICKS = 500  # on the ground
# A setpoint that comes later than this after its tick began was held up on the way: PX4 is not to have it.
_SETPOINT_NS = 60_000_000

log = logging.getLogger("covey.agent")


class Agent:
    """One vehicle's process."""

    def __init__(
        self,
        fleet: FleetConfig,
        name: str,
        *,
        apply_params: bool,
        law: str | None,
        is_realtime: bool = False,
        has_bus_mocap: bool = False,
    ) -> None:
        self.fleet, self.name, self.vehicle = fleet, name, fleet.vehicles[name]
        self._apply_params, self._is_realtime = apply_params, is_realtime
        self._core = AgentCore(fleet, name, boot_id=time.time_ns() & 0x7FFFFFFF, law=law)
        # with a mocap PX4's own estimate is only watched
        position_hz = _WATCHED_HZ if self.vehicle.mocap_required else 1e9 / PERIOD_NS
        self._link = Px4Link(self.vehicle.autopilot, self.vehicle.system_id, position_hz=position_hz)
        others = [fleet.vehicles[other].agent for other in fleet.enabled_names if other != name]
        self._bus = BusSession(
            namespace=fleet.namespace,
            node=name,
            listen=[self.vehicle.agent],
            connect=[*others, fleet.simulator_endpoint],
        )
        self._clock = ClockNode(self._bus)
        self._inbox: deque[ev.EventIn] = deque(maxlen=_MAX_EVENTS)  # the newest matter
        self._notices: deque[ev.EventIn] = deque(maxlen=_MAX_EVENTS)  # few, and none may be pushed out by the others
        self._replies: dict[str, Callable[[OrderReply], None]] = {}
        self._blocking = ThreadPoolExecutor(1, thread_name_prefix="link")
        self._reliable, self._interest = Outbox("bus"), Outbox("interest")
        self._mocap: MocapSource | None = None
        self._told = ""  # of the mocap's problems, the newest one said
        self._on_poses: tuple[OnPose, OnMalformed]
        self._mocap_table = MocapConfig() if has_bus_mocap else fleet.mocap
        self._ended: asyncio.Future[int] | None = None
        self._ticks = self._failed_ticks = self._signals = self._tick_ns = 0
        self._was_ready = False
        self._life = Notifier()

    async def run(self) -> int:
        """Fly until told to stop; exit status."""
        loop = asyncio.get_running_loop()
        self._ended = loop.create_future()
        for number in (signal.SIGINT, signal.SIGTERM):  # before anything takes time: a stop asked for early counts too
            loop.add_signal_handler(number, self._signalled)
        warm_up(self.fleet, self.name, self._core.control.law)
        self._link.start()
        try:
            self._bus.start()
            self._subscribe(loop)
            self._core.preflight.is_warm = True
            realtime.settle()
            if self._is_realtime:
                for submit in (self._blocking.submit, self._reliable.submit, self._interest.submit):
                    submit(int)  # nothing, but their threads are there now, and have their part in the precedence
                log.info("%s", realtime.take_precedence())
            place = self.vehicle.index / max(1, len(self.fleet.vehicles))
            ticker = self._ticker = Ticker(PERIOD_NS, self._tick, offset_ns=int(place * PERIOD_NS))
            ticker.start(loop)
            link_task = asyncio.create_task(self._keep_link(loop))
            link_task.add_done_callback(_log_end)
            try:
                return await self._ended
            finally:
                ticker.stop()
                link_task.cancel()
        finally:
            self._blocking.shutdown(wait=True, cancel_futures=True)
            self._interest.stop()
            self._reliable.stop()
            if self._mocap is not None:
                self._mocap.stop()
            self._bus.stop()
            self._link.stop()

    # -- in ----------------------------------------------------------------------------------------------------------

    def _subscribe(self, loop: asyncio.AbstractEventLoop) -> None:
        """Bus threads only append to the inbox (a deque is safe for that) or wake the loop for an order."""

        def neighbour(topic: Topic, name: str, message: Message | Malformed) -> None:
            if isinstance(message, (StateMessage, Telemetry)):
                if name != self.name or message.boot_id != self._core.boot_id:  # a twin counts as one
                    now_ns = time.monotonic_ns()
                    if isinstance(message, StateMessage):
                        message = self._clock.state(name, message, now_ns)
                    self._inbox.append(ev.NeighbourReceived(message, now_ns))
            else:
                self._inbox.append(ev.MessageMalformed())

        def pose(message: MocapPose, received_ns: int) -> None:
            aged = self._clock.pose(message, received_ns)
            if aged is not None:
                self._inbox.append(ev.PoseReceived(aged, received_ns))

        def malformed() -> None:
            self._inbox.append(ev.MessageMalformed())

        def order(message: Order | Malformed, reply: Callable[[OrderReply], None]) -> None:
            loop.call_soon_threadsafe(self._ordered, message, reply)

        self._clock.start()
        self._on_state = neighbour
        self._bus.collect(Topic.SLOW_TELEMETRY, "*", neighbour)
        if self.vehicle.mocap_required and self.vehicle.body:
            self._on_poses = pose, malformed
            body = "*" if self._mocap_table.direct else self.vehicle.body
            self._mocap = source_of(self._mocap_table, self._bus, body, pose, malformed)
            self._mocap.start()
        self._bus.serve_orders(self.name, order)
        self._bus.watch_alive(lambda node, is_alive: self._notices.append(ev.NodeChanged(node, is_alive)))

    def _ordered(self, message: Order | Malformed, reply: Callable[[OrderReply], None]) -> None:
        if isinstance(message, Malformed):
            self._core.handle(ev.MessageMalformed(), time.monotonic_ns())
            answer = OrderReply(order_id="", vehicle=self.name, is_accepted=False, reason="The order is not readable.")
            self._reliable.submit(reply, answer)
            return
        self._replies[message.order_id] = reply
        self._core.handle(ev.SnapshotReceived(self._link.snapshot()), time.monotonic_ns())
        now_ns = time.monotonic_ns()
        self._execute(self._core.handle(ev.OrderReceived(self._clock.order(message, now_ns)), now_ns))
        log.info("order %s of %s", message.kind, message.author)

    def _signalled(self) -> None:
        self._signals += 1
        if self._signals > 1:
            os.write(2, b"asked twice: ending at once; if in the air, PX4's own failsafe lands\n")
            os._exit(EXIT_INTERRUPTED)
        else:
            log.info("asked to stop: landing first if in the air")
            self._notices.append(ev.ShutdownRequested())

    # -- tick --------------------------------------------------------------------------------------------------------

    def _tick(self) -> None:
        now_ns = self._tick_ns = time.monotonic_ns()
        try:
            while self._notices:
                self._execute(self._core.handle(self._notices.popleft(), now_ns))
            self._bus.deliver()
            for_px4: list[ev.Command] = []  # poses, which may wait until the setpoint is out
            while self._inbox:
                for_px4 += self._core.handle(self._inbox.popleft(), now_ns)
            self._core.handle(ev.SnapshotReceived(self._link.snapshot()), now_ns)
            self._execute(self._core.tick(now_ns))
            self._execute(for_px4)
            if self._ticks % _STATISTICS_TICKS == 0:
                self._clock.beat()
                self._core.handle(ev.ClocksCompared(self._clock.clocks.bounds_s(now_ns)), now_ns)
                if self._mocap is not None and self._mocap.problem != self._told:
                    self._told = self._mocap.problem
                    self._core.handle(ev.MocapProblemChanged(self._told), now_ns)
            self._failed_ticks = 0
            self._life.alive(now_ns, self._core.flight.state)
        except Exception as error:  # our own bug in flight: the one place that catches it
            log.exception("tick failed")
            self._failed_ticks += 1
            self._core.handle(ev.TickFailed(f"Internal error: {type(error).__name__}: {error}."), now_ns)
            if self._failed_ticks == _FAILED_TICKS_TO_LAND:
                self._link.land()
        self._ticks += 1
        ticker, flight = self._ticker, self._core.flight
        if self._ticks % _STATISTICS_TICKS == 0:
            timed = ev.LoopTimed(
                *ticker.statistics_ms(), ticker.late_ticks, ticker.lateness_p99_ms(), ticker.missed_ticks
            )
            self._core.handle(timed, now_ns)
        if self._ticks % _TIDY_TICKS == 0 and flight.situation is Situation.GROUND:
            realtime.tidy()
        if not self._was_ready and flight.state == "ready":
            self._was_ready = self._reliable.submit(lambda: print(f"agent {self.name}: ready", flush=True))

    def _execute(self, commands: list[ev.Command]) -> None:
        for command in commands:
            match command:
                case ev.SendAttitude(setpoint):
                    if time.monotonic_ns() - self._tick_ns < _SETPOINT_NS:
                        self._link.send_attitude(setpoint)
                case ev.Publish(topic, message):
                    if TOPICS[topic].delivery is Delivery.RELIABLE:
                        log.info("%s", getattr(message, "sentence", topic.value))
                        self._reliable.submit(self._bus.publish, topic, self.name, message)
                    else:
                        self._bus.publish(topic, self.name, message)
                case ev.SendOdometry(position, quaternion, std_m, resets):
                    self._link.send_odometry(position, quaternion, std_m, resets)
                case ev.Reply(answer):
                    reply = self._replies.pop(answer.order_id, None)
                    if reply is not None:
                        self._reliable.submit(reply, answer)
                case ev.WatchBodies(bodies):
                    if not self._mocap_table.direct:  # who reads the system itself hears all bodies anyway
                        for body in bodies:
                            source = source_of(self._mocap_table, self._bus, body, *self._on_poses)
                            self._interest.submit(source.start)
                case ev.Follow(names):
                    self._interest.submit(self._bus.follow, Topic.STATE, names, self._on_state)
                    slowly = set(self.fleet.enabled_names) - names | {self.name}  # a twin speaks under our own name
                    self._interest.submit(self._bus.follow, Topic.FAR, slowly, self._on_state)
                case ev.SetOffboard():
                    self._link.set_offboard()
                case ev.Arm():
                    self._link.arm()
                case ev.Disarm():
                    self._link.disarm()
                case ev.Px4Land():
                    self._link.land()
                case ev.Kill():
                    self._link.kill()
                case ev.PlayTune():
                    self._link.play_tune()
                case ev.Exit():
                    self._end(EXIT_OK)

    def _end(self, status: int) -> None:
        if self._ended is not None and not self._ended.done():
            self._ended.set_result(status)

    # -- link --------------------------------------------------------------------------------------------------------

    async def _keep_link(self, loop: asyncio.AbstractEventLoop) -> None:
        """Discovery, rates and parameters; again when PX4 restarts."""
        required = required_params(self.vehicle)
        while True:
            try:
                if await loop.run_in_executor(self._blocking, self._link.connect, 1.0):
                    break
            except LinkError as error:
                log.error("%s", error)
                self._notices.append(ev.ParamsRead((str(error),)))
                await asyncio.sleep(_PARAM_REPEAT_S)
        log.info("PX4 answers at %s", self.vehicle.autopilot)
        while True:
            self._link.request_rates()
            asked_ns = time.monotonic_ns()
            while self._link.snapshot().heartbeat_ns < asked_ns:  # noqa: ASYNC110 - MAVSDK's threads set no Event
                await asyncio.sleep(0.1)
            is_armed = self._link.snapshot().is_armed
            if is_armed:  # by an earlier life of this agent, or a pilot: nothing is changed under way
                log.warning("PX4 is armed already: its origin and its parameters are left as they are")
            if self.vehicle.mocap_required and not is_armed:
                self._link.set_global_origin()
            if self._apply_params and not is_armed:
                await loop.run_in_executor(self._blocking, self._link.apply_params, required)
            problems: tuple[str, ...] | None = None
            read_ns = 0
            boot_ms = self._link.snapshot().px4_boot_ms
            while True:
                is_due = problems or time.monotonic_ns() - read_ns > _PARAM_AGAIN_NS  # somebody may have set another
                if problems is None or (is_due and self._core.flight.situation is Situation.GROUND):
                    read_ns = time.monotonic_ns()
                    actual = await loop.run_in_executor(self._blocking, self._link.read_params, required)
                    problems = differences(required, actual)
                    self._notices.append(ev.ParamsRead(problems))
                    for sentence in problems:
                        log.warning("%s", sentence)
                if self._core.flight.situation is Situation.GROUND:
                    self._link.settle_global_origin(sets_ours=self.vehicle.mocap_required)
                await asyncio.sleep(_PARAM_REPEAT_S if problems else 1.0)
                is_full = await loop.run_in_executor(self._blocking, realtime.is_disk_full)
                self._notices.append(ev.DiskChecked(is_full))
                before, boot_ms = boot_ms, self._link.snapshot().px4_boot_ms
                if boot_ms + 1000 < before:
                    log.warning("PX4 has restarted")
                    break


def _log_end(task: asyncio.Task[None]) -> None:
    """The link's upkeep never ends by itself; if a bug ends it, the flight goes on without it."""
    if not task.cancelled() and task.exception() is not None:
        log.error("upkeep of the link ended", exc_info=task.exception())


def run_agent(
    fleet: FleetConfig,
    name: str,
    *,
    apply_params: bool = False,
    law: str | None = None,
    is_realtime: bool = False,
    has_bus_mocap: bool = False,
) -> int:
    """Run one agent until it is told to stop; exit status as in the documentation of the commands."""
    lines = realtime.log_elsewhere(name, os.environ.get("COVEY_LOG", "INFO"))
    agent = Agent(fleet, name, apply_params=apply_params, law=law, is_realtime=is_realtime, has_bus_mocap=has_bus_mocap)
    try:
        return asyncio.run(agent.run())
    except (LinkError, BusError) as error:
        print(f"agent {name}: {error}", file=sys.stderr, flush=True)
        return EXIT_WRONG_INPUT
    finally:
        lines.stop()
