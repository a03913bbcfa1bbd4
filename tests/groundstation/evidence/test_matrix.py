"""Rows of the matrix: evidence, something against it, or not shown."""

from __future__ import annotations

from groundstation.evidence.evidence_page import pair_words, result_words
from groundstation.evidence.kept_flights import digest
from groundstation.evidence.matrix import NOT_SHOWN, SHOWN, WRONG, conditions_never_seen, matrix
from onboard.safety.failsafe_table import TABLE, Action, Condition, Situation
from tests.groundstation.evidence.campaigns import flown

GROUND_LOST = "ground lost for good"


def row(key: str, *flights):
    return next(one for one in matrix(flights, {"ground station lost for long": ["a test"]})
                if one.key == key)  # fmt: skip


def test_a_row_with_flights_in_which_all_held_is_shown_with_its_exact_bound() -> None:
    flights = [flown(GROUND_LOST, number, seen={"ground station lost for long": 5})
               for number in range(3)]  # fmt: skip
    found = row("c2-lost", *flights, flown("motor dead"))
    assert found.status == SHOWN
    assert (found.flights, found.wrong_flights, found.seeds) == (3, 0, (0, 2000))
    assert found.upper_bound == round(1.0 - 0.05 ** (1.0 / 3.0), 4)
    assert found.digest == digest(flights)
    assert found.faults == {GROUND_LOST: 3}
    lost = next(one for one in found.rows if one.condition == "ground station lost for long")
    assert (lost.flights_noticed, lost.tests, lost.wrong) == (3, ("a test",), "")


def test_a_wrong_flight_makes_its_rows_red_and_says_how_to_find_it() -> None:
    bad = flown(GROUND_LOST, 2, wrong=("mav0 leaves the fence",))
    found = row("c2-lost", flown(GROUND_LOST), bad)
    assert found.status == WRONG
    assert found.reasons == (
        "ground lost for good, mav0 at 9.00 s, seed 2000: mav0 leaves the fence",
    )
    assert row("battery", flown(GROUND_LOST), bad).status == NOT_SHOWN


def test_a_question_about_others_is_not_shown_by_vehicles_that_were_alone_in_the_air() -> None:
    alone = [
        flown(fault, had_pair=False) for fault in ("nothing", "motor dead", "a pilot takes over")
    ]
    for key in ("distances", "one-among-others", "pilot-among-others"):
        found = row(key, *alone)
        assert (found.status, found.flights, found.faults) == (NOT_SHOWN, 0, {}), key
        assert pair_words(found) == " with two vehicles in the air"
    for key in ("normal", "propulsion", "pilot"):
        assert row(key, *alone).status == SHOWN, key

    beside_dead = flown("motor dead", 1, smallest_m=None, smallest_silenced_m=0.9)
    found = row("one-among-others", *alone, beside_dead)
    assert (found.status, found.flights) == (SHOWN, 1)
    assert result_words(found).startswith("evidence for, in part: 6 faults not flown with two")


def test_a_wrong_flight_of_a_vehicle_alone_is_named_and_is_in_no_share_of_such_flights() -> None:
    right = flown("one lies: stands")
    bad = flown("one lies: stands", 1, had_pair=False, wrong=("mav0 leaves the fence",))
    found = row("not-cooperating", right, bad)
    assert found.status == WRONG
    assert found.reasons[0].endswith("mav0 leaves the fence")
    assert (found.flights, found.wrong_flights, found.faults) == (1, 0, {"one lies: stands": 1})


def test_a_row_taken_out_of_the_failsafe_table_shows_red(monkeypatch) -> None:
    monkeypatch.delitem(TABLE, (Situation.FLYING, Condition.GROUND_LOST_LONG))
    found = row("c2-lost", flown(GROUND_LOST))
    assert found.status == WRONG
    assert "the failsafe table has no such row" in found.reasons[0]


def test_a_row_that_is_weakened_shows_red(monkeypatch) -> None:
    key = (Situation.FLYING, Condition.GROUND_LOST_LONG)
    monkeypatch.setitem(TABLE, key, Action.GO_ON)
    found = row("c2-lost", flown(GROUND_LOST))
    assert found.status == WRONG
    assert found.reasons == (
        "ground station lost for long: 'landing' is claimed, and the failsafe table says"
        " 'going on'",
    )


def test_the_digest_does_not_depend_on_the_order_and_does_on_every_figure() -> None:
    one = flown()
    other = flown(number=1)
    assert digest([one, other]) == digest([other, one])
    assert digest([one, other]) != digest([one, flown(number=1, highest_m=1.01)])


def test_conditions_that_no_flight_has_brought_about_are_named() -> None:
    never = conditions_never_seen([flown(seen={"battery low": 3})])
    assert "battery low" not in never
    assert len(never) == len(Condition) - 1
