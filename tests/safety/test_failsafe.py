"""The failsafe table, all of it."""

from __future__ import annotations

import itertools

import pytest

from onboard.safety.failsafe import TABLE, Action, Condition, Situation, decide, table_text

AIRBORNE = (Situation.FLYING, Situation.LANDING)


@pytest.mark.parametrize(("situation", "condition"), list(itertools.product(Situation, Condition)))
def test_every_pair_has_a_decided_action(situation: Situation, condition: Condition) -> None:
    action, speaker = decide(situation, {condition})
    assert action is TABLE[situation, condition]
    assert speaker is condition


def test_the_table_has_no_other_pairs() -> None:
    assert set(TABLE) == set(itertools.product(Situation, Condition))


def test_nothing_disarms_what_may_be_in_the_air() -> None:
    in_air = (*AIRBORNE, Situation.PX4_LANDING, Situation.SILENT)
    assert all(TABLE[situation, condition] is not Action.DISARM for situation in in_air for condition in Condition)


def test_who_gave_up_stays_silent_and_who_is_on_the_ground_needs_nothing_but_a_refusal() -> None:
    assert {TABLE[Situation.SILENT, condition] for condition in Condition} == {Action.GO_ON}
    assert {TABLE[Situation.GROUND, condition] for condition in Condition} <= {Action.GO_ON, Action.REFUSE}


def test_what_lasts_is_answered_at_least_as_strongly_as_what_has_just_begun() -> None:
    pairs = [
        (Condition.POSITION_STALE, Condition.POSITION_LOST),
        (Condition.BUS_LOST, Condition.BUS_LOST_LONG),
        (Condition.FENCE_BREACH, Condition.FENCE_BREACH_LONG),
        (Condition.NOT_FINITE, Condition.NOT_FINITE_LONG),
        (Condition.LOOP_STALLED, Condition.LOOP_STALLED_LONG),
        (Condition.BATTERY_WARNING, Condition.BATTERY_LOW),
    ]
    for (short, long), situation in itertools.product(pairs, Situation):
        assert TABLE[situation, long] >= TABLE[situation, short]


@pytest.mark.parametrize(("situation", "first"), list(itertools.product(Situation, Condition)))
def test_of_two_conditions_the_stronger_action_wins(situation: Situation, first: Condition) -> None:
    for second in Condition:
        action, _ = decide(situation, {first, second})
        assert action is max(TABLE[situation, first], TABLE[situation, second])


def test_without_conditions_it_goes_on() -> None:
    assert decide(Situation.FLYING, ()) == (Action.GO_ON, None)


def test_a_landing_is_never_broken_off_into_a_hold() -> None:
    assert all(TABLE[Situation.LANDING, condition] is not Action.HOLD for condition in Condition)


def test_the_printed_table_has_a_row_for_every_condition() -> None:
    text = table_text()
    assert all(condition.value in text for condition in Condition)
    assert text.count("\n") == len(Condition) + 1
