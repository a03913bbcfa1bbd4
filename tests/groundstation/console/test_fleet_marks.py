"""Marks of the fleet table: whose they are, and when they end by themselves."""

from __future__ import annotations

from groundstation.console.widgets.fleet_marks import ALL_MARKED_S, FleetMarks

FLEET = ("mav0", "mav1", "mav2")


def _all_marked(now_s: float) -> FleetMarks:
    marks = FleetMarks()
    marks.set(FLEET, FLEET, now_s)
    return marks


def test_marks_on_all_end_after_five_seconds() -> None:
    marks = _all_marked(10.0)
    marks.update(FLEET, 10.0 + ALL_MARKED_S - 0.1)
    assert marks.names == set(FLEET)
    marks.update(FLEET, 10.0 + ALL_MARKED_S)
    assert not marks.names


def test_marks_that_are_still_used_last_five_seconds_longer() -> None:
    marks = _all_marked(10.0)
    marks.keep(13.0)
    marks.update(FLEET, 13.0 + ALL_MARKED_S - 0.1)
    assert marks.names == set(FLEET)
    marks.update(FLEET, 13.0 + ALL_MARKED_S)
    assert not marks.names


def test_marks_on_some_do_not_end_by_being_used() -> None:
    marks = FleetMarks()
    marks.set(FLEET[:2], FLEET, 10.0)
    marks.keep(11.0)
    marks.update(FLEET, 1e6)
    assert marks.names == set(FLEET[:2])


def test_a_vehicle_that_has_vanished_loses_its_mark() -> None:
    marks = FleetMarks()
    marks.set(FLEET[:2], FLEET, 10.0)
    marks.update(FLEET[1:], 11.0)
    assert marks.names == {"mav1"}
