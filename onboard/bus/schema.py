"""Messages on the bus: frozen, with a schema version, and units and frames in the field names.

Fields that many messages have, with the same meaning in all of them:

* ``vehicle``: the name in the fleet file of the vehicle that the message is about.
* ``boot_id``: a number of the sender's process. It changes when the sender restarts, so that stamps
and sequences from before a restart are never compared with later ones.
* ``sequence``: grows with each message of this kind by this sender. An agent uses the number of its
tick.
* ``stamp_ns``: the sender's monotonic clock, in nanoseconds, when the message was made.
* ``..._enu_...``: east, north, up of the fleet's frame.

Messages are only data, without numpy, so that any process can read the bus cheaply. They are sent
as arrays without field names, so a new field must go to the end of its class and have a default.
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
# "identify" is the former name of "locate": records and older grounds still use it
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
# orders that change how a vehicle follows a path or another vehicle
ON_PATHS = ("pause", "resume", "skip")
# orders that determine whether a vehicle takes part in flights, and which vehicle it stands in for
SERVICE = ("disable", "enable", "stand_in")
# orders that start no flight and end no other order
BESIDE = (*LOCATE, "load_path", *ON_PATHS, *SERVICE)
# Values of ``Order.reason``. An order without a reason comes from a person who has named its
# vehicles.
BY_MISSION = "mission"  # a mission or a script sends it, during its run or at its end
TO_EVERYBODY = "everybody"  # a person sends it to all vehicles, as LAND ALL does
OrderOutcome = Literal["accepted", "done", "refused", "superseded", "failed", "timed out"]
Severity = Literal["debug", "info", "warning", "critical"]


class Message(msgspec.Struct, frozen=True, array_like=True, kw_only=True):
    """Base of all messages."""

    # the first field, so that a receiver can refuse another version before it reads the rest
    schema: int = SCHEMA_VERSION


class StateMessage(Message, frozen=True, array_like=True, kw_only=True):
    """State of one vehicle for its neighbours, at up to 50 Hz. It holds the motion now and after
    the lag.
    """

    vehicle: str
    boot_id: int
    sequence: int
    stamp_ns: int

    is_valid: bool  # the sender knows its own position
    is_airborne: bool  # the others must avoid it, because it is or may be in the air
    is_cooperative: bool  # it does its share of the avoiding

    # its own estimate, at ``stamp_ns``
    position_enu_m: Xyz
    velocity_enu_m_s: Xyz
    acceleration_enu_m_s2: Xyz  # 0 while its feet may touch the ground

    # its motion at the time when a command given now takes effect
    predicted_position_enu_m: Xyz
    predicted_velocity_enu_m_s: Xyz
    commanded_acceleration_enu_m_s2: Xyz  # its command at this tick
    lead_time_s: float  # from ``stamp_ns`` to the time of the prediction

    position_std_m: float  # standard deviation of its estimate's position
    velocity_std_m_s: float  # standard deviation of its estimate's velocity
    crowd_count: float  # number of neighbours nearer than twice the design distance
    intent_enu_m_s: Xyz = (0.0, 0.0, 0.0)  # velocity straight to its goal


class Telemetry(Message, frozen=True, array_like=True, kw_only=True):
    """State of one vehicle for people, ten times a second, and at once when its step changes.

    The other vehicles get it twice a second.
    """

    vehicle: str
    boot_id: int
    sequence: int
    stamp_ns: int

    # what it does
    state: AgentState
    reason: str  # why it is in this state; a sentence, or empty
    not_ready: tuple[str, ...]  # sentences that refuse take-off
    is_armed: bool  # as PX4 reports it
    is_airborne: bool  # the others must avoid it, because it is or may be in the air
    mode: str  # flight mode of PX4

    # where it is and where it goes
    position_enu_m: Xyz
    velocity_enu_m_s: Xyz
    yaw_deg: float  # heading, counterclockwise from east
    is_position_valid: bool  # it knows its own position
    setpoint_position_enu_m: Xyz  # of the trajectory, at this tick
    goal_position_enu_m: Xyz  # of the order

    # as its PX4 reports them
    battery_frac: float  # charge, 0 to 1; NaN while PX4 has not reported it
    battery_voltage_v: float

    # avoidance
    law: str  # name of the law that it flies
    law_status: str  # of the last tick
    intervention_m_s2: float  # by how much the law changes the thrust
    nearest_vehicle: str  # empty while it receives no state of another vehicle
    nearest_distance_m: float  # between the centres

    # the newest order
    order_id: str
    order_kind: str
    order_phase: str  # text of the present step, such as "climb"

    # time since the newest of these arrived
    state_age_s: float  # its own position
    autopilot_age_s: float  # packets from PX4
    neighbour_age_s: float  # newest state of the neighbour that has been silent longest

    # control loop: median, 99th percentile and maximum of the last ten seconds
    loop_period_p50_ms: float
    loop_period_p99_ms: float
    loop_period_max_ms: float
    late_ticks: int  # since the start: ticks whose period was too long
    malformed_messages: int  # since the start: see onboard/message_counts.py

    hover_thrust_frac: float  # hover throttle, as learned so far
    config_hash: str  # of the fleet file and the law: equal on all vehicles that fly together
    system_id: int  # MAV_SYS_ID of its PX4

    # conditions of the failsafe table that hold now, and the one for which PX4 lands it, in words
    conditions: tuple[str, ...] = ()
    action: str = ""  # action that the failsafe table demands now, in words
    operator: str = ""  # token of the operator, as this vehicle sees it: control_token.py
    roles: tuple[str, ...] = ()  # the other tokens of control_token.py
    loop_lateness_p99_ms: float = 0.0  # how far behind its schedule a tick began
    missed_ticks: int = 0  # since the start: skipped ticks
    # Neighbour that it avoids most, or that it waits for beside a passage; empty: none.
    avoids: str = ""
    # vehicles for which two agents publish at the same time, see DuplicateAgents
    doubles: tuple[str, ...] = ()
    mocap_delay_s: float = 0.0  # mean time from a pose's measurement to its arrival

    # the path that it follows
    show_id: str = ""  # empty: it follows no path
    path_time_s: float = 0.0  # on the path's clock
    path_rate_frac: float = 1.0  # rate of that clock: 1 is real time
    path_lag_m: float = 0.0  # distance from the path's point at that time
    is_behind: bool = False  # it requests that all vehicles slow the clock

    # reason -> number of orders refused for this reason since the agent's start, because they were
    # not trusted or not from the operator
    refused_orders: dict[str, int] = {}
    # since this agent's start: see onboard/message_counts.py
    refused_messages: int = 0
    dropped_messages: int = 0
    late_messages: int = 0

    # mean velocity of the air, as estimated in flight, east and north; NaN: not known
    wind_enu_m_s: tuple[float, float] = (math.nan, math.nan)
    gust_m_s: float = math.nan  # standard deviation of the gusts, per axis; NaN: not known
    max_wind_m_s: float = math.nan  # limit of that mean for this vehicle; NaN: not known

    is_flown_by_hand: bool = False  # its PX4 is in a pilot's mode and receives the sticks
    # the newest order that it has accepted, even after the end of that order; `locate` and parts of
    # paths do not count
    taken_order_id: str = ""
    taken_order_kind: str = ""
    taken_order_from: str = ""  # author and node

    # an order has stopped the clock of its path, and so the clocks of all vehicles of the show; or
    # an order has made it stop following another vehicle until `resume`
    is_path_paused: bool = False
    # the person who took it out of flights; empty: it takes part
    disabled_by: str = ""

    # only for a vehicle that uses satellite positioning
    fix: str = ""  # kind of its receiver's fix, in words; empty while it is not known
    satellites: int = -1  # number that the receiver uses; -1: not known
    # only where the fleet has corrections
    corrections_age_s: float = math.nan  # since the newest were sent to PX4; NaN: none yet
    base_id: int = -1  # station that sent those corrections; -1: not known
    base_distance_m: float = math.nan  # from the vehicle to that station; NaN: not known

    # the vehicle whose spot, slots and paths it uses instead of its own; empty: its own
    stands_in_for: str = ""
    follows: str = ""  # the vehicle that its goals follow, paused or not; empty: none


class PreflightReport(Message, frozen=True, array_like=True, kw_only=True):
    """Go or no-go of one vehicle, 1 Hz while it stands on the ground."""

    vehicle: str
    boot_id: int
    sequence: int
    stamp_ns: int
    # (name, is_ok, sentence, remedy), in the order in which a person should look for faults. A
    # check that is not ok refuses take-off. A check that is ok and has a remedy is advice. A check
    # that is ok without a remedy needs no action.
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

    # own motion when a command of this tick takes effect
    predicted_position_enu_m: Xyz
    predicted_velocity_enu_m_s: Xyz
    commanded_acceleration_enu_m_s2: Xyz

    # the law
    law_status: str
    intervention_m_s2: float  # by how much it changes the thrust
    slack_m_s2: float  # by how much its constraints had to be relaxed
    active_neighbour: str  # neighbour that causes most of the intervention; empty: none
    neighbour_distances_m: dict[str, float]  # vehicle -> distance
    neighbour_ages_s: dict[str, float]  # vehicle -> age of its state

    # attitude and throttle: setpoints sent to PX4, and values that PX4 reports
    setpoint_quaternion_enu_flu_wxyz: Wxyz
    setpoint_thrust_frac: float
    attitude_quaternion_enu_flu_wxyz: Wxyz
    hover_thrust_frac: float  # hover throttle, as learned so far
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
    order_id: str = ""  # of the order that has ended; empty for all other events
    order_outcome: OrderOutcome | Literal[""] = ""  # how that order ended


class PathOrder(msgspec.Struct, frozen=True, array_like=True, kw_only=True):
    """The part of an order about a path: a part of the path's bytes, or the start of the flight.

    Kind ``load_path`` sends a part; ``follow_path`` starts the flight.
    """

    path_id: str  # of the whole path: see onboard/control/path.py

    # load_path only
    part: int = 0  # index of this part, from 0
    parts: int = 1  # number of parts of the whole path
    data: bytes = b""  # bytes of this part

    # follow_path only
    show_id: str = ""  # equal for all vehicles that follow their paths by the same clock
    start_ns: int = 0  # time 0 of the path, on the sender's monotonic clock
    on_lag: Literal["land", "hold"] = "land"  # what a vehicle does that is behind for too long


class Order(Message, frozen=True, array_like=True, kw_only=True):
    """Order of a ground to one vehicle.

    The vehicle answers at once with an :class:`OrderReply`, and publishes an :class:`Event` when
    the order ends.
    """

    order_id: str  # unique
    author: str  # user name of the person who sends it
    kind: OrderKind
    stamp_ns: int
    # the order must not begin after this time, on the sender's monotonic clock; 0: no deadline
    deadline_ns: int
    # move only: the vehicle's own goal, to which the ground has added the offset of its slot
    position_enu_m: Xyz | None = None
    height_m: float | None = None  # takeoff only: above the fleet's origin
    duration_s: float = 0.0  # 0: as fast as the limits allow
    node: str = ""  # the sender's node on the bus; vehicles recognise the operator by it
    path: PathOrder | None = None  # load_path and follow_path only
    # move only: heading to turn to, counterclockwise from east; None: keep the heading
    yaw_deg: float | None = None
    then_land: bool = False  # move only: land at the goal; the order ends on the ground
    # Boot id and stamp of the newest telemetry that the sender has received from this vehicle. The
    # stamp is by the vehicle's own clock. So the vehicle can refuse an order that was signed more
    # than a few seconds ago, without trusting any other clock (only in a fleet with keys).
    heard_boot_id: int = 0
    heard_ns: int = 0
    # BY_MISSION, TO_EVERYBODY, or empty for a person's order to named vehicles. A landing with a
    # reason is refused while a pilot flies the vehicle by hand.
    reason: str = ""
    # stand_in only: the vehicle whose spot, slots and paths this vehicle uses from now on; its own
    # name ends the stand-in
    stands_in_for: str = ""
    follows: str = ""  # move only: the vehicle whose motion this goal follows

    @property
    def text(self) -> str:
        """Kind, author and sender. Names are truncated, because they may come from anybody."""
        return f"{self.kind} of {self.author[:60]} (from {self.node[:60]})"


class FaultOrder(Message, frozen=True, array_like=True, kw_only=True):
    """Order of a ground to the emulator in simulated flights: inject a fault.

    The emulator answers with an :class:`OrderReply`.
    """

    order_id: str  # unique
    author: str  # user name of the person who sends it
    stamp_ns: int
    vehicle: str
    fault: str  # name of the kind of fault
    parameters: dict[str, float | str]  # of that kind
    after_s: float = 0.0  # simulated time from now until the fault begins
    duration_s: float = 0.0  # of the fault; 0: until the end of the simulation
    is_rehearsal: bool = False  # only answer whether the fault could be injected


class OrderReply(Message, frozen=True, array_like=True, kw_only=True):
    """Reply to an order: accepted, or refused with a reason."""

    order_id: str  # of the order
    vehicle: str
    is_accepted: bool
    # sentence: why the order is refused, or what an accepted order leads to if its kind does not
    # show that; may be empty
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
    """One RTCM 3 frame from the fleet's base, exactly as received, for every vehicle's PX4."""

    source: str  # the node whose clock stamps it
    boot_id: int
    sequence: int
    stamp_ns: int  # when the frame was complete at the node that reads the source
    frame: bytes  # preamble, length, message and checksum


class LogRequest(Message, frozen=True, array_like=True, kw_only=True):
    """One request for PX4's own logs. The agent passes it on to its PX4."""

    packet: bytes  # a whole packet of MAVLink


