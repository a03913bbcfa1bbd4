"""The public scenarios: geometry, and that a seed alone decides it."""

import itertools

import numpy as np
import pytest

from onboard.config.fleet import ConfigError
from sitl.monte_carlo import scenarios


def nearest(points):
    gap = points[:, None, :2] - points[None, :, :2]
    return np.sqrt((gap**2).sum(-1))[np.triu_indices(len(points), 1)].min()


def test_form3_goes_into_a_triangle_of_side_160_cm_by_all_permutations_and_both_durations():
    plans = [scenarios.plan("form3", seed) for seed in range(12)]
    for plan in plans:
        sides = [
            np.hypot(*(plan.goal_enu_m[i] - plan.goal_enu_m[j])[:2])
            for i, j in itertools.combinations(range(3), 2)
        ]
        np.testing.assert_allclose(sides, 1.6, atol=1e-12)
        np.testing.assert_allclose(plan.goal_enu_m.mean(0)[:2], [0.0, 1.2], atol=1e-12)
        assert np.abs(plan.start_enu_m[:, :2] - [[-1.5, -1.5], [0, -1.5], [1.5, -1.5]]).max() < 0.5
    orders = {tuple(np.round(plan.goal_enu_m[:, 0], 6)) for plan in plans}
    assert len(orders) == 6
    assert {(plan.duration_s, tuple(np.round(plan.goal_enu_m[:, 0], 6))) for plan in plans} == {
        (duration, order) for duration in (7.0, 5.0) for order in orders
    }


@pytest.mark.parametrize("count", [2, 3, 8, 16, 64, 100])
def test_swap_takes_everybody_to_the_opposite_place_of_the_circle(count):
    exact = scenarios.plan(f"swap{count}x", 5)
    radius = max(2.5, 1.25 * count / (2 * np.pi))
    np.testing.assert_allclose(np.hypot(*exact.start_enu_m[:, :2].T), radius)
    np.testing.assert_allclose(exact.goal_enu_m[:, :2], -exact.start_enu_m[:, :2])
    jitter = scenarios.plan(f"swap{count}", 5).start_enu_m - exact.start_enu_m
    assert 0.0 < np.abs(jitter[:, :2]).max() < 0.25
    assert np.abs(scenarios.plan(f"swap{count}x", 6).start_enu_m - exact.start_enu_m).max() == 0.0


@pytest.mark.parametrize(
    ("name", "area"),
    [("rand4", 6), ("rand16d4", 4), ("rand16d10", 10), ("rand32", 6), ("rand100", 6)],
)
def test_rand_fills_its_square_with_starts_and_goals_140_cm_apart(name, area):
    plan = scenarios.plan(name, 3)
    half = 0.5 * np.sqrt(area * plan.count)
    for points in (plan.start_enu_m, plan.goal_enu_m):
        assert nearest(points) >= 1.4
        assert np.abs(points[:, :2]).max() <= half


@pytest.mark.parametrize("angle", [90, 180])
def test_cross_sends_two_blocks_through_each_other(angle):
    plan = scenarios.plan(f"cross8@{angle}", 1)
    way = (plan.goal_enu_m - plan.start_enu_m)[:, :2]
    first = way[:4].mean(0)
    second = way[4:].mean(0)
    cosine = first @ second / np.hypot(*first) / np.hypot(*second)
    assert cosine == pytest.approx(np.cos(np.radians(angle)), abs=0.05)
    assert nearest(plan.start_enu_m) > 0.9
    assert nearest(plan.goal_enu_m) == pytest.approx(1.2)


def test_squeeze_moves_the_outer_two_in_and_leaves_the_middle_one():
    plan = scenarios.plan("squeeze", 2)
    assert np.abs(plan.goal_enu_m[1, :2]).max() == 0.0
    assert (np.abs(plan.goal_enu_m[[0, 2], 0]) < np.abs(plan.start_enu_m[[0, 2], 0])).all()
    assert nearest(plan.goal_enu_m) >= 1.0


@pytest.mark.parametrize("speed", [1, 2])
def test_intruder_flies_straight_through_the_formation_at_its_speed(speed):
    plan = scenarios.plan(f"intruder@{speed}", 4)
    assert plan.intruder_m_s is not None
    assert np.hypot(*plan.intruder_m_s[:2]) == pytest.approx(speed)
    end = plan.start_enu_m[-1] + plan.intruder_m_s * plan.earliest_s
    np.testing.assert_allclose(end, plan.goal_enu_m[-1])
    np.testing.assert_allclose(plan.start_enu_m[:-1], plan.goal_enu_m[:-1])
    ways = (
        np.linspace(plan.start_enu_m[-1], end, 200)[:, None, :2] - plan.start_enu_m[None, :-1, :2]
    )
    assert np.hypot(*np.moveaxis(ways, -1, 0)).min() < 2.0


def test_lost_loses_one_vehicle_frozen_and_silent_in_turn_or_as_named():
    def how_lost(name, seed):
        lost = scenarios.plan(name, seed).lost
        assert lost is not None
        return lost[2]

    assert [how_lost("lost", seed) for seed in range(4)] == [
        "frozen",
        "silent",
        "frozen",
        "silent",
    ]
    assert how_lost("lost6@dead", 0) == "dead"
    assert scenarios.plan("lost6", 0).count == 6


@pytest.mark.parametrize("name", [*scenarios.MIX, "cross", "squeeze", "intruder", "lost"])
def test_seed_alone_decides_and_all_start_apart_at_one_height(name):
    plan = scenarios.plan(name, 17)
    again = scenarios.plan(name, 17)
    assert plan.start_enu_m.tobytes() == again.start_enu_m.tobytes()
    assert plan.goal_enu_m.tobytes() == again.goal_enu_m.tobytes()
    assert nearest(plan.start_enu_m) > 0.8
    assert nearest(plan.goal_enu_m) > 0.8
    assert set(plan.start_enu_m[:, 2]) == set(plan.goal_enu_m[:, 2]) == {scenarios.HEIGHT_M}


def test_scale_multiplies_every_spacing_and_leaves_the_height():
    plan = scenarios.plan("rand8", 3)
    wide = scenarios.plan("rand8", 3, scale=2.5)
    np.testing.assert_allclose(wide.start_enu_m[:, :2], 2.5 * plan.start_enu_m[:, :2])
    np.testing.assert_allclose(wide.goal_enu_m[:, 2], plan.goal_enu_m[:, 2])


@pytest.mark.parametrize(
    "name", ["swap", "swap1", "swap0x", "swap9999", "rand16d1", "form4", "cross8@45", "", "swap8X"]
)
def test_unknown_scenario_is_a_sentence(name):
    with pytest.raises(ConfigError, match=r"is not a scenario\. Known|takes|fit from"):
        scenarios.expand([name])
