"""The condition table has a row for each condition, and a condition begins at the tick that its row
says.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import pytest
from msgspec.structs import replace

from onboard.safety.condition_timer import ConditionTimer
from onboard.safety.failsafe_table import Condition
from onboard.supervision.condition_monitor import ANY_TIME_S, ConditionMonitor, time_limit_s
from onboard.supervision.condition_table import ROWS, Cause, ConditionRow
from onboard.supervision.tick_facts import CorrectionsFacts, ModeLoss, SlowFacts, TickFacts
from onboard.supervision.wind_monitor import WindFacts
from tests.onboard.supervision.limits import LIMITS

TICK_NS = 20_000_000
FINE = TickFacts(now_ns=0, limits=LIMITS, is_slow_tick=True)


def _corrected(**facts: Any) -> TickFacts:
    """Facts of a vehicle that uses corrections."""
    return replace(FINE, slow=SlowFacts(corrections=CorrectionsFacts(**facts)))


def ticks_with(
    cause: Cause, seen: Iterable[bool], *, every_ns: int = TICK_NS, slow_every: int = 1
) -> list[bool]:
    """Return at which ticks a condition with this cause holds; ``seen`` is its predicate's word."""
    row = ConditionRow(Condition.BUS_LOST, (cause,))
    monitor = ConditionMonitor(LIMITS, [row])
    holds = []
    for tick, is_seen in enumerate(seen):
        facts = replace(
            FINE,
            now_ns=tick * every_ns,
            is_disk_full=is_seen,
            is_slow_tick=tick % slow_every == 0,
        )
        holds.append(bool(monitor.update(facts)))
    return holds


def full(facts: TickFacts) -> bool:
    return facts.is_disk_full


# -- the table -------------------------------------------------------------------------------------


def test_among_others_dead_reckoning_goes_on_for_twelve_seconds_before_px4_lands() -> None:
    for nearest_m, age_s, is_long in ((9.0, 7.0, True), (2.0, 7.0, False), (2.0, 13.0, True)):
        facts = replace(FINE, position_age_s=age_s, nearest_m=nearest_m)
        monitor = ConditionMonitor(LIMITS)
        for tick in range(10):
            held = monitor.update(replace(facts, now_ns=tick * TICK_NS))
        assert (Condition.POSITION_LOST_LONG in held) is is_long


def test_every_condition_has_exactly_one_row() -> None:
    assert Counter(row.condition for row in ROWS) == Counter(Condition)


def test_nothing_holds_for_a_vehicle_without_complaints() -> None:
    monitor = ConditionMonitor(LIMITS)
    for tick in range(200):
        assert monitor.update(replace(FINE, now_ns=tick * TICK_NS)) == {}


