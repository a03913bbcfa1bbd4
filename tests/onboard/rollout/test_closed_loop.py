"""The paper's mission, flown in closed loop with perturbations: what the law promises and what
happens without it.
"""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from onboard.config.fleet import load_fleet
from onboard.rollout import closed_loop
from onboard.rollout.vehicle_model import Perturbation
from onboard.types import TICK_S

STARTS = np.array([[-1.5, -1.5, 1.0], [0.0, -1.5, 1.0], [1.5, -1.5, 1.0]])
PERMUTATIONS = [list(order) for order in itertools.permutations(range(3))]
STILL = Perturbation(
    lag_share=0, gain_share=0, drag_share=0, hover_share=0, gust_m_s2=0, message_loss=0, start_m=0
)


def paper_mission(fleet, count):
    """Into the triangle at (0, 1.2) by every permutation of slots, on by (0, -2.4), and back by a
    second one.
    """
    slots = np.array(list(fleet.formations["triangle"].values()))
    away = np.array([0, 1.2, 1.0])
    home = np.array([0, -1.2, 1.0])
    legs = [
        [
            slots[PERMUTATIONS[k % 6]] + away,
            slots[PERMUTATIONS[k % 6]] + home,
            slots[PERMUTATIONS[k // 6 % 6]] + away,
        ]
        for k in range(count)
    ]
    return closed_loop.Scenario(
        np.repeat(STARTS[None], count, 0), np.array(legs), np.array([7.0, 5.0, 5.0]), 25.0
    )


def fly(fleet_name, law, count, seed=0, **options):
    fleet = load_fleet(f"configs/fleets/{fleet_name}.toml")
    model = closed_loop.fleet_model(fleet, list(fleet.vehicles), law)
    return closed_loop.fly(paper_mission(fleet, count), model, range(seed, seed + count), **options)


def max_speed_m_s(result):
    return np.linalg.norm(np.diff(result.trace_enu_m, axis=0), axis=-1).max() / TICK_S


@pytest.mark.parametrize("fleet_name", [pytest.param("paper", marks=pytest.mark.long), "sih"])
def test_72_perturbed_flights_of_the_mission_keep_080_m_and_all_arrive(fleet_name):
    result = fly(fleet_name, "covey", 72)
    assert result.min_separation_m.min() >= 0.80
    assert result.is_success.all()
    assert result.arrival_s.max() < 25.0
    assert np.median(result.arrival_s[:, 0]) < 8.0
    assert max_speed_m_s(result) < 1.5


@pytest.mark.long
def test_without_the_law_the_vehicles_collide():
    result = fly("paper", "off", 12)
    assert (result.min_separation_m < 0.5).sum() >= 8


@pytest.mark.long
def test_the_papers_ring_flies_the_mission_with_strong_vehicles_but_does_not_keep_its_distance():
    result = fly("sih", "paper", 6)
    assert result.is_success.sum() >= 4
    assert result.min_separation_m.min() > 0.5
    assert result.min_separation_m.min() < 0.80


@pytest.mark.long
def test_fleet_of_unequal_vehicles_keeps_its_distance():
    weak = load_fleet("configs/fleets/paper.toml")
    strong = load_fleet("configs/fleets/sih.toml")
    names = list(weak.vehicles)
    model = closed_loop.fleet_model(weak, names)
    strong_model = closed_loop.fleet_model(strong, names)
    params = [model.params[0], strong_model.params[1], model.params[2]]
    plants = [model.plants[0], strong_model.plants[1], model.plants[2]]
    result = closed_loop.fly(
        paper_mission(weak, 24), closed_loop.FleetModel(params, plants), range(24)
    )
    assert result.min_separation_m.min() >= 0.80
    assert result.is_success.mean() > 0.95


def test_a_flight_alone_equals_the_same_flight_in_a_batch():
    fleet = load_fleet("configs/fleets/sih.toml")
    model = closed_loop.fleet_model(fleet, list(fleet.vehicles))
    scenario = replace(paper_mission(fleet, 4), timeout_s=3.0)
    together = closed_loop.fly(scenario, model, [5, 6, 7, 8])
    one = closed_loop.Scenario(
        scenario.start_enu_m[2:3], scenario.legs_enu_m[2:3], scenario.duration_s, 3.0
    )
    alone = closed_loop.fly(one, model, [7])
    length = min(len(alone.trace_enu_m), len(together.trace_enu_m))
    np.testing.assert_allclose(
        alone.trace_enu_m[:length, 0], together.trace_enu_m[:length, 2], atol=1e-6
    )


def test_what_a_flight_does_after_its_end_changes_nothing_of_its_result():
    fleet = load_fleet("configs/fleets/sih.toml")
    model = closed_loop.fleet_model(fleet, list(fleet.vehicles))
    waits = STARTS[None]
    moves = STARTS[None] + np.array([0.0, 1.0, 0.0])
    scenario = closed_loop.Scenario(
        start_enu_m=np.repeat(STARTS[None], 2, 0),
        legs_enu_m=np.array([waits, moves]),
        duration_s=np.array([2.0]),
        timeout_s=5.0,
    )
    gusts = Perturbation(start_m=0.0, gust_m_s2=0.5)
    together = closed_loop.fly(scenario, model, [5, 6], gusts)
    one = replace(scenario, start_enu_m=STARTS[None], legs_enu_m=waits[None])
    alone = closed_loop.fly(one, model, [5], gusts)

    assert len(alone.trace_enu_m) < len(together.trace_enu_m)
    np.testing.assert_allclose(together.positions_enu_m(0), alone.positions_enu_m(0), atol=1e-9)
    assert together.min_separation_m[0] == pytest.approx(alone.min_separation_m[0], abs=1e-9)
    assert together.ticks[1] == len(together.trace_enu_m)


def test_repeating_a_flight_gives_the_same_bytes():
    fleet = load_fleet("configs/fleets/sih.toml")
    model = closed_loop.fleet_model(fleet, list(fleet.vehicles))
    scenario = replace(paper_mission(fleet, 2), timeout_s=2.0)
    one, two = (closed_loop.fly(scenario, model, [1, 2]) for _ in range(2))
    assert one.trace_enu_m.tobytes() == two.trace_enu_m.tobytes()


def test_weak_vehicle_alone_ends_within_5_cm_in_spite_of_static_gain_and_tilt_bias():
    fleet = load_fleet("configs/fleets/paper.toml")
    model = closed_loop.fleet_model(fleet, ["mav0"])
    legs = np.array([[[[1.0, 1.5, 1.2]]]])
    scenario = closed_loop.Scenario(
        np.array([[[0.0, 0.0, 1.0]]]), legs, np.array([4.0]), 12.0, settle_s=3.0
    )
    result = closed_loop.fly(scenario, model, [0], perturbation=STILL)
    assert result.is_success.all()
    assert np.hypot(*(result.trace_enu_m[-1, 0, 0] - legs[0, 0, 0])[:2]) < 0.05
    assert abs(result.trace_enu_m[-1, 0, 0, 2] - 1.2) < 0.05
    assert max_speed_m_s(result) < 1.2


def test_vehicle_that_cannot_arrive_ends_its_leg_at_the_timeout_and_says_so():
    fleet = load_fleet("configs/fleets/paper.toml")
    model = closed_loop.fleet_model(fleet, ["mav0"])
    scenario = closed_loop.Scenario(
        np.zeros((1, 1, 3)), np.full((1, 1, 1, 3), 50.0), np.array([0.0]), 1.0
    )
    result = closed_loop.fly(scenario, model, [0])
    assert not result.is_success.any()
    assert np.isinf(result.arrival_s).all()
    assert TICK_S * len(result.trace_enu_m) == pytest.approx(1.0, abs=0.03)


def test_legs_of_vehicles_that_are_all_parked_end_at_once():
    fleet = load_fleet("configs/fleets/paper.toml")
    model = closed_loop.fleet_model(fleet, ["mav0"])
    scenario = closed_loop.Scenario(
        np.zeros((1, 1, 3)), np.full((1, 2, 1, 3), 5.0), np.zeros(2), 1.0, is_parked=(True,)
    )
    result = closed_loop.fly(scenario, model, [0])
    assert result.arrival_s.tolist() == [[0.0, 0.0]]
    assert result.ticks.tolist() == [2]
