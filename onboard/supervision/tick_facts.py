"""Facts of one tick that the conditions of the failsafe table are judged by.

A fact is what the agent sees; whether that is wrong, and for how long it has to last, stands in
:mod:`onboard.supervision.condition_table`. The defaults are those of a vehicle that stands on the
ground and has nothing to complain of.
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
    BY_HAND = "a pilot's mode, and his sticks are heard"
    LEFT = "another mode"  # a pilot's, or out of PX4's landing
    FAILSAFE = "PX4's own failsafe"
    DISARMED = "disarmed"


class SlowFacts(Struct, frozen=True, kw_only=True):
    """Facts that are looked at ten times a second."""

    # own position
    px4_accuracy_m: float = 0.0  # as PX4 tells it, of two axes together; 0 or NaN: not told
    has_lost_satellites: bool = False
    position_miss_m: float = 0.0  # by which PX4's positions miss what the own motion explains

    # satellites of a vehicle that takes corrections
    fix_below: str = ""  # its fix, while it is less than the fleet demands
    is_position_coarse: bool = False  # its position is worse than the fleet holds with
    base_fault: str = ""  # what is wrong with the base, in words
    corrections_old_s: float = 0.0  # age of its corrections, while that is more than the fleet's

    # battery
    battery_frac: float = 1.0  # NaN: not told
    is_battery_falling: bool = False

    wind: WindFacts = WindFacts()

    # the last jump of a clock: of the mocap's against ours, or of ours; 0 never
    clock_jump_ns: int = 0

    # names of other vehicles
    without_position: tuple[str, ...] = ()  # they say so themselves
    blind: tuple[str, ...] = ()  # in the air by dead reckoning, while this vehicle has positions
    late: tuple[str, ...] = ()  # their messages are old, and not yet silent
    other_files: tuple[str, ...] = ()  # they fly by another fleet file or law
    implausible: tuple[str, ...] = ()  # with the reason behind each name
    uncooperative: tuple[str, ...] = ()  # they do not fly as they predict
    endangered: tuple[str, ...] = ()  # even hard braking will not keep the distance from them


class TickFacts(Struct, frozen=True, kw_only=True):
    """Facts of one tick."""

    now_ns: int
    limits: FleetSection  # of the fleet file
    is_slow_tick: bool = False  # the slow facts are of this tick
    slow: SlowFacts = SlowFacts()  # of the last slow tick

    # the flight
    is_flying: bool = False  # in free flight, by the situation of the failsafe table
    is_under_law: bool = False
    is_airborne: bool = False
    is_in_contact: bool = False  # it stands, and PX4 has not yet seen it
    # sign that a move or a landing makes no progress; None while it does
    overdue: str | None = None

    # own motion
    has_position: bool = True
    position_age_s: float = 0.0  # of the newest sample that was used
    position_stale_s: float = 0.0  # for so long the position has been stale
    height_enu_m: float = 0.0  # in the fleet frame
    height_m: float = 0.0  # above the ground where it took off
    is_standing: bool = False  # by thrust and vertical motion, whatever its height reads
    mocap_required: bool = True  # else it flies by PX4's own position
    jumps: int = 0  # impossible samples in a row
    jumped_onto: str = ""  # the vehicle near which the newest of them is
    is_mocap_frozen: bool = False
    is_mocap_late: bool = False

    # PX4
    is_px4_silent: bool = False  # no packet
    px4_nonsense: str = ""  # what is wrong with its newest numbers, as a sentence
    is_px4_frozen: bool = False  # packets, and a clock that stands still
    is_heartbeat_late: bool = False
    is_px4_rebooted: bool = False  # in the last seconds
    is_px4_back: bool = False  # in the last seconds, after a standstill
    contradicted_s: float = 0.0  # for so long its reports have contradicted each other
    contradicted: str = ""  # kind of those reports
    has_landed_report: bool = True  # it has told lately whether it is on the ground
    is_on_ground: bool = False  # by that report
    mode_loss: ModeLoss = ModeLoss.NONE
    px4_mode: str = ""
    is_attitude_lost: bool = False  # it does not follow its setpoints
    is_thrust_saturated: bool = False
    is_sinking: bool = False  # with full thrust

    # own process
    period_s: float = TICK_S  # since the last tick
    is_last_tick_finite: bool = True
    law_refusal: str = ""  # name of an own law, and why Covey's flies in its place
    is_stopping: bool = False  # the agent is asked to end
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
    nearest_m: float = math.inf  # separation from the nearest one
    touched: str = ""  # the one that is nearer than a body
    is_law_infeasible: bool = False
    silent: tuple[str, ...] = ()  # heard in the air, and not any more
    unseen: tuple[str, ...] = ()  # of those, the ones without mocap poses
    heard_again: tuple[str, ...] = ()  # in the last seconds
