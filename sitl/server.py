"""Emulated PX4s in real time: one process, and one UDP socket per link in PX4's port layout.

This module, `fleet_emulator.py` and `bus_messages.py` connect the emulator with the rest of the
project. They read fleet files, and publish poses and ground truth on the bus. From the bus comes
nothing but orders for faults.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import os
import selectors
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from onboard.bus.clock_sync import ClockNode
from onboard.bus.codec import Malformed
from onboard.bus.pose_publisher import PosePublisher
from onboard.bus.schema import FaultOrder, OrderReply
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig
from onboard.end_signals import end_signals
from onboard.security.credentials import credentials_of
from onboard.security.mavlink_key import mavlink_key
from onboard.security.node_roles import NodeRole
from sitl.bus_messages import TRUTH_EVERY_STEPS, Broadcast, answer_fault
from sitl.emulator.emulator import Environment
from sitl.emulator.mocap import MocapSettings
from sitl.faults.catalogue import Fault
from sitl.fleet_emulator import emulator_of
from sitl.mavlink.endpoints import (
    Address,
    Ports,
    Socket,
    StartError,
    bind,
    ground_ports,
    onboard_ports,
    read_all,
    simulator_ports,
)
from sitl.mavlink.lossy_link import LossyLink
from sitl.mavlink.streams import GCS_RATES_HZ, ONBOARD_RATES_HZ, SIMULATOR_RATES_HZ
from sitl.physics.vehicle import STEP_S

# A busy machine delays the process at times. The process catches up on a delay of up to this number
# of steps, and reads its sockets between them. This is less than the shortest COM_OF_LOSS_T in use.
# After a longer delay, simulated time pauses instead.
_LARGEST_BACKLOG_STEPS = 70
_REALTIME_PRIORITY = 5  # below the priority that the loops of agents may request


@dataclass(frozen=True, slots=True)
class _LinkPlan:
    """One link that will be opened."""

    index: int  # index of the vehicle
    ports: Ports
    rates_hz: dict[int, float]
    name: str  # name for :class:`LossyLink`
    title: str  # name in sentences


class Server:
    """The emulated part of a fleet in real time.

    Args:
        fleet: the fleet file.
        vehicles: names of the vehicles to emulate.
        seed: seed of all random numbers.
        mocap: quality of the emulated motion capture.
        bus: session of the bus for poses and truth; None: MAVLink only.
        truth_offset_m: offset of the published true positions, to prove that no flight depends on
            them.
        station: ground station to which every vehicle streams; None: no ground station.
        environment: wind, downwash and errors.
        injected: planned faults.
        px4: version of PX4 of all vehicles; None: the version of each in the fleet file.
        file_session_bytes: number of bytes after which a file transfer ends silently; 0: no limit.

    Raises:
        FaultError: a planned fault is impossible.
    """

    def __init__(
        self,
        fleet: FleetConfig,
        vehicles: Sequence[str],
        *,
        seed: int,
        mocap: MocapSettings | None = None,
        bus: BusSession | None = None,
        truth_offset_m: float = 0.0,
        station: Address | None = None,
        environment: Environment | None = None,
        injected: Sequence[Fault] = (),
        px4: str | None = None,
        file_session_bytes: int = 0,
    ) -> None:
        self._station = station
        self.fleet = fleet
        self._vehicles = [fleet.vehicles[name] for name in vehicles]
        self.emulator = emulator_of(
            fleet, self._vehicles, seed=seed, environment=environment, px4=px4
        )
        self.emulator.unix_start_s = time.time()
        for logs in self.emulator.keep_logs():
            logs.session_limit_bytes = file_session_bytes
        self._put_keys(fleet)
        for fault in injected:
            self.emulator.inject(fault)

        self.bus = bus
        self._poses: PosePublisher | None = None
        own_node = ""
        if bus is not None:
            self._poses = PosePublisher(bus)
            own_node = bus.node
        self._broadcast = Broadcast(
            self.emulator,
            self._vehicles,
            mocap,
            people=fleet.people,
            seed=seed,
            boot_id=time.time_ns() & 0x7FFFFFFF,  # different at each start
            # The clock of the event loop is the monotonic one, from which all nodes take stamps.
            stamp_ns=lambda time_s: round((self._epoch_s + time_s) * 1e9),
            source=own_node,
            truth_offset_m=truth_offset_m,
        )
        self._sockets: list[Socket] = []
        self._ready = selectors.DefaultSelector()
        self._epoch_s = 0.0  # time of the event loop at the start of simulated time

    def _put_keys(self, fleet: FleetConfig) -> None:
        """Store the key of each PX4 that supports signing, as if it had been set earlier."""
        for vehicle, px4, store in zip(
            self._vehicles, self.emulator.autopilots, self.emulator.key_stores, strict=True
        ):
            key = mavlink_key(fleet, vehicle.name)
            if px4.version.knows_signing and key is not None:
                store.put(key, 0)

    async def start(self) -> list[str]:
        """Bind all ports, or no port if one cannot be bound; return a line per link.

        Raises:
            StartError: a port is taken or an endpoint cannot be emulated.
        """
        plans = self._links()

        sockets: list[socket.socket] = []
        try:
            for plan in plans:
                sockets.append(bind(plan.ports, plan.title))
        except StartError:
            for sock in sockets:
                sock.close()
            raise

        lines: list[str] = []
        for sock, plan in zip(sockets, plans, strict=True):
            link = LossyLink(self.emulator, plan.index, plan.rates_hz, plan.name)
            opened = Socket(sock, link, plan.ports.peer)
            opened.open(self._ready)
            self._sockets.append(opened)

            _, own_port = plan.ports.bind
            line = f"{self._vehicles[plan.index].name} {own_port}"
            if plan.ports.peer is not None:
                _, peer_port = plan.ports.peer
                line += f" -> {peer_port}"
            lines.append(line)
        return lines

    def _links(self) -> list[_LinkPlan]:
        """Return the links of all vehicles."""
        plans: list[_LinkPlan] = []
        for index, vehicle in enumerate(self._vehicles):
            key = f"vehicles.{vehicle.name}"
            companion = _LinkPlan(
                index=index,
                ports=onboard_ports(vehicle.autopilot, f"{key}.autopilot"),
                rates_hz=ONBOARD_RATES_HZ,
                name="companion",
                title=f"The companion link of {vehicle.name}",
            )
            plans.append(companion)

            ports = ground_ports(vehicle.autopilot, vehicle.direct, key, self._station)
            if ports is not None:
                ground = _LinkPlan(
                    index=index,
                    ports=ports,
                    rates_hz=GCS_RATES_HZ,
                    name="ground",
                    title=f"The ground link of {vehicle.name}",
                )
                plans.append(ground)

            ports = simulator_ports(vehicle.autopilot)
            if ports is not None:
                simulator = _LinkPlan(
                    index=index,
                    ports=ports,
                    rates_hz=SIMULATOR_RATES_HZ,
                    name="simulator",
                    title=f"The simulator's link of {vehicle.name}",
                )
                plans.append(simulator)
        return plans

    async def run(self, stopped: asyncio.Event, say: Callable[[str], None]) -> None:
        """Fly in real time, on an absolute schedule, until `stopped`."""
        loop = asyncio.get_running_loop()
        self._epoch_s = loop.time() - self.emulator.time_s

        while not stopped.is_set():
            elapsed_steps = int((loop.time() - self._epoch_s) / STEP_S)
            due_steps = elapsed_steps - self.emulator.world.vehicles.steps
            if due_steps > _LARGEST_BACKLOG_STEPS:
                # The delay is too long to catch up. Simulated time pauses, as PX4's does.
                self._epoch_s += (due_steps - 1) * STEP_S
                due_steps = 1

            for _ in range(due_steps):
                self._step(say)

            wake_s = self._epoch_s + (self.emulator.world.vehicles.steps + 1) * STEP_S
            await asyncio.sleep(max(0.0, wake_s - loop.time()))

    def stop(self) -> None:
        """Close all sockets; a second call does nothing."""
        for opened in self._sockets:
            opened.close(self._ready)
        self._sockets.clear()

    def _step(self, say: Callable[[str], None]) -> None:
        """Read the sockets, advance by one step, and send."""
        read_all(self._ready)

        for collision in self.emulator.step():
            first = self._vehicles[collision.first].name
            second = self._vehicles[collision.second].name
            say(
                f"collision: {first} and {second} touched at {collision.time_s:.2f} s "
                f"({collision.distance_m:.2f} m between centres); both fall"
            )
        for notice in self.emulator.disturbances.take_notices():
            say(f"{notice} ({self.emulator.time_s:.2f} s)")

        for opened in self._sockets:
            opened.endpoint.poll()
        if self.emulator.world.vehicles.steps % TRUTH_EVERY_STEPS == 0:
            self._publish()

    def _publish(self) -> None:
        if self.bus is None or self._poses is None:
            return
        poses, truths = self._broadcast.messages()
        for pose in poses:
            self._poses.publish(pose)
        for truth in truths:
            self.bus.publish(Topic.TRUTH, truth.vehicle, truth)


def simulator_bus(
    fleet: FleetConfig, node: str = "sitl", *, is_partial: bool = False
) -> BusSession:
    """Return the node of an emulator, or of a relay of truth, on the bus of a fleet.

    The node connects to the agents.

    Args:
        fleet: the fleet file.
        node: name of the node.
        is_partial: whether the node emulates a part of the fleet, while a relay publishes the poses
            of the other part.
    """
    agents = [fleet.vehicles[name].agent for name in fleet.enabled_names]
    # While only a part is emulated, the relay of the other part has the main endpoint.
    main_endpoint, second_endpoint = fleet.pose_endpoints
    endpoint = main_endpoint
    if is_partial:
        endpoint = second_endpoint
    return BusSession(
        namespace=fleet.namespace,
        node=node,
        listen=[endpoint],
        connect=agents,
        credentials=credentials_of(fleet, NodeRole.EMULATOR),
        routers=fleet.fleet.routers,
    )


def run(server: Server) -> None:
    """Emulate until a signal asks to end, and print "ready: ..." once all ports are bound.

    Raises:
        StartError: a port or an endpoint cannot be used.
        BusError: the bus cannot be opened.
    """
    asyncio.run(_serve(server))


async def _serve(server: Server) -> None:
    """Run a server until a signal asks to end, and close its sockets and its bus at the end."""
    bus = server.bus
    stopped = asyncio.Event()
    loop = asyncio.get_running_loop()
    clock: asyncio.Task[None] | None = None
    for number in end_signals():
        loop.add_signal_handler(number, stopped.set)
    take_precedence()

    try:
        lines = await server.start()
        if bus is not None:
            bus.start()

            def take_fault(
                order: FaultOrder | Malformed, reply: Callable[[OrderReply], None]
            ) -> None:
                loop.call_soon_threadsafe(
                    lambda: reply(answer_fault(server.emulator, server.fleet, order))
                )

            bus.serve_faults(take_fault)
            clock = loop.create_task(ClockNode(bus).keep())  # agents may run on other hosts

        # A full garbage collection would delay all vehicles. The present objects stay in use until
        # the end, so that the collector can leave them out.
        gc.collect()
        gc.freeze()

        print(f"ready: {', '.join(lines)}", flush=True)
        await server.run(stopped, _say)
    finally:
        server.stop()
        if clock is not None:
            clock.cancel()
        if bus is not None:
            bus.stop()


def take_precedence() -> None:
    """Let this thread run before other processes, if this is permitted.

    The threads that this thread starts later have the same precedence. Without it, other processes
    would delay the flight of the emulated vehicles.
    """
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(_REALTIME_PRIORITY))


def _say(line: str) -> None:
    print(line, flush=True)