class LogPieces(Message, frozen=True, array_like=True, kw_only=True):
    """PX4's answers to requests for its own logs, as PX4 sent them."""

    packets: tuple[bytes, ...]  # whole packets of MAVLink


class HeardClock(msgspec.Struct, frozen=True, array_like=True):
    """Arrival of another node's clock message."""

    node: str  # the sender of that message
    host: int  # the sender's host id, see :class:`ClockMessage`
    sent_ns: int  # when it was sent, by the sender's clock
    received_ns: int  # when it arrived, by the clock of the node that publishes this


class ClockMessage(Message, frozen=True, array_like=True, kw_only=True):
    """A node's monotonic clock, and arrivals of the others' clock messages, twice a second.

    ``onboard/bus/clock_offsets.py`` calculates the offsets between the clocks from them.
    """

    node: str
    host: int  # host id: equal for all nodes that share a clock; a reboot changes it
    sequence: int
    sent_ns: int  # by the node's own clock
    heard: tuple[HeardClock, ...] = ()  # the newest message of each other node
    world_ns: int = 0  # the computer's wall clock at ``sent_ns``, since 1970; 0: not published


class Light(Message, frozen=True, array_like=True, kw_only=True):
    """Colour of a vehicle in a show, as the ground shows and records it."""

    vehicle: str
    stamp_ns: int
    colour: tuple[int, int, int]  # red, green and blue, 0 to 255 each


class Truth(Message, frozen=True, array_like=True, kw_only=True):
    """True motion of a vehicle in a simulation, for records and expectations. No agent uses it."""

    vehicle: str
    stamp_ns: int
    position_enu_m: Xyz
    velocity_enu_m_s: Xyz
    quaternion_enu_flu_wxyz: Wxyz
    is_on_ground: bool
    is_collided: bool  # it has touched another vehicle of its simulator
    touchdowns: int = 0  # number of first ground contacts after flights; 0 if not counted
    touchdown_m_s: float = 0.0  # vertical speed at the newest touchdown
    had_thrust: bool = True  # its motors had their full thrust at that touchdown
    is_flown_by_agent: bool = True  # PX4 follows new setpoints in OFFBOARD; True if not known
    # boot id of the simulator that knows which of its vehicles touch each other; 0: none knows, as
    # with PX4s that are simulated one by one
    contacts_known_by: int = 0
