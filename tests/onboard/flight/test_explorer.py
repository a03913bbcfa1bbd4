"""Every state of a flight has a way down; a row taken out of the flight table is noticed."""

from __future__ import annotations

import functools

import pytest

from onboard.flight import state_machine
from onboard.flight.flight_table import ROWS, TABLE, Row
from onboard.flight.types import FlightStep
from onboard.safety.failsafe_table import TABLE as FAILSAFE_TABLE
from onboard.safety.failsafe_table import Action, Condition, Situation
from tests.architecture.documents import written
from tests.onboard.flight.explorer import (
    Found,
    combined_actions,
    difference_without_condition,
    difference_without_row,
    explore,
)

# an exploration takes some 10 s of processor time
pytestmark = pytest.mark.timeout(900)

# The explored vehicle flies by a motion capture, and so it never feels for the ground.
BY_SATELLITES_ONLY = {"feels_for_ground"}

# Rows that do nothing in any situation: their conditions are told to people, and that is all.
ONLY_REPORTED = {
    Condition.LOOP_LATE,
    Condition.OWN_LAW_REFUSED,
    Condition.NEIGHBOUR_BACK,
    Condition.CORRECTIONS_OLD,
}


@functools.cache
def _found() -> Found:
    return explore()


def test_every_state_has_a_way_down_and_the_docs_tell_what_was_explored() -> None:
    assert _found().wrong == {}
    assert _found().steps == set(FlightStep)
    assert written("explored") == _found().in_words()


def test_conditions_that_hold_at_once_do_what_the_strongest_of_them_does() -> None:
    for situation, conditions, action in combined_actions():
        alone = [FAILSAFE_TABLE[situation, condition] for condition in conditions]
        assert action is max(alone), (situation, conditions)


@pytest.mark.long
@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{ROWS.index(row)} {row.event.value}")
def test_a_row_of_the_flight_table_that_is_taken_out_is_noticed(
    row: Row, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = _found()
    without = {place: _without(row, rows) for place, rows in TABLE.items()}
    monkeypatch.setattr(
        state_machine, "TABLE", {place: rows for place, rows in without.items() if rows}
    )

    difference = difference_without_row(row, whole)
    if row.when is not None and row.when.__name__ in BY_SATELLITES_ONLY:
        assert difference is None
    else:
        assert difference is not None


@pytest.mark.long
@pytest.mark.parametrize("condition", Condition, ids=lambda condition: condition.value)
def test_a_row_of_the_failsafe_table_that_is_taken_out_is_noticed(
    condition: Condition, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = _found()
    for situation in Situation:
        monkeypatch.setitem(FAILSAFE_TABLE, (situation, condition), Action.GO_ON)

    difference = difference_without_condition(condition, whole)
    if condition in ONLY_REPORTED:
        assert difference is None
    else:
        assert difference is not None


def _without(row: Row, rows: tuple[Row, ...]) -> tuple[Row, ...]:
    return tuple(other for other in rows if other is not row)
