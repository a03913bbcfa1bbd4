"""Ways around obstacles keep their distance, are short, and are there whenever there is room."""

from __future__ import annotations

import math
import tomllib
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from onboard.avoidance.params import Capsule, Walls, still
from onboard.config.fleet import fleet_from_mapping
from onboard.control.route_map import MAX_TESTS, RouteMap
from onboard.vectors import Vec2
from sitl.monte_carlo.clutter import Outlines, forest

CLEARANCE_M = 0.45
OPEN = Walls(-math.inf, math.inf, -math.inf, math.inf)
LINE_SPARE_M = 0.05  # by which a way may be nearer: the law holds the distance itself


def wall(begin: tuple[float, float], end: tuple[float, float], radius_m: float = 0.1) -> Capsule:
    return Capsule(Vec2(*begin), Vec2(*end), radius_m)


def route_map(*walls: Capsule, box: Walls = OPEN) -> RouteMap:
    return RouteMap(walls, CLEARANCE_M, box)


def length_m(way: list[Vec2]) -> float:
    """Return the length [m] of a way through these points."""
    total_m = 0.0
    for begin, end in pairwise(way):
        total_m += math.dist(begin, end)
    return total_m


def least_gap_m(way: list[Vec2], walls: tuple[Capsule, ...]) -> float:
    """Return the least distance of a way from the outlines, by points along it."""
    shares = np.linspace(0.0, 1.0, 400)[:, None]
    points = [np.array(a) + shares * (np.array(b) - np.array(a)) for a, b in pairwise(way)]
    return float(Outlines(walls).gaps_m(np.concatenate(points)[None]).min())


# a deep U that is open to the west; its goal lies behind the back wall
U = (
    wall((-1.5, 1.5), (1.5, 1.5)),
    wall((1.5, 1.5), (1.5, -1.5)),
    wall((1.5, -1.5), (-1.5, -1.5)),
)


def test_a_goal_in_sight_is_flown_to_straight() -> None:
    begin, goal = Vec2(-3.0, 3.0), Vec2(3.0, 3.0)
    assert route_map(*U).route(begin, goal) == [goal]


def test_the_way_out_of_a_deep_u_leads_back_first_and_keeps_its_distance() -> None:
    begin, goal = Vec2(0.8, 0.1), Vec2(3.0, 0.1)
    way = [begin, *route_map(*U).route(begin, goal)]

    assert way[1].x < -1.5  # out through the open side
    assert least_gap_m(way, U) > CLEARANCE_M - LINE_SPARE_M - 1e-6
    # a taut string: to the end of the wall, half around it, along the wall and down to the goal
    keep_m = CLEARANCE_M + 0.1
    taut_m = 2.5 + math.pi * keep_m + 3.0 + math.dist((1.5, 1.5 + keep_m), goal)
    assert taut_m < length_m(way) < 1.1 * taut_m


def test_of_two_ways_the_shorter_one_is_taken() -> None:
    long_below = wall((0.0, -5.0), (0.0, 1.0))
    way = route_map(long_below).route(Vec2(-2.0, 0.0), Vec2(2.0, 0.0))
    assert all(point.y > 1.0 for point in way[:-1])


def test_a_goal_that_is_walled_in_has_no_way() -> None:
    lid = wall((-1.5, 1.5), (-1.5, -1.5))
    assert route_map(*U, lid).route(Vec2(0.0, 0.0), Vec2(3.0, 0.0)) == []


@pytest.mark.parametrize("width_m", [0.93, 1.0, 1.2])
def test_a_passage_with_room_for_one_is_found_from_everywhere(width_m: float) -> None:
    """The corner in the middle of the passage is needed where it is narrow."""
    upper = wall((0.0, 0.1 + 0.5 * width_m), (0.0, 9.0))
    lower = wall((0.0, -0.1 - 0.5 * width_m), (0.0, -9.0))
    for y in (-3.0, -0.7, 0.0, 0.2, 2.0):
        begin, goal = Vec2(-2.0, y), Vec2(2.0, -1.5 * y)
        way = route_map(upper, lower).route(begin, goal)
        assert way, f"no way from {begin}"
        straight_m = math.dist(begin, goal)
        assert length_m([begin, *way]) < 1.5 * straight_m  # not around the walls


