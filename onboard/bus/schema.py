"""Messages on the bus: frozen, with a schema version, units and frames in every field name.

``stamp_ns`` is the sender's monotonic clock; ``boot_id`` changes when the sender restarts, so that
stamps before and after a restart are never compared. All positions are fleet ENU. Only data,
without numpy, so that any process can read the bus cheaply.
"""

from __future__ import annotations

from typing import Literal

import msgspec

SCHEMA_VERSION = 1

Vec3 = tuple[float, float, float]
Vec4 = tuple[float, float, float, float]

AgentState = Literal[
    "waiting", "ready", "armed", "taking off", "flying", "holding", "landing", "landed", "failed"
]
# "identify" is the former name of "locate": records and older grounds have it
LOCATE = ("locate", "identify")
OrderKind = Literal[
    "arm",
    "disarm",
    "takeoff",
    "move",
    "land",
    "hold",
    "kill",
    "locate",
    "identify",
    "load_path",
    "follow_path",
]
OrderOutcome = Literal["accepted", "done", "refused", "superseded", "failed", "timed out"]
Severity = Literal["debug", "info", "warning", "critical"]


class Message(msgspec.Struct, frozen=True, array_like=True, kw_only=True):
    """Base of all messages."""

    # first, so that a receiver can refuse a version before it reads the rest
    schema: int = SCHEMA_VERSION


class StateMessage(Message, frozen=True, array_like=True, kw_only=True):
    """State for the neighbours at 50 Hz: the plain estimate, and the state predicted over the
    sender's own lag.
    """

    vehicle: str
    boot_id: int
    sequence: int
    stamp_ns: int
    is_valid: bool
    is_airborne: bool
    is_cooperative: bool
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    acceleration_enu_m_s2: Vec3
    predicted_position_enu_m: Vec3
    predicted_velocity_enu_m_s: Vec3
    commanded_acceleration_enu_m_s2: Vec3
    lead_time_s: float  # from ``stamp_ns`` to the time of the prediction
    position_std_m: float
    velocity_std_m_s: float
    crowd_count: float  # neighbours nearer than twice the design distance
    intent_enu_m_s: Vec3 = (0.0, 0.0, 0.0)


class Telemetry(Message, frozen=True, array_like=True, kw_only=True):
    """State of one vehicle for people, 5-10 Hz."""

    vehicle: str
    boot_id: int
    sequence: int
    stamp_ns: int
    state: AgentState
    reason: str
    not_ready: tuple[str, ...]
    is_armed: bool
    is_airborne: bool
    mode: str
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    yaw_deg: float
    is_position_valid: bool
    setpoint_position_enu_m: Vec3
    goal_position_enu_m: Vec3
    battery_frac: float
    battery_voltage_v: float
    law: str
    law_status: str
    intervention_m_s2: float
    nearest_vehicle: str
    nearest_distance_m: float
    order_id: str
    order_kind: str
    order_phase: str
    state_age_s: float
    autopilot_age_s: float
    neighbour_age_s: float
    loop_period_p50_ms: float
    loop_period_p99_ms: float
    loop_period_max_ms: float
    late_ticks: int
    malformed_messages: int
    hover_thrust_frac: float
    config_hash: str
    system_id: int
    conditions: tuple[str, ...] = ()  # of the failsafe table that hold now, in words
    action: str = ""  # of the failsafe table, in words
    operator: str = ""  # token of the operator, as this vehicle sees it: control_token.py
    roles: tuple[str, ...] = ()  # the other role tokens
    loop_lateness_p99_ms: float = 0.0
    missed_ticks: int = 0
    # the neighbour that the law's intervention is mostly for; "" without intervention
    avoids: str = ""
    doubles: tuple[str, ...] = ()  # vehicles for which this one hears two agents
    mocap_delay_s: float = 0.0  # mean time from a pose's measurement to its arrival
    show_id: str = ""  # of the path being followed; "" without one
    path_time_s: float = 0.0  # on the path's clock
    path_rate_frac: float = 1.0  # of that clock
    path_lag_m: float = 0.0  # distance from where the path is at that time
    is_behind: bool = False  # asks all to slow the clock
    # orders that were not believed -> how many, since this agent's start
    refused_orders: dict[str, int] = {}
    refused_messages: int = 0  # these four since the agent's start: see onboard/message_counts.py
    dropped_messages: int = 0
    late_messages: int = 0


class PreflightReport(Message, frozen=True, array_like=True, kw_only=True):
    """Go or no-go of one vehicle, 1 Hz while it stands on the ground."""

    vehicle: str
    boot_id: int
    sequence: int
    stamp_ns: int
    # (name, is_ok, sentence, remedy) in the order in which a person looks for the fault. Not ok
    # refuses take-off; ok with a remedy is advice; ok without one needs no action.
    checks: tuple[tuple[str, bool, str, str], ...]
    px4_version: tuple[int, int] | None = None  # as this vehicle's PX4 reports it

    @property
    def is_go(self) -> bool:
        """Whether nothing refuses take-off."""
        return all(is_ok for _, is_ok, _, _ in self.checks)


