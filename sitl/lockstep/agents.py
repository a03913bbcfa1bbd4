"""An agent's shell in simulated time: calls do what ``onboard.agent.loop`` does with threads and
sockets.

The core is the real one. Between two ticks messages wait in the inbox, orders are answered at once,
and commands are executed in their order. The process around the core can be stopped, continued,
killed and started anew.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from onboard import agent_commands, agent_inputs
from onboard.agent.control_step import PipelineInputs
from onboard.agent.core import AgentCore
from onboard.arrays import BoolArray
from onboard.bus.codec import Malformed
from onboard.bus.protocol import UntrustedOrder
from onboard.bus.schema import (
    Message,
    MocapPose,
    MocapPoses,
    Order,
    OrderReply,
    StateMessage,
    Telemetry,
)
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig
from onboard.control.pipeline import PipelineMemory
from onboard.neighbours.subscription import is_slow
from onboard.neighbours.table import NeighbourTable
from onboard.rollout.rows import Rows
from onboard.types import TICK_S, Tick
from sitl.lockstep.bus import Node, SimBus
from sitl.lockstep.link import EmulatedLink
from sitl.lockstep.neighbour_tables import Round, Tables

CONNECT_AFTER_NS = 1_000_000_000  # discovery and parameters of a real link
BULK_FROM = 8  # vehicles, from which it is cheaper to take what the others say all at once
_MAX_EVENTS = 2000
_STATISTICS_TICKS = 25
_PERIOD_MS = 1e3 * TICK_S
_LATE_MS = 5.0


@dataclass(frozen=True, slots=True)
class Arrivals:
    """Messages that have arrived at one instant."""

    received_ns: int
    states: list[StateMessage]
    telemetries: dict[str, Telemetry]
    round: Round | None  # the states as arrays


def by_arrival(
    messages: Sequence[tuple[int, Message]], indices: Mapping[str, int]
) -> list[Arrivals]:
    """Return messages grouped by the time of arrival, with the states made into arrays once for all
    receivers.
    """
    arrivals = []
    for received_ns, group in itertools.groupby(messages, key=lambda one: one[0]):
        both = [message for _, message in group]
        states = [message for message in both if isinstance(message, StateMessage)]
        telemetries = {
            message.vehicle: message for message in both if isinstance(message, Telemetry)
        }
        arrivals.append(
            Arrivals(
                received_ns, states, telemetries, Round.of(states, indices) if states else None
            )
        )
    return arrivals


class FleetTables:
    """All agents' tables of their neighbours in common arrays, so that what all hear is heard at
    once.
    """

    def __init__(self, agents: Sequence[AgentShell]) -> None:
        self._collect([agent.core.neighbours for agent in agents])

    def _collect(self, tables: list[NeighbourTable]) -> None:
        self.tables = Tables(tables)
        self._rows = {id(table): row for row, table in enumerate(tables)}

    def receive(
        self, agents: Sequence[AgentShell], arrivals: Sequence[Arrivals], now_ns: int
    ) -> None:
        """Take the messages since the last tick in all agents' tables; an agent started anew has a
        new table.
        """
        tables = [agent.core.neighbours for agent in agents]
        if any(id(table) not in self._rows for table in tables):
            self._collect(tables)
        # an agent that has stood still has older messages waiting, and takes the newest after them
        at_once = [agent.is_ticking and not agent.has_backlog for agent in agents]
        is_listening = np.array(at_once)
        for one in arrivals:
            if one.round is not None:
                self.tables.hear(one.round, one.received_ns, is_listening)
            for agent, is_quick in zip(agents, at_once, strict=True):
                if is_quick:
                    agent.core.neighbours.hear_telemetry(one.telemetries, one.received_ns)
                elif agent.is_running:
                    agent.receive_later((one,))
        self.tables.age(now_ns)

    def snapshots(self, tables: Sequence[NeighbourTable], now_ns: int) -> tuple[Rows, BoolArray]:
        """Return the snapshots of some of the tables (n, K) as rows of Neighbour, and which of them
        are present.
        """
        return self.tables.snapshots([self._rows[id(table)] for table in tables], now_ns)


class AgentShell:
    """One agent.

    Args:
        link: its PX4; bus: where it becomes a node of the vehicle's name.
    """

    def __init__(self, fleet: FleetConfig, name: str, link: EmulatedLink, bus: SimBus) -> None:
        self.fleet, self.name, self.link, self._bus = fleet, name, link, bus
        self._reads_in_bulk = len(fleet.enabled_names) >= BULK_FROM
        self.is_hung = self.is_running = self.has_backlog = False
        self._lives = 0
        self._inbox: deque[agent_inputs.AgentInput] = deque(maxlen=_MAX_EVENTS)
        self._orders: list[
            tuple[Order | Malformed | UntrustedOrder, Callable[[OrderReply], None]]
        ] = []
        self._replies: dict[str, Callable[[OrderReply], None]] = {}
        self._periods_ms: deque[float] = deque(maxlen=500)
        self._ticks = self._late = self._last_ns = 0
        self.start()

    # -- life --------------------------------------------------------------------------------------

    def start(self) -> None:
        """A new process: a fresh core that knows nothing of its predecessor."""
        if self.is_running:
            return
        self._lives += 1
        self.is_running, self.is_hung = True, False
        self.core = AgentCore(self.fleet, self.name, boot_id=1000 * self._lives + self.index)
        self.core.preflight.is_warm = True
        self._followed = self.core.neighbours.followed
        self._inbox.clear()
        self._last_ns = 0
        self.node = self._bus.node(self.name)
        self.node.start()
        self._subscribe(self.node)
        self._bus.call_at(self._bus.now_ns() + CONNECT_AFTER_NS, self._connect, self._lives)

    def kill(self) -> None:
        """SIGKILL: silence on the wire and on the bus, and the others see the connections close."""
        if self.is_running:
            self.is_running = False
            self._orders.clear()
            self._replies.clear()
            self.node.stop()

    def hang(self) -> None:
        """The event loop stalls; the connections live on."""
        self.is_hung = True

    def resume(self) -> None:
        """It goes on, and finds what has arrived meanwhile."""
        self.is_hung = False
        orders, self._orders = self._orders, []
        for message, reply in orders:
            self._order_received(message, reply)

    def request_stop(self) -> None:
        """SIGTERM: land first if in the air."""
        self._inbox.append(agent_inputs.ShutdownRequested())

    @property
    def index(self) -> int:
        """Index of the vehicle in the fleet file."""
        return self.fleet.vehicles[self.name].index

    @property
    def is_ticking(self) -> bool:
        """Whether its loop turns."""
        return self.is_running and not self.is_hung

    # -- in ----------------------------------------------------------------------------------------

    def _connect(self, life: object) -> None:
        if self.is_running and life == self._lives:
            self._inbox.append(self.link.connect())

    def _subscribe(self, node: Node) -> None:
        now_ns, vehicle = self._bus.now_ns, self.core.vehicle
        inbox, name, boot_id = self._inbox, self.name, self.core.boot_id

        def is_interested(topic: object, other: object) -> bool:
            """Whether it would have subscribed: to fast states of those followed, to slow ones of
            the others.
            """
            return topic not in (Topic.STATE, Topic.FAR) or (topic is Topic.STATE) == (
                other in self._followed
            )

        def neighbour(topic: Topic, other: str, message: Message | Malformed) -> None:
            if not is_interested(topic, other):
                return
            if not isinstance(message, (StateMessage, Telemetry)) or message.vehicle != other:
                is_claim = not isinstance(message, Malformed)
                inbox.append(agent_inputs.MessagesCounted(malformed=not is_claim, refused=is_claim))
            elif other != name or message.boot_id != boot_id:
                inbox.append(agent_inputs.NeighbourReceived(message, now_ns()))

        def pose(_topic: Topic, _body: str, message: Message | Malformed) -> None:
            if isinstance(message, MocapPose):
                inbox.append(agent_inputs.PoseReceived(message, now_ns()))

        def all_poses(_topic: Topic, _name: str, message: Message | Malformed) -> None:
            if isinstance(message, MocapPoses):
                inbox.append(agent_inputs.AllPosesReceived(message.poses, now_ns()))

        self._on_neighbour, self._on_pose, node.is_interested = neighbour, pose, is_interested
        if self._reads_in_bulk:
            self._bus.subscribe_in_bulk(node, neighbour)
        else:
            node.subscribe(Topic.STATE, "*", neighbour)
            node.subscribe(Topic.FAR, "*", neighbour)
            node.subscribe(Topic.SLOW_TELEMETRY, "*", neighbour)
        if vehicle.mocap_required and vehicle.body:
            node.subscribe(Topic.MOCAP, vehicle.body, pose)
        node.subscribe(Topic.ALL_POSES, "*", all_poses)
        node.serve_orders(name, self._order_received)
        node.watch_alive(
            lambda other, is_alive: inbox.append(agent_inputs.NodeChanged(other, is_alive))
        )

    def _order_received(
        self, message: Order | Malformed | UntrustedOrder, reply: Callable[[OrderReply], None]
    ) -> None:
        if self.is_hung:
            self._orders.append((message, reply))
        elif isinstance(message, Order):
            self._replies[message.order_id] = reply
            now_ns = self._bus.now_ns()
            self.core.handle(agent_inputs.SnapshotReceived(self.link.snapshot()), now_ns)
            self._execute(self.core.handle(agent_inputs.OrderReceived(message), now_ns))

    def receive_later(self, arrivals: Sequence[Arrivals]) -> None:
        """Put messages into the inbox one by one: they wait for a loop that stands still."""
        self.has_backlog = True
        for one in arrivals:
            for state in one.states:
                self._on_neighbour(Topic.STATE, state.vehicle, state)
                if is_slow(state.sequence):
                    self._on_neighbour(Topic.FAR, state.vehicle, state)
            for telemetry in one.telemetries.values():
                self._on_neighbour(Topic.SLOW_TELEMETRY, telemetry.vehicle, telemetry)

    # -- a tick ------------------------------------------------------------------------------------

    def begin_tick(self, now_ns: int) -> PipelineInputs:
        """Take what has arrived and the first half of the core's tick."""
        inbox, handle = self._inbox, self.core.handle
        self.has_backlog = False
        while inbox:
            commands = handle(inbox.popleft(), now_ns)
            if commands:
                self._execute(commands)
        handle(agent_inputs.SnapshotReceived(self.link.snapshot()), now_ns)
        return self.core.begin_tick(now_ns)

    def end_tick(self, memory: PipelineMemory, tick: Tick, now_ns: int) -> None:
        """The second half, with what the pipeline made of it."""
        self._execute(self.core.end_tick(memory, tick))
        if self._last_ns:
            period_ms = (now_ns - self._last_ns) * 1e-6
            self._periods_ms.append(period_ms)
            self._late += period_ms > _PERIOD_MS + _LATE_MS
        self._last_ns = now_ns
        self._ticks += 1
        if self._ticks % _STATISTICS_TICKS == 0:
            periods = sorted(self._periods_ms)
            p50, p99 = (periods[round(share * (len(periods) - 1))] for share in (0.5, 0.99))
            self.core.handle(agent_inputs.LoopTimed(p50, p99, periods[-1], self._late), now_ns)

    def _execute(self, commands: list[agent_commands.Command]) -> None:
        link = self.link
        for command in commands:
            match command:
                case agent_commands.SendAttitude(setpoint):
                    link.send_attitude(setpoint)
                case agent_commands.Publish(topic, message):
                    self.node.publish(topic, self.name, message)
                case agent_commands.Follow(names):
                    self._followed = names
                case agent_commands.SendOdometry(position, quaternion, std_m, resets):
                    link.send_odometry(position, quaternion, std_m, resets)
                case agent_commands.Reply(answer):
                    reply = self._replies.pop(answer.order_id, None)
                    if reply is not None:
                        reply(answer)
                case agent_commands.WatchBodies(bodies):
                    vehicle = self.core.vehicle
                    own = (vehicle.body,) if vehicle.mocap_required and vehicle.body else ()
                    self.node.follow(Topic.MOCAP, (*own, *bodies), self._on_pose)
                case agent_commands.SetOffboard():
                    link.set_offboard()
                case agent_commands.Arm():
                    link.arm()
                case agent_commands.Disarm():
                    link.disarm()
                case agent_commands.Px4Land():
                    link.land()
                case agent_commands.Kill():
                    link.kill()
                case agent_commands.RequestHeartbeat():
                    link.request_heartbeat()
                case agent_commands.PlayTune():
                    link.play_tune()
                case agent_commands.Exit():
                    self.kill()