def test_a_passage_that_is_too_narrow_is_flown_around() -> None:
    upper = wall((0.0, 0.45), (0.0, 3.0))
    lower = wall((0.0, -0.45), (0.0, -3.0))
    way = route_map(upper, lower).route(Vec2(-2.0, 0.0), Vec2(2.0, 0.0))
    assert any(abs(point.y) > 3.0 for point in way)


def test_no_way_leads_through_the_walls_of_the_box() -> None:
    across = wall((0.0, -1.0), (0.0, 1.8))
    box = Walls(-3.0, 3.0, -3.0, 2.2)  # no room above the wall
    way = route_map(across, box=box).route(Vec2(-1.0, 1.0), Vec2(1.0, 1.0))
    assert all(point.y < -1.0 for point in way[:-1])


def test_whoever_is_too_near_to_an_obstacle_finds_a_way_from_there() -> None:
    across = wall((0.0, -1.0), (0.0, 1.0))
    begin = Vec2(-0.3, 0.0)  # 0.2 m from the outline
    way = route_map(across).route(begin, Vec2(2.0, 0.0))
    assert len(way) > 1
    assert way[0].x < -0.1


@pytest.mark.parametrize("seed", range(5))
def test_ways_through_a_forest_keep_their_distance(seed: int) -> None:
    pillars = forest(4, seed)
    ways = route_map(*pillars)
    rng = np.random.default_rng(seed)
    for y_begin, y_goal in rng.uniform(-5.0, 5.0, (40, 2)).tolist():
        begin, goal = Vec2(-6.0, y_begin), Vec2(6.0, y_goal)
        way = [begin, *ways.route(begin, goal)]
        assert least_gap_m(way, pillars) > CLEARANCE_M - LINE_SPARE_M - 1e-6
        assert length_m(way) < 1.15 * math.dist(begin, goal)


def test_a_way_in_a_field_with_two_arms_goes_around_its_inner_corner() -> None:
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text())
    data["fleet"]["geofence_m"] = {"x": [-8.0, 8.0], "y": [-8.0, 8.0], "z": [0.0, 3.0]}
    ell = [[-3, -3], [6, -3], [6, 0.6], [0.6, 0.6], [0.6, 6], [-3, 6]]
    data["fences"] = [{"name": "field", "keep": "in", "polygon_enu_m": ell, "buffer_m": 0.2}]
    edges = still(fleet_from_mapping(data))

    way = RouteMap(edges, CLEARANCE_M, OPEN).route(Vec2(0.0, 5.2), Vec2(5.2, 0.0))
    assert len(way) > 1
    for corner in way[:-1]:
        assert corner.x < 0.6 - 0.2 or corner.y < 0.6 - 0.2


def test_a_round_field_is_in_nobodys_way() -> None:
    field = Capsule(Vec2(0.0, 0.0), Vec2(0.0, 0.0), 5.0, area=1, keep_m=0.3)
    goal = Vec2(4.0, 0.0)
    assert route_map(field).route(Vec2(-4.0, 0.0), goal) == [goal]


def test_a_map_of_too_many_corners_knows_no_ways_and_says_so() -> None:
    pillars = []
    for k in range(1 + round((MAX_TESTS / 64) ** (1 / 3))):
        middle = Vec2(3.0 * k, 0.0)
        pillars.append(Capsule(middle, middle, 0.2))
    crowded = route_map(*pillars)
    assert not crowded.is_complete
    assert crowded.route(Vec2(0.0, -2.0), Vec2(0.0, 2.0)) == []
    assert route_map(*pillars[:2]).is_complete


def test_lengths_of_ways_past_a_vehicle_lead_around_it() -> None:
    ways = route_map(*U)
    begin = Vec2(0.8, 0.0)
    far = Vec2(0.0, 9.0)
    free_m = ways.lengths_past(begin, far, 0.9)
    for corner, free in zip(ways.corners, free_m, strict=True):
        assert free == pytest.approx(length_m([begin, *ways.route(begin, corner)]))

    in_the_mouth = Vec2(-0.4, 0.0)  # 1.0 m from the walls: nobody gets past
    assert all(math.isinf(length) for length in ways.lengths_past(begin, in_the_mouth, 0.9))