# facts that are wrong, for the condition or the conditions that they are a sign of
WRONG: dict[Condition, TickFacts] = {
    Condition.POSITION_STALE: replace(FINE, position_age_s=0.3),
    Condition.POSITION_LOST: replace(FINE, position_age_s=0.65),
    Condition.POSITION_LOST_LONG: replace(FINE, position_age_s=7.0),
    Condition.POSITION_JUMPED: replace(FINE, jumps=3),
    Condition.MOCAP_SWAPPED: replace(FINE, jumps=2, jumped_onto="mav1"),
    Condition.MOCAP_FROZEN: replace(FINE, is_mocap_frozen=True),
    Condition.MOCAP_LATE: replace(FINE, is_mocap_late=True),
    Condition.SATELLITES_LOST: replace(FINE, slow=SlowFacts(has_lost_satellites=True)),
    Condition.POSITION_UNFIT: replace(FINE, slow=SlowFacts(position_miss_m=0.2)),
    Condition.POSITION_INACCURATE: replace(
        FINE, mocap_required=False, slow=SlowFacts(px4_accuracy_m=1.0)
    ),
    Condition.FIX_COARSE: _corrected(fix_below="3D", is_position_coarse=True),
    Condition.FIX_FELL_BACK: _corrected(fix_below="RTK float"),
    Condition.BASE_FAULT: _corrected(base_fault="has moved in flight"),
    Condition.CORRECTIONS_OLD: _corrected(old_s=12.0),
    Condition.FLOWN_BY_HAND: replace(FINE, mode_loss=ModeLoss.BY_HAND, px4_mode="POSCTL"),
    Condition.LEFT_OFFBOARD: replace(FINE, mode_loss=ModeLoss.LEFT, px4_mode="POSCTL"),
    Condition.PX4_FAILSAFE: replace(FINE, mode_loss=ModeLoss.FAILSAFE),
    Condition.DISARMED: replace(FINE, mode_loss=ModeLoss.DISARMED),
    Condition.REBOOTED: replace(FINE, is_px4_rebooted=True),
    Condition.AUTOPILOT_SILENT: replace(FINE, is_px4_silent=True),
    Condition.AUTOPILOT_IMPOSSIBLE: replace(FINE, is_px4_silent=True, px4_nonsense="It lies."),
    Condition.AUTOPILOT_FROZEN: replace(FINE, is_px4_frozen=True),
    Condition.AUTOPILOT_BACK: replace(FINE, is_px4_back=True),
    Condition.HEARTBEAT_LOST: replace(FINE, is_heartbeat_late=True),
    Condition.REPORTS_CONTRADICT: replace(FINE, has_contradiction=True, contradicted="battery"),
    Condition.REPORTS_CONTRADICT_LONG: replace(FINE, contradicted_s=2.1, contradicted="battery"),
    Condition.LANDED_UNKNOWN: replace(FINE, has_landed_report=False),
    Condition.LANDED_WRONG: replace(
        FINE, is_flying=True, height_m=1.0, height_above_lowest_ground_m=1.0, is_on_ground=True
    ),
    Condition.ATTITUDE_NOT_FOLLOWED: replace(FINE, is_attitude_lost=True),
    Condition.THRUST_SATURATED: replace(FINE, is_thrust_saturated=True),
    Condition.NOT_CLIMBING: replace(FINE, is_sinking=True),
    Condition.FALLEN: replace(FINE, is_flying=True, height_above_lowest_ground_m=0.1),
    Condition.LOOP_LATE: replace(FINE, period_s=0.03),
    Condition.LOOP_STALLED: replace(FINE, period_s=0.25),
    Condition.LOOP_STALLED_LONG: replace(FINE, period_s=0.35),
    Condition.CLOCK_JUMPED: replace(FINE, slow=SlowFacts(clock_jump_ns=1)),
    Condition.NOT_FINITE: replace(FINE, is_last_tick_finite=False),
    Condition.NOT_FINITE_LONG: replace(FINE, is_last_tick_finite=False),
    Condition.OWN_LAW_REFUSED: replace(FINE, law_refusal="mine is slow"),
    Condition.DISK_FULL: replace(FINE, is_disk_full=True),
    Condition.TWIN: replace(FINE, has_duplicate=True),
    Condition.SHUTDOWN: replace(FINE, is_stopping=True),
    Condition.BUS_LOST: replace(FINE, bus_age_s=1.1),
    Condition.BUS_LOST_LONG: replace(FINE, bus_age_s=1.1),
    Condition.GROUND_LOST: replace(FINE, has_ground=False),
    Condition.GROUND_LOST_LONG: replace(FINE, has_ground=False),
    Condition.ORDER_OVERDUE: replace(FINE, is_overdue=True),
    Condition.COLLISION_SUSPECTED: replace(FINE, is_airborne=True, nearest_m=0.1, touched="mav1"),
    Condition.SEPARATION_BREACHED: replace(FINE, is_airborne=True, nearest_m=0.1),
    Condition.SEPARATION_PREDICTED: replace(FINE, slow=SlowFacts(endangered=("mav1",))),
    Condition.LAW_INFEASIBLE: replace(FINE, is_under_law=True, is_law_infeasible=True),
    Condition.NEIGHBOUR_UNSEEN: replace(FINE, silent=("mav1",), unseen=("mav1",)),
    Condition.NEIGHBOUR_SILENT: replace(FINE, silent=("mav1",)),
    Condition.NEIGHBOUR_INVALID: replace(FINE, slow=SlowFacts(without_position=("mav1",))),
    Condition.NEIGHBOUR_BLIND: replace(FINE, slow=SlowFacts(blind=("mav1",))),
    Condition.NEIGHBOUR_UNCOOPERATIVE: replace(FINE, slow=SlowFacts(uncooperative=("mav1",))),
    Condition.NEIGHBOUR_IMPLAUSIBLE: replace(FINE, slow=SlowFacts(implausible=("mav1 jumps",))),
    Condition.NEIGHBOUR_STALE: replace(FINE, slow=SlowFacts(late=("mav1",))),
    Condition.NEIGHBOUR_BACK: replace(FINE, heard_again=("mav1",)),
    Condition.CONFIG_DIFFERS: replace(FINE, slow=SlowFacts(other_files=("mav1",))),
    Condition.BATTERY_WARNING: replace(FINE, slow=SlowFacts(battery_frac=0.1)),
    Condition.BATTERY_LOW: replace(FINE, slow=SlowFacts(battery_frac=0.1)),
    Condition.BATTERY_FALLING: replace(FINE, slow=SlowFacts(is_battery_falling=True)),
    Condition.BATTERY_UNKNOWN: replace(FINE, slow=SlowFacts(battery_frac=float("nan"))),
    Condition.FENCE_NEAR: replace(FINE, is_fence_near=True),
    Condition.FENCE_BREACH: replace(FINE, is_outside=True),
    Condition.FENCE_BREACH_LONG: replace(FINE, is_outside=True),
    Condition.CEILING: replace(FINE, is_above_ceiling=True),
    Condition.WIND_ABOVE: replace(FINE, slow=SlowFacts(wind=WindFacts(is_above=True))),
    Condition.PUSHED_ABOUT: replace(FINE, slow=SlowFacts(wind=WindFacts(is_pushed_about=True))),
    Condition.WIND_NEAR: replace(FINE, slow=SlowFacts(wind=WindFacts(is_near=True))),
    Condition.DISTURBANCE_BOUND: replace(FINE, slow=SlowFacts(wind=WindFacts(is_at_bound=True))),
}


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.condition.name)
def test_a_condition_begins_when_its_row_says_and_ends_with_its_facts(row: ConditionRow) -> None:
    wrong = WRONG[row.condition]
    # LOST_LONG has a second cause, for vehicles without a mocap
    checks = row.causes[0].checks
    over_s = time_limit_s(row.causes[0], LIMITS)

    monitor = ConditionMonitor(LIMITS)
    for tick in itertools.count(1):
        is_expected = tick >= checks and (tick - 1) * TICK_NS * 1e-9 > over_s
        holds = monitor.update(replace(wrong, now_ns=tick * TICK_NS))
        assert (row.condition in holds) is is_expected, tick
        if is_expected:
            break

    ended_ns = tick * TICK_NS + 6 * 10**9  # behind the time for which a jump of a clock is said
    assert monitor.update(replace(FINE, now_ns=ended_ns)) == {}


