"""What stands still: pillars, polygons and the fence as rows of the same projection, flown in
closed loop.
"""

import math
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from onboard.config.fleet import ConfigError, fleet_from_mapping
from onboard.rollout import closed_loop
from onboard.rollout.vehicle_model import Perturbation
from onboard.types import LawStatus
from tests.onboard.avoidance.law_cases import FENCE, law_of, neighbour_of, run

CALM = Perturbation(
    lag_share=0.05, gain_share=0.02, drag_share=0.05, hover_share=0.0, gust_m_s2=0.0, start_m=0.0
)
PILLAR = {"name": "pillar", "circle": {"center_enu_m": [0.0, 0.0], "radius_m": 0.4}}
BOX = {"name": "box", "polygon_enu_m": [[-0.5, -0.6], [0.5, -0.6], [0.5, 0.6], [-0.5, 0.6]]}


def paper_data(*obstacles, law=None):
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text())
    data["obstacles"] = list(obstacles)
    data["law"] |= law or {}
    return data


def fly_from_to(start, goal, *obstacles, law=None, seeds=(0,)):
    fleet = fleet_from_mapping(paper_data(*obstacles, law=law))
    model = closed_loop.fleet_model(fleet, ["mav0"])
    count = len(seeds)
    starts = np.repeat(np.array([[[*start, 1.0]]]), count, 0)
    legs = np.repeat(np.array([[[[*goal, 1.0]]]]), count, 0)
    scenario = closed_loop.Scenario(starts, legs, np.array([0.0]), 25.0)
    result = closed_loop.fly(scenario, model, seeds, CALM)
    return result, fleet


def nearest_to(obstacle, trace):
    return min(obstacle.distance_m(point) for point in trace.reshape(-1, 3)[::3])


@pytest.mark.parametrize("shape", [PILLAR, BOX], ids=["pillar", "box"])
@pytest.mark.parametrize("offset", [0.0, 0.05, -0.3])
def test_a_goal_straight_behind_an_obstacle_is_reached_without_touching_it(shape, offset):
    result, fleet = fly_from_to((-2.5, offset), (2.5, 0.0), shape)
    assert result.is_success.all()
    # half a body, and most of the margin
    assert nearest_to(fleet.obstacles[0], result.trace_enu_m) > 0.25 + 0.12


def test_a_vehicle_sent_at_the_fence_stops_in_front_of_it():
    result, _ = fly_from_to((-2.0, 0.3), (30.0, 0.3), seeds=(0, 1, 2))
    assert result.trace_enu_m[..., 0].max() < 4.0
    assert result.trace_enu_m[-1, ..., 0].min() > 3.8
    low, _ = fly_from_to((0.0, 0.0), (-20.0, -30.0))
    assert low.trace_enu_m[..., :2].min() > -4.0


def test_goal_near_the_fence_but_inside_is_reached():
    result, _ = fly_from_to((0.0, 0.0), (3.9, -3.9))
    assert result.is_success.all()


def test_polygon_and_its_edges_know_inside_from_outside():
    fleet = fleet_from_mapping(paper_data(BOX))
    box = fleet.obstacles[0]
    assert box.distance_m((0.0, 0.0)) == pytest.approx(-0.5)
    assert box.distance_m((2.5, 0.0)) == pytest.approx(2.0)
    assert box.distance_m((0.8, 1.0)) == pytest.approx(0.5)


WRONG = [
    ({"name": "", "circle": {"center_enu_m": [0, 0], "radius_m": 1}}, "name of its own"),
    ({"name": "a"}, "one shape"),
    (
        {"name": "a", "circle": {"center_enu_m": [0, 0], "radius_m": 1}, "polygon_enu_m": [[0, 0]]},
        "one shape",
    ),
    ({"name": "a", "circle": {"center_enu_m": [0, 0], "radius_m": -1.0}}, "radius_m"),
    ({"name": "a", "polygon_enu_m": [[0, 0], [1, 1]]}, "has 3 to 200"),
    ({"name": "a", "polygon_enu_m": [[9, k * k] for k in range(201)]}, "201 corners"),
    ({"name": "a", "polygon_enu_m": [[2, 2], [3, 3], [3, 2], [2, 3]]}, "crosses itself"),
    ({"name": "a", "polygon_enu_m": [[3, 3], [3, 3], [4, 5]]}, "1 and 2 are the same point"),
    ({"name": "a", "polygon_enu_m": [[3, 3], [2e4, 3], [4, 5]]}, "beyond 10000 m"),
    ({"name": "a", "circle": {"center_enu_m": [0, 2e4], "radius_m": 1}}, "beyond 10000 m"),
    ({"name": "a", "polygon_enu_m": [[0, 0], [1, 1], [float("nan"), 0]]}, "not finite"),
    ({"name": "a", "circle": {"center_enu_m": [-1.5, -1.5], "radius_m": 0.2}}, "Move the start"),
    ({"name": "a", "colour": "red"}, "unknown key"),
    ({"name": "a", "polygon_enu_m": "round"}, "polygon_enu_m"),
]


