"""Inputs that wait for the next tick, and the callbacks of bus and mocap that put them there.

The callbacks come on threads of the bus and of the mocap. They only append, and a deque is safe for
that.
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

_MOST_EVENTS = 2000
_MOST_CORRECTIONS = 32  # frames that wait for a tick
_NODES_PER_TICK = 50
# states in a row; a longer gap is a silence, or a neighbour that was not followed
_MOST_MISSING = 50


class Inbox:
    """Queues of one agent.

    Args:
        vehicle: the agent's own.
        boot_id: of the agent's core.
        bus: not yet open.
        mocap: where the poses come from.
        state_ticks: from one state of a neighbour to the next.
        takes_corrections: whether PX4's receiver is given RTK corrections.
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
        # Notices are few, and events must push none of them out. Of events the newest are kept.
        self.notices: deque[agent_inputs.AgentInput] = deque(maxlen=_MOST_EVENTS)
        self.events: deque[agent_inputs.AgentInput] = deque(maxlen=_MOST_EVENTS)
        self._nodes: dict[str, bool] = {}  # node whose presence has changed -> whether it is there

        self._vehicle = vehicle
        self._boot_id = boot_id
        self._bus = bus
        self._mocap_config = mocap
        self._state_ticks = state_ticks
        self._takes_corrections = takes_corrections
        self._mocap: MocapSource | None = None
        self._others = BusMocap(bus, "*", self._pose_received, self._malformed_received)
        self._reported_problem = ""  # of the mocap
        self._counts = MessageCounts()  # since they were taken last
        self._sequences: dict[str, int] = {}  # of the newest state of each followed neighbour

    def start(self) -> None:
        """Subscribe to everything but the orders; the bus is open."""
        self.clock.start()
        self._bus.collect(Topic.SLOW_TELEMETRY, "*", self.neighbour_received)
        if self._vehicle.mocap_required and self._vehicle.body:
            self._mocap = self.source("*" if self._mocap_config.direct else self._vehicle.body)
            self._mocap.start()
            if not self._mocap_config.direct:  # else all bodies come from the source
                self._bus.collect(Topic.ALL_POSES, "*", self._all_poses_received)
        if self._takes_corrections:
            self._bus.collect(
                Topic.CORRECTIONS, "*", self._corrections_received, most=_MOST_CORRECTIONS
            )
        self._bus.watch_alive(self._node_changed)

    def stop(self) -> None:
        """End the mocap's source; the rest ends with the bus."""
        if self._mocap is not None:
            self._mocap.stop()

    def take_counts(self) -> agent_inputs.MessagesCounted:
        """Return how many messages were not passed on since the last call."""
        counts = self._counts
        self._counts = MessageCounts()
        return agent_inputs.MessagesCounted(counts.malformed, counts.refused, counts.dropped)

    def nodes_changed(self) -> list[agent_inputs.NodeChanged]:
        """Return the newest changes of nodes, at most as many as one tick has time for."""
        changes: list[agent_inputs.NodeChanged] = []
        while self._nodes and len(changes) < _NODES_PER_TICK:
            changes.append(agent_inputs.NodeChanged(*self._nodes.popitem()))
        return changes

    def neighbour_received(self, topic: Topic, name: str, message: Message | Malformed) -> None:
        """Take a state or a telemetry; under our own name it is another agent's."""
        if not isinstance(message, (StateMessage, Telemetry)):
            self._malformed_received()
            return

        # The bus checks who may publish under a name, but not what stands in the message.
        if message.vehicle != name:
            self._counts.refused += 1
            return

        if topic is Topic.STATE:
            self._count_missing(name, message.sequence)

        is_own = name == self._vehicle.name and message.boot_id == self._boot_id
        if is_own:
            return
        now_ns = time.monotonic_ns()
        if isinstance(message, StateMessage):
            message = self.clock.state(name, message, now_ns)
        self._append(agent_inputs.NeighbourReceived(message, now_ns))

    def _count_missing(self, name: str, sequence: int) -> None:
        """Count the states that were lost: to a follower every one is sent."""
        before = self._sequences.get(name, sequence - self._state_ticks)
        missing = (sequence - before) // self._state_ticks - 1
        if 0 < missing < _MOST_MISSING:
            self._counts.dropped += missing

        is_overtaken = -_MOST_MISSING < missing < 0
        if not is_overtaken:  # newer, or counted anew
            self._sequences[name] = sequence

    def source(self, body: str) -> MocapSource:
        """Return a source of one body's poses, not yet started."""
        return source_of(
            self._mocap_config, self._bus, body, self._pose_received, self._malformed_received
        )

    def watch_bodies(self, bodies: tuple[str, ...]) -> None:
        """Receive the poses of exactly these other bodies.

        A mocap that is read directly sends those of all bodies anyway.
        """
        if not self._mocap_config.direct:
            self._bus.follow(Topic.MOCAP, bodies, self._others.receive)

    def mocap_problem(self) -> agent_inputs.MocapProblemChanged | None:
        """Return the change of what is wrong with the mocap's source, if there is one."""
        problem = "" if self._mocap is None else self._mocap.problem
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
        stamped = (self.clock.pose(pose, now_ns) for pose in message.poses)
        self._append(
            agent_inputs.AllPosesReceived(
                tuple(pose for pose in stamped if pose is not None), now_ns
            )
        )

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
        if len(self.events) == _MOST_EVENTS:
            self._counts.dropped += 1  # the oldest makes room
        self.events.append(event)
