"""Messages on the bus: frozen, with a schema version, units and frames in every field name.

Fields that many messages have, with one meaning:

* ``vehicle``: the name in the fleet file of the vehicle that the message is about.
* ``boot_id``: a number of the sender's process. It changes when the sender starts anew, so that
  stamps and sequences from before a restart are never compared with those after it.
* ``sequence``: counts the messages of this kind by this sender.
* ``stamp_ns``: the sender's monotonic clock, in nanoseconds, when the message was made.
* ``..._enu_...``: east, north, up of the fleet's frame.

Messages are only data, without numpy, so that any process can read the bus cheaply. They travel as
arrays: a new field goes to the end of its class and has a default.
"""

from __future__ import annotations

import math
from typing import Literal

import msgspec

from onboard.tuples import Wxyz, Xyz

SCHEMA_VERSION = 1


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
    "pause",
    "resume",
    "skip",
    "reboot",
    "disable",
    "enable",
    "stand_in",
]
# they change how a path, or another vehicle, is followed
ON_PATHS = ("pause", "resume", "skip")
# whether a vehicle takes part in flights, and from whose place
SERVICE = ("disable", "enable", "stand_in")
BESIDE = (*LOCATE, "load_path", *ON_PATHS, *SERVICE)  # orders that begin nothing, and end no other
# Reasons of an order; without one a person gives it, to the vehicles that he names.
BY_MISSION = "mission"  # a mission or a script gives it, at its end or in its course
TO_EVERYBODY = "everybody"  # a person gives it to all, as LAND ALL does
OrderOutcome = Literal["accepted", "done", "refused", "superseded", "failed", "timed out"]
Severity = Literal["debug", "info", "warning", "critical"]


class Message(msgspec.Struct, frozen=True, array_like=True, kw_only=True):
    """Base of all messages."""

    # first, so that a receiver can refuse a version before it reads the rest
    schema: int = SCHEMA_VERSION


class StateMessage(Message, frozen=True, array_like=True, kw_only=True):
    """State of one vehicle for its neighbours, at up to 50 Hz: as it is, and as it will be."""

    vehicle: str
    boot_id: int
    sequence: int
    stamp_ns: int

    is_valid: bool  # the sender knows its own position
    is_airborne: bool  # the others have to reckon with it in the air
    is_cooperative: bool  # it takes its share of avoiding

    # its own estimate, at ``stamp_ns``
    position_enu_m: Xyz
    velocity_enu_m_s: Xyz
    acceleration_enu_m_s2: Xyz

    # where its lag brings it, whatever it commands from now on
    predicted_position_enu_m: Xyz
    predicted_velocity_enu_m_s: Xyz
    commanded_acceleration_enu_m_s2: Xyz  # what it commands at this tick
    lead_time_s: float  # from ``stamp_ns`` to the time of the prediction

    position_std_m: float  # standard deviation of its estimate's position
    velocity_std_m_s: float  # standard deviation of its estimate's velocity
    crowd_count: float  # neighbours nearer than twice the design distance
    intent_enu_m_s: Xyz = (0.0, 0.0, 0.0)  # velocity straight to its goal


