"""The matrix asks about everything that can fail, and claims what the failsafe table does."""

from __future__ import annotations

from groundstation.evidence.hazards import CLAIMS, HAZARDS, claimed_action
from groundstation.evidence.kept_flights import NOTHING
from onboard.safety.failsafe_table import TABLE, Action, Condition, Situation
from sitl.lockstep.campaign.injections import FIELD_INJECTIONS, INJECTIONS


def test_every_row_of_the_failsafe_table_is_claimed_with_its_action_in_flight() -> None:
    in_table = {condition: TABLE[Situation.FLYING, condition] for condition in Condition}
    assert in_table == CLAIMS


def test_no_two_questions_claim_different_actions_for_one_condition() -> None:
    for hazard in HAZARDS:
        for condition, action in hazard.claims.items():
            assert CLAIMS[condition] is action, f"{hazard.key}: {condition.value}"


def test_everything_that_is_broken_answers_a_question_and_nothing_else_is_named() -> None:
    broken = {one.name for one in (*INJECTIONS, *FIELD_INJECTIONS)}
    named = {fault for hazard in HAZARDS for fault in hazard.faults}
    assert named - {NOTHING} == broken


def test_there_are_at_least_fifteen_questions_with_keys_of_their_own() -> None:
    keys = [hazard.key for hazard in HAZARDS]
    assert len(set(keys)) == len(keys) >= 15


def test_the_strongest_claim_counts() -> None:
    assert claimed_action([]) is Action.GO_ON
    assert claimed_action([Condition.MOCAP_LATE, Condition.BATTERY_LOW]) is Action.LAND
