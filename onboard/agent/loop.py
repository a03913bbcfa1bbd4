"""The agent's shell: moves bytes and time between PX4, the bus and the core, and decides nothing.

One thread runs the core: a timer on an absolute schedule calls it 50 times a second. Inputs from
MAVSDK's and Zenoh's threads wait for the next tick, except orders. Blocking calls run on their own
threads, so that nothing delays the setpoint of a tick.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
import sys
import time
from collections.abc import Callable

from onboard import agent_commands, agent_inputs
from onboard.agent.command_executor import CommandExecutor
from onboard.agent.core import AgentCore
from onboard.agent.inbox import Inbox
from onboard.agent.link_upkeep import LinkUpkeep
from onboard.agent.log_relay import LogRelay
from onboard.agent.start_attempts import started
from onboard.agent.ticker import Ticker
from onboard.agent.warm_up import warm_up
from onboard.autopilot import LinkError
from onboard.bus.codec import Malformed
from onboard.bus.protocol import BusError, UntrustedOrder
from onboard.bus.schema import Order, OrderReply
from onboard.bus.session import BusSession
from onboard.config.fleet import ConfigError, FleetConfig, MocapConfig
from onboard.end_signals import end_signals
from onboard.exit_status import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_OK, EXIT_WRONG_INPUT
from onboard.preflight.preflight_facts import HEARTBEAT_SILENT_S
from onboard.process import realtime
from onboard.process.systemd import Notifier
from onboard.px4.mavsdk_link import Px4Link
from onboard.safety.failsafe_table import Situation
from onboard.security.certificate_ends import first_end, links_left_s
from onboard.security.credentials import credentials_of
from onboard.security.mavlink_key import mavlink_key
from onboard.types import TICK_S

PERIOD_NS = round(TICK_S * 1e9)
# rate of PX4's position with mocap, which only compares this position
_CHECKED_POSITION_HZ = 10.0
_SATELLITES_HZ = 5.0  # rate of PX4's satellite fix, without mocap
_STATISTICS_TICKS = 25  # number of ticks between two reports of the loop's times
_FAILED_TICKS_TO_LAND = 25  # after each such number of failed ticks in a row, PX4 lands
_TIDY_TICKS = 500  # number of ticks between two garbage collections, on the ground only
_ROUTER_S = 1.0  # time of one search for a router; signals are handled between two searches

log = logging.getLogger("covey.agent")


class AgentProcess:
    """One vehicle's process: link, bus, core and loop.

    :func:`run_agent` explains the arguments.
    """

    def __init__(
        self,
        fleet: FleetConfig,
        name: str,
        *,
        apply_params: bool,
        is_realtime: bool = False,
        has_bus_mocap: bool = False,
    ) -> None:
        self._fleet = fleet
        self._name = name
        self._is_realtime = is_realtime
        vehicle = fleet.vehicles[name]

        boot_id = time.time_ns() & 0x7FFFFFFF  # differs at each start, and fits 31 bits
        self._core = AgentCore(fleet, name, boot_id=boot_id, clock=time.perf_counter)

        position_hz = 1e9 / PERIOD_NS
        satellites_hz = _SATELLITES_HZ
        if vehicle.mocap_required:  # then PX4's own position is only compared
            position_hz = _CHECKED_POSITION_HZ
            satellites_hz = 0.0
        self._link = Px4Link(
            vehicle.autopilot,
            vehicle.system_id,
            position_hz=position_hz,
            satellites_hz=satellites_hz,
            key=mavlink_key(fleet, name),
        )

        other_agents = [
            fleet.vehicles[other].agent for other in fleet.enabled_names if other != name
        ]
        self._bus = BusSession(
            namespace=fleet.namespace,
            node=name,
            listen=[vehicle.agent],
            connect=[*other_agents, *fleet.pose_endpoints],
            credentials=credentials_of(fleet, name),
            routers=fleet.fleet.routers,
            router_timeout_s=_ROUTER_S,
        )

        # earliest expiry of the certificates that the links use; None without certificates
        self._certificate_end = first_end(fleet, name)
        # monotonic time at which the links are closed; None without certificates
        self._links_end_ns: int | None = None
        left_s = links_left_s([fleet], name)
        if left_s is not None:
            self._links_end_ns = time.monotonic_ns() + round(left_s * 1e9)
        self._ends_links = False  # whether the process ends because of its certificate

        mocap = fleet.mocap
        if has_bus_mocap or vehicle.emulated:
            mocap = MocapConfig()  # its default: poses come over the bus
        self._inbox = Inbox(
            vehicle=vehicle,
            boot_id=self._core.boot_id,
            bus=self._bus,
            mocap=mocap,
            state_ticks=fleet.state_ticks,
            takes_corrections=fleet.takes_corrections(vehicle),
        )
        self._executor = CommandExecutor(
            name=name,
            others=[other for other in fleet.vehicles if other != name],
            link=self._link,
            bus=self._bus,
            inbox=self._inbox,
            on_exit=self._exit,
            on_dropped=lambda: self._inbox.notices.append(agent_inputs.SetpointDropped()),
        )
        self._upkeep = LinkUpkeep(
            fleet=fleet,
            vehicle=vehicle,
            link=self._link,
            flight=self._core.flight,
            notify=self._inbox.notices.append,
            applies_params=apply_params,
        )

        self._log_relay = LogRelay(name, self._link, self._bus)

        # the ticks of the vehicles are spread over the period
        offset_ns = vehicle.index * PERIOD_NS // max(1, len(fleet.vehicles))
        self._ticker = Ticker(PERIOD_NS, self._tick, offset_ns=offset_ns)

        self._notifier = Notifier()
        self._ended: asyncio.Future[int] | None = None
        self._ticks = 0
        self._failed_ticks = 0  # in a row
        self._signals = 0  # number of signals that asked to stop, without SIGHUP
        self._stop_requested = asyncio.Event()  # set by the first signal, also by SIGHUP
        self._has_said_ready = False

    async def run(self) -> int:
        """Fly until the process is asked to end; return the exit status."""
        loop = asyncio.get_running_loop()
        self._ended = loop.create_future()

        # first of all, because a request to stop may come early
        for number in end_signals():
            loop.add_signal_handler(number, self._signalled, number)

        warm_up(self._fleet, self._name)

        try:
            for start in (self._link.start, self._bus.start):
                if not await started(self._name, start, self._stop_requested):
                    return EXIT_OK

            self._inbox.start()
            self._log_relay.start()
            self._bus.serve_orders(self._name, self._order_on_bus_thread)
            self._core.preflight.is_warm = True

            realtime.stop_garbage_collection()  # none in flight
            if self._is_realtime:
                self._upkeep.start_threads()
                self._executor.start_threads()
                if self._fleet.own_law is not None:  # a user's law may never return
                    realtime.end_when_hung()
                log.info("%s", realtime.set_realtime_priority())

            self._ticker.start(loop)
            self._upkeep.start()
            return await self._ended
        finally:
            self._ticker.stop()
            self._upkeep.stop()
            self._executor.stop()
            self._inbox.stop()
            self._bus.stop()
            self._link.stop()

    def _order_on_bus_thread(
        self, message: Order | Malformed | UntrustedOrder, reply: Callable[[OrderReply], None]
    ) -> None:
        assert self._ended is not None
        self._ended.get_loop().call_soon_threadsafe(self._order_received, message, reply)

    def _order_received(
        self, message: Order | Malformed | UntrustedOrder, reply: Callable[[OrderReply], None]
    ) -> None:
        now_ns = time.monotonic_ns()

        if isinstance(message, Malformed):
            self._core.handle(agent_inputs.MessagesCounted(malformed=1), now_ns)
            answer = OrderReply(
                order_id="",
                vehicle=self._name,
                is_accepted=False,
                reason="The order is not readable.",
            )
            self._executor.reliable.submit(reply, answer)
            return

        if isinstance(message, UntrustedOrder):
            if message.is_answered:
                self._executor.expect_reply(message.order_id, reply)
            self._executor.execute(self._core.handle(agent_inputs.OrderUntrusted(message), now_ns))
            return

        self._executor.expect_reply(message.order_id, reply)
        self._core.handle(agent_inputs.SnapshotReceived(self._link.snapshot()), now_ns)
        order = self._inbox.clock.order(message, now_ns)
        self._executor.execute(self._core.handle(agent_inputs.OrderReceived(order), now_ns))
        log.info("order %s", message.text)

    def _signalled(self, number: signal.Signals) -> None:
        # Several SIGHUPs come when a terminal closes, from its shell and from the kernel, and then
        # perhaps a SIGTERM at the end of the login. None of them may cut the landing short.
        if number != signal.SIGHUP:
            self._signals += 1

        if self._signals > 1:
            with contextlib.suppress(OSError):  # the terminal may be closed
                os.write(
                    2,
                    b"second request to stop: ending at once; "
                    b"in the air PX4's own failsafe lands the vehicle\n",
                )
            os._exit(EXIT_INTERRUPTED)
        elif not self._stop_requested.is_set():
            self._stop_requested.set()
            log.info("asked to stop: landing first if in the air")
            self._inbox.notices.append(agent_inputs.ShutdownRequested())

    def _exit(self) -> None:
        status = EXIT_OK
        if self._ends_links:
            status = EXIT_FAILED
        if self._ended is not None and not self._ended.done():
            self._ended.set_result(status)

    # -- tick --------------------------------------------------------------------------------------

    def _tick(self) -> None:
        now_ns = time.monotonic_ns()
        self._executor.tick_ns = now_ns
        try:
            self._run_core(now_ns)
            self._failed_ticks = 0
            self._notifier.alive(now_ns, self._core.flight.state)
        except Exception as error:  # our own bug in flight: only this place catches it
            log.exception("tick failed")
            self._failed_ticks += 1
            self._core.handle(
                agent_inputs.TickFailed(f"Internal error: {type(error).__name__}: {error}."), now_ns
            )
            if self._failed_ticks % _FAILED_TICKS_TO_LAND == 0:
                self._land_by_px4(now_ns)

        self._ticks += 1
        if self._ticks % _STATISTICS_TICKS == 0:
            self._report_loop(now_ns)

        flight = self._core.flight
        if self._ticks % _TIDY_TICKS == 0 and flight.step.situation is Situation.GROUND:
            realtime.collect_garbage()

        # submit returns False if its queue is full; then the next tick tries again
        if not self._has_said_ready and flight.state == "ready":
            self._has_said_ready = self._executor.reliable.submit(
                lambda: print(f"agent {self._name}: ready", flush=True)
            )

    def _land_by_px4(self, now_ns: int) -> None:
        """Let PX4 land a vehicle that this agent flies, unless a pilot flies it by hand."""
        is_by_hand = self._link.snapshot().is_flown_by_hand(now_ns)
        if self._core.flight.step.is_streaming and not is_by_hand:
            self._link.land()

    def _run_core(self, now_ns: int) -> None:
        core = self._core
        inbox = self._inbox
        execute = self._executor.execute

        while inbox.notices:
            execute(core.handle(inbox.notices.popleft(), now_ns))
        for change in inbox.nodes_changed():
            execute(core.handle(change, now_ns))
        self._bus.deliver()

        # commands in response to poses; the setpoint does not wait for them
        pose_commands: list[agent_commands.Command] = []
        while inbox.events:
            pose_commands += core.handle(inbox.events.popleft(), now_ns)
        snapshot = self._link.snapshot()
        core.handle(agent_inputs.SnapshotReceived(snapshot), now_ns)

        execute(core.tick(now_ns))
        execute(pose_commands)

        is_on_ground = core.flight.step.situation is Situation.GROUND
        hears_px4 = (now_ns - snapshot.heartbeat_ns) * 1e-9 < HEARTBEAT_SILENT_S
        is_disarmed = is_on_ground and hears_px4 and not snapshot.is_armed
        self._log_relay.step(is_disarmed=is_disarmed, now_ns=now_ns)

        if self._ticks % _STATISTICS_TICKS == 0:
            inbox.clock.beat()
            core.handle(inbox.take_counts(), now_ns)
            errors_s = inbox.clock.clocks.largest_errors_s(now_ns)
            core.handle(agent_inputs.ClocksCompared(errors_s), now_ns)
            problem = inbox.mocap_problem()
            if problem is not None:
                core.handle(problem, now_ns)
            self._check_certificate(now_ns)

    def _check_certificate(self, now_ns: int) -> None:
        """Tell the core how long the certificates stay valid; end the process after they expired.

        Open links survive the expiry of a certificate, so no flight is interrupted. Once the
        certificate has been expired for longer than the longest flight, the process ends as soon as
        the vehicle is on the ground. That closes the links. This time is counted from the start of
        the process by the monotonic clock: a time of day that is wrong for a moment ends nothing.
        """
        end = self._certificate_end
        if end is None or self._links_end_ns is None:
            return

        left_s = end.left_s(time.time())
        self._core.handle(agent_inputs.CertificateChecked(end.node, left_s), now_ns)

        is_long_expired = now_ns > self._links_end_ns
        is_on_ground = self._core.flight.step.situation is Situation.GROUND
        if is_long_expired and is_on_ground and not self._ends_links:
            self._ends_links = True
            log.error("the certificate of %s has ended: all links are closed now", end.node)
            self._inbox.notices.append(agent_inputs.ShutdownRequested())

    def _report_loop(self, now_ns: int) -> None:
        ticker = self._ticker
        p50_ms, p99_ms, max_ms = ticker.statistics_ms()
        timed = agent_inputs.LoopTimed(
            p50_ms=p50_ms,
            p99_ms=p99_ms,
            max_ms=max_ms,
            late_ticks=ticker.late_ticks,
            lateness_p99_ms=ticker.lateness_p99_ms(),
            missed_ticks=ticker.missed_ticks,
        )
        self._core.handle(timed, now_ns)


def run_agent(
    fleet: FleetConfig,
    name: str,
    *,
    apply_params: bool = False,
    is_realtime: bool = False,
    has_bus_mocap: bool = False,
) -> int:
    """Run one agent until it is asked to end.

    Args:
        fleet: the fleet file.
        name: name of the vehicle.
        apply_params: whether PX4's required parameters are set, and not only checked.
        is_realtime: whether the control loop gets realtime priority.
        has_bus_mocap: whether poses come over the bus, whatever the fleet file says.
    Returns:
        The exit status.
    """

    async def run() -> int:
        # AgentProcess has handlers of its own
        stop_requested = asyncio.Event()
        for number in end_signals():
            asyncio.get_running_loop().add_signal_handler(number, stop_requested.set)

        if not await started(name, lambda: credentials_of(fleet, name), stop_requested):
            return EXIT_OK
        agent = AgentProcess(
            fleet,
            name,
            apply_params=apply_params,
            is_realtime=is_realtime,
            has_bus_mocap=has_bus_mocap,
        )
        return await agent.run()

    log_level = os.environ.get("COVEY_LOG", "INFO")
    if log_level.upper() not in logging.getLevelNamesMapping():
        print(
            f"agent {name}: COVEY_LOG is '{log_level}', which is no level of the log. Write debug, "
            "info, warning or error.",
            file=sys.stderr,
            flush=True,
        )
        return EXIT_WRONG_INPUT

    log_listener = realtime.log_in_thread(name, log_level.upper())
    try:
        return asyncio.run(run())
    except (ConfigError, LinkError, BusError) as error:
        print(f"agent {name}: {error}", file=sys.stderr, flush=True)
        return EXIT_WRONG_INPUT
    finally:
        log_listener.stop()
