"""Queues of inputs that wait for the next tick, filled by callbacks of the bus and the mocap.

The callbacks run on threads of the bus and of the mocap. They only append to a deque, which is safe
between threads. The loop empties the queues at each tick.
"""

from __future__ import annotations

import time
from collections import deque

from onboard import agent_inputs
from onboard.agent.peers import CONCERNS_AGENTS
from onboard.bus.clock_sync import ClockNode
from onboard.bus.codec import Malformed
from onboard.bus.protocol import Bus
from onboard.bus.schema import (
    Corrections,
    Message,
    MocapPose,
    MocapPoses,
    StateMessage,
    Telemetry,
)
from onboard.bus.topics import Topic
from onboard.config.fleet import Vehicle
from onboard.config.mocap import MocapConfig
from onboard.message_counts import MessageCounts
from onboard.mocap.bus_source import BusMocap
from onboard.mocap.factory import source_of
from onboard.mocap.source import MocapSource

_MAX_EVENTS = 2000  # largest number of messages that wait for a tick
_MAX_CORRECTIONS = 32  # largest number of frames that wait for a tick
_NODES_PER_TICK = 50  # one tick handles at most this many changes of nodes
# if more states than this are missing, the neighbour was silent or not followed, and none counts as
# lost
_MAX_MISSING = 50


