"""Messages on the bus: frozen, with a schema version, units and frames in every field name.

``stamp_ns`` is the sender's monotonic clock; ``boot_id`` changes when the sender restarts, so that stamps of two lives
are never compared. All positions are fleet ENU. Only data: no numpy, so that any process can read the bus cheaply.
"""

from __future__ import annotations

from typing import Literal

import msgspec

SCHEMA_VERSION = 1

Vec3 = tuple[float, float, float]
Vec4 = tuple[float, float, float, float]

AgentState = Literal["waiting", "ready", "armed", "taking off", "flying", "holding", "landing", "landed", "failed"]
# "identify" is the former name of "locate": records and older grounds have it
LOCATE = ("locate", "identify")
OrderKind = Literal["arm", "disarm", "takeoff", "move", "land", "hold", "kill", "locate", "identify"]
OrderOutcome = Literal["accepted", "done", "refused", "superseded", "failed", "timed out"]
Severity = Literal["debug", "info", "warning", "critical"]


class Message(msgspec.Struct, frozen=True, array_like=True, kw_only=True):
    """Base: ``schema`` first, so that a receiver can refuse a version before it reads the rest."""

    schema: int = SCHEMA_VERSION


class StateMessage(Message, frozen=True, array_like=True, kw_only=True):
    """What neighbours need at 50 Hz: the plain estimate, and the state predicted over the sender's own lag."""

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
    lead_time_s: float
    position_std_m: float
    velocity_std_m_s: float
    crowd_count: float
    intent_enu_m_s: Vec3 = (0.0, 0.0, 0.0)


class Telemetry(Message, frozen=True, array_like=True, kw_only=True):
    """Everything that a person looks at, 5-10 Hz.

    conditions: what is wrong now, in the words of the failsafe table; action: what is done about it, in words.
    doubles: vehicles that two agents speak for, as this one hears it.
    operator: the token of who may give orders, as this vehicle sees it; roles: the other such tokens (see operator.py).
    avoids: the neighbour for whose sake the law holds back most now; "" when it does not.
    """

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
    conditions: tuple[str, ...] = ()
    action: str = ""
    operator: str = ""
    roles: tuple[str, ...] = ()
    loop_lateness_p99_ms: float = 0.0
    missed_ticks: int = 0
    avoids: str = ""
    doubles: tuple[str, ...] = ()
    mocap_delay_s: float = 0.0  # mean time from a pose's measurement to its arrival


class PreflightReport(Message, frozen=True, array_like=True, kw_only=True):
    """Go or no-go of one vehicle, 1 Hz while it stands on the ground.

    checks: (name, is_ok, sentence, remedy) in the order in which a person looks for the fault. Not ok refuses take-off;
    ok with a remedy is advice; ok without one needs no action.
    """

    vehicle: str
    boot_id: int
    sequence: int
    stamp_ns: int
    checks: tuple[tuple[str, bool, str, str], ...]

    @property
    def is_go(self) -> bool:
        """Whether nothing refuses take-off."""
        return all(is_ok for _, is_ok, _, _ in self.checks)


class TickSample(Message, frozen=True, array_like=True, kw_only=True):
    """One pass of the pipeline, every intermediate value."""

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
    """Something happened: a sentence for people, a code for programs. Ends of orders are events too."""

    vehicle: str
    stamp_ns: int
    severity: Severity
    code: str
    sentence: str
    order_id: str = ""
    order_outcome: OrderOutcome | Literal[""] = ""


class Order(Message, frozen=True, array_like=True, kw_only=True):
    """Ground to one vehicle; answered at once by an :class:`OrderReply`, ended by an event.

    position_enu_m: move only, the vehicle's own goal (the ground has added the slot's offset).
    height_m: takeoff only, above the fleet's origin. duration_s: 0 = as fast as the limits allow.
    deadline_ns: on the sender's monotonic clock, after which the order must not begin.
    node: the sender on the bus, by which the operator is known.
    """

    order_id: str
    author: str
    kind: OrderKind
    stamp_ns: int
    deadline_ns: int
    position_enu_m: Vec3 | None = None
    height_m: float | None = None
    duration_s: float = 0.0
    node: str = ""


class FaultOrder(Message, frozen=True, array_like=True, kw_only=True):
    """Ground to the emulator, in simulated flights only: let something go wrong. Answered by an :class:`OrderReply`.

    after_s: simulated time from now. duration_s: 0 = until the end. is_rehearsal: only say whether it could be done.
    """

    order_id: str
    author: str
    stamp_ns: int
    vehicle: str
    fault: str
    parameters: dict[str, float | str]
    after_s: float = 0.0
    duration_s: float = 0.0
    is_rehearsal: bool = False


class OrderReply(Message, frozen=True, array_like=True, kw_only=True):
    """Accepted, or refused with a reason."""

    order_id: str
    vehicle: str
    is_accepted: bool
    reason: str


class MocapPose(Message, frozen=True, array_like=True, kw_only=True):
    """Pose of one body, measured at ``stamp_ns``; the quaternion rotates body FLU to fleet ENU.

    source: the node whose clock stamps it; empty when that is the receiver's own.
    """

    body: str
    boot_id: int
    sequence: int
    stamp_ns: int
    is_tracked: bool
    position_enu_m: Vec3
    quaternion_enu_flu_wxyz: Vec4
    source: str = ""


class HeardClock(msgspec.Struct, frozen=True, array_like=True):
    """A node's clock message of ``sent_ns``, by its own clock, arrived at ``received_ns`` by the teller's."""

    node: str
    host: int
    sent_ns: int
    received_ns: int


class ClockMessage(Message, frozen=True, array_like=True, kw_only=True):
    """A node's monotonic clock, and what it heard of the others': twice a second, ``onboard/bus/clock_offsets.py``.

    host: what shares one clock has the same; another boot is another host.
    """

    node: str
    host: int
    sequence: int
    sent_ns: int
    heard: tuple[HeardClock, ...] = ()


class Truth(Message, frozen=True, array_like=True, kw_only=True):
    """Ground truth, simulation only: for records and judges; no agent listens."""

    vehicle: str
    stamp_ns: int
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    quaternion_enu_flu_wxyz: Vec4
    is_on_ground: bool
    is_collided: bool