def test_a_wrong_obstacle_is_refused_in_words():
    for obstacle, words in WRONG:
        with pytest.raises(ConfigError, match=words) as error:
            fleet_from_mapping(paper_data(obstacle), path="my.toml")
        assert "my.toml" in str(error.value), obstacle


def test_too_many_corners_and_circles_of_all_obstacles_are_refused():
    corners = [[20 + 3 * math.cos(0.0314 * k), 3 * math.sin(0.0314 * k)] for k in range(200)]
    rings = [{"name": f"ring {k}", "polygon_enu_m": corners} for k in range(5)]
    assert len(fleet_from_mapping(paper_data(*rings)).obstacles) == 5
    with pytest.raises(ConfigError, match="have 1001 corners and circles; 1000 are the most"):
        fleet_from_mapping(paper_data(*rings, PILLAR))


def test_two_obstacles_of_one_name_are_refused_and_obstacles_change_the_hash():
    plain = fleet_from_mapping(paper_data())
    pillared = fleet_from_mapping(paper_data(PILLAR))
    assert plain.config_hash != pillared.config_hash
    with pytest.raises(ConfigError, match="name of its own"):
        fleet_from_mapping(paper_data(PILLAR, PILLAR))


def test_pair_that_meets_at_a_pillar_passes_both_the_pillar_and_each_other():
    fleet = fleet_from_mapping(paper_data(PILLAR))
    model = closed_loop.fleet_model(fleet, ["mav0", "mav1"])
    starts = np.array([[[-2.5, 0.0, 1.0], [2.5, 0.0, 1.0]]] * 3)
    legs = np.array([[[[2.5, 0.0, 1.0], [-2.5, 0.0, 1.0]]]] * 3)
    scenario = closed_loop.Scenario(starts, legs, np.array([0.0]), 25.0)
    result = closed_loop.fly(scenario, model, [0, 1, 2], replace(CALM, start_m=0.05))
    assert result.is_success.all()
    assert result.min_separation_m.min() > 0.8
    assert nearest_to(fleet.obstacles[0], result.trace_enu_m) > 0.25 + 0.10


def test_walls_win_over_the_margin_of_a_neighbour_whose_position_is_uncertain():
    law = law_of({"fence_enu_m": FENCE})
    position = [2.6, 0.0, 1.0]
    velocity = [0.0, 0.0, 0.0]  # the limit of the speed does not matter to who stands
    # all that the wall allows
    wall = run(position, velocity, [9.0, 0.0, 0.0], [], law).thrust.thrust_enu_m_s2.x
    for std_m in (0.0, 0.2, 0.5):
        neighbour = neighbour_of([1.3, 0.1, 1.0], position_std_m=std_m)
        out = run(position, velocity, [0.0, 0.0, 0.0], [neighbour], law)
        # walls give a thousandth of the slack
        assert out.thrust.thrust_enu_m_s2.x <= wall + 0.05, std_m
    assert out.status == LawStatus.RELAXED  # of the margin alone


def test_a_wall_and_the_promise_share_what_is_missing_where_both_cannot_be_kept():
    law = law_of({"fence_enu_m": FENCE})
    position = [2.8, 0.0, 1.0]
    velocity = [0.0, 0.0, 0.0]
    wall = run(position, velocity, [9.0, 0.0, 0.0], [], law).thrust.thrust_enu_m_s2.x
    out = run(
        position, velocity, [0.0, 0.0, 0.0], [neighbour_of([2.1, 0.0, 1.0], [0.5, 0.0, 0.0])], law
    )
    assert out.status == LawStatus.RELAXED
    assert out.thrust.thrust_enu_m_s2.x > wall + 0.02