class TickSample(Message, frozen=True, array_like=True, kw_only=True):
    """One run of the pipeline with every intermediate value."""

    stamp_ns: int
    period_s: float
    state: str
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    acceleration_enu_m_s2: Vec3
    yaw_rad: float
    setpoint_position_enu_m: Vec3
    setpoint_velocity_enu_m_s: Vec3
    setpoint_acceleration_enu_m_s2: Vec3
    thrust_baseline_enu_m_s2: Vec3
    thrust_safe_enu_m_s2: Vec3
    predicted_position_enu_m: Vec3
    predicted_velocity_enu_m_s: Vec3
    commanded_acceleration_enu_m_s2: Vec3
    law_status: str
    intervention_m_s2: float
    slack_m_s2: float
    active_neighbour: str
    neighbour_distances_m: dict[str, float]
    neighbour_ages_s: dict[str, float]
    setpoint_quaternion_enu_flu_wxyz: Vec4
    setpoint_thrust_frac: float
    attitude_quaternion_enu_flu_wxyz: Vec4
    hover_thrust_frac: float
    attitude_age_s: float = 0.0  # since PX4's attitude arrived


class TickBatch(Message, frozen=True, array_like=True, kw_only=True):
    """Several ticks in one message, oldest first."""

    vehicle: str
    boot_id: int
    sequence: int
    ticks: tuple[TickSample, ...]


class Event(Message, frozen=True, array_like=True, kw_only=True):
    """An event: a sentence for people, a code for programs. Ends of orders are events too."""

    vehicle: str
    stamp_ns: int
    severity: Severity
    code: str
    sentence: str
    order_id: str = ""
    order_outcome: OrderOutcome | Literal[""] = ""


class PathOrder(msgspec.Struct, frozen=True, array_like=True, kw_only=True):
    """The part of an order that is about a path: its bytes in parts, or the begin of its flight."""

    path_id: str  # of the whole path: see onboard/control/path.py
    part: int = 0
    parts: int = 1
    data: bytes = b""  # load_path only
    # equal for all that follow their paths by one clock; follow_path only, as the rest
    show_id: str = ""
    start_ns: int = 0  # time 0 of the path, on the sender's monotonic clock
    on_lag: Literal["land", "hold"] = "land"  # what a vehicle does that falls behind for too long


class Order(Message, frozen=True, array_like=True, kw_only=True):
    """Ground to one vehicle; answered at once by an :class:`OrderReply`, ended by an event."""

    order_id: str
    author: str
    kind: OrderKind
    stamp_ns: int
    deadline_ns: int  # after which the order must not begin, on the sender's monotonic clock
    # move only: the vehicle's own goal, its slot's offset added by the ground
    position_enu_m: Vec3 | None = None
    height_m: float | None = None  # takeoff only: above the fleet's origin
    duration_s: float = 0.0  # 0: as fast as the limits allow
    node: str = ""  # the sender on the bus, by which the operator is known
    path: PathOrder | None = None  # load_path and follow_path only
    # move only: heading to turn to, counterclockwise from east; None: as it is
    yaw_deg: float | None = None
    then_land: bool = False  # move only: lands at the goal, and has ended when it is down
    # of the newest telemetry that the sender had of this vehicle, hence by the vehicle's own clock:
    # a fleet with keys obeys no order that was signed more than some seconds ago, whatever other
    # clocks say
    heard_boot_id: int = 0
    heard_ns: int = 0

    @property
    def text(self) -> str:
        """Kind, author and sender, in a few words: others may have written them."""
        return f"{self.kind} of {self.author[:60]} (from {self.node[:60]})"


class FaultOrder(Message, frozen=True, array_like=True, kw_only=True):
    """Ground to the emulator, in simulated flights only: inject a fault. Answered by an
    :class:`OrderReply`.
    """

    order_id: str
    author: str
    stamp_ns: int
    vehicle: str
    fault: str
    parameters: dict[str, float | str]
    after_s: float = 0.0  # simulated time from now
    duration_s: float = 0.0  # 0: until the end
    is_rehearsal: bool = False  # only say whether it could be done


class OrderReply(Message, frozen=True, array_like=True, kw_only=True):
    """Accepted, or refused with a reason."""

    order_id: str
    vehicle: str
    is_accepted: bool
    reason: str


class MocapPose(Message, frozen=True, array_like=True, kw_only=True):
    """Pose of one body, measured at ``stamp_ns``; the quaternion rotates body FLU to fleet ENU."""

    body: str
    boot_id: int
    sequence: int
    stamp_ns: int
    is_tracked: bool
    position_enu_m: Vec3
    quaternion_enu_flu_wxyz: Vec4
    source: str = ""  # the node whose clock stamps it; empty for the receiver's own clock


class MocapPoses(Message, frozen=True, array_like=True, kw_only=True):
    """Newest poses of several bodies."""

    poses: tuple[MocapPose, ...]


class HeardClock(msgspec.Struct, frozen=True, array_like=True):
    """Arrival of another node's clock message."""

    node: str  # the sender of that message
    host: int
    sent_ns: int  # by its own clock
    received_ns: int  # by the clock of the node that publishes this


class ClockMessage(Message, frozen=True, array_like=True, kw_only=True):
    """A node's monotonic clock, and arrivals of the others': twice a second, see
    ``onboard/bus/clock_offsets.py``.
    """

    node: str
    host: int  # equal for all that share one clock; another boot is another host
    sequence: int
    sent_ns: int
    heard: tuple[HeardClock, ...] = ()


class Light(Message, frozen=True, array_like=True, kw_only=True):
    """Colour of a vehicle in a show, as the ground shows and records it; red, green and blue up to
    255.
    """

    vehicle: str
    stamp_ns: int
    colour: tuple[int, int, int]


class Truth(Message, frozen=True, array_like=True, kw_only=True):
    """Ground truth, simulation only: for records and expectations; no agent listens."""

    vehicle: str
    stamp_ns: int
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    quaternion_enu_flu_wxyz: Vec4
    is_on_ground: bool
    is_collided: bool
