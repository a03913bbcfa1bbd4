"""Distances to areas that a fleet stays in or out of, by numbers that a drawing gives."""

from __future__ import annotations

import math

import numpy as np
import pytest

from onboard.config.areas import Area, Point
from onboard.safety.area_room import clearances_m, is_breached, length_beyond_m, rooms_m

SQUARE: tuple[Point, ...] = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))
DIAMOND: tuple[Point, ...] = ((5.0, 0.0), (10.0, 5.0), (5.0, 10.0), (0.0, 5.0))


def area(
    corners_enu_m: tuple[Point, ...] = (),
    *,
    keeps_in: bool = True,
    center_enu_m: Point = (0.0, 0.0),
    radius_m: float = 0.0,
    buffer_m: float = 0.0,
) -> Area:
    """Return an area from the ground to a height of 8 m."""
    return Area(
        name="one",
        keeps_in=keeps_in,
        corners_enu_m=corners_enu_m,
        center_enu_m=center_enu_m,
        radius_m=radius_m,
        low_m=0.0,
        high_m=8.0,
        buffer_m=buffer_m,
    )


HALL = area(SQUARE)


@pytest.mark.parametrize("keeps_in", [True, False])
@pytest.mark.parametrize(
    ("x", "y", "inside_m"),
    [
        (1.0, 4.0, 1.0),
        (5.0, 8.0, 2.0),
        (0.5, 0.2, 0.2),  # near a corner, whose edges begin and end there
        (9.8, 9.5, 0.2),
        (-3.0, 5.0, -3.0),  # beside an edge
        (13.0, 14.0, -5.0),  # beyond a corner
        (5.0, -2.0, -2.0),
        (4.0, 10.0, 0.0),  # on an edge
    ],
)
def test_the_distance_to_a_polygon_is_that_to_its_nearest_edge(
    keeps_in: bool, x: float, y: float, inside_m: float
) -> None:
    expected_m = inside_m if keeps_in else -inside_m
    found_m = rooms_m(area(SQUARE, keeps_in=keeps_in), np.array([[x, y, 1.0]]))
    assert found_m.tolist() == pytest.approx([expected_m])


@pytest.mark.parametrize("x", [-2.0, 2.0, 5.0, 8.0, 12.0])
@pytest.mark.parametrize("y", [0.0, 5.0, 10.0])
def test_a_position_as_far_north_as_a_corner_is_inside_or_outside_like_any_other(
    x: float, y: float
) -> None:
    inside_m = (5.0 - abs(x - 5.0) - abs(y - 5.0)) / math.sqrt(2.0)
    found_m = rooms_m(area(DIAMOND), np.array([x, y, 1.0]))
    assert (found_m > 0.0) == (inside_m > 0.0)
    if inside_m > 0.0:
        assert found_m == pytest.approx(inside_m)


@pytest.mark.parametrize(("keeps_in", "sign"), [(True, 1.0), (False, -1.0)])
def test_the_distance_to_a_circle_is_that_along_its_radius(keeps_in: bool, sign: float) -> None:
    circle = area(keeps_in=keeps_in, center_enu_m=(2.0, 1.0), radius_m=6.0)
    positions = np.array([[[2.0, 1.0, 1.0], [5.0, 5.0, 1.0]], [[8.0, 1.0, 9.0], [2.0, 9.0, 0.0]]])
    found_m = rooms_m(circle, positions)
    assert (sign * found_m).tolist() == [[6.0, 1.0], [0.0, -2.0]]


def test_without_areas_every_position_has_room() -> None:
    positions = np.zeros((4, 2, 3))
    assert clearances_m((), positions).tolist() == [[math.inf] * 2] * 4
    assert is_breached((), positions).tolist() == [[False] * 2] * 4


def test_the_nearest_of_several_areas_counts_with_its_buffer_and_a_breach_without() -> None:
    tree = area(keeps_in=False, center_enu_m=(5.0, 5.0), radius_m=1.0, buffer_m=0.5)
    positions = np.array([[1.0, 5.0, 1.0], [3.0, 5.0, 1.0], [3.7, 5.0, 1.0], [4.2, 5.0, 1.0]])
    assert clearances_m((HALL, tree), positions) == pytest.approx([1.0, 0.5, -0.2, -0.7])
    assert is_breached((HALL, tree), positions).tolist() == [False, False, False, True]


def test_up_to_the_edge_itself_nothing_is_breached() -> None:
    positions = np.array([[0.02, 5.0, 1.0], [-0.02, 5.0, 1.0], [5.0, 5.0, 7.98], [5.0, 5.0, 8.02]])
    assert is_breached((HALL,), positions).tolist() == [False, True, False, True]


@pytest.mark.parametrize(
    ("begin_x", "end_x", "beyond_m"),
    [(5.0, 15.0, 5.0), (15.0, 5.0, 5.0), (9.0, 1.0, 0.0), (-3.0, 17.0, 10.0), (11.0, 14.0, 3.0)],
)
def test_the_way_beyond_an_edge_is_measured_to_centimetres(
    begin_x: float, end_x: float, beyond_m: float
) -> None:
    found_m = length_beyond_m((HALL,), (begin_x, 5.0, 1.0), (end_x, 5.0, 1.0))
    assert found_m == pytest.approx(beyond_m, abs=0.06)


def test_a_way_through_a_wall_of_six_centimetres_is_found_wherever_the_wall_stands() -> None:
    for west_m in np.arange(2.0, 2.3, 0.01).tolist():
        east_m = west_m + 0.06
        wall = area(((west_m, 0.0), (west_m, 9.0), (east_m, 9.0), (east_m, 0.0)), keeps_in=False)
        assert length_beyond_m((wall,), (0.0, 5.0, 1.0), (9.0, 5.0, 1.0)) > 0.0, west_m