class Telemetry(Message, frozen=True, array_like=True, kw_only=True):
    """State of one vehicle for people, 5 to 10 times a second."""

    vehicle: str
    boot_id: int
    sequence: int
    stamp_ns: int

    # what it does
    state: AgentState
    reason: str  # why it is in this state; a sentence, or empty
    not_ready: tuple[str, ...]  # sentences that refuse take-off
    is_armed: bool  # by PX4
    is_airborne: bool  # the others have to reckon with it in the air
    mode: str  # flight mode of PX4

    # where it is and where it goes
    position_enu_m: Xyz
    velocity_enu_m_s: Xyz
    yaw_deg: float  # heading, counterclockwise from east
    is_position_valid: bool  # it knows its own position
    setpoint_position_enu_m: Xyz  # of the trajectory, at this tick
    goal_position_enu_m: Xyz  # of the order

    # of its PX4
    battery_frac: float  # charge, 0 to 1; NaN while PX4 has not reported it
    battery_voltage_v: float

    # avoidance
    law: str  # name of the law that it flies
    law_status: str  # of the last tick
    intervention_m_s2: float  # by how much the law changes the thrust
    nearest_vehicle: str  # empty while it hears none
    nearest_distance_m: float  # between the centres

    # the newest order
    order_id: str
    order_kind: str
    order_phase: str  # how far it is

    # time since the newest of each kind arrived
    state_age_s: float  # own position
    autopilot_age_s: float  # packet of PX4
    neighbour_age_s: float  # state of the neighbour that has been silent for longest

    # control loop: median, 99th percentile and maximum of the last ten seconds
    loop_period_p50_ms: float
    loop_period_p99_ms: float
    loop_period_max_ms: float
    late_ticks: int  # since the start: ticks whose period was too long
    malformed_messages: int  # since the start: see onboard/message_counts.py

    hover_thrust_frac: float  # throttle that hovers, as learned so far
    config_hash: str  # of the fleet file and the law: equal on all that fly together
    system_id: int  # MAV_SYS_ID of its PX4

    conditions: tuple[str, ...] = ()  # of the failsafe table that hold now, in words
    action: str = ""  # of the failsafe table, in words
    operator: str = ""  # token of the operator, as this vehicle sees it: control_token.py
    roles: tuple[str, ...] = ()  # the other role tokens
    loop_lateness_p99_ms: float = 0.0  # how far behind its schedule a tick began
    missed_ticks: int = 0  # since the start
    avoids: str = ""  # neighbour that the law intervenes mostly for; empty while it does not
    doubles: tuple[str, ...] = ()  # vehicles for which this one hears two agents
    mocap_delay_s: float = 0.0  # mean time from a pose's measurement to its arrival

    # the path that it follows
    show_id: str = ""  # empty without one
    path_time_s: float = 0.0  # on the path's clock
    path_rate_frac: float = 1.0  # of that clock
    path_lag_m: float = 0.0  # distance from where the path is at that time
    is_behind: bool = False  # asks all to slow the clock

    # orders that were not believed -> how many, since this agent's start
    refused_orders: dict[str, int] = {}
    # since this agent's start: see onboard/message_counts.py
    refused_messages: int = 0
    dropped_messages: int = 0
    late_messages: int = 0

    # mean velocity of the air that it feels, east and north; NaN: not known
    wind_enu_m_s: tuple[float, float] = (math.nan, math.nan)
    gust_m_s: float = math.nan  # standard deviation of the gusts, per axis; NaN: not known
    max_wind_m_s: float = math.nan  # its limit of the mean; NaN: not known

    is_flown_by_hand: bool = False  # its PX4 is in a pilot's mode and hears his sticks
    # the newest order that it has taken, also after its end; `locate` and parts of paths are none
    taken_order_id: str = ""
    taken_order_kind: str = ""
    taken_order_from: str = ""  # author and node

    # an order has stopped its path's clock, and so everybody's; or it follows nobody until `resume`
    is_path_paused: bool = False
    disabled_by: str = ""  # who has ordered that it takes part in no flight; empty: it does

    # of a vehicle that flies by satellites
    fix: str = ""  # of its PX4's receiver, in words; empty while it is not known
    satellites: int = -1  # that the receiver uses; -1: not known
    # of corrections, where the fleet has some
    corrections_age_s: float = math.nan  # since the newest were given to PX4; NaN: never
    base_id: int = -1  # station of those corrections; -1: none is known
    base_distance_m: float = math.nan  # from the vehicle to that station; NaN: not known

    # the vehicle whose spot, slots and paths it has instead of its own; empty: its own
    stands_in_for: str = ""
    follows: str = ""  # the vehicle that its goals follow, paused or not; empty: none


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
    """One run of the control pipeline, with every intermediate value."""

    stamp_ns: int
    period_s: float  # since the last tick
    state: str  # of the agent

    # own estimate
    position_enu_m: Xyz
    velocity_enu_m_s: Xyz
    acceleration_enu_m_s2: Xyz
    yaw_rad: float  # heading, counterclockwise from east

    # trajectory
    setpoint_position_enu_m: Xyz
    setpoint_velocity_enu_m_s: Xyz
    setpoint_acceleration_enu_m_s2: Xyz

    # thrust per mass, gravity included: before the law, and after it
    thrust_baseline_enu_m_s2: Xyz
    thrust_safe_enu_m_s2: Xyz

    # own motion when a command of now takes effect
    predicted_position_enu_m: Xyz
    predicted_velocity_enu_m_s: Xyz
    commanded_acceleration_enu_m_s2: Xyz

    # the law
    law_status: str
    intervention_m_s2: float  # by how much it changes the thrust
    slack_m_s2: float  # by how much its constraints had to be relaxed
    active_neighbour: str  # that it intervenes mostly for; empty while it does not
    neighbour_distances_m: dict[str, float]  # vehicle -> distance
    neighbour_ages_s: dict[str, float]  # vehicle -> age of its state

    # attitude and throttle: what PX4 is sent, and what it reports
    setpoint_quaternion_enu_flu_wxyz: Wxyz
    setpoint_thrust_frac: float
    attitude_quaternion_enu_flu_wxyz: Wxyz
    hover_thrust_frac: float  # throttle that hovers, as learned so far
    attitude_age_s: float = 0.0  # since PX4's attitude arrived


