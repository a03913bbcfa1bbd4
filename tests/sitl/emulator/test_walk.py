"""Persons of the emulated motion capture walk to and fro."""

import pytest

from sitl.emulator.walk import position_at

CORNER = ((0.0, 0.0), (3.0, 0.0), (3.0, 1.0))


@pytest.mark.parametrize(
    ("time_s", "place"),
    [
        (-1.0, (0.0, 0.0)),
        (0.0, (0.0, 0.0)),
        (1.0, (2.0, 0.0)),
        (1.75, (3.0, 0.5)),
        (2.0, (3.0, 1.0)),
        (3.0, (2.0, 0.0)),
        (5.0, (2.0, 0.0)),  # once more from the beginning
    ],
)
def test_a_person_goes_to_the_end_and_back(time_s, place):
    x_m, y_m, _ = position_at(CORNER, 2.0, time_s)
    assert (x_m, y_m) == pytest.approx(place)


def test_a_single_point_is_a_person_who_stands():
    assert position_at(((1.0, 2.0),), 1.0, 7.0)[:2] == (1.0, 2.0)
