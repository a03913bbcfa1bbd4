"""Keeps the newest inputs of the agent that the preflight rules need."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from onboard.agent_inputs import (
    AgentInput,
    CertificateChecked,
    ClocksCompared,
    LoopTimed,
    MocapProblemChanged,
    NeighbourReceived,
    NodeChanged,
    ParamsRead,
    PoseReceived,
    SnapshotReceived,
)
from onboard.autopilot import Snapshot
from onboard.bus.control_token import GROUND, WATCHER
from onboard.bus.schema import MocapPose, StateMessage, Telemetry
from onboard.neighbours.duplicate_agents import DuplicateAgents
from onboard.security.node_roles import NodeRole
from onboard.tuples import Wxyz

RECORDER = "recorder"  # first word of a recorder's node name
EMULATOR = NodeRole.EMULATOR.value  # first word of an emulator's node name
_DUPLICATE_FOR_NS = 3_000_000_000  # another agent for this vehicle counts for this time
_POSE_SOURCE_NS = 500_000_000  # a program counts as a source for this time after a pose


class MocapSample(NamedTuple):
    """Newest mocap sample of our own body."""

    quaternion_enu_flu_wxyz: Wxyz
    received_ns: int
    delay_s: float  # from its stamp to its arrival


@dataclass(slots=True)
class PreflightInputs:
    """Newest input of each kind. Pass every input of the agent to :meth:`hear`."""

    vehicle: str
    body: str | None  # mocap body of this vehicle
    boot_id: int  # number of this start of the agent

    sample: MocapSample | None = None
    param_problems: tuple[str, ...] | None = None  # None until PX4's parameters are read
    dropped: Snapshot = field(default_factory=Snapshot)  # newest snapshot with impossible numbers
    loop_p99_ms: float = 0.0
    source_problem: str = ""  # problem of a mocap that this computer reads; empty: none
    certificate: CertificateChecked | None = None  # None on a bus without keys
    # node on another host -> largest error of its clock
    clock_bounds_s: dict[str, float] = field(default_factory=dict)
    duplicates: DuplicateAgents = field(default_factory=DuplicateAgents)

    # sender's boot id -> arrival of its last pose
    _pose_sources: dict[int, int] = field(default_factory=dict)
    _nodes: set[str] = field(default_factory=set)  # nodes on the bus
    _duplicate_ns: int | None = None  # arrival of the last message of another agent of this vehicle

    @property
    def has_recorder(self) -> bool:
        """Whether a recorder is on the bus."""
        return self._has(RECORDER)

    @property
    def has_emulator(self) -> bool:
        """Whether an emulator is on the bus."""
        return self._has(EMULATOR)

    def _has(self, role: str) -> bool:
        """Return whether a node with a name that starts with this word is on the bus."""
        return any(_first_word(node) == role for node in self._nodes)

    def pose_sources(self, now_ns: int) -> int:
        """Return the number of programs that have recently sent poses of our own body."""
        return sum(
            1 for heard_ns in self._pose_sources.values() if now_ns - heard_ns < _POSE_SOURCE_NS
        )

    def has_duplicate(self, now_ns: int) -> bool:
        """Return whether another agent has published for this vehicle in the last seconds."""
        return self._duplicate_ns is not None and now_ns - self._duplicate_ns < _DUPLICATE_FOR_NS

    def hear(self, event: AgentInput) -> None:
        """Take an input of any kind. Many kinds have no effect here."""
        match event:
            case PoseReceived(pose, received_ns):
                if pose.body == self.body and pose.is_tracked:
                    self._take_pose(pose, received_ns)
            case NeighbourReceived(message, received_ns):
                self._take_message(message, received_ns)
            case ClocksCompared(bounds_s):
                self.clock_bounds_s = {
                    node: bound_s
                    for node, bound_s in bounds_s.items()
                    if _first_word(node) not in (GROUND, WATCHER)
                }
            case NodeChanged(node, is_alive):
                if is_alive:
                    self._nodes.add(node)
                else:
                    self._nodes.discard(node)
            case ParamsRead(problems):
                self.param_problems = problems
            case SnapshotReceived(snapshot):
                self.dropped = snapshot
            case CertificateChecked():
                self.certificate = event
            case LoopTimed():
                self.loop_p99_ms = event.p99_ms
            case MocapProblemChanged(sentence):
                self.source_problem = sentence

    def _take_message(self, message: StateMessage | Telemetry, received_ns: int) -> None:
        """Detect two agents that publish for the same vehicle."""
        if message.vehicle == self.vehicle:
            if message.boot_id != self.boot_id:
                self._duplicate_ns = received_ns
            return

        if isinstance(message, Telemetry):
            self.duplicates.hear(message.vehicle, message.boot_id, received_ns)
            if self.vehicle in message.doubles:
                self._duplicate_ns = received_ns

    def _take_pose(self, pose: MocapPose, received_ns: int) -> None:
        """Keep the newest sample, and the programs that have sent samples in the last moment."""
        self.sample = MocapSample(
            quaternion_enu_flu_wxyz=pose.quaternion_enu_flu_wxyz,
            received_ns=received_ns,
            delay_s=(received_ns - pose.stamp_ns) * 1e-9,
        )

        recent = {
            sender: heard_ns
            for sender, heard_ns in self._pose_sources.items()
            if received_ns - heard_ns < _POSE_SOURCE_NS
        }
        recent[pose.boot_id] = received_ns
        self._pose_sources = recent


def _first_word(node: str) -> str:
    """Return the first word of a node's name, which gives the kind of node."""
    word, _, _ = node.partition("-")
    return word