class TickBatch(Message, frozen=True, array_like=True, kw_only=True):
    """Several ticks in one message."""

    vehicle: str
    boot_id: int
    sequence: int
    ticks: tuple[TickSample, ...]  # the oldest first


class Event(Message, frozen=True, array_like=True, kw_only=True):
    """An event: a sentence for people, a code for programs. Ends of orders are events too."""

    vehicle: str
    stamp_ns: int
    severity: Severity
    code: str  # for programs
    sentence: str  # for people
    order_id: str = ""  # of the order that ends with it; empty for other events
    order_outcome: OrderOutcome | Literal[""] = ""  # how that order ended


class PathOrder(msgspec.Struct, frozen=True, array_like=True, kw_only=True):
    """The part of an order that is about a path: its bytes in parts, or the begin of its flight."""

    path_id: str  # of the whole path: see onboard/control/path.py

    # load_path only
    part: int = 0  # number of this part, from 0
    parts: int = 1  # of the whole path
    data: bytes = b""  # of this part

    # follow_path only
    show_id: str = ""  # equal for all that follow their paths by one clock
    start_ns: int = 0  # time 0 of the path, on the sender's monotonic clock
    on_lag: Literal["land", "hold"] = "land"  # what a vehicle does that falls behind for too long


class Order(Message, frozen=True, array_like=True, kw_only=True):
    """Ground to one vehicle; answered at once by an :class:`OrderReply`, ended by an event."""

    order_id: str  # no two orders have the same
    author: str  # the person, as their computer names them
    kind: OrderKind
    stamp_ns: int
    deadline_ns: int  # after which the order must not begin, on the sender's monotonic clock
    # move only: the vehicle's own goal, its slot's offset added by the ground
    position_enu_m: Xyz | None = None
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
    # BY_MISSION, TO_EVERYBODY, or empty: a person's to the vehicles that he names. A landing with a
    # reason is refused while a pilot flies the vehicle by hand.
    reason: str = ""
    stands_in_for: str = ""  # stand_in only: whose place the vehicle takes, maybe its own again
    follows: str = ""  # move only: the vehicle whose motion this goal follows

    @property
    def text(self) -> str:
        """Kind, author and sender, in a few words: others may have written them."""
        return f"{self.kind} of {self.author[:60]} (from {self.node[:60]})"


