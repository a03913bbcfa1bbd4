"""Edges of areas as rows of the law: as the walls of the box, on the right side, and flown."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onboard.avoidance.constraints import constraints_around
from onboard.avoidance.fence_edges import edge_constraint, edge_constraints, edge_of, pivot_of
from onboard.avoidance.half_planes import HalfPlane
from onboard.avoidance.interface import NOT_A_VEHICLE, Baseline, own_at
from onboard.avoidance.pairs import Own
from onboard.avoidance.params import Capsule, LawParams, law_params, obstacles, still
from onboard.avoidance.prediction import Motion
from onboard.config.fleet import FleetConfig, fleet_from_mapping
from onboard.config.flight_space import flight_space_of
from onboard.constants import GRAVITY_M_S2
from onboard.rollout import closed_loop
from onboard.rollout.vehicle_model import Perturbation
from onboard.safety.area_room import rooms_m
from onboard.types import State, Thrust
from onboard.vectors import ZERO_3, Vec2, Vec3
from tests.onboard.avoidance.law_cases import law_of, run

CALM = Perturbation(
    lag_share=0.05, gain_share=0.02, drag_share=0.05, hover_share=0.0, gust_m_s2=0.0, start_m=0.0
)
SQUARE: list[list[float]] = [[-3, -3], [3, -3], [3, 3], [-3, 3]]
ELL: list[list[float]] = [[-3, -3], [6, -3], [6, 0], [0.6, 0], [0.6, 6], [-3, 6]]


def fenced(*fences: dict[str, Any], half_m: float = 9.0) -> FleetConfig:
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text())
    sides = [-half_m, half_m]
    data["fleet"]["geofence_m"] = {"x": sides, "y": sides, "z": [0.0, 5.0]}
    data["fences"] = list(fences)
    return fleet_from_mapping(data)


def inside(corners: Sequence[Sequence[float]], **keys: Any) -> dict[str, Any]:
    return {"name": "field", "keep": "in", "polygon_enu_m": corners, **keys}


def own_of(
    params: LawParams, position: tuple[float, float], velocity: tuple[float, float], z: float = 1.0
) -> Own:
    p = Vec3(*position, z)
    v = Vec3(*velocity, 0.0)
    state = State(
        position_enu_m=p,
        velocity_enu_m_s=v,
        acceleration_enu_m_s2=ZERO_3,
        yaw_rad=0.0,
        age_s=0.0,
        position_std_m=0.0,
        velocity_std_m_s=0.0,
    )
    baseline = Baseline(Thrust(Vec3(1.0, 0.5, GRAVITY_M_S2)), Vec3(0.2, -0.1, 0.0), ZERO_3)
    return own_at(baseline, Motion(p, v), state, params)


def rows_of(
    fleet: FleetConfig, position: tuple[float, float], velocity: tuple[float, float], z: float = 1.0
) -> list[HalfPlane]:
    params = law_params(fleet, "mav0")
    own = own_of(params, position, velocity, z)
    return [constraint.row for constraint in edge_constraints(own, still(fleet), params)]


def binding(rows: list[HalfPlane], radius_m_s2: float) -> list[tuple[float, ...]]:
    """Rows that some thrust of the disc violates, in an order of their own."""
    found = [(*row.normal, row.bound_m_s2) for row in rows if row.bound_m_s2 > -radius_m_s2]
    return sorted(tuple(round(value, 9) + 0.0 for value in row) for row in found)


def test_a_square_has_the_rows_of_the_same_box() -> None:
    square = fenced(inside(SQUARE))
    box = fenced(half_m=3.0)
    params = law_params(box, "mav0")
    rng = np.random.default_rng(3)
    for _ in range(200):
        east_m, north_m = rng.uniform(-2.99, 2.99, 2).tolist()
        east_m_s, north_m_s = rng.uniform(-1.5, 1.5, 2).tolist()
        position = (east_m, north_m)
        velocity = (east_m_s, north_m_s)
        own = own_of(params, position, velocity)
        walls = [one.row for one in constraints_around(own, [], [], 0.0, params)]
        edges = rows_of(square, position, velocity)
        radius = own.radius_m_s2
        assert binding(edges, radius) == binding(walls, radius), (position, velocity)


def test_a_buffer_moves_an_edge_inwards() -> None:
    wide = rows_of(fenced(inside(SQUARE)), (-2.9, 0.0), (0.0, 0.0))
    buffered = inside([[-3.5, -3], [3, -3], [3, 3], [-3.5, 3]], buffer_m=0.5)
    narrow = rows_of(fenced(buffered), (-2.9, 0.0), (0.0, 0.0))
    assert wide[0] == pytest.approx(narrow[0])


@pytest.mark.parametrize(
    ("position", "normal"),
    [
        ((-3.2, 0.0), (1.0, 0.0)),  # beside an edge
        ((-4.9, 0.0), (1.0, 0.0)),  # far beyond it
        ((-3.2, -3.2), (math.sqrt(0.5), math.sqrt(0.5))),  # beyond a corner
        ((0.7, 0.15), (-1.0, 0.0)),  # in the bay: the nearest edge is that of the upper arm
    ],
)
def test_outside_only_the_nearest_edge_leads_back(
    position: tuple[float, float], normal: tuple[float, float]
) -> None:
    (row,) = rows_of(fenced(inside(ELL)), position, (0.0, 0.0))
    assert row.normal == pytest.approx(normal)
    assert row.bound_m_s2 > 0.0


def test_a_corner_that_points_inwards_is_kept_off_all_around() -> None:
    fleet = fenced(inside(ELL))
    for angle_deg in (190, 225, 260):
        angle = math.radians(angle_deg)
        position = (0.6 + 0.2 * math.cos(angle), 0.2 * math.sin(angle))
        for row in rows_of(fleet, position, (0.0, 0.0)):
            assert row.normal == pytest.approx((math.cos(angle), math.sin(angle)))


def test_a_circle_is_kept_from_both_sides_and_its_bend_is_counted() -> None:
    round_field = {"circle": {"center_enu_m": [0, 0], "radius_m": 3.0}}
    fleet = fenced({"name": "a", "keep": "in", **round_field})
    (still_row,) = rows_of(fleet, (2.8, 0.0), (0.0, 0.0))
    assert still_row.normal == pytest.approx((-1.0, 0.0))
    (bent,) = rows_of(fleet, (2.8, 0.0), (0.0, 1.0))
    assert bent.bound_m_s2 - still_row.bound_m_s2 == pytest.approx(1.0 / 2.8)
    assert rows_of(fleet, (3.1, 0.0), (0.0, 0.0))[0].normal == pytest.approx((-1.0, 0.0))

    pond = {"circle": {"center_enu_m": [2, 2], "radius_m": 1.0}}
    fleet = fenced({"name": "a", "keep": "out", **pond})
    assert rows_of(fleet, (3.2, 2.0), (0.0, 0.0))[0].normal == pytest.approx((1.0, 0.0))
    assert rows_of(fleet, (2.9, 2.0), (0.0, 0.0))[0].normal == pytest.approx((1.0, 0.0))


def test_an_area_to_stay_out_of_counts_at_its_heights_only() -> None:
    house = {"name": "house", "keep": "out", "polygon_enu_m": [[1, 1], [2, 1], [2, 2], [1, 2]]}
    fleet = fenced(house | {"height_m": [0.0, 2.0], "buffer_m": 0.5})
    assert rows_of(fleet, (0.6, 1.5), (0.0, 0.0), z=1.0)
    assert rows_of(fleet, (0.6, 1.5), (0.0, 0.0), z=2.5)
    assert not rows_of(fleet, (0.6, 1.5), (0.0, 0.0), z=2.6)


def test_edges_out_of_reach_cost_no_row_and_a_fleet_without_areas_has_none() -> None:
    assert rows_of(fenced(inside(SQUARE)), (0.0, 0.0), (0.0, 0.0)) == []
    plain = fenced()
    assert still(plain) == ()
    pillar = {"name": "pillar", "circle": {"center_enu_m": [0.0, 0.0], "radius_m": 0.4}}
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text())
    data["obstacles"] = [pillar]
    assert still(fleet_from_mapping(data)) == obstacles(fleet_from_mapping(data))


# -- one edge, in numbers --------------------------------------------------------------------------

_EAST = Capsule(Vec2(0.0, 0.0), Vec2(4.0, 0.0), 0.0, area=1, keep_m=0.2)  # allowed: north of it
_POND = Capsule(Vec2(0.0, 0.0), Vec2(0.0, 0.0), 2.0, area=1, keep_m=0.2, is_turned_about=True)


def at(x: float, y: float, velocity: tuple[float, float] = (0.0, 0.0)) -> Own:
    return own_of(law_of(), (x, y), velocity)


@pytest.mark.parametrize(
    ("x", "y", "e", "is_allowed", "is_flat"),
    [
        (1.0, 0.02, (0.0, 0.02), True, True),
        (1.0, -0.02, (0.0, -0.02), False, True),
        (0.02, 0.5, (0.0, 0.5), True, True),
        (3.98, 0.5, (0.0, 0.5), True, True),
        (-0.02, 0.5, (-0.02, 0.5), False, False),  # nearest to a corner that points away from it
        (4.02, 0.5, (0.02, 0.5), False, False),
    ],
)
def test_the_side_of_an_edge_counts_along_it_and_its_corner_beyond_it(
    x: float, y: float, e: tuple[float, float], is_allowed: bool, is_flat: bool
) -> None:
    edge = edge_of(_EAST, at(x, y))
    assert edge.e == pytest.approx(e)
    assert edge.distance_m == pytest.approx(math.hypot(*e))
    assert (edge.is_allowed, edge.is_flat) == (is_allowed, is_flat)

    # a corner that points inwards has the vehicle on its allowed side
    pointing = _EAST._replace(is_begin_inwards=True, is_end_inwards=True)
    assert edge_of(pointing, at(x, y)).is_allowed is (is_allowed or not is_flat)


def test_an_edge_of_a_decimetre_is_no_circle() -> None:
    short = _EAST._replace(end_enu_m=Vec2(0.1, 0.0))
    edge = edge_of(short, at(0.05, 0.3))
    assert edge.e == pytest.approx((0.0, 0.3))
    assert edge.is_allowed


def test_on_an_edge_its_own_side_is_the_allowed_one() -> None:
    edge = edge_of(_EAST, at(1.0, 0.0))
    assert edge.e == pytest.approx((0.0, 1e-6))
    assert (edge.distance_m, edge.is_allowed) == (1e-6, True)
    assert edge_of(_EAST, at(1.0, -2e-6)).distance_m == pytest.approx(2e-6)


@pytest.mark.parametrize(
    ("away_m", "e_m", "is_outside"), [(2.05, 0.05, True), (1.95, -0.05, False)]
)
def test_a_circle_knows_inside_from_outside_and_bends_only_for_who_is_to_stay_inside(
    away_m: float, e_m: float, is_outside: bool
) -> None:
    pond = edge_of(_POND, at(away_m, 0.0))
    assert pond.e == pytest.approx((e_m, 0.0))
    assert (pond.is_allowed, pond.curvature_1_m, pond.is_flat) == (is_outside, 0.0, False)

    field = edge_of(_POND._replace(is_turned_about=False), at(away_m, 0.0))
    assert field.e == pytest.approx((e_m, 0.0))
    assert field.is_allowed is not is_outside
    assert field.curvature_1_m == pytest.approx(1.0 / away_m)


@pytest.mark.parametrize(("keep_m", "behind_m"), [(0.2, 0.3), (0.5, 0.0), (0.7, 0.0)])
def test_a_vehicle_turns_about_a_point_half_a_metre_behind_where_it_keeps(
    keep_m: float, behind_m: float
) -> None:
    own = at(1.0, 0.9, (0.4, -0.3))
    pivot = pivot_of(own, edge_of(_EAST._replace(keep_m=keep_m), own))
    assert pivot.e == pytest.approx((0.0, 0.9 + behind_m))
    assert pivot.w == pytest.approx((0.0, -0.3))  # it moves along with the vehicle
    assert (pivot.d_m, pivot.gap_m) == pytest.approx((keep_m + behind_m, 0.9))

    beside = at(-1.0, 0.5, (0.4, -0.3))
    assert pivot_of(beside, edge_of(_EAST, beside)).w == pytest.approx((0.4, -0.3))


@pytest.mark.parametrize(
    ("is_turned_about", "north_m_s", "is_allowed", "rotation", "turns"),
    [
        (True, -1.5, True, "ahead", True),
        (True, -1.5, True, "violated", True),
        (True, -1.5, True, "never", False),
        (True, -1.5, False, "ahead", False),
        (True, 1.5, True, "ahead", False),  # it flies away
        (False, -1.5, True, "ahead", False),
    ],
)
def test_an_edge_is_turned_about_while_it_is_in_the_way_of_who_is_on_the_allowed_side(
    is_turned_about: bool, north_m_s: float, is_allowed: bool, rotation: str, turns: bool
) -> None:
    own = at(1.0, 0.4, (0.0, north_m_s))
    edge = edge_of(_EAST._replace(is_turned_about=is_turned_about), own)
    constraint = edge_constraint(own, edge, is_allowed, law_of(rotation=rotation))
    assert constraint.is_turning is turns
    assert constraint.table_index == NOT_A_VEHICLE


def test_obstacles_are_no_edges_and_only_eight_edges_count() -> None:
    params = law_of()
    own = at(1.0, 0.3)
    pillar = Capsule(Vec2(1.0, 0.0), Vec2(1.0, 0.0), 0.1)
    assert edge_constraints(own, [pillar], params) == []

    def count(edges: int) -> int:
        areas = [_EAST._replace(area=1 + k, west_m=0.0, east_m=4.0) for k in range(edges)]
        return len(edge_constraints(own, areas, params))

    assert [count(edges) for edges in (1, 8, 9)] == [1, 8, 8]


def test_a_field_of_one_circle_holds_a_vehicle_back() -> None:
    field = {"name": "a", "keep": "in", "circle": {"center_enu_m": [0, 0], "radius_m": 3.0}}
    edges = still(fenced(field))
    assert len(edges) == 1
    output = run((2.7, 0.0, 1.0), (0.5, 0.0, 0.0), (2.0, 0.0, 0.0), [], law_of(), obstacles=edges)
    assert output.active_neighbour == NOT_A_VEHICLE
    assert output.thrust.thrust_enu_m_s2.x < 0.0


# -- flights ---------------------------------------------------------------------------------------


def fly(
    fleet: FleetConfig, start: tuple[float, float], goal: tuple[float, float], timeout_s: float
) -> tuple[bool, float]:
    """Return whether one vehicle arrives, and its least room to an edge."""
    model = closed_loop.fleet_model(fleet, ["mav0"])
    scenario = closed_loop.Scenario(
        start_enu_m=np.array([[[*start, 1.0]]]),
        legs_enu_m=np.array([[[[*goal, 1.0]]]]),
        duration_s=np.array([0.0]),
        timeout_s=timeout_s,
    )
    result = closed_loop.fly(scenario, model, [0], CALM)
    rooms = [rooms_m(area, result.trace_enu_m).min() for area in flight_space_of(fleet).areas]
    return bool(result.is_success.all()), float(min(rooms))


def test_a_goal_in_the_other_arm_of_a_field_is_reached_around_the_corner() -> None:
    arrives, room_m = fly(fenced(inside(ELL)), (-1.0, 4.5), (5.0, -1.5), 30.0)
    assert arrives
    assert room_m > 0.0


def test_a_goal_behind_a_house_is_reached_around_it() -> None:
    house = {"name": "house", "keep": "out", "polygon_enu_m": [[1, 1], [2, 1], [2, 2], [1, 2]]}
    arrives, room_m = fly(fenced(house), (-0.5, 1.5), (3.5, 1.5), 30.0)
    assert arrives
    assert room_m > 0.0


def test_without_the_edges_the_same_flight_leaves_the_field(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(closed_loop, "still", lambda fleet: obstacles(fleet))
    _, room_m = fly(fenced(inside(ELL)), (-1.0, 4.5), (5.0, -1.5), 15.0)
    assert room_m < -0.5
