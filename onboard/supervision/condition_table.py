"""The conditions of the failsafe table: when each one holds, and how long it must last. Pure data.

Each condition has one row with one or more causes, and any cause is enough. A cause is a fact of a
tick, a fact compared with a limit or a value, or a predicate of several facts. It must hold for a
number of checks in a row, for longer than a time, or both. docs/failsafe.md prints these numbers.

A process that was not scheduled for a while finds every message old at its first tick, although
nothing else is wrong. Therefore a silence counts only after several checks in a row have seen it.
Conditions that can do harm within a tenth of a second are checked at every tick. The others are
checked ten times a second.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from onboard.safety.failsafe_table import Condition
from onboard.safety.limits import (
    AMONG_OTHERS_M,
    DOWN_HEIGHT_M,
    FLICKER_S,
    LARGEST_PX4_ACCURACY_M,
    POSITION_LOST_S,
    POSITION_STALE_S,
    RECKONING_AMONG_OTHERS_S,
    RECKONING_S,
)
from onboard.supervision.tick_facts import ModeLoss, TickFacts
from onboard.types import TICK_S

# own position
STALE_FOR_S = 0.4  # a position that is stale for longer is lost, even if poses arrive regularly
JUMPS = 3  # number of impossible samples in a row
UNUSABLE_M = 3.0  # if PX4's position is less accurate than this, PX4 flies level and ignores it
INACCURATE_S = 0.5
FIX_BELOW_S = 0.5  # a receiver that loses its fix briefly has it again at the next report

# PX4
CONTRADICTED_LONG_S = 2.0  # contradictions that last longer are not single datagrams

# own process
LATE_S = 0.005  # a tick is late if its period is longer by more than this
STALLED_S = 0.2
STALLED_LONG_S = 0.3  # PX4 lands after COM_OF_LOSS_T = 0.3 s without setpoints
NOT_FINITE_LONG_S = 0.5
CLOCK_JUMP_REPORTED_S = 5.0

# bus
BUS_LOST_S = 1.0

# space
CLEARLY_UP_M = 0.5  # above this height, PX4's report of the ground is wrong
LANDED_WRONG_S = 0.5
UNFIT_M = 0.18  # correct positions stay far below this; see localization/motion_fit.py
UNFIT_S = 0.3
DOWN_LONG_S = 1.0  # a flying vehicle that stays below DOWN_HEIGHT_M for this time has fallen
# Without a mocap, a vehicle below this height that does not sink may have fallen. Above it, only
# rising air has the same signs.
MAY_BE_DOWN_M = 2.0
FENCE_LONG_S = 2.0

# air; these times are short, because the estimate itself is a mean over two seconds
WIND_S = 0.5
PUSHED_ABOUT_S = 0.5
DISTURBANCE_BOUND_S = 0.5

INFEASIBLE_S = 0.1
# after a gap in all poses, a vehicle learns this much later that the others also have poses again
NEIGHBOUR_BLIND_OVER_S = 0.15
BATTERY_UNKNOWN_S = 5.0  # in addition to the 5 s after which a report counts as old

# A silence over this many checks in a row is not caused by a process that slept.
LIVE_CHECKS = 5
# For the silence of a neighbour, fewer checks are enough, because the 50 Hz states of other
# neighbours show that the process has not slept.
NEIGHBOUR_CHECKS = 2
STALE_CHECKS = 5
PREDICTED_CHECKS = 2


@dataclass(frozen=True, slots=True)
class Cause:
    """One cause of a condition."""

    # The cause holds if the fact is true, unless one of the next two fields is set.
    fact: Callable[[TickFacts], Any]
    above: float | None = None  # the cause holds if the fact is greater than this
    equals: object = None  # the cause holds if the fact has this value

    checks: int = 1  # number of checks in a row at which the cause must hold
    # time that it must exceed: seconds, or a key of [fleet]; None: no time
    over_s: float | str | None = None
    given: Callable[[TickFacts], object] | None = None  # further predicate that must be true
    is_slow: bool = False  # True: checked ten times a second, instead of at every tick
    detail: str | Callable[[TickFacts], str] = ""  # words in brackets after the condition


@dataclass(frozen=True, slots=True)
class ConditionRow:
    """Detection and report of one condition."""

    condition: Condition
    causes: tuple[Cause, ...]  # any one is enough; the last one that holds gives the detail
    is_quiet: bool = False  # True: no event is published for it
    names_vehicles: bool = False  # True: it is reported again if its detail names other vehicles


def _row(
    condition: Condition, *causes: Cause, is_quiet: bool = False, names_vehicles: bool = False
) -> ConditionRow:
    return ConditionRow(condition, causes, is_quiet, names_vehicles)


def _names(field: str) -> Callable[[TickFacts], str]:
    """Return a function that lists the names of vehicles in a fact, as the detail of a cause."""
    names_of = attrgetter(field)
    return lambda facts: ", ".join(names_of(facts))


def _is_lost(facts: TickFacts) -> bool:
    if facts.position_age_s > POSITION_LOST_S or facts.position_stale_s > STALE_FOR_S:
        return True
    # if poses come and go, the vehicle drifts and sinks a little in each gap
    return facts.position_age_s > POSITION_STALE_S and facts.position_flicker_s > FLICKER_S


def _is_reckoned_for_too_long(facts: TickFacts) -> bool:
    longest_s = RECKONING_S
    if facts.nearest_m < AMONG_OTHERS_M:
        longest_s = RECKONING_AMONG_OTHERS_S
    # on the ground, a handover to PX4 would make the vehicle lift off
    return facts.position_age_s > longest_s and not facts.is_in_contact


def _is_accuracy_unusable(facts: TickFacts) -> bool:
    is_unusable = facts.slow.px4_accuracy_m > UNUSABLE_M and not facts.mocap_required
    return is_unusable and not facts.is_in_contact


def _is_accuracy_out_of_range(facts: TickFacts) -> bool:
    # comparisons with NaN are False, so that NaN is out of range
    is_in_range = 0.0 < facts.slow.px4_accuracy_m <= LARGEST_PX4_ACCURACY_M
    is_height_in_range = facts.slow.px4_height_accuracy_m <= LARGEST_PX4_ACCURACY_M
    is_accurate = is_in_range and is_height_in_range
    return not is_accurate and not facts.mocap_required


def _accuracy(facts: TickFacts) -> str:
    return f"PX4 says {facts.slow.px4_accuracy_m:.1f} m"


def _accuracy_and_its_limit(facts: TickFacts) -> str:
    accuracy = "PX4 does not say how accurate it is"
    if facts.slow.px4_height_accuracy_m > LARGEST_PX4_ACCURACY_M:
        return f"PX4 says {facts.slow.px4_height_accuracy_m:.1f} m of its height"
    if facts.slow.px4_accuracy_m:
        accuracy = _accuracy(facts)
    return f"{accuracy}; distances cover {LARGEST_PX4_ACCURACY_M:.1f} m"


def _px4_mode(facts: TickFacts) -> str:
    return f"now {facts.px4_mode}"


def _is_reported_down_in_the_air(facts: TickFacts) -> bool:
    is_up = facts.has_position and facts.height_m > CLEARLY_UP_M
    return facts.is_flying and is_up and facts.is_on_ground


def _is_down(facts: TickFacts) -> bool:
    if not facts.mocap_required:
        # without a mocap, a low height is not a sign, because PX4's own height has an error of half
        # a metre
        does_not_move = facts.is_standing or facts.is_stuck
        return facts.is_flying and does_not_move and facts.height_m < MAY_BE_DOWN_M
    # a slow climb takes longer than DOWN_LONG_S to this height
    stays_low = facts.height_above_lowest_ground_m < DOWN_HEIGHT_M and not facts.has_risen
    return facts.is_flying and facts.has_position and stays_low


def _has_jumped(facts: TickFacts) -> bool:
    return facts.jumps >= JUMPS and not facts.jumped_onto


def _has_clock_jumped(facts: TickFacts) -> bool:
    jump_ns = facts.slow.clock_jump_ns
    return jump_ns != 0 and facts.now_ns - jump_ns < CLOCK_JUMP_REPORTED_S * 1e9


def _is_fix_coarse(facts: TickFacts) -> bool:
    return bool(facts.slow.corrections.fix_below) and facts.slow.corrections.is_position_coarse


def _corrections_age(facts: TickFacts) -> str:
    return f"{facts.slow.corrections.old_s:.0f} s"


def _is_too_near(facts: TickFacts) -> bool:
    limit_m = facts.limits.safety_distance_m
    if facts.is_taking_off:
        # other vehicles may stand, land and pass beside it, but nobody may be near its propellers
        return facts.nearest_person_m < limit_m
    return facts.is_airborne and facts.nearest_m < limit_m


def _person_too_near(facts: TickFacts) -> str:
    if facts.nearest_person_m < facts.limits.safety_distance_m:
        return facts.nearest_person
    return ""


def _has_touched(facts: TickFacts) -> bool:
    is_near = facts.nearest_m < facts.limits.safety_distance_m
    return bool(facts.touched) and is_near and facts.is_airborne


def _is_law_infeasible(facts: TickFacts) -> bool:
    return facts.is_law_infeasible and facts.is_under_law


def _is_beyond_the_fence(facts: TickFacts) -> bool:
    return facts.is_outside or facts.is_above_ceiling


def _wind(facts: TickFacts) -> str:
    return facts.slow.wind.words


def _is_wind_above_for_a_neighbour(facts: TickFacts) -> bool:
    # All vehicles fly in the same air, but gusts hide a rising wind from some of them for seconds.
    # They land together with the first one that notices it.
    return facts.slow.wind.is_strong and bool(facts.slow.too_windy_for)


def _wind_of_neighbours(facts: TickFacts) -> str:
    return f"{facts.slow.wind.words}; too much for {', '.join(facts.slow.too_windy_for)}"


def _battery_pct(facts: TickFacts) -> float:
    return 100.0 * facts.slow.battery_frac


_C = Condition
_fact = attrgetter

# facts that two conditions share
_bus_age_s = _fact("bus_age_s")
_has_ground = _fact("has_ground")
_is_last_tick_finite = _fact("is_last_tick_finite")

ROWS: tuple[ConditionRow, ...] = (
    # -- own motion
    _row(
        _C.POSITION_STALE,
        Cause(
            _fact("position_age_s"),
            above=POSITION_STALE_S,
            detail="it brakes and sinks by dead reckoning",
        ),
    ),
    _row(_C.POSITION_LOST, Cause(_is_lost, checks=LIVE_CHECKS, detail="by dead reckoning")),
    _row(
        _C.POSITION_LOST_LONG,
        Cause(_is_lost, checks=LIVE_CHECKS, given=_is_reckoned_for_too_long),
        Cause(_is_accuracy_unusable, over_s=INACCURATE_S, is_slow=True, detail=_accuracy),
    ),
    _row(
        _C.POSITION_JUMPED,
        Cause(_has_jumped),
    ),
    _row(_C.MOCAP_SWAPPED, Cause(_fact("jumped_onto"), detail=_fact("jumped_onto"))),
    _row(_C.MOCAP_FROZEN, Cause(_fact("is_mocap_frozen"))),
    _row(_C.MOCAP_LATE, Cause(_fact("is_mocap_late"))),
    _row(_C.SATELLITES_LOST, Cause(_fact("slow.has_lost_satellites"), is_slow=True)),
    _row(
        _C.POSITION_INACCURATE,
        Cause(
            _is_accuracy_out_of_range,
            over_s=INACCURATE_S,
            is_slow=True,
            detail=_accuracy_and_its_limit,
        ),
    ),
    _row(
        _C.POSITION_UNFIT,
        Cause(_fact("slow.position_miss_m"), above=UNFIT_M, over_s=UNFIT_S, is_slow=True),
        Cause(_fact("slow.is_position_late"), is_slow=True, detail="it seems to be late"),
    ),
    _row(
        _C.FIX_COARSE,
        Cause(
            _is_fix_coarse,
            over_s=FIX_BELOW_S,
            is_slow=True,
            detail=_fact("slow.corrections.fix_below"),
        ),
    ),
    _row(
        _C.FIX_FELL_BACK,
        Cause(
            _fact("slow.corrections.fix_below"),
            over_s=FIX_BELOW_S,
            is_slow=True,
            detail=_fact("slow.corrections.fix_below"),
        ),
    ),
    _row(
        _C.BASE_FAULT,
        Cause(
            _fact("slow.corrections.base_fault"),
            is_slow=True,
            detail=_fact("slow.corrections.base_fault"),
        ),
    ),
    _row(
        _C.CORRECTIONS_OLD,
        Cause(_fact("slow.corrections.old_s"), is_slow=True, detail=_corrections_age),
    ),
    # -- PX4
    _row(
        _C.FLOWN_BY_HAND,
        Cause(_fact("mode_loss"), equals=ModeLoss.BY_HAND, detail=_fact("px4_mode")),
    ),
    _row(
        _C.LEFT_OFFBOARD,
        Cause(_fact("mode_loss"), equals=ModeLoss.LEFT, detail=_px4_mode),
    ),
    _row(
        _C.PX4_FAILSAFE,
        Cause(_fact("mode_loss"), equals=ModeLoss.FAILSAFE, detail=_px4_mode),
    ),
    _row(_C.DISARMED, Cause(_fact("mode_loss"), equals=ModeLoss.DISARMED)),
    _row(_C.REBOOTED, Cause(_fact("is_px4_rebooted"))),
    # a PX4 that sends impossible numbers also counts as silent; the numbers distinguish the two
    # cases
    _row(
        _C.AUTOPILOT_SILENT,
        Cause(
            _fact("is_px4_silent"), checks=LIVE_CHECKS, given=lambda facts: not facts.px4_nonsense
        ),
    ),
    _row(
        _C.AUTOPILOT_IMPOSSIBLE,
        Cause(
            _fact("is_px4_silent"),
            checks=LIVE_CHECKS,
            given=_fact("px4_nonsense"),
            detail=lambda facts: facts.px4_nonsense.removesuffix("."),
        ),
    ),
    _row(_C.AUTOPILOT_FROZEN, Cause(_fact("is_px4_frozen"), checks=LIVE_CHECKS)),
    _row(_C.AUTOPILOT_BACK, Cause(_fact("is_px4_back"))),
    _row(_C.HEARTBEAT_LOST, Cause(_fact("is_heartbeat_late"), checks=LIVE_CHECKS)),
    _row(_C.REPORTS_CONTRADICT, Cause(_fact("has_contradiction"), detail=_fact("contradicted"))),
    _row(
        _C.REPORTS_CONTRADICT_LONG,
        Cause(_fact("contradicted_s"), above=CONTRADICTED_LONG_S, detail=_fact("contradicted")),
    ),
    _row(
        _C.LANDED_UNKNOWN,
        Cause(_fact("has_landed_report"), equals=False, checks=LIVE_CHECKS),
    ),
    _row(_C.LANDED_WRONG, Cause(_is_reported_down_in_the_air, over_s=LANDED_WRONG_S)),
    _row(_C.ATTITUDE_NOT_FOLLOWED, Cause(_fact("is_attitude_lost"))),
    _row(_C.THRUST_SATURATED, Cause(_fact("is_thrust_saturated"))),
    _row(_C.NOT_CLIMBING, Cause(_fact("is_sinking"))),
    _row(_C.FALLEN, Cause(_is_down, over_s=DOWN_LONG_S)),
    # -- own process
    _row(_C.LOOP_LATE, Cause(_fact("period_s"), above=TICK_S + LATE_S), is_quiet=True),
    _row(_C.LOOP_STALLED, Cause(_fact("period_s"), above=STALLED_S)),
    _row(_C.LOOP_STALLED_LONG, Cause(_fact("period_s"), above=STALLED_LONG_S)),
    _row(_C.CLOCK_JUMPED, Cause(_has_clock_jumped, is_slow=True)),
    _row(_C.NOT_FINITE, Cause(_is_last_tick_finite, equals=False), is_quiet=True),
    _row(_C.NOT_FINITE_LONG, Cause(_is_last_tick_finite, equals=False, over_s=NOT_FINITE_LONG_S)),
    _row(_C.OWN_LAW_REFUSED, Cause(_fact("law_refusal"), detail=_fact("law_refusal"))),
    _row(_C.DISK_FULL, Cause(_fact("is_disk_full"))),
    _row(_C.TWIN, Cause(_fact("has_duplicate"))),
    _row(_C.SHUTDOWN, Cause(_fact("is_stopping")), is_quiet=True),
    # -- bus and ground
    _row(_C.BUS_LOST, Cause(_bus_age_s, above=BUS_LOST_S, checks=LIVE_CHECKS)),
    _row(
        _C.BUS_LOST_LONG,
        Cause(_bus_age_s, above=BUS_LOST_S, checks=LIVE_CHECKS, over_s="bus_lost_land_s"),
    ),
    _row(_C.GROUND_LOST, Cause(_has_ground, equals=False, checks=LIVE_CHECKS)),
    _row(
        _C.GROUND_LOST_LONG,
        Cause(_has_ground, equals=False, checks=LIVE_CHECKS, over_s="ground_lost_land_s"),
    ),
    _row(
        _C.ORDER_OVERDUE,
        Cause(_fact("is_overdue"), detail=_fact("overdue_reason")),
    ),
    # -- other vehicles
    _row(
        _C.COLLISION_SUSPECTED,
        Cause(_has_touched, detail=_fact("touched")),
    ),
    _row(_C.SEPARATION_BREACHED, Cause(_is_too_near, detail=_person_too_near)),
    _row(
        _C.SEPARATION_PREDICTED,
        Cause(
            _fact("slow.endangered"),
            checks=PREDICTED_CHECKS,
            is_slow=True,
            detail=_names("slow.endangered"),
        ),
    ),
    _row(
        _C.LAW_INFEASIBLE,
        Cause(_is_law_infeasible, over_s=INFEASIBLE_S),
    ),
    _row(
        _C.NEIGHBOUR_UNSEEN,
        Cause(_fact("unseen"), checks=NEIGHBOUR_CHECKS, detail=_names("unseen")),
        names_vehicles=True,
    ),
    _row(
        _C.NEIGHBOUR_SILENT,
        Cause(_fact("silent"), checks=NEIGHBOUR_CHECKS, detail=_names("silent")),
        names_vehicles=True,
    ),
    _row(
        _C.NEIGHBOUR_INVALID,
        Cause(_fact("slow.without_position"), is_slow=True, detail=_names("slow.without_position")),
        names_vehicles=True,
    ),
    _row(
        _C.NEIGHBOUR_BLIND,
        Cause(
            _fact("slow.blind"),
            over_s=NEIGHBOUR_BLIND_OVER_S,
            is_slow=True,
            detail=_names("slow.blind"),
        ),
        names_vehicles=True,
    ),
    _row(
        _C.NEIGHBOUR_UNCOOPERATIVE,
        Cause(_fact("slow.uncooperative"), is_slow=True, detail=_names("slow.uncooperative")),
        names_vehicles=True,
    ),
    _row(
        _C.NEIGHBOUR_IMPLAUSIBLE,
        Cause(_fact("slow.implausible"), is_slow=True, detail=_names("slow.implausible")),
        names_vehicles=True,
    ),
    _row(
        _C.NEIGHBOUR_STALE,
        Cause(_fact("slow.late"), checks=STALE_CHECKS, is_slow=True, detail=_names("slow.late")),
    ),
    _row(
        _C.NEIGHBOUR_BACK,
        Cause(_fact("heard_again"), detail=_names("heard_again")),
        names_vehicles=True,
    ),
    _row(
        _C.CONFIG_DIFFERS,
        Cause(_fact("slow.other_files"), is_slow=True, detail=_names("slow.other_files")),
        names_vehicles=True,
    ),
    # -- energy and space
    _row(
        _C.BATTERY_WARNING,
        Cause(lambda facts: _battery_pct(facts) < facts.limits.battery_warning_pct, is_slow=True),
    ),
    _row(
        _C.BATTERY_LOW,
        Cause(lambda facts: _battery_pct(facts) < facts.limits.battery_land_pct, is_slow=True),
    ),
    _row(_C.BATTERY_FALLING, Cause(_fact("slow.is_battery_falling"), is_slow=True)),
    _row(
        _C.BATTERY_UNKNOWN,
        Cause(
            lambda facts: math.isnan(facts.slow.battery_frac),
            over_s=BATTERY_UNKNOWN_S,
            is_slow=True,
        ),
    ),
    _row(_C.FENCE_NEAR, Cause(_fact("is_fence_near"))),
    _row(_C.FENCE_BREACH, Cause(_fact("is_outside"))),
    _row(_C.FENCE_BREACH_LONG, Cause(_is_beyond_the_fence, over_s=FENCE_LONG_S)),
    _row(_C.CEILING, Cause(_fact("is_above_ceiling"))),
    # -- air
    _row(
        _C.WIND_ABOVE,
        Cause(_fact("slow.wind.is_above"), over_s=WIND_S, is_slow=True, detail=_wind),
        Cause(_is_wind_above_for_a_neighbour, is_slow=True, detail=_wind_of_neighbours),
    ),
    _row(
        _C.PUSHED_ABOUT,
        Cause(
            _fact("slow.wind.is_pushed_about"),
            over_s=PUSHED_ABOUT_S,
            is_slow=True,
            detail=lambda facts: facts.slow.wind.gust_words,
        ),
    ),
    _row(
        _C.WIND_NEAR,
        Cause(_fact("slow.wind.is_near"), over_s=WIND_S, is_slow=True, detail=_wind),
    ),
    _row(
        _C.DISTURBANCE_BOUND,
        Cause(_fact("slow.wind.is_at_bound"), over_s=DISTURBANCE_BOUND_S, is_slow=True),
    ),
)
