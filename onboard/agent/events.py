"""What goes into the agent's core and what comes out of it: frozen values, no clock, no sockets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from onboard.bus.schema import Message, MocapPose, Order, OrderReply, StateMessage, Telemetry
from onboard.bus.topics import Topic
from onboard.link.autopilot import Snapshot, Vec3, Vec4
from onboard.types import AttitudeSetpoint


@dataclass(frozen=True, slots=True)
class PoseArrived:
    """A mocap sample, with its arrival on our clock."""

    pose: MocapPose
    received_ns: int


@dataclass(frozen=True, slots=True)
class NeighbourHeard:
    """A neighbour's state or telemetry."""

    message: StateMessage | Telemetry
    received_ns: int


@dataclass(frozen=True, slots=True)
class OrderArrived:
    """An order; its answer comes as a :class:`Reply` in the same call."""

    order: Order


@dataclass(frozen=True, slots=True)
class NodeSeen:
    """A node appeared on the bus or left it."""

    node: str
    is_alive: bool


@dataclass(frozen=True, slots=True)
class AutopilotHeard:
    """The link's newest snapshot."""

    snapshot: Snapshot


@dataclass(frozen=True, slots=True)
class ParamsRead:
    """What is wrong with PX4's parameters, as sentences; empty when nothing is."""

    problems: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ClocksCompared:
    """Nodes on other hosts, and how well their clocks are known [s]; infinite: not measured yet."""

    bounds_s: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class LoopTimed:
    """Statistics of the loop's period over the last window, and how far behind its schedule it began."""

    p50_ms: float
    p99_ms: float
    max_ms: float
    late_ticks: int
    lateness_p99_ms: float = 0.0
    missed_ticks: int = 0


@dataclass(frozen=True, slots=True)
class MessageMalformed:
    """Somebody sent bytes that are no message."""

    count: int = 1


@dataclass(frozen=True, slots=True)
class TickFailed:
    """The shell caught an exception of the last tick: our own bug."""

    sentence: str


@dataclass(frozen=True, slots=True)
class DiskChecked:
    """Whether this computer's disk has room left for logs and records."""

    is_full: bool


@dataclass(frozen=True, slots=True)
class SourceTold:
    """Why the mocap gives nothing, in the words of whoever reads it."""

    sentence: str


@dataclass(frozen=True, slots=True)
class ShutdownAsked:
    """Somebody wants this process to end: land first."""


EventIn = (
    PoseArrived
    | NeighbourHeard
    | OrderArrived
    | NodeSeen
    | AutopilotHeard
    | ParamsRead
    | ClocksCompared
    | LoopTimed
    | MessageMalformed
    | TickFailed
    | DiskChecked
    | SourceTold
    | ShutdownAsked
)


@dataclass(frozen=True, slots=True)
class SendAttitude:
    """One setpoint, already in PX4's heading."""

    setpoint: AttitudeSetpoint


@dataclass(frozen=True, slots=True)
class SetOffboard:
    """Ask PX4 for OFFBOARD."""


@dataclass(frozen=True, slots=True)
class Px4Land:
    """Ask PX4 to land by itself."""


@dataclass(frozen=True, slots=True)
class Arm:
    """Ask PX4 to arm."""


@dataclass(frozen=True, slots=True)
class Disarm:
    """Ask PX4 to disarm; it refuses in the air."""


@dataclass(frozen=True, slots=True)
class Kill:
    """Stop the motors now."""


@dataclass(frozen=True, slots=True)
class PlayTune:
    """Let PX4 play a tune, so that people see which vehicle it is."""


@dataclass(frozen=True, slots=True)
class SendOdometry:
    """Forward a mocap pose to PX4; another reset count tells its estimator to begin anew there."""

    position_enu_m: Vec3
    quaternion_enu_flu_wxyz: Vec4
    std_m: float
    reset_count: int = 0


@dataclass(frozen=True, slots=True)
class WatchBodies:
    """Subscribe to the mocap poses of these bodies as well: their vehicles have begun to be silent."""

    bodies: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Publish:
    """Put a message on the bus under this vehicle's name."""

    topic: Topic
    message: Message


@dataclass(frozen=True, slots=True)
class Follow:
    """Hear the states of exactly these vehicles at full rate from now on, and those of the others slowly."""

    names: frozenset[str]


@dataclass(frozen=True, slots=True)
class Reply:
    """The answer to an order."""

    reply: OrderReply


@dataclass(frozen=True, slots=True)
class Exit:
    """The vehicle is on the ground and disarmed, and somebody asked the agent to stop."""


Command = (
    SendAttitude
    | SetOffboard
    | Px4Land
    | Arm
    | Disarm
    | Kill
    | PlayTune
    | SendOdometry
    | WatchBodies
    | Publish
    | Follow
    | Reply
    | Exit
)