def test_a_vehicle_without_a_mocap_has_lost_its_position_for_long_when_px4_is_off_by_metres() -> (
    None
):
    monitor = ConditionMonitor(LIMITS)
    wrong = replace(FINE, mocap_required=False, slow=SlowFacts(px4_accuracy_m=3.1))
    held = [monitor.update(replace(wrong, now_ns=tick * TICK_NS)) for tick in range(40)]
    assert Condition.POSITION_LOST_LONG not in held[25]  # after 0.5 s
    assert held[26][Condition.POSITION_LOST_LONG] == "PX4 says 3.1 m"


def test_in_a_strong_wind_a_vehicle_lands_with_a_neighbour_for_which_it_is_too_much() -> None:
    strong = WindFacts(speed_m_s=6.2, limit_m_s=8.1, is_strong=True)
    held = ConditionMonitor(LIMITS).update(
        replace(FINE, slow=SlowFacts(wind=strong, too_windy_for=("mav1",)))
    )
    words = "6.2 m/s, its limit is 8.1 m/s; too much for mav1"
    assert held == {Condition.WIND_ABOVE: words}

    # a neighbour of a type that bears less wind lands alone
    light = dataclasses.replace(strong, speed_m_s=4.0, is_strong=False)
    alone = replace(FINE, slow=SlowFacts(wind=light, too_windy_for=("mav1",)))
    assert ConditionMonitor(LIMITS).update(alone) == {}
    nobody = replace(FINE, slow=SlowFacts(wind=strong))
    assert ConditionMonitor(LIMITS).update(nobody) == {}


def test_a_silent_px4_whose_numbers_are_impossible_is_not_called_silent_as_well() -> None:
    monitor = ConditionMonitor(LIMITS)
    for tick in range(4):
        monitor.update(replace(FINE, now_ns=tick * TICK_NS, is_px4_silent=True))
    # the silence has lasted, whatever is sent while it does
    says = replace(FINE, now_ns=4 * TICK_NS, is_px4_silent=True, px4_nonsense="It lies.")
    assert monitor.update(says) == {Condition.AUTOPILOT_IMPOSSIBLE: "It lies"}
    says_nothing = replace(FINE, now_ns=5 * TICK_NS, is_px4_silent=True)
    assert set(monitor.update(says_nothing)) == {Condition.AUTOPILOT_SILENT}


