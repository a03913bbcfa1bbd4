"""Inputs and outputs of the agent's core: frozen values, no clock, no sockets.

Some twenty of them are made at every tick; a frozen Struct costs a tenth of a frozen dataclass.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from onboard.autopilot import Snapshot, Vec3, Vec4
from onboard.bus.protocol import UntrustedOrder
from onboard.bus.schema import Message, MocapPose, Order, OrderReply, StateMessage, Telemetry
from onboard.bus.topics import Topic
from onboard.types import AttitudeSetpoint


class PoseReceived(Struct, frozen=True):
    """A mocap sample, with its arrival on our clock."""

    pose: MocapPose
    received_ns: int


class AllPosesReceived(Struct, frozen=True):
    """Mocap samples of several bodies, with their arrival on our clock."""

    poses: tuple[MocapPose, ...]
    received_ns: int


class NeighbourReceived(Struct, frozen=True):
    """A neighbour's state or telemetry."""

    message: StateMessage | Telemetry
    received_ns: int


class OrderReceived(Struct, frozen=True):
    """An order; its answer comes as a :class:`Reply` in the same call."""

    order: Order


class OrderUntrusted(Struct, frozen=True):
    """An order that is not believed."""

    order: UntrustedOrder


class NodeChanged(Struct, frozen=True):
    """A node appeared on the bus or left it."""

    node: str
    is_alive: bool


class SnapshotReceived(Struct, frozen=True):
    """Newest snapshot of the link to PX4."""

    snapshot: Snapshot


class ParamsRead(Struct, frozen=True):
    """What PX4's parameters say."""

    problems: tuple[str, ...]  # sentences about wrong ones; empty when all are right
    # charge at which PX4's simulated battery stops emptying; 0 for a real one
    battery_floor_frac: float = 0.0


class ClocksCompared(Struct, frozen=True):
    """Nodes on other hosts, and how well their clocks are known [s]; infinite: not measured yet."""

    bounds_s: Mapping[str, float]


class LoopTimed(Struct, frozen=True):
    """Statistics of the loop's period over the last window, and how far behind its schedule it
    began.
    """

    p50_ms: float
    p99_ms: float
    max_ms: float
    late_ticks: int
    lateness_p99_ms: float = 0.0
    missed_ticks: int = 0


class MessagesCounted(Struct, frozen=True):
    """Messages that the shell has not passed on, since the last such event: see message_counts.py."""

    malformed: int = 0
    refused: int = 0
    dropped: int = 0


class TickFailed(Struct, frozen=True):
    """The shell caught an exception of the last tick: our own bug."""

    sentence: str


class DiskChecked(Struct, frozen=True):
    """Whether this computer's disk has room left for logs and records."""

    is_full: bool


class MocapProblemChanged(Struct, frozen=True):
    """Reason why the mocap delivers nothing, from the source that reads it; empty when it delivers
    again.
    """

    sentence: str


class ShutdownRequested(Struct, frozen=True):
    """Somebody wants this process to end; in the air it lands first."""


EventIn = (
    PoseReceived
    | AllPosesReceived
    | NeighbourReceived
    | OrderReceived
    | OrderUntrusted
    | NodeChanged
    | SnapshotReceived
    | ParamsRead
    | ClocksCompared
    | LoopTimed
    | MessagesCounted
    | TickFailed
    | DiskChecked
    | MocapProblemChanged
    | ShutdownRequested
)


class SendAttitude(Struct, frozen=True):
    """One setpoint, already in PX4's heading."""

    setpoint: AttitudeSetpoint


class SetOffboard(Struct, frozen=True):
    """Ask PX4 for OFFBOARD."""


class Px4Land(Struct, frozen=True):
    """Ask PX4 to land by itself."""


class Arm(Struct, frozen=True):
    """Ask PX4 to arm."""


class Disarm(Struct, frozen=True):
    """Ask PX4 to disarm; it refuses in the air."""


class Kill(Struct, frozen=True):
    """Stop the motors now."""


class RequestHeartbeat(Struct, frozen=True):
    """Ask PX4 for a heartbeat now, since one waits for another that agrees."""


class PlayTune(Struct, frozen=True):
    """Let PX4 play a tune, so that people see which vehicle it is."""


class SendOdometry(Struct, frozen=True):
    """Forward a mocap pose to PX4; another reset count tells its estimator to begin anew there."""

    position_enu_m: Vec3
    quaternion_enu_flu_wxyz: Vec4
    std_m: float
    reset_count: int = 0


class WatchBodies(Struct, frozen=True):
    """Receive the mocap poses of exactly these other bodies: their vehicles are, or lately were,
    silent.
    """

    bodies: tuple[str, ...]


class Publish(Struct, frozen=True):
    """Put a message on the bus under this vehicle's name."""

    topic: Topic
    message: Message


class Follow(Struct, frozen=True):
    """Hear the states of exactly these vehicles at full rate from now on, and those of the others
    slowly.
    """

    names: frozenset[str]


class Reply(Struct, frozen=True):
    """The answer to an order."""

    reply: OrderReply


class Exit(Struct, frozen=True):
    """The vehicle is on the ground and disarmed, and somebody asked the agent to stop."""


Command = (
    SendAttitude
    | SetOffboard
    | Px4Land
    | Arm
    | Disarm
    | Kill
    | RequestHeartbeat
    | PlayTune
    | SendOdometry
    | WatchBodies
    | Publish
    | Follow
    | Reply
    | Exit
)
