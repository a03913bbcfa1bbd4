"""Inputs of the agent's core, which computes without I/O.

Inputs are poses, messages of the neighbours, orders, PX4's newest snapshot, and observations of the
process about itself. The shell does all I/O, and passes them to the core one by one before each
tick.

Some twenty inputs are created at every tick. They are frozen Structs, because creating a Struct
takes a tenth of the time of a frozen dataclass.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from onboard.autopilot import Snapshot
from onboard.bus.protocol import UntrustedOrder
from onboard.bus.schema import Corrections, MocapPose, Order, StateMessage, Telemetry


class PoseReceived(Struct, frozen=True):
    """A mocap sample of one body."""

    pose: MocapPose
    received_ns: int  # on our clock


class AllPosesReceived(Struct, frozen=True):
    """Mocap samples of several bodies that arrived together."""

    poses: tuple[MocapPose, ...]
    received_ns: int  # on our clock


class NeighbourReceived(Struct, frozen=True):
    """A neighbour's state or telemetry message."""

    message: StateMessage | Telemetry
    received_ns: int  # on our clock


class CorrectionsReceived(Struct, frozen=True):
    """An RTCM frame of the fleet's base."""

    message: Corrections
    received_ns: int  # on our clock


class OrderReceived(Struct, frozen=True):
    """An order; the core answers it with a ``Reply`` in the same call."""

    order: Order


class OrderUntrusted(Struct, frozen=True):
    """An order that the bus rejected because its signature or its sender is wrong."""

    order: UntrustedOrder


class NodeChanged(Struct, frozen=True):
    """A node appeared on the bus or left it."""

    node: str
    is_alive: bool


class SnapshotReceived(Struct, frozen=True):
    """Newest snapshot of the link to PX4."""

    snapshot: Snapshot


class SetpointDropped(Struct, frozen=True):
    """The last tick's setpoint was not sent, because the tick took too long."""


class ParamsRead(Struct, frozen=True):
    """PX4's parameters were read and compared with the required ones."""

    problems: tuple[str, ...]  # a sentence for each wrong parameter; empty when all are right
    # charge at which PX4's simulated battery stops emptying; 0 for a real battery
    battery_floor_frac: float = 0.0


class ClocksCompared(Struct, frozen=True):
    """The clocks of the nodes on other hosts were compared with ours."""

    bounds_s: Mapping[str, float]  # node -> largest error of its clock; inf: not measured yet


class CertificateChecked(Struct, frozen=True):
    """The process checked how long the certificates of this computer are still valid."""

    node: str  # the node whose certificate ends first
    left_s: float  # time until that end, by this computer's wall clock; negative after it


class LoopTimed(Struct, frozen=True):
    """Statistics of the control loop over the last ten seconds."""

    p50_ms: float  # median of the period
    p99_ms: float  # 99th percentile of the period
    max_ms: float  # maximum of the period
    late_ticks: int  # number of ticks since the start whose period was too long
    lateness_p99_ms: float = 0.0  # 99th percentile of the time by which a tick began too late
    missed_ticks: int = 0  # number of ticks since the start that were skipped


class MessagesCounted(Struct, frozen=True):
    """Numbers of messages that the shell has not passed on since the last input of this type.

    ``message_counts.py`` says what each reason means.
    """

    malformed: int = 0
    refused: int = 0
    dropped: int = 0


class TickFailed(Struct, frozen=True):
    """The shell caught an exception of the last tick, which is a bug of Covey."""

    sentence: str


class DiskChecked(Struct, frozen=True):
    """The process checked whether this computer's disk has space for logs and records."""

    is_full: bool


class MocapProblemChanged(Struct, frozen=True):
    """The source that reads the mocap stopped delivering poses, or delivers them again."""

    sentence: str  # why it delivers nothing; empty when it delivers again


class ShutdownRequested(Struct, frozen=True):
    """Somebody asks this process to end; a vehicle in the air lands first."""


AgentInput = (
    PoseReceived
    | AllPosesReceived
    | NeighbourReceived
    | CorrectionsReceived
    | OrderReceived
    | OrderUntrusted
    | NodeChanged
    | SnapshotReceived
    | SetpointDropped
    | ParamsRead
    | ClocksCompared
    | CertificateChecked
    | LoopTimed
    | MessagesCounted
    | TickFailed
    | DiskChecked
    | MocapProblemChanged
    | ShutdownRequested
)