class Limits(NamedTuple):
    """What a cause waits for, beside its fact."""

    above: float | None = None
    checks: int = 1
    over_s: float | str | None = None


# Limits and times of all causes that have any, by condition and place in the row. They were
# measured, and a changed one changes what vehicles do: whoever changes one writes it here as well.
LIMITS_OF_CAUSES = {
    (Condition.POSITION_STALE, 0): Limits(above=0.2),
    (Condition.POSITION_LOST, 0): Limits(checks=5),
    (Condition.POSITION_LOST_LONG, 0): Limits(checks=5),
    (Condition.POSITION_LOST_LONG, 1): Limits(over_s=0.5),
    (Condition.POSITION_INACCURATE, 0): Limits(over_s=0.5),
    (Condition.POSITION_UNFIT, 0): Limits(above=0.18, over_s=0.3),
    (Condition.FIX_COARSE, 0): Limits(over_s=0.5),
    (Condition.FIX_FELL_BACK, 0): Limits(over_s=0.5),
    (Condition.AUTOPILOT_SILENT, 0): Limits(checks=5),
    (Condition.AUTOPILOT_IMPOSSIBLE, 0): Limits(checks=5),
    (Condition.AUTOPILOT_FROZEN, 0): Limits(checks=5),
    (Condition.HEARTBEAT_LOST, 0): Limits(checks=5),
    (Condition.REPORTS_CONTRADICT_LONG, 0): Limits(above=2),
    (Condition.LANDED_UNKNOWN, 0): Limits(checks=5),
    (Condition.LANDED_WRONG, 0): Limits(over_s=0.5),
    (Condition.FALLEN, 0): Limits(over_s=1.0),
    (Condition.LOOP_LATE, 0): Limits(above=0.025),
    (Condition.LOOP_STALLED, 0): Limits(above=0.2),
    (Condition.LOOP_STALLED_LONG, 0): Limits(above=0.3),
    (Condition.NOT_FINITE_LONG, 0): Limits(over_s=0.5),
    (Condition.BUS_LOST, 0): Limits(above=1, checks=5),
    (Condition.BUS_LOST_LONG, 0): Limits(above=1, checks=5, over_s="bus_lost_land_s"),
    (Condition.GROUND_LOST, 0): Limits(checks=5),
    (Condition.GROUND_LOST_LONG, 0): Limits(checks=5, over_s="ground_lost_land_s"),
    (Condition.SEPARATION_PREDICTED, 0): Limits(checks=2),
    (Condition.LAW_INFEASIBLE, 0): Limits(over_s=0.1),
    (Condition.NEIGHBOUR_UNSEEN, 0): Limits(checks=2),
    (Condition.NEIGHBOUR_SILENT, 0): Limits(checks=2),
    (Condition.NEIGHBOUR_STALE, 0): Limits(checks=5),
    (Condition.NEIGHBOUR_BLIND, 0): Limits(over_s=0.15),
    (Condition.BATTERY_UNKNOWN, 0): Limits(over_s=5.0),
    (Condition.FENCE_BREACH_LONG, 0): Limits(over_s=2.0),
    (Condition.WIND_ABOVE, 0): Limits(over_s=0.5),
    (Condition.PUSHED_ABOUT, 0): Limits(over_s=0.5),
    (Condition.WIND_NEAR, 0): Limits(over_s=0.5),
    (Condition.DISTURBANCE_BOUND, 0): Limits(over_s=0.5),
}


def test_limits_and_times_are_those_that_were_measured() -> None:
    found = {}
    for row in ROWS:
        for place, cause in enumerate(row.causes):
            limits = Limits(above=cause.above, checks=cause.checks, over_s=cause.over_s)
            if limits != Limits():
                found[row.condition, place] = limits
    assert found == LIMITS_OF_CAUSES


def holds_from_the_first(condition: Condition, facts: TickFacts) -> bool:
    """Whether a condition is seen in these facts, however long they have to last."""
    (row,) = (row for row in ROWS if row.condition is condition)
    causes = tuple(dataclasses.replace(cause, checks=1, over_s=None) for cause in row.causes)
    monitor = ConditionMonitor(LIMITS, [ConditionRow(condition, causes)])
    return condition in monitor.update(facts)


