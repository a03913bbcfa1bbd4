"""Events that wait for the next tick, and the bus and mocap callbacks that put them there.

The callbacks come on threads of the bus and of the mocap: they only append, and a deque is safe for that.
"""

from __future__ import annotations

import time
from collections import deque

from onboard import events as ev
from onboard.agent.peers import CONCERNS_AGENTS
from onboard.bus.clock_sync import ClockNode
from onboard.bus.codec import Malformed
from onboard.bus.protocol import Bus
from onboard.bus.schema import Message, MocapPose, StateMessage, Telemetry
from onboard.bus.topics import Topic
from onboard.config.fleet import Vehicle
from onboard.config.mocap import MocapConfig
from onboard.mocap.factory import source_of
from onboard.mocap.source import MocapSource

_MOST_EVENTS = 2000
_NODES_PER_TICK = 50


class Inbox:
    """Queues of one agent.

    Args:
        vehicle: the agent's own.
        boot_id: of the agent's core.
        bus: not yet open.
        mocap: where the poses come from.
    """

    def __init__(self, vehicle: Vehicle, boot_id: int, bus: Bus, mocap: MocapConfig) -> None:
        self.clock = ClockNode(bus)
        self.notices: deque[ev.EventIn] = deque(maxlen=_MOST_EVENTS)  # few, and the others must push none of them out
        self.events: deque[ev.EventIn] = deque(maxlen=_MOST_EVENTS)  # the newest matter
        self._nodes: dict[str, bool] = {}  # node whose presence has changed -> whether it is there
        self._vehicle, self._boot_id, self._bus, self._mocap_config = vehicle, boot_id, bus, mocap
        self._mocap: MocapSource | None = None
        self._reported_problem = ""  # of the mocap

    def start(self) -> None:
        """Subscribe to everything but the orders; the bus is open."""
        self.clock.start()
        self._bus.collect(Topic.SLOW_TELEMETRY, "*", self.neighbour_received)
        if self._vehicle.mocap_required and self._vehicle.body:
            self._mocap = self.source("*" if self._mocap_config.direct else self._vehicle.body)
            self._mocap.start()
        self._bus.watch_alive(self._node_changed)

    def stop(self) -> None:
        """End the mocap's source; the rest ends with the bus."""
        if self._mocap is not None:
            self._mocap.stop()

    def nodes_changed(self) -> list[ev.NodeChanged]:
        """Return the newest changes of nodes, at most as many as one tick has time for."""
        changes: list[ev.NodeChanged] = []
        while self._nodes and len(changes) < _NODES_PER_TICK:
            changes.append(ev.NodeChanged(*self._nodes.popitem()))
        return changes

    def neighbour_received(self, topic: Topic, name: str, message: Message | Malformed) -> None:
        """Take a state or a telemetry; under our own name it is another agent's."""
        if not isinstance(message, (StateMessage, Telemetry)):
            self._malformed_received()
        elif name != self._vehicle.name or message.boot_id != self._boot_id:
            now_ns = time.monotonic_ns()
            if isinstance(message, StateMessage):
                message = self.clock.state(name, message, now_ns)
            self.events.append(ev.NeighbourReceived(message, now_ns))

    def source(self, body: str) -> MocapSource:
        """Return a source of one body's poses, not yet started."""
        return source_of(self._mocap_config, self._bus, body, self._pose_received, self._malformed_received)

    def further_sources(self, bodies: tuple[str, ...]) -> list[MocapSource]:
        """Return sources of other bodies' poses; none where the mocap is read directly, with all its bodies."""
        return [] if self._mocap_config.direct else [self.source(body) for body in bodies]

    def mocap_problem(self) -> ev.MocapProblemChanged | None:
        """Return the change of what is wrong with the mocap's source, if there is one."""
        problem = "" if self._mocap is None else self._mocap.problem
        if problem == self._reported_problem:
            return None
        self._reported_problem = problem
        return ev.MocapProblemChanged(problem)

    def _pose_received(self, pose: MocapPose, received_ns: int) -> None:
        stamped = self.clock.pose(pose, received_ns)
        if stamped is not None:
            self.events.append(ev.PoseReceived(stamped, received_ns))

    def _node_changed(self, node: str, is_alive: bool) -> None:
        if node.startswith(CONCERNS_AGENTS):
            self._nodes[node] = is_alive

    def _malformed_received(self) -> None:
        self.events.append(ev.MessageMalformed())
