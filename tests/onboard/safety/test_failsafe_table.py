"""The failsafe table, all of it."""

from __future__ import annotations

import itertools
from pathlib import Path

from onboard.safety.failsafe_table import (
    TABLE,
    Action,
    Condition,
    Situation,
    decide,
    latched,
    needs_level,
)
from tests.architecture import tables

AIRBORNE = (Situation.LIFTOFF, Situation.FLYING, Situation.LANDING)


def test_every_pair_has_a_decided_action_and_there_are_no_others() -> None:
    for situation, condition in itertools.product(Situation, Condition):
        assert decide(situation, {condition}) == (TABLE[situation, condition], condition), (
            situation,
            condition,
        )
    assert set(TABLE) == set(itertools.product(Situation, Condition))


def test_nothing_disarms_what_may_be_in_the_air() -> None:
    in_air = (*AIRBORNE, Situation.PX4_LANDING, Situation.SILENT)
    assert all(
        TABLE[situation, condition] is not Action.DISARM
        for situation in in_air
        for condition in Condition
    )


def test_a_vehicle_without_setpoints_stays_silent_and_one_on_the_ground_is_only_refused() -> None:
    assert {TABLE[Situation.SILENT, condition] for condition in Condition} == {Action.GO_ON}
    assert {TABLE[Situation.GROUND, condition] for condition in Condition} <= {
        Action.GO_ON,
        Action.REFUSE,
    }


def test_a_condition_that_lasts_has_at_least_as_strong_an_action_as_one_that_has_just_begun() -> (
    None
):
    pairs = [
        (Condition.POSITION_STALE, Condition.POSITION_LOST),
        (Condition.POSITION_LOST, Condition.POSITION_LOST_LONG),
        (Condition.BUS_LOST, Condition.BUS_LOST_LONG),
        (Condition.FENCE_BREACH, Condition.FENCE_BREACH_LONG),
        (Condition.NOT_FINITE, Condition.NOT_FINITE_LONG),
        (Condition.LOOP_STALLED, Condition.LOOP_STALLED_LONG),
        (Condition.BATTERY_WARNING, Condition.BATTERY_LOW),
        (Condition.POSITION_JUMPED, Condition.MOCAP_SWAPPED),
        (Condition.NEIGHBOUR_SILENT, Condition.NEIGHBOUR_UNSEEN),
        (Condition.SEPARATION_PREDICTED, Condition.SEPARATION_BREACHED),
        (Condition.SEPARATION_BREACHED, Condition.COLLISION_SUSPECTED),
        (Condition.THRUST_SATURATED, Condition.NOT_CLIMBING),
        (Condition.FENCE_NEAR, Condition.FENCE_BREACH),
    ]
    for (short, long), situation in itertools.product(pairs, Situation):
        assert TABLE[situation, long] >= TABLE[situation, short]


def test_the_actions_have_these_ranks() -> None:
    assert [action.name for action in sorted(Action)] == [
        "GO_ON",
        "REFUSE",
        "SLOW",
        "HOLD",
        "LEVEL",
        "LAND",
        "PX4_LAND",
        "DISARM",
        "STOP",
    ]


def test_of_two_conditions_with_one_action_the_first_in_the_list_is_named() -> None:
    for situation in Situation:
        for first, second in itertools.combinations(Condition, 2):
            if TABLE[situation, first] is TABLE[situation, second]:
                assert decide(situation, {second, first})[1] is first


def test_a_setpoint_is_level_where_one_condition_demands_it_among_others() -> None:
    for situation, condition in itertools.product(Situation, Condition):
        is_level = TABLE[situation, condition] is Action.LEVEL
        assert needs_level(situation, {condition}) is is_level
        level_too = needs_level(situation, {condition, Condition.NOT_FINITE})
        assert level_too is (is_level or needs_level(situation, {Condition.NOT_FINITE}))
    assert needs_level(Situation.FLYING, {Condition.NOT_FINITE})


def test_of_two_conditions_the_stronger_action_wins() -> None:
    for situation, first, second in itertools.product(Situation, Condition, Condition):
        action, _ = decide(situation, {first, second})
        assert action is max(TABLE[situation, first], TABLE[situation, second]), (
            situation,
            first,
            second,
        )


def test_on_every_path_to_the_ground_a_stronger_action_is_never_taken_back() -> None:
    for before, demanded in itertools.product(Action, repeat=2):
        assert latched(before, demanded) >= demanded
        if before not in (Action.REFUSE, Action.LEVEL):
            assert latched(before, demanded) >= before
    assert latched(Action.LEVEL, Action.GO_ON) is Action.HOLD
    assert latched(Action.REFUSE, Action.GO_ON) is Action.GO_ON


def test_level_flight_is_for_a_missing_number_only_and_never_hidden_by_a_landing() -> None:
    level = {condition for (_, condition), action in TABLE.items() if action is Action.LEVEL}
    assert level == {Condition.NOT_FINITE}
    both = {Condition.NOT_FINITE, Condition.BATTERY_LOW}
    assert decide(Situation.FLYING, both)[0] is Action.LAND
    assert needs_level(Situation.FLYING, both)


def test_setpoints_stop_in_flight_only_when_the_controls_are_gone() -> None:
    silent = {
        condition for condition in Condition if TABLE[Situation.FLYING, condition] is Action.STOP
    }
    assert silent == {
        Condition.FLOWN_BY_HAND,
        Condition.LEFT_OFFBOARD,
        Condition.PX4_FAILSAFE,
        Condition.DISARMED,
        Condition.REBOOTED,
        Condition.AUTOPILOT_SILENT,
        Condition.AUTOPILOT_IMPOSSIBLE,
        Condition.AUTOPILOT_FROZEN,
        Condition.FALLEN,
    }


def test_without_conditions_it_goes_on() -> None:
    assert decide(Situation.FLYING, ()) == (Action.GO_ON, None)


def test_a_landing_is_never_broken_off_into_a_hold() -> None:
    assert all(TABLE[Situation.LANDING, condition] is not Action.HOLD for condition in Condition)


def test_the_printed_table_has_a_row_for_every_condition() -> None:
    text = tables.failsafes()
    assert all(condition.value in text for condition in Condition)
    assert text.count("\n") == len(Condition) + 1


def test_the_document_says_how_each_condition_is_noticed() -> None:
    text = (Path(__file__).parents[3] / "docs" / "failsafe.md").read_text(encoding="utf-8")
    section = text.split("## How each condition is noticed")[1].split("## ")[0]
    rows = [
        line.split(" | ")[0].removeprefix("| ")
        for line in section.splitlines()
        if line.startswith("| ")
    ]
    assert rows[1:] == [condition.value for condition in Condition]
