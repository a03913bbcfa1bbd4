"""The facts of one tick. The condition table finds from them the conditions that hold.

A fact says what the agent observes. :mod:`onboard.supervision.condition_table` says which values
are a condition, and how long they must last. The defaults describe a vehicle on the ground without
any problem.
"""

from __future__ import annotations

import math
from enum import Enum

from msgspec import Struct

from onboard.config.fleet import FleetSection
from onboard.supervision.wind_monitor import WindFacts
from onboard.types import TICK_S


class ModeLoss(Enum):
    """The way in which PX4 has left the mode that the flight needs."""

    NONE = "none"
    BY_HAND = "a pilot's mode, and sticks are received"
    LEFT = "another mode"  # for instance after a command of another ground station
    FAILSAFE = "PX4's own failsafe"
    DISARMED = "disarmed"


class CorrectionsFacts(Struct, frozen=True, kw_only=True):
    """Facts about the satellites of a vehicle that uses corrections."""

    fix_below: str = ""  # type of the fix in words, if it is less than the fleet requires
    is_position_coarse: bool = False  # whether the position is worse than hold_accuracy_m
    base_fault: str = ""  # what is wrong with the base, in words; empty: nothing
    old_s: float = 0.0  # age of the corrections, if they are too old; otherwise 0


class SlowFacts(Struct, frozen=True, kw_only=True):
    """Facts that are observed ten times a second."""

    # own position
    # standard deviation that PX4 reports, of two axes together; 0 or NaN: not reported
    px4_accuracy_m: float = 0.0
    # the same of its height, in a fleet whose vehicles pass above each other; else 0
    px4_height_accuracy_m: float = 0.0
    has_lost_satellites: bool = False
    is_position_late: bool = False  # whether PX4's velocity follows attitude and throttle late
    position_miss_m: float = 0.0  # how much PX4's positions contradict our own motion

    corrections: CorrectionsFacts = CorrectionsFacts()

    # battery
    battery_frac: float = 1.0  # NaN: not reported
    is_battery_falling: bool = False

    wind: WindFacts = WindFacts()

    # time of the last jump of our clock, or of the mocap's clock against ours; 0: none yet
    clock_jump_ns: int = 0

    # names of other vehicles
    without_position: tuple[str, ...] = ()  # their messages say that they have no position
    blind: tuple[str, ...] = ()  # use dead reckoning, while this vehicle has poses
    late: tuple[str, ...] = ()  # their messages are old, but they do not count as silent yet
    other_files: tuple[str, ...] = ()  # use another fleet file or law
    implausible: tuple[str, ...] = ()  # their messages cannot be true; each name with its reason
    uncooperative: tuple[str, ...] = ()  # do not fly as they predict
    too_windy_for: tuple[str, ...] = ()  # neighbours that land because of the wind
    endangered: tuple[str, ...] = ()  # even hard braking will not keep the distance to them


class TickFacts(Struct, frozen=True, kw_only=True):
    """Facts of one tick."""

    now_ns: int
    limits: FleetSection  # of the fleet file
    is_slow_tick: bool = False  # whether the slow facts were observed at this tick
    slow: SlowFacts = SlowFacts()  # facts of the last slow tick

    # the flight
    is_flying: bool = False  # whether the situation is FLYING
    is_under_law: bool = False  # whether the vehicle flies the output of the avoidance law
    is_airborne: bool = False  # whether other vehicles must expect this vehicle in the air
    is_taking_off: bool = False  # whether it is armed on the ground, or lifts off
    is_in_contact: bool = False  # it stands after a landing that PX4 has not confirmed yet
    is_overdue: bool = False  # the move or the landing takes too long
    overdue_reason: str = ""  # why it does

    # own motion
    has_position: bool = True  # known from poses or by dead reckoning
    position_age_s: float = 0.0  # age of the newest sample that was used
    position_stale_s: float = 0.0  # how long the position has been stale
    # time for which it was stale recently, summed over all gaps (onboard/safety/condition_timer.py)
    position_flicker_s: float = 0.0
    height_above_lowest_ground_m: float = 0.0  # the lowest in the fleet file
    has_risen: bool = False  # it is low, and has just reached a greater height
    height_m: float = 0.0  # above the ground where it took off
    is_standing: bool = False  # by thrust and vertical motion, without using its height
    is_stuck: bool = False  # it pushes upwards to its goal, and does not move
    mocap_required: bool = True  # False: it uses PX4's own position
    jumps: int = 0  # number of impossible samples in a row
    jumped_onto: str = ""  # vehicle near the newest impossible sample; empty: none
    is_mocap_frozen: bool = False
    is_mocap_late: bool = False

    # PX4
    is_px4_silent: bool = False  # no packet arrives
    px4_nonsense: str = ""  # sentence about impossible numbers; empty: there are none
    is_px4_frozen: bool = False  # packets arrive, but PX4's clock does not advance
    is_heartbeat_late: bool = False
    is_px4_rebooted: bool = False  # PX4 rebooted within the last seconds
    is_px4_back: bool = False  # PX4's clock advanced again within the last seconds
    has_contradiction: bool = False  # two reports of PX4 have just contradicted each other
    contradicted_s: float = 0.0  # time from the first such contradiction to the last one
    contradicted: str = ""  # kind of those reports
    has_landed_report: bool = True  # whether the last report of the landed state is recent
    is_on_ground: bool = False  # whether a recent report says that it is on the ground
    mode_loss: ModeLoss = ModeLoss.NONE
    px4_mode: str = ""
    is_attitude_lost: bool = False  # the attitude does not follow its setpoints
    is_thrust_saturated: bool = False
    is_sinking: bool = False  # it does not climb although the thrust is full

    # own process
    period_s: float = TICK_S  # since the last tick
    is_last_tick_finite: bool = True
    law_refusal: str = ""  # name of the user's law, and why Covey's law flies instead
    is_stopping: bool = False  # a shutdown of the agent was requested
    has_duplicate: bool = False  # another agent publishes for this vehicle
    is_disk_full: bool = False

    # bus and ground
    bus_age_s: float = 0.0  # since the last message of any neighbour
    has_ground: bool = True  # a ground station is on the bus

    # geofence
    is_fence_near: bool = False  # it would cross the fence even if it braked now
    is_outside: bool = False
    is_above_ceiling: bool = False

    # other vehicles
    nearest_m: float = math.inf  # separation from the nearest other vehicle or person
    nearest_person: str = ""
    nearest_person_m: float = math.inf  # separation from the nearest person
    touched: str = ""  # vehicle that is nearer than one body diameter; empty: none
    is_law_infeasible: bool = False
    silent: tuple[str, ...] = ()  # were in the air when last heard, and are silent now
    unseen: tuple[str, ...] = ()  # silent vehicles and persons without mocap poses
    heard_again: tuple[str, ...] = ()  # heard again within the last seconds
