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
from onboard.avoidance.fence_edges import edge_constraints
from onboard.avoidance.half_planes import HalfPlane
from onboard.avoidance.interface import Baseline, own_at
from onboard.avoidance.pairs import Own
from onboard.avoidance.params import LawParams, law_params, obstacles, still
from onboard.avoidance.prediction import Motion
from onboard.config.fleet import FleetConfig, fleet_from_mapping
from onboard.config.flight_space import flight_space_of
from onboard.constants import GRAVITY_M_S2
from onboard.rollout import closed_loop
from onboard.rollout.vehicle_model import Perturbation
from onboard.safety.area_room import rooms_m
from onboard.types import State, Thrust
from onboard.vectors import ZERO_3, Vec3

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