JUST_NOT = [
    (Condition.POSITION_STALE, {"position_age_s": 0.2}, {"position_age_s": 0.201}),
    (Condition.POSITION_LOST, {"position_age_s": 0.6}, {"position_age_s": 0.601}),
    (Condition.POSITION_LOST, {"position_stale_s": 0.4}, {"position_stale_s": 0.401}),
    (
        Condition.POSITION_LOST,
        {"position_age_s": 0.3, "position_flicker_s": 0.6},
        {"position_age_s": 0.3, "position_flicker_s": 0.601},
    ),
    (
        Condition.POSITION_LOST,
        {"position_age_s": 0.2, "position_flicker_s": 0.9},
        {"position_age_s": 0.201, "position_flicker_s": 0.9},
    ),
    (Condition.POSITION_JUMPED, {"jumps": 2}, {"jumps": 3}),
    (
        Condition.LANDED_WRONG,
        {"is_flying": True, "is_on_ground": True, "height_m": 0.5},
        {"is_flying": True, "is_on_ground": True, "height_m": 0.51},
    ),
    (
        Condition.FALLEN,
        {"is_flying": True, "height_above_lowest_ground_m": 0.12},
        {"is_flying": True, "height_above_lowest_ground_m": 0.119},
    ),
    (
        Condition.FALLEN,
        {"is_flying": True, "height_above_lowest_ground_m": 0.05, "has_risen": True},
        {"is_flying": True, "height_above_lowest_ground_m": 0.05},
    ),
    (
        Condition.FALLEN,
        {"is_flying": True, "mocap_required": False, "is_standing": True, "height_m": 2.0},
        {"is_flying": True, "mocap_required": False, "is_standing": True, "height_m": 1.99},
    ),
    (
        Condition.FALLEN,
        {"is_flying": True, "mocap_required": False, "is_stuck": True, "height_m": 2.0},
        {"is_flying": True, "mocap_required": False, "is_stuck": True, "height_m": 1.99},
    ),
    (Condition.LOOP_LATE, {"period_s": 0.025}, {"period_s": 0.0251}),
    (Condition.LOOP_STALLED, {"period_s": 0.2}, {"period_s": 0.201}),
    (
        Condition.CLOCK_JUMPED,
        {"now_ns": 5_000_000_001, "slow": SlowFacts(clock_jump_ns=1)},
        {"now_ns": 5_000_000_000, "slow": SlowFacts(clock_jump_ns=1)},
    ),
    (
        Condition.POSITION_LOST_LONG,
        {"mocap_required": False, "slow": SlowFacts(px4_accuracy_m=3.0)},
        {"mocap_required": False, "slow": SlowFacts(px4_accuracy_m=3.01)},
    ),
    (
        Condition.SEPARATION_BREACHED,
        {"is_airborne": True, "nearest_m": LIMITS.safety_distance_m},
        {"is_airborne": True, "nearest_m": LIMITS.safety_distance_m - 0.001},
    ),
    # while it takes off, only people count
    (
        Condition.SEPARATION_BREACHED,
        {"is_taking_off": True, "is_airborne": True, "nearest_m": 0.1},
        {"is_taking_off": True, "nearest_m": 0.1, "nearest_person_m": 0.1},
    ),
    (
        Condition.SEPARATION_BREACHED,
        {"is_taking_off": False, "nearest_person_m": 0.1},
        {"is_taking_off": True, "nearest_person_m": 0.1},
    ),
    # PX4 reports whole percents
    (
        Condition.BATTERY_WARNING,
        {"slow": SlowFacts(battery_frac=0.01 * LIMITS.battery_warning_pct)},
        {"slow": SlowFacts(battery_frac=0.01 * LIMITS.battery_warning_pct - 0.01)},
    ),
    (
        Condition.BATTERY_LOW,
        {"slow": SlowFacts(battery_frac=0.01 * LIMITS.battery_land_pct)},
        {"slow": SlowFacts(battery_frac=0.01 * LIMITS.battery_land_pct - 0.01)},
    ),
    # both of two facts are needed
    (
        Condition.COLLISION_SUSPECTED,
        {"is_airborne": True, "nearest_m": 2.0, "touched": "mav1"},
        {"is_airborne": True, "nearest_m": 0.1, "touched": "mav1"},
    ),
    (
        Condition.COLLISION_SUSPECTED,
        {"is_airborne": True, "nearest_m": 0.1},
        {"is_airborne": True, "nearest_m": 0.1, "touched": "mav1"},
    ),
    (
        Condition.LAW_INFEASIBLE,
        {"is_law_infeasible": True},
        {"is_law_infeasible": True, "is_under_law": True},
    ),
    (
        Condition.LAW_INFEASIBLE,
        {"is_under_law": True},
        {"is_law_infeasible": True, "is_under_law": True},
    ),
]