class Inbox:
    """Queues of one agent.

    Args:
        vehicle: the agent's own vehicle.
        boot_id: number of this start of the agent.
        bus: the bus, not yet open.
        mocap: source of the poses.
        state_ticks: number of ticks between two states of a neighbour.
        takes_corrections: whether PX4's receiver gets RTK corrections.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        boot_id: int,
        bus: Bus,
        mocap: MocapConfig,
        state_ticks: int = 1,
        *,
        takes_corrections: bool = False,
    ) -> None:
        self.clock = ClockNode(bus)
        # Events are messages of others. If they come in a flood, the newest are kept. Notices of
        # this process are few, and have their own queue so that no event can push them out.
        self.notices: deque[agent_inputs.AgentInput] = deque(maxlen=_MAX_EVENTS)
        self.events: deque[agent_inputs.AgentInput] = deque(maxlen=_MAX_EVENTS)
        self._nodes: dict[str, bool] = {}  # changed node -> whether it is present

        self._vehicle = vehicle
        self._boot_id = boot_id
        self._bus = bus
        self._mocap_config = mocap
        self._state_ticks = state_ticks
        self._takes_corrections = takes_corrections
        self._mocap: MocapSource | None = None
        # receives the poses of the bodies that watch_bodies names
        self._other_bodies = BusMocap(bus, "*", self._pose_received, self._malformed_received)
        self._reported_problem = ""  # problem of the mocap's source that was reported last
        self._counts = MessageCounts()  # since the last take_counts
        self._sequences: dict[str, int] = {}  # followed neighbour -> sequence of its newest state

    def start(self) -> None:
        """Subscribe to everything except orders. The bus must be open."""
        self.clock.start()
        self._bus.collect(Topic.SLOW_TELEMETRY, "*", self.neighbour_received)
        if self._vehicle.mocap_required and self._vehicle.body:
            if self._mocap_config.direct:
                self._mocap = self.source("*")  # delivers the poses of all bodies
            else:
                self._mocap = self.source(self._vehicle.body)
                self._bus.collect(Topic.ALL_POSES, "*", self._all_poses_received)
            self._mocap.start()
        if self._takes_corrections:
            self._bus.collect(
                Topic.CORRECTIONS, "*", self._corrections_received, most=_MAX_CORRECTIONS
            )
        self._bus.watch_alive(self._node_changed)

    def stop(self) -> None:
        """Stop the mocap's source; the subscriptions end with the bus."""
        if self._mocap is not None:
            self._mocap.stop()

    def take_counts(self) -> agent_inputs.MessagesCounted:
        """Return how many messages have not been passed on since the last call."""
        counts = self._counts
        self._counts = MessageCounts()
        return agent_inputs.MessagesCounted(counts.malformed, counts.refused, counts.dropped)

    def nodes_changed(self) -> list[agent_inputs.NodeChanged]:
        """Take the newest changes of nodes, at most _NODES_PER_TICK."""
        changes: list[agent_inputs.NodeChanged] = []
        while self._nodes and len(changes) < _NODES_PER_TICK:
            changes.append(agent_inputs.NodeChanged(*self._nodes.popitem()))
        return changes

    def neighbour_received(self, topic: Topic, name: str, message: Message | Malformed) -> None:
        """Take a state or a telemetry message.

        Messages of this agent are skipped. A message under our own name with another boot_id comes
        from a second agent of the same vehicle, and is taken.
        """
        if not isinstance(message, (StateMessage, Telemetry)):
            self._malformed_received()
            return

        # the bus checks who may publish under a name, but not the name inside the message
        if message.vehicle != name:
            self._counts.refused += 1
            return

        if topic is Topic.STATE:
            self._count_missing(name, message.sequence)

        if name == self._vehicle.name and message.boot_id == self._boot_id:
            return
        now_ns = time.monotonic_ns()
        on_own_clock = self.clock.from_neighbour(name, message, now_ns)
        self._append(agent_inputs.NeighbourReceived(on_own_clock, now_ns))

    def _count_missing(self, name: str, sequence: int) -> None:
        """Count the states of a followed neighbour that were lost before the state ``sequence``."""
        # at the first state of a neighbour, no state is missing
        last_sequence = self._sequences.get(name, sequence - self._state_ticks)
        missing = (sequence - last_sequence) // self._state_ticks - 1
        if 0 < missing < _MAX_MISSING:
            self._counts.dropped += missing

        # A small negative number: a newer state has overtaken this state. A large negative number:
        # the neighbour has restarted its count.
        is_overtaken = -_MAX_MISSING < missing < 0
        if not is_overtaken:
            self._sequences[name] = sequence

    def source(self, body: str) -> MocapSource:
        """Return a source of one body's poses, not yet started."""
        return source_of(
            self._mocap_config, self._bus, body, self._pose_received, self._malformed_received
        )

    def watch_bodies(self, bodies: tuple[str, ...]) -> None:
        """Receive the poses of exactly these other bodies.

        A mocap that is read directly sends the poses of all bodies anyway.
        """
        if not self._mocap_config.direct:
            self._bus.follow(Topic.MOCAP, bodies, self._other_bodies.receive)

    def mocap_problem(self) -> agent_inputs.MocapProblemChanged | None:
        """Return the problem of the mocap's source if it has changed; otherwise None."""
        problem = ""
        if self._mocap is not None:
            problem = self._mocap.problem
        if problem == self._reported_problem:
            return None
        self._reported_problem = problem
        return agent_inputs.MocapProblemChanged(problem)

    def _pose_received(self, pose: MocapPose, received_ns: int) -> None:
        stamped = self.clock.pose(pose, received_ns)
        if stamped is not None:
            self._append(agent_inputs.PoseReceived(stamped, received_ns))

    def _all_poses_received(self, _topic: Topic, _name: str, message: Message | Malformed) -> None:
        if not isinstance(message, MocapPoses):
            self._malformed_received()
            return
        now_ns = time.monotonic_ns()
        stamped = [self.clock.pose(pose, now_ns) for pose in message.poses]
        usable = tuple(pose for pose in stamped if pose is not None)
        self._append(agent_inputs.AllPosesReceived(usable, now_ns))

    def _corrections_received(
        self, _topic: Topic, _name: str, message: Message | Malformed
    ) -> None:
        if not isinstance(message, Corrections):
            self._malformed_received()
            return
        now_ns = time.monotonic_ns()
        stamped = self.clock.corrections(message, now_ns)
        self._append(agent_inputs.CorrectionsReceived(stamped, now_ns))

    def _node_changed(self, node: str, is_alive: bool) -> None:
        if node.startswith(CONCERNS_AGENTS):
            self._nodes[node] = is_alive

    def _malformed_received(self) -> None:
        self._counts.malformed += 1

    def _append(self, event: agent_inputs.AgentInput) -> None:
        if len(self.events) == _MAX_EVENTS:
            self._counts.dropped += 1  # append removes the oldest event
        self.events.append(event)