class FaultOrder(Message, frozen=True, array_like=True, kw_only=True):
    """Ground to the emulator in simulated flights: inject a fault; answered by a reply.

    The reply is an :class:`OrderReply`.
    """

    order_id: str  # no two orders have the same
    author: str  # the person, as their computer names them
    stamp_ns: int
    vehicle: str
    fault: str  # name of its kind
    parameters: dict[str, float | str]  # of that kind
    after_s: float = 0.0  # simulated time from now
    duration_s: float = 0.0  # 0: until the end
    is_rehearsal: bool = False  # only say whether it could be done


class OrderReply(Message, frozen=True, array_like=True, kw_only=True):
    """Accepted, or refused with a reason."""

    order_id: str  # of the order
    vehicle: str
    is_accepted: bool
    # of a refusal, as a sentence; of an order that is accepted: what it leads to, where its name
    # does not say it
    reason: str


class MocapPose(Message, frozen=True, array_like=True, kw_only=True):
    """Pose of one body, measured at ``stamp_ns``; the quaternion rotates body FLU to fleet ENU."""

    body: str  # its name in the mocap
    boot_id: int
    sequence: int
    stamp_ns: int
    is_tracked: bool  # False: the mocap has lost the body
    position_enu_m: Xyz
    quaternion_enu_flu_wxyz: Wxyz
    source: str = ""  # the node whose clock stamps it; empty for the receiver's own clock


class MocapPoses(Message, frozen=True, array_like=True, kw_only=True):
    """Newest poses of several bodies."""

    poses: tuple[MocapPose, ...]


class Corrections(Message, frozen=True, array_like=True, kw_only=True):
    """One RTCM 3 frame of the fleet's base, as its source sent it, for every vehicle's PX4."""

    source: str  # the node whose clock stamps it
    boot_id: int
    sequence: int
    stamp_ns: int  # when the frame was complete at the node that reads the source
    frame: bytes  # preamble, length, message and checksum


class LogRequest(Message, frozen=True, array_like=True, kw_only=True):
    """One request for PX4's own logs, which the agent passes on to its PX4."""

    packet: bytes  # a whole packet of MAVLink


class LogPieces(Message, frozen=True, array_like=True, kw_only=True):
    """PX4's answers to such requests, as it sent them."""

    packets: tuple[bytes, ...]  # whole packets of MAVLink


class HeardClock(msgspec.Struct, frozen=True, array_like=True):
    """Arrival of another node's clock message."""

    node: str  # the sender of that message
    host: int  # of the sender's clock, see :class:`ClockMessage`
    sent_ns: int  # by its own clock
    received_ns: int  # by the clock of the node that publishes this


class ClockMessage(Message, frozen=True, array_like=True, kw_only=True):
    """A node's monotonic clock, and arrivals of the others', twice a second.

    ``onboard/bus/clock_offsets.py`` makes offsets of them.
    """

    node: str
    host: int  # equal for all that share one clock; another boot is another host
    sequence: int
    sent_ns: int  # by the node's own clock
    heard: tuple[HeardClock, ...] = ()  # the newest of each other node
    world_ns: int = 0  # of the world's clock then, as this computer has it, since 1970; 0: not told


class Light(Message, frozen=True, array_like=True, kw_only=True):
    """Colour of a vehicle in a show, as the ground shows and records it."""

    vehicle: str
    stamp_ns: int
    colour: tuple[int, int, int]  # red, green and blue, 0 to 255 each


class Truth(Message, frozen=True, array_like=True, kw_only=True):
    """Ground truth, simulation only: for records and expectations; no agent listens."""

    vehicle: str
    stamp_ns: int
    position_enu_m: Xyz
    velocity_enu_m_s: Xyz
    quaternion_enu_flu_wxyz: Wxyz
    is_on_ground: bool
    is_collided: bool  # it has touched another vehicle
    # first contacts with the ground after flights, so far; 0 also where nobody counts them
    touchdowns: int = 0
    touchdown_m_s: float = 0.0  # vertical speed at the newest of them
    had_thrust: bool = True  # its motors had all their thrust then
