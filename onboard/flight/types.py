"""Types of a flight: its steps, the events that change the step, and its inputs at one tick.

Four words describe the progress of a flight. All four follow from the step, so they cannot
contradict each other:

    FlightStep    what the flight waits for: "climb", "descent", "waiting to be armed". It is the
                  only stored state of the state machine; the table in flight_table.py leads from
                  step to step.

    Situation     how much harm an action can do: on the ground, armed, lifting off, flying,
                  landing. It is the column of the failsafe table (safety/failsafe_table.py).

    ControlMode   what the pipeline computes: thrust on the ground, a lift-off, a flight under the
                  law, a landing, a flight by dead reckoning (control/control_mode.py).

    AgentState    the word for people and for other programs: "holding", "landing". Telemetry
                  publishes it (bus/schema.py), and several steps share the same word.

Each row of FlightStep names the other three. To describe more of a flight, add a step or a property
of FlightContext, but not a fifth word.
"""

from __future__ import annotations

import math
from enum import Enum, unique

from msgspec import Struct

from onboard.autopilot import Landed, Snapshot
from onboard.bus.schema import AgentState
from onboard.control.control_mode import ControlMode
from onboard.control.control_mode import ControlMode as M
from onboard.flight.path_flight import OtherClock
from onboard.safety.failsafe_table import Situation
from onboard.safety.failsafe_table import Situation as S
from onboard.tuples import Wxyz, Xyz
from onboard.types import TICK_S

_LANDED_FRESH_NS = 1_500_000_000  # PX4 reports its landed state 5 to 10 times a second


@unique  # two steps with equal columns would be one
class FlightStep(Enum):
    """Steps of a flight.

    The columns are: state and text for people, situation for the failsafe table, control mode for
    the pipeline, and ``is_streaming``, whether setpoints are sent to PX4 at every tick.
    """

    __hash__ = object.__hash__  # faster: Enum's own hash is a Python function

    WAITING = "waiting", "", S.GROUND, M.GROUND, False
    READY = "ready", "", S.GROUND, M.GROUND, False
    REBOOTING = "waiting", "PX4 reboots", S.GROUND, M.GROUND, False
    ARM_OFFBOARD = "ready", "waiting for OFFBOARD", S.ARMED, M.GROUND, True
    ARM_ARMING = "ready", "waiting to be armed", S.ARMED, M.GROUND, True
    ARMED = "armed", "", S.ARMED, M.GROUND, True
    TAKEOFF_OFFBOARD = "taking off", "waiting for OFFBOARD", S.ARMED, M.GROUND, True
    TAKEOFF_ARMING = "taking off", "waiting to be armed", S.ARMED, M.GROUND, True
    LIFTOFF = "taking off", "lift-off", S.LIFTOFF, M.LIFTOFF, True
    CLIMB = "taking off", "climb", S.FLYING, M.FLYING, True
    LEG = "flying", "on the way", S.FLYING, M.FLYING, True
    PATH = "flying", "on its path", S.FLYING, M.FLYING, True
    ARRIVED = "flying", "arrived", S.FLYING, M.FLYING, True
    HOLDING = "holding", "arrived", S.FLYING, M.FLYING, True
    TAKEOVER = "holding", "taking over from PX4's hold", S.FLYING, M.FLYING, True
    COASTING = "flying", "no pose: brakes and sinks", S.FLYING, M.DEAD_RECKONING, True
    DESCENT = "landing", "descent", S.LANDING, M.LANDING, True
    SINKING = "landing", "descent without poses", S.LANDING, M.DEAD_RECKONING, True
    CONTACT = "landing", "on the ground, waiting for PX4", S.LANDING, M.GROUND, True
    PX4_LANDING = "landing", "PX4 lands", S.PX4_LANDING, M.GROUND, False
    LANDED = "landed", "", S.GROUND, M.GROUND, False
    DISARMING = "armed", "waiting to be disarmed", S.ARMED, M.GROUND, False
    DISARMED = "ready", "waiting for PX4 to confirm", S.GROUND, M.GROUND, False
    FAILSAFE_DISARMING = "waiting", "waiting to be disarmed", S.GROUND, M.GROUND, False
    FAILED = "failed", "", S.SILENT, M.GROUND, False
    FAILED_DISARMING = "failed", "waiting to be disarmed", S.SILENT, M.GROUND, False
    KILLING = "failed", "waiting for the motors to stop", S.SILENT, M.GROUND, False

    def __init__(
        self,
        state: AgentState,
        text: str,
        situation: Situation,
        control_mode: ControlMode,
        is_streaming: bool,
    ) -> None:
        self.state = state
        self.text = text
        self.situation = situation
        self.control_mode = control_mode
        self.is_streaming = is_streaming

        # whether the vehicle flies the output of the pipeline, and so that of the avoidance law
        self.is_under_law = is_streaming and control_mode is not ControlMode.GROUND


