"""An agent's shell in simulated time.

Calls do what ``onboard.agent.loop`` does with threads and sockets.

The core is the real one. Between two ticks messages wait in the inbox, orders are answered at once,
and commands are executed in their order. The process around the core can be stopped, continued,
killed and started anew.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from onboard import agent_commands, agent_inputs
from onboard.agent.control_step import PipelineStep
from onboard.agent.core import AgentCore
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
from onboard.types import TICK_S
from sitl.lockstep.bus import Node, SimBus
from sitl.lockstep.link import EmulatedLink

CONNECT_AFTER_NS = 1_000_000_000  # discovery and parameters of a real link
_MAX_EVENTS = 2000
_STATISTICS_TICKS = 25
_TICK_NS = round(1e9 * TICK_S)
_PERIOD_MS = 1e3 * TICK_S
_LATE_MS = 5.0


class AgentShell:
    """One agent.

    Args:
        link: its PX4.
        bus: where it becomes a node of the vehicle's name.
        pipeline_step: how its passes are calculated.
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
        self.is_hung = self.is_running = False
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
        self.core = AgentCore(
            self.fleet,
            self.name,
            boot_id=1000 * self._lives + self.index,
            pipeline_step=self._pipeline_step,
        )
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

    # -- a tick ------------------------------------------------------------------------------------

    def receive(self, now_ns: int) -> None:
        """Hand what has arrived since the last tick to the core."""
        inbox = self._inbox
        handle = self.core.handle
        while inbox:
            commands = handle(inbox.popleft(), now_ns)
            if commands:
                self._execute(commands)
        handle(agent_inputs.SnapshotReceived(self.link.snapshot()), now_ns)

    def period_ns(self, now_ns: int) -> int:
        """Return the time since its last tick; before the first one a whole period."""
        return now_ns - self._last_ns if self._last_ns else _TICK_NS

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
            periods = sorted(self._periods_ms)
            p50, p99 = (periods[round(share * (len(periods) - 1))] for share in (0.5, 0.99))
            self.core.handle(agent_inputs.LoopTimed(p50, p99, periods[-1], self._late), now_ns)

    # one case for each command, each of a line or two
    def _execute(self, commands: list[agent_commands.Command]) -> None:  # noqa: C901
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
