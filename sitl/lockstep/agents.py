"""An agent in simulated time: its real core, in a shell of plain calls.

The core of an agent takes inputs, decides, and returns commands. The shell around it receives
messages and executes the commands; in a real agent it is ``onboard.agent.loop``, with threads and
sockets. In this shell messages wait in an inbox until the next tick, and orders are answered at
once. Its simulated process can be stopped, continued, killed and started anew.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable

from msgspec.structs import replace

from onboard import agent_commands, agent_inputs
from onboard.agent.control_step import PipelineStep
from onboard.agent.core import AgentCore
from onboard.bus.codec import Malformed
from onboard.bus.protocol import UntrustedOrder
from onboard.bus.schema import (
    Corrections,
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
from onboard.types import TICK_S
from sitl.lockstep.bus import Node, SimBus
from sitl.lockstep.direct_link import EmulatedLink

CONNECT_AFTER_NS = 1_000_000_000  # time that a real link takes for discovery and parameters

_MAX_INPUTS = 2000  # inputs that can wait for a tick; then the oldest ones are dropped
_TICK_NS = round(1e9 * TICK_S)

# The loop statistics, as the loop of a real agent counts them.
_STATISTICS_TICKS = 25  # ticks from one report to the next
_STATISTICS_PERIODS = 500  # newest periods that a report is about
_PERIOD_MS = 1e3 * TICK_S
_LATE_MS = 5.0  # a tick delayed by more than this counts as late

OnReply = Callable[[OrderReply], None]


class AgentShell:
    """One agent: a core, and the simulated process around it.

    Args:
        fleet: the fleet file.
        name: name of its vehicle, and of its node on the bus.
        link: the link to its PX4.
        bus: the bus on which it becomes a node.
        pipeline_step: computes one pass of its pipeline.
    """

    def __init__(
        self,
        fleet: FleetConfig,
        name: str,
        *,
        link: EmulatedLink,
        bus: SimBus,
        pipeline_step: PipelineStep,
    ) -> None:
        self.fleet = fleet
        self.name = name
        self.link = link
        self._bus = bus
        self._pipeline_step = pipeline_step

        # the process
        self.is_running = False
        self.is_hung = False
        self._starts = 0  # number of processes started so far

        # faults that tests of shows inject
        self.path_delay_s = 0.0  # delay with which it starts its path, as if its clock were behind
        self.follows_alone = False  # whether it ignores the show clocks of the other vehicles

        self._inbox: deque[agent_inputs.AgentInput] = deque(maxlen=_MAX_INPUTS)

        # orders that came while it was hung
        self._waiting_orders: list[tuple[Order | Malformed | UntrustedOrder, OnReply]] = []
        # id of an order that the core works on -> function that sends the reply
        self._replies: dict[str, OnReply] = {}

        # ticks since the start of the flight, also those before a restart
        self._ticks = 0
        self._late = 0  # ticks whose period was too long
        self._last_ns = 0  # time of the last tick; 0: this process has not ticked yet
        self._periods_ms: deque[float] = deque(maxlen=_STATISTICS_PERIODS)

        self.start()

    # -- life --------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start a new process: a fresh core with no memory of the previous one."""
        if self.is_running:
            return

        self._starts += 1
        self.is_running = True
        self.is_hung = False

        self.core = AgentCore(
            self.fleet,
            self.name,
            boot_id=1000 * self._starts + self.index,
            pipeline_step=self._pipeline_step,
        )
        # A real agent runs its pipeline once before it is ready, to load and compile it.
        self.core.preflight.is_warm = True
        self._followed = self.core.neighbours.followed  # vehicles whose fast states it receives
        self._inbox.clear()
        self._last_ns = 0

        self.node = self._bus.node(self.name)
        self.node.start()
        self._subscribe(self.node)
        self._bus.call_at(self._bus.now_ns() + CONNECT_AFTER_NS, self._connect, self._starts)

    def kill(self) -> None:
        """End the process as SIGKILL does: it goes silent, and the others see it leave the bus."""
        if not self.is_running:
            return

        self.is_running = False
        self._waiting_orders.clear()
        self._replies.clear()
        self.node.stop()

    def hang(self) -> None:
        """Stall the event loop; the connections stay open."""
        self.is_hung = True

    def resume(self) -> None:
        """Continue the event loop; orders that have arrived meanwhile are handled now."""
        self.is_hung = False
        waiting_orders = self._waiting_orders
        self._waiting_orders = []
        for message, reply in waiting_orders:
            self._order_received(message, reply)

    def request_stop(self) -> None:
        """Ask the agent to end, as SIGTERM does: a flying vehicle lands first."""
        self._inbox.append(agent_inputs.ShutdownRequested())

    @property
    def index(self) -> int:
        """Index of the vehicle in the fleet file."""
        return self.fleet.vehicles[self.name].index

    @property
    def is_ticking(self) -> bool:
        """Whether its process runs and its event loop is not stalled."""
        return self.is_running and not self.is_hung

    # -- in ----------------------------------------------------------------------------------------

    def _connect(self, start: object) -> None:
        """Connect to PX4, unless another process has been started meanwhile."""
        if self.is_running and start == self._starts:
            self._inbox.append(self.link.connect())

    def _subscribe(self, node: Node) -> None:
        """Subscribe to all topics of an agent, so that their messages go to the inbox."""
        now_ns = self._bus.now_ns
        inbox = self._inbox
        vehicle = self.core.vehicle

        def is_interested(topic: object, other: object) -> bool:
            """Return whether a real agent would have subscribed to this topic of that vehicle.

            It receives fast states of the vehicles that it follows, and slow states of the others.
            This saves messages. The callbacks filter once more, because a message can be on its
            way while the agent begins or ends to follow a vehicle.
            """
            if topic is Topic.STATE:
                return other in self._followed
            if topic is Topic.FAR:
                return other not in self._followed
            return True

        def pose_received(_topic: Topic, _body: str, message: Message | Malformed) -> None:
            if isinstance(message, MocapPose):
                inbox.append(agent_inputs.PoseReceived(message, now_ns()))

        def all_poses_received(_topic: Topic, _name: str, message: Message | Malformed) -> None:
            if isinstance(message, MocapPoses):
                inbox.append(agent_inputs.AllPosesReceived(message.poses, now_ns()))

        def node_changed(other: str, is_alive: bool) -> None:
            inbox.append(agent_inputs.NodeChanged(other, is_alive))

        self._on_pose = pose_received
        node.is_interested = is_interested

        self._subscribe_neighbours(node)
        if vehicle.mocap_required and vehicle.body:
            node.subscribe(Topic.MOCAP, vehicle.body, pose_received)
        node.subscribe(Topic.ALL_POSES, "*", all_poses_received)
        if self.core.corrections is not None:
            node.subscribe(Topic.CORRECTIONS, "*", self._corrections_received)
        node.serve_orders(self.name, self._order_received)
        node.watch_alive(node_changed)

    def _subscribe_neighbours(self, node: Node) -> None:
        """Subscribe to the states and the telemetry of the other vehicles."""
        now_ns = self._bus.now_ns
        inbox = self._inbox
        name = self.name
        boot_id = self.core.boot_id

        def received(_topic: Topic, other: str, message: Message | Malformed) -> None:
            if isinstance(message, Malformed):
                inbox.append(agent_inputs.MessagesCounted(malformed=1))
                return

            # a message of another kind, or one whose vehicle differs from its topic
            if not isinstance(message, (StateMessage, Telemetry)) or message.vehicle != other:
                inbox.append(agent_inputs.MessagesCounted(refused=1))
                return

            # Skip its own messages. What arrives under its name with another boot id comes from
            # another process of the same vehicle, which the core has to notice.
            if other != name or message.boot_id != boot_id:
                inbox.append(agent_inputs.NeighbourReceived(message, now_ns()))

        def fast_state_received(topic: Topic, other: str, message: Message | Malformed) -> None:
            if other in self._followed:
                received(topic, other, message)

        def slow_state_received(topic: Topic, other: str, message: Message | Malformed) -> None:
            if other not in self._followed:
                received(topic, other, message)

        node.subscribe(Topic.STATE, "*", fast_state_received)
        node.subscribe(Topic.FAR, "*", slow_state_received)
        node.subscribe(Topic.SLOW_TELEMETRY, "*", received)

    def _corrections_received(
        self, _topic: Topic, _name: str, message: Message | Malformed
    ) -> None:
        if isinstance(message, Corrections):
            self._inbox.append(agent_inputs.CorrectionsReceived(message, self._bus.now_ns()))

    def _order_received(self, message: Order | Malformed | UntrustedOrder, reply: OnReply) -> None:
        if self.is_hung:
            self._waiting_orders.append((message, reply))
            return

        # Nothing malformed and no forged order is sent in lockstep.
        if isinstance(message, Order):
            message = self._with_path_fault(message)
            self._replies[message.order_id] = reply
            now_ns = self._bus.now_ns()
            # the order is judged by what PX4 reports now, not by the snapshot of the last tick
            self.core.handle(agent_inputs.SnapshotReceived(self.link.snapshot()), now_ns)
            self._execute(self.core.handle(agent_inputs.OrderReceived(message), now_ns))

    def _with_path_fault(self, order: Order) -> Order:
        """Return an order to follow a path, changed by ``path_delay_s`` and ``follows_alone``."""
        path = order.path
        if path is None or order.kind != "follow_path":
            return order

        path = replace(path, start_ns=path.start_ns + round(1e9 * self.path_delay_s))
        if self.follows_alone:
            # no other vehicle flies a show with this id, so there is no clock to compare with
            path = replace(path, show_id=self.name)
        return replace(order, path=path)

    # -- a tick ------------------------------------------------------------------------------------

    def receive(self, now_ns: int) -> None:
        """Hand all messages since the last tick to the core."""
        inbox = self._inbox
        handle = self.core.handle
        while inbox:
            commands = handle(inbox.popleft(), now_ns)
            if commands:
                self._execute(commands)

        handle(agent_inputs.SnapshotReceived(self.link.snapshot()), now_ns)

    def period_ns(self, now_ns: int) -> int:
        """Return the time since its last tick [ns], or the nominal period if it has not ticked."""
        if not self._last_ns:
            return _TICK_NS
        return now_ns - self._last_ns

    def tick(self, now_ns: int) -> None:
        """Run one tick of the core, and count it as the loop of a real agent does."""
        self._execute(self.core.tick(now_ns))

        if self._last_ns:
            period_ms = (now_ns - self._last_ns) * 1e-6
            self._periods_ms.append(period_ms)
            if period_ms > _PERIOD_MS + _LATE_MS:
                self._late += 1

        self._last_ns = now_ns
        self._ticks += 1
        if self._ticks % _STATISTICS_TICKS == 0:
            self._report_periods(now_ns)

    def _report_periods(self, now_ns: int) -> None:
        """Hand the statistics of the loop to the core."""
        periods_ms = sorted(self._periods_ms)
        last = len(periods_ms) - 1
        timed = agent_inputs.LoopTimed(
            p50_ms=periods_ms[round(0.5 * last)],
            p99_ms=periods_ms[round(0.99 * last)],
            max_ms=periods_ms[-1],
            late_ticks=self._late,
        )
        self.core.handle(timed, now_ns)

    # one case per command, each a line or two long
    def _execute(self, commands: list[agent_commands.Command]) -> None:  # noqa: C901
        """Execute the commands of the core in their order."""
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
                case agent_commands.SendCorrections(flags, data):
                    link.send_corrections(flags, data)
                case agent_commands.Reply(answer):
                    reply = self._replies.pop(answer.order_id, None)
                    if reply is not None:
                        reply(answer)
                case agent_commands.WatchBodies(bodies):
                    self._watch_bodies(bodies)
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
                case agent_commands.RebootPx4():
                    link.reboot()
                case agent_commands.PlayTune():
                    link.play_tune()
                case agent_commands.Exit():
                    self.kill()

    def _watch_bodies(self, bodies: Iterable[str]) -> None:
        """Subscribe to the poses of the vehicle's own body and of these others."""
        vehicle = self.core.vehicle
        watched = list(bodies)
        if vehicle.mocap_required and vehicle.body:
            watched.insert(0, vehicle.body)
        self.node.follow(Topic.MOCAP, watched, self._on_pose)
