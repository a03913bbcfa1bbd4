"""Fences of a fleet file: their geometry, and each mistake in a sentence."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onboard.config import areas
from onboard.config.earth import Origin, east_north_m, latitude_longitude_deg
from onboard.config.fences import Fence, FenceCircle, area_of
from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping
from onboard.config.flight_space import flight_space_of
from onboard.safety.area_room import clearances_m, is_breached, rooms_m

FIELD = {"name": "field", "keep": "in", "polygon_enu_m": [[-3, -3], [3, -3], [3, 3], [-3, 3]]}
ELL = ((-3.0, -3.0), (6.0, -3.0), (6.0, 0.0), (0.0, 0.0), (0.0, 6.0), (-3.0, 6.0))
ZURICH = {"latitude_deg": 47.397742, "longitude_deg": 8.545594, "altitude_m": 489.4}


def paper(*fences: dict[str, Any], origin: dict[str, float] | None = None) -> FleetConfig:
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text())
    data["fences"] = list(fences)
    if origin is not None:
        data["fleet"]["origin"] = origin
    return fleet_from_mapping(data, path="my.toml")


def field(**changes: Any) -> dict[str, Any]:
    return {**FIELD, **changes}


def polygon(*corners: list[float]) -> dict[str, Any]:
    return field(polygon_enu_m=[list(corner) for corner in corners])


def circle(**keys: Any) -> dict[str, Any]:
    return {"name": "round", "keep": "in", "circle": keys}


NAN = float("nan")
WRONG = [
    (field(name=" "), "name of its own"),
    (field(keep="near"), "keep"),
    (field(colour="red"), "unknown key"),
    ({"name": "a", "keep": "in"}, "exactly one shape"),
    (field(circle={"center_enu_m": [0, 0], "radius_m": 3}), "exactly one shape"),
    (polygon([0, 0], [1, 1]), "2 corners; a polygon has 3 to 200"),
    (polygon(*[[math.cos(k), k] for k in range(201)]), "201 corners"),
    (polygon([-3, -3], [3, NAN], [0, 3]), "not finite"),
    (polygon([-3, -3], [2e4, -3], [0, 3]), "beyond 10000 m"),
    (polygon([-3, -3], [3, 3], [3, -3], [-3, 3]), "crosses itself: the edge after corner 1"),
    (polygon([-3, -3], [3, -3], [5, -3], [4, -3], [0, 3]), "crosses itself"),
    (polygon([-3, -3], [3, -3], [3, 3], [-3, -3]), "corners 4 and 1 are the same point"),
    (polygon([-3, -3], [0, -3], [3, -3]), "crosses itself"),
    (polygon([-3, -3], [3, -3], [-3, -3], [0, 3]), "crosses itself"),  # there and back
    (circle(center_enu_m=[0, 0], radius_m=0), "above 0"),
    (circle(center_enu_m=[0, 0], radius_m=NAN), "above 0"),
    (circle(center_enu_m=[NAN, 0], radius_m=3), "not finite"),
    (circle(radius_m=3), "one centre"),
    (field(buffer_m=-1), "buffer_m is -1"),
    (field(buffer_m=NAN), "buffer_m is nan"),
    (field(height_m=[3, 1]), "low < high"),
    (field(height_m=[0, NAN]), "low < high"),
    (field(height_m=[2.0, 3.0]), "Vehicles start in the fences"),
    (field(height_m=[0.5, 3.0]), "Vehicles start in the fences"),
    (polygon([0, -3], [3, -3], [3, 3], [0, 3]), "vehicles.mav0.start_enu_m' lies outside"),
    (field(keep="out"), "lies inside the fence 'field'"),
    (field(buffer_m=1.6), "buffer_m and law.fence_margin_m need 1.65 m"),
    ({"name": "a", "keep": "in", "polygon_deg": [[47, 8], [47, 9], [48, 9]]}, "no origin"),
]


@pytest.mark.parametrize(("fence", "words"), WRONG, ids=[words for _, words in WRONG])
def test_a_wrong_fence_is_refused_in_words(fence: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError) as error:
        paper(fence)
    assert words in str(error.value)
    assert str(error.value).startswith("my.toml")


def test_two_fences_of_one_name_and_too_many_fences_are_refused() -> None:
    with pytest.raises(ConfigError, match="name of its own"):
        paper(FIELD, FIELD)
    with pytest.raises(ConfigError, match="51 entries"):
        paper(*(field(name=f"f{number}") for number in range(51)))


def in_degrees(corners: list[tuple[float, float]]) -> dict[str, Any]:
    return {"name": "field", "keep": "in", "polygon_deg": [list(corner) for corner in corners]}


def around(origin: Origin, half_m: float) -> list[tuple[float, float]]:
    corners = ((-half_m, -half_m), (half_m, -half_m), (half_m, half_m), (-half_m, half_m))
    return [latitude_longitude_deg(origin, x, y) for x, y in corners]


def test_latitude_and_longitude_are_metres_from_the_origin() -> None:
    fleet = paper(in_degrees(around(Origin(**ZURICH), 3.0)), origin=ZURICH)
    (area,) = flight_space_of(fleet).areas
    assert np.array(area.corners_enu_m) == pytest.approx(
        np.array([[-3, -3], [3, -3], [3, 3], [-3, 3]]), abs=1e-6
    )


def test_a_field_upon_the_date_line_is_a_field_like_any_other() -> None:
    fiji = {"latitude_deg": -16.8, "longitude_deg": 180.0, "altitude_m": 3.0}
    corners = around(Origin(**fiji), 3.0)
    assert {longitude > 0.0 for _, longitude in corners} == {True, False}
    (area,) = flight_space_of(paper(in_degrees(corners), origin=fiji)).areas
    assert areas.area_m2(area.corners_enu_m) == pytest.approx(36.0, rel=1e-6)


@pytest.mark.parametrize(
    ("corners", "words"),
    [
        ([(47.39, 8.54), (47.39, -171.4), (47.4, 8.54)], "km from the fleet's origin"),
        ([(8.545, 47.397), (8.546, 47.397), (8.545, 47.398)], "in this order"),
        ([(91.0, 8.54), (47.39, 8.55), (47.4, 8.54)], "within -90 to 90"),
        ([(47.39, NAN), (47.39, 8.55), (47.4, 8.54)], "within -90 to 90"),
        ([(47.39, 361.0), (47.39, 8.55), (47.4, 8.54)], "within -90 to 90"),
    ],
)
def test_degrees_that_are_no_place_near_the_origin_are_refused(
    corners: list[tuple[float, float]], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        paper(in_degrees(corners), origin=ZURICH)


def test_degrees_and_metres_turn_into_each_other() -> None:
    origin = Origin(**ZURICH)
    for east_m, north_m in ((0.0, 0.0), (1200.0, -3400.0), (-9000.0, 10.0)):
        degrees = latitude_longitude_deg(origin, east_m, north_m)
        assert east_north_m(origin, *degrees) == pytest.approx((east_m, north_m), abs=1e-5)


def test_fences_change_the_hash_and_a_file_without_them_keeps_it() -> None:
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text())
    before = fleet_from_mapping(data).config_hash
    assert paper().config_hash == before
    assert paper(FIELD).config_hash != before
    assert paper(FIELD).config_hash != paper(field(buffer_m=0.5)).config_hash


def an_area(keep: Any, shape: Any, **keys: Any) -> areas.Area:
    if isinstance(shape, FenceCircle):
        return area_of(Fence(name="a", keep=keep, circle=shape, **keys), None)
    return area_of(Fence(name="a", keep=keep, polygon_enu_m=shape, **keys), None)


ROUND = FenceCircle(radius_m=2.0, center_enu_m=(1.0, 1.0))


def in_ell(x: float, y: float) -> bool:
    in_right_arm = -3.0 <= x <= 6.0 and -3.0 <= y <= 0.0
    in_upper_arm = -3.0 <= x <= 0.0 and -3.0 <= y <= 6.0
    return in_right_arm or in_upper_arm


def in_round(x: float, y: float) -> bool:
    return (x - 1.0) ** 2 + (y - 1.0) ** 2 <= 4.0


@pytest.mark.parametrize("keep", ["in", "out"])
@pytest.mark.parametrize(
    ("shape", "contains"), [(ELL, in_ell), (ELL[::-1], in_ell), (ROUND, in_round)]
)
def test_sides_and_distances_are_those_of_the_shape(
    keep: str, shape: Any, contains: Callable[[float, float], bool]
) -> None:
    area = an_area(keep, shape)
    grid = [(0.83 * east - 5.0, 0.89 * north - 5.0) for east in range(16) for north in range(15)]
    border = _border(shape)
    rooms = rooms_m(area, np.array([(x, y, 1.0) for x, y in grid]))

    for (x, y), room_m in zip(grid, rooms.tolist(), strict=True):
        is_right = contains(x, y) == (keep == "in")
        assert areas.is_allowed(area, (x, y, 1.0)) == is_right, (x, y)
        nearest = areas.nearest(area, x, y)
        assert nearest.room_m == pytest.approx(room_m, abs=1e-9)
        assert (nearest.room_m > 0.0) == is_right, (x, y)
        to_border_m = np.hypot(border[:, 0] - x, border[:, 1] - y).min()
        assert abs(nearest.room_m) == pytest.approx(to_border_m, abs=0.02)

        # a step along the normal, from the edge into what is allowed
        step = (nearest.x + 0.01 * nearest.normal_x, nearest.y + 0.01 * nearest.normal_y)
        assert areas.is_allowed(area, (*step, 1.0)), (x, y)


def _border(shape: Any) -> np.ndarray[Any, Any]:
    """Points on the edge, dense, from the shape itself."""
    if isinstance(shape, FenceCircle):
        angles = np.linspace(0.0, 2.0 * math.pi, 2000)
        return np.column_stack([1.0 + 2.0 * np.cos(angles), 1.0 + 2.0 * np.sin(angles)])
    parts = []
    for index, begin in enumerate(shape):
        share = np.linspace(0.0, 1.0, 500)[:, None]
        end = shape[(index + 1) % len(shape)]
        parts.append(np.array(begin) + share * (np.array(end) - np.array(begin)))
    return np.concatenate(parts)


def test_heights_say_between_which_an_area_counts() -> None:
    tree = an_area("out", ROUND, height_m=(0.0, 8.0), buffer_m=1.0)
    assert not areas.is_allowed(tree, (1.0, 1.0, 5.0))
    assert areas.is_allowed(tree, (1.0, 1.0, 8.5))
    assert clearances_m((tree,), np.array([[1.0, 1.0, 8.5], [1.0, 1.0, 12.0]])).tolist() == [
        -0.5,
        3.0,
    ]

    hall = an_area("in", ROUND, height_m=(0.0, 8.0))
    heights = np.array([[1.0, 1.0, z] for z in (-0.6, -0.4, 4.0, 8.1)])
    assert is_breached((hall,), heights).tolist() == [True, False, False, True]
    assert [areas.is_allowed(hall, tuple(one)) for one in heights.tolist()] == [
        False,
        True,
        True,
        False,
    ]


def test_a_goal_is_refused_by_where_it_lies() -> None:
    house = {"name": "house", "keep": "out", "circle": {"center_enu_m": [2, 2], "radius_m": 0.5}}
    fleet = paper(field(height_m=[0, 2.5]), house | {"height_m": [0, 1], "buffer_m": 0.3})
    place = flight_space_of(fleet)
    assert place.refusal((0.0, 0.0, 1.0)) == ""
    assert place.refusal((3.5, 0.0, 1.0)) == "outside the fence 'field'"
    assert "above the fence 'field', which ends at 2.5 m" in place.refusal((0.0, 0.0, 2.8))
    assert "inside the fence 'house', which is to stay out of" in place.refusal((2.0, 2.1, 0.5))
    assert "0.10 m from the edge of the fence 'house'" in place.refusal((2.0, 1.4, 0.5))
    assert "0.20 m from the edge of the fence 'house'" in place.refusal((2.0, 2.0, 1.2))
    assert place.refusal((2.0, 2.0, 1.5)) == ""
    assert place.contains((2.0, 1.4, 0.5))
    assert not place.contains((2.0, 2.0, 0.5))


@pytest.mark.parametrize("start", [(2.0, 3.0, 1.0), (-5.0, 7.0, 1.0), (5.9, -0.1, 1.0)])
def test_the_nearest_point_inside_is_inside_every_buffer(start: tuple[float, float, float]) -> None:
    ell = {"name": "ell", "keep": "in", "polygon_enu_m": [list(corner) for corner in ELL]}
    tree = {"name": "tree", "keep": "out", "circle": {"center_enu_m": [-1.5, 3], "radius_m": 0.4}}
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text())
    data["fleet"]["geofence_m"] = {"x": [-9, 9], "y": [-9, 9], "z": [0, 3]}
    data["fences"] = [ell | {"buffer_m": 0.2}, tree | {"buffer_m": 0.2}]
    fleet = fleet_from_mapping(data)
    inside = flight_space_of(fleet).nearest_inside(start, 0.05)
    room_m, _ = flight_space_of(fleet).room_m(inside)
    assert room_m >= 0.049
    assert math.dist(inside, start) < 5.5


def test_a_way_that_crosses_an_edge_is_found_at_the_heights_that_count() -> None:
    ell = an_area("in", ELL)
    assert areas.is_crossed(ell, (-1.0, 5.0, 1.0), (5.0, -1.0, 1.0))
    assert not areas.is_crossed(ell, (-1.0, 5.0, 1.0), (-1.0, -1.0, 1.0))
    tree = an_area("out", ROUND, height_m=(0.0, 8.0))
    assert areas.is_crossed(tree, (-3.0, 1.0, 5.0), (5.0, 1.0, 5.0))
    assert not areas.is_crossed(tree, (-3.0, 1.0, 9.0), (5.0, 1.0, 9.0))
    assert not areas.is_crossed(tree, (-3.0, 4.0, 5.0), (5.0, 4.0, 5.0))