@pytest.mark.parametrize(("condition", "at_limit", "beyond"), JUST_NOT)
def test_a_condition_begins_beyond_its_limit_and_not_at_it(
    condition: Condition, at_limit: dict[str, Any], beyond: dict[str, Any]
) -> None:
    assert not holds_from_the_first(condition, replace(FINE, **at_limit))
    assert holds_from_the_first(condition, replace(FINE, **beyond))


# -- how long a cause has to hold ------------------------------------------------------------------


def test_a_late_position_counts_at_once_and_is_called_so() -> None:
    late = replace(FINE, is_slow_tick=True, slow=SlowFacts(is_position_late=True))
    assert ConditionMonitor(LIMITS).update(late) == {
        Condition.POSITION_UNFIT: "it seems to be late"
    }


def test_an_order_that_is_overdue_says_what_it_waits_for() -> None:
    for said in ("", "kept off by mav1"):
        held = ConditionMonitor(LIMITS).update(replace(FINE, is_overdue=True, overdue_reason=said))
        assert held == {Condition.ORDER_OVERDUE: said}


def test_a_cause_counts_only_after_its_checks_in_a_row() -> None:
    cause = Cause(full, checks=3)
    assert ticks_with(cause, [True] * 4) == [False, False, True, True]
    assert ticks_with(cause, [True, True, False, True, True, True]) == [False] * 5 + [True]
    assert ticks_with(Cause(full), [False, True, False]) == [False, True, False]


def test_a_cause_counts_only_when_it_has_held_for_longer_than_its_time() -> None:
    cause = Cause(full, over_s=0.5)
    quarters = 250_000_000
    assert ticks_with(cause, [True] * 4, every_ns=quarters) == [False, False, False, True]
    # a check that has not seen it begins the time anew
    seen = [True] * 3 + [False] + [True] * 4
    assert ticks_with(cause, seen, every_ns=quarters) == [False] * 7 + [True]


def test_checks_and_time_must_both_have_passed() -> None:
    cause = Cause(full, checks=5, over_s=0.02)
    assert ticks_with(cause, [True] * 6) == [False] * 4 + [True] * 2
    # a process that was not scheduled: much time, and few checks
    assert ticks_with(cause, [True] * 5, every_ns=10**9) == [False] * 4 + [True]


def test_a_slow_cause_counts_slow_ticks_and_holds_until_the_next_one() -> None:
    cause = Cause(full, checks=2, is_slow=True)
    holds = ticks_with(cause, [True] * 8 + [False] * 4, slow_every=5)
    assert holds == [False] * 5 + [True] * 5 + [False] * 2


def test_what_is_given_is_asked_for_only_when_the_cause_has_held_long_enough() -> None:
    cause = Cause(full, checks=2, given=lambda facts: facts.now_ns >= 3 * TICK_NS)
    assert ticks_with(cause, [True] * 5) == [False, False, False, True, True]


def test_the_name_of_a_key_is_a_time_of_the_fleet_file() -> None:
    assert time_limit_s(Cause(full, over_s="bus_lost_land_s"), LIMITS) == LIMITS.bus_lost_land_s
    assert time_limit_s(Cause(full), LIMITS) == ANY_TIME_S


def test_the_detail_is_that_of_the_last_cause_that_holds() -> None:
    predicate: Callable[[TickFacts], bool] = full
    row = ConditionRow(
        Condition.BUS_LOST,
        (Cause(predicate, detail="first"), Cause(predicate, checks=2, detail="second")),
    )
    monitor = ConditionMonitor(LIMITS, [row])
    facts = replace(FINE, is_disk_full=True)
    assert monitor.update(facts) == {Condition.BUS_LOST: "first"}
    assert monitor.update(facts) == {Condition.BUS_LOST: "second"}


def test_held_begins_at_its_first_check_and_ends_with_the_first_that_sees_nothing() -> None:
    held = ConditionTimer()
    assert held.seconds(5) == 0.0
    held.see(10**9)
    assert (held.checks, held.seconds(10**9)) == (1, 0.0)
    held.see(3 * 10**9)
    assert (held.checks, held.seconds(3 * 10**9)) == (2, 2.0)
    held.end()
    assert (held.checks, held.seconds(4 * 10**9)) == (0, 0.0)
    held.see(5 * 10**9)
    assert held.seconds(6 * 10**9) == 1.0
