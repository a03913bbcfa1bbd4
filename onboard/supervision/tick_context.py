"""Inputs of the supervision at one tick: what the agent knows about itself, besides its flight."""

from __future__ import annotations

import math

from msgspec import Struct

from onboard.corrections.status import CorrectionsStatus
from onboard.localization.own_state import OwnEstimate
from onboard.tuples import Wxyz, Xyz
from onboard.types import TICK_S


class TickContext(Struct, frozen=True, kw_only=True):
    """State of the agent itself at one tick."""

    own: OwnEstimate

    # own process
    period_s: float = TICK_S  # since the last tick
    is_last_tick_finite: bool = True
    law_refusal: str = ""  # why Covey's law flies instead of the user's law; empty: no reason
    is_stopping: bool = False  # a shutdown of the agent was requested
    has_duplicate: bool = False  # another agent publishes for this vehicle
    is_disk_full: bool = False
    clock_jump_ns: int = 0  # time of the last jump of our clock; 0: none yet

    corrections: CorrectionsStatus | None = None  # None: the vehicle uses no corrections

    # bus
    has_ground: bool = False  # a ground station is on the bus
    bus_age_s: float = 0.0  # since the last message of any neighbour

    # the vehicle and the others
    is_airborne: bool = False
    # charge at which a simulated battery stops emptying; 0 for a real one
    battery_floor_frac: float = 0.0
    nearest_m: float = math.inf  # separation from the nearest vehicle or person
    nearest_person: str = ""
    nearest_person_m: float = math.inf  # separation from the nearest person
    unseen_people: tuple[str, ...] = ()  # persons whose poses have stopped

    # the last pass of the pipeline
    law_status: int = 0
    active_neighbour: int = -1  # index of the neighbour that the law avoids most; -1: none
    commanded_wxyz: Wxyz = (1.0, 0.0, 0.0, 0.0)  # last attitude setpoint sent, in the fleet frame
    thrust_frac: float = 0.0  # throttle sent last
    below_m: float = 0.0  # how far the vehicle is below its trajectory
    is_law_active: bool = False  # whether the law changes the thrust
    # horizontal distance between the setpoint and the law's predicted position
    setpoint_miss_m: float = 0.0
    disturbance_enu_m_s2: Xyz = (0.0, 0.0, 0.0)  # disturbance that the observer has learned