_NOT_YET_OFFBOARD = {FlightStep.ARM_OFFBOARD, FlightStep.TAKEOFF_OFFBOARD, FlightStep.TAKEOVER}

# In these steps, a heartbeat with another mode means that somebody else has taken control.
MUST_BE_OFFBOARD = {step for step in FlightStep if step.is_streaming} - _NOT_YET_OFFBOARD

# In these steps a heartbeat without the armed flag means that the motors were stopped in the air.
MUST_BE_ARMED = {
    FlightStep.LIFTOFF,
    FlightStep.CLIMB,
    FlightStep.LEG,
    FlightStep.PATH,
    FlightStep.ARRIVED,
    FlightStep.HOLDING,
    FlightStep.COASTING,
}


class FlightEvent(Enum):
    """Causes of a change of step: an order, a failsafe's action, the preflight check, or a tick."""

    __hash__ = object.__hash__  # as for FlightStep

    ARM = "order arm"
    TAKEOFF = "order takeoff"
    MOVE = "order move"
    FOLLOW_PATH = "order follow_path"
    HOLD = "order hold"
    LAND = "order land"
    DISARM = "order disarm"
    KILL = "order kill"
    REBOOT = "order reboot"
    FAILSAFE_SLOW = "failsafe slow"
    FAILSAFE_HOLD = "failsafe hold"
    FAILSAFE_LAND = "failsafe land"
    FAILSAFE_PX4_LAND = "failsafe px4 land"
    FAILSAFE_DISARM = "failsafe disarm"
    FAILSAFE_STOP = "failsafe stop"
    PREFLIGHT_PASSED = "preflight check passed"
    PREFLIGHT_REFUSED = "preflight check refused"
    TICK = "tick"


class FlightView(Struct, frozen=True):
    """State of the vehicle at one tick, as its flight knows it."""

    now_ns: int
    position_enu_m: Xyz  # in the fleet's frame
    velocity_enu_m_s: Xyz
    has_position: bool  # whether the position is known, from poses or by dead reckoning
    snapshot: Snapshot  # newest reports of PX4
    thrust_share: float = 1.0  # thrust of the last setpoint, divided by the hover thrust
    lift_share: float = 1.0  # vertical part of that thrust, divided by the hover thrust
    # clocks of the other vehicles of the same show; None: they are not compared at this tick
    other_clocks: tuple[OtherClock, ...] | None = None
    period_s: float = TICK_S  # time since the last tick
    is_dead_reckoned: bool = False  # whether position and velocity come from dead reckoning
    yaw_rad: float = math.nan  # heading, counterclockwise from east; NaN: not known
    position_age_s: float = math.inf  # age of the newest sample that the estimate has used
    attitude_wxyz: Wxyz = (1.0, 0.0, 0.0, 0.0)  # in the fleet's frame
    gust_m_s2: float = 0.0  # standard deviation of the present gusts, per axis
    expected_gust_m_s2: float = 0.0  # standard deviation of the gusts to expect, per axis

    @property
    def has_landed_report(self) -> bool:
        """Whether PX4's last report of its landed state is recent."""
        return self.now_ns - self.snapshot.landed_ns < _LANDED_FRESH_NS

    @property
    def is_on_ground(self) -> bool:
        """Whether PX4 has recently reported the ground."""
        return self.has_landed_report and self.snapshot.landed is Landed.ON_GROUND

    @property
    def hears_sticks(self) -> bool:
        """Whether PX4 hears a pilot's sticks."""
        return self.snapshot.hears_sticks(self.now_ns)

    @property
    def is_flown_by_hand(self) -> bool:
        """Whether a pilot flies: PX4 is in a pilot's mode and hears the pilot's sticks."""
        return self.snapshot.is_flown_by_hand(self.now_ns)

    @property
    def was_on_ground(self) -> bool:
        """Whether PX4 last reported the ground, however long ago."""
        return self.snapshot.landed is Landed.ON_GROUND