def test_no_piece_ends_outside_the_box() -> None:
    box = Walls(-3.0, 3.0, -3.0, 3.0)
    assert route_map(*U, box=box).is_free(Vec2(-2.0, 0.0), Vec2(-2.9, 0.0))
    assert not route_map(*U, box=box).is_free(Vec2(-2.0, 0.0), Vec2(-3.1, 0.0))


def test_of_two_ways_of_about_one_length_the_present_one_is_kept() -> None:
    ways = route_map(Capsule(Vec2(0.0, -1.0), Vec2(0.0, 1.0), 0.1))
    goal = Vec2(3.0, 0.0)
    above = ways.route(Vec2(-3.0, 0.1), goal)[0]
    assert above.y > 0.0

    assert ways.route(Vec2(-3.0, -0.1), goal)[0].y < 0.0
    assert ways.route(Vec2(-3.0, -0.1), goal, above)[0] == above
    assert ways.route(Vec2(-3.0, -1.5), goal, above)[0].y < 0.0  # the other one is much shorter


def test_whoever_is_beyond_the_edge_of_an_area_finds_a_way_back() -> None:
    corners = [Vec2(-3.0, -3.0), Vec2(3.0, -3.0), Vec2(3.0, 3.0), Vec2(-3.0, 3.0)]
    stay_in = outline(corners, area=1)
    stay_out = outline(corners[::-1], area=1)
    tree = Capsule(Vec2(1.5, 0.0), Vec2(1.5, 0.0), 0.3)

    inside = Vec2(0.0, 0.0)
    outside = Vec2(3.3, 0.0)
    way = route_map(*stay_in, tree).route(outside, inside)
    assert len(way) > 1  # obstacles count nevertheless
    assert way[-1] == inside
    assert route_map(*stay_in).route(inside, outside) == []

    assert route_map(*stay_out).route(inside, outside) == [outside]
    assert route_map(*stay_out).route(outside, inside) == []


def outline(corners: list[Vec2], area: int) -> list[Capsule]:
    return [
        Capsule(begin, end, 0.0, area=area, keep_m=0.3)
        for begin, end in zip(corners, [*corners[1:], corners[0]], strict=True)
    ]


@pytest.mark.parametrize(("wider_m", "is_passed"), [(-0.02, False), (-0.09, False), (0.0, True)])
def test_a_passage_that_is_a_little_too_narrow_is_closed(wider_m: float, is_passed: bool) -> None:
    half_m = CLEARANCE_M + 0.1 + 0.5 * wider_m
    upper = Capsule(Vec2(0.0, half_m), Vec2(0.0, 5.0), 0.1)
    lower = Capsule(Vec2(0.0, -half_m), Vec2(0.0, -5.0), 0.1)
    way = route_map(upper, lower).route(Vec2(-2.0, 0.0), Vec2(2.0, 0.0))
    assert max(abs(point.y) for point in way) < 1.0 if is_passed else abs(way[0].y) > 5.0


@pytest.mark.parametrize(("wider_m", "is_passed"), [(-0.02, False), (0.01, True)])
def test_a_passage_beside_a_wall_of_the_box_is_closed_if_it_is_too_narrow(
    wider_m: float, is_passed: bool
) -> None:
    width_m = CLEARANCE_M + 0.1 + wider_m
    across = Capsule(Vec2(0.0, -5.0), Vec2(0.0, 2.0), 0.1)
    box = Walls(-3.0, 3.0, -3.0, 2.0 + width_m)
    found = route_map(across, box=box)

    beside = 2.0 + width_m
    assert bool(found.route(Vec2(-2.0, beside), Vec2(2.0, beside))) == is_passed
    assert bool(found.route(Vec2(-2.0, 0.0), Vec2(2.0, 0.0))) == is_passed
