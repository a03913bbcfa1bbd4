"""Words and facts of a flight: where in its state a vehicle is, and what the state machine knows at one tick."""

from __future__ import annotations

from enum import Enum
from functools import cache

from msgspec import Struct

from onboard.autopilot import Landed, Snapshot, Vec3
from onboard.bus.schema import AgentState
from onboard.control.pipeline import Phase
from onboard.safety.failsafe_table import Situation


class Step(Enum):
    """Where in its state the vehicle is; the words are shown to people."""

    __hash__ = object.__hash__  # members are what they are; Enum's own costs a call of Python for each look-up

    IDLE = ""
    OFFBOARD = "waiting for OFFBOARD"
    ARMING = "waiting to be armed"
    LIFTOFF = "lift-off"
    CLIMB = "climb"
    LEG = "on the way"
    ARRIVED = "arrived"
    DESCENT = "descent"
    CONTACT = "on the ground, waiting for PX4"
    PX4 = "PX4 lands"
    TAKEOVER = "taking over from PX4's hold"


@cache
def situation_of(state: AgentState, step: Step) -> Situation:
    """For the failsafe table."""
    if state == "failed":
        return Situation.SILENT
    if state == "armed" or step in (Step.OFFBOARD, Step.ARMING):
        return Situation.ARMED
    if step is Step.LIFTOFF:
        return Situation.LIFTOFF
    if state in ("taking off", "flying", "holding"):
        return Situation.FLYING
    if state == "landing":
        return Situation.PX4_LANDING if step is Step.PX4 else Situation.LANDING
    return Situation.GROUND


@cache
def phase_of(state: AgentState, step: Step) -> Phase:
    """For the pipeline."""
    if step is Step.LIFTOFF:
        return Phase.LIFTOFF
    if step is Step.DESCENT:
        return Phase.LANDING
    return Phase.FLYING if situation_of(state, step) is Situation.FLYING else Phase.GROUND


class FlightView(Struct, frozen=True):
    """What the flight needs to know at one tick; position and velocity in fleet ENU."""

    now_ns: int
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    has_position: bool
    snapshot: Snapshot

    @property
    def is_on_ground(self) -> bool:
        """PX4 says so."""
        return self.snapshot.landed is Landed.ON_GROUND
