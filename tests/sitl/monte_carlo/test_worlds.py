"""The same flights on other physics: refused in words without the library, flown with it."""

import sys

import numpy as np
import pytest

from groundstation.cli import main
from onboard.config.fleet import ConfigError
from sitl.monte_carlo import batch_flight, campaign_settings, scenarios, worlds
from sitl.monte_carlo.noise import FlightNoise
from sitl.monte_carlo.open_benchmark import scene_plans, suite


def world_of(scenario, seeds=(0,), scripted_m_s=None, **options):
    setup = campaign_settings.setup_for()
    plans = [scenarios.plan(scenario, seed) for seed in seeds]
    start = np.stack([plan.start_enu_m for plan in plans])
    scripted = np.full(start.shape, np.nan)
    if scripted_m_s is not None:
        scripted[:, -1] = scripted_m_s
    return worlds.world_of("rotorpy")(
        vehicles=list(setup.fleet(plans[0].count).vehicles.values()),
        start_enu_m=start,
        scripted=scripted,
        noise=FlightNoise(seeds, plans[0].count, has_links=False),
        perturbation=setup.perturbation,
        seeds=seeds,
        **options,
    )


def test_an_unknown_physics_is_refused_in_words(capsys):
    assert main(["simulate", "swap2", "--physics", "bullet"]) == 2
    assert "there are only emulator, rotorpy" in capsys.readouterr().err


def test_physics_of_a_library_that_is_missing_is_refused_in_words(monkeypatch):
    monkeypatch.setitem(sys.modules, "rotorpy.vehicles.multirotor", None)
    with pytest.raises(ConfigError, match="pip install 'rotorpy"):
        world_of("swap2")


def test_vehicles_above_each_other_are_refused_where_there_is_no_downwash():
    with pytest.raises(ConfigError, match="no downwash"):
        world_of("swap2", wash_diameter_m=0.5)


@pytest.mark.parametrize(
    "change", ["gain=0.1", "drag_mismatch=0.2", "hover_mismatch=0.1", "lag_error_s=0.1"]
)
def test_a_value_without_effect_in_a_physics_is_refused_before_the_flight(change, capsys):
    words = ["simulate", "swap2", "--seeds", "0", "--set", change]
    assert main([*words, "--physics", "rotorpy"]) == 2
    said = capsys.readouterr().err
    assert f"{change.partition('=')[0]} is set, and it has no effect with --physics" in said
    assert "fly with --physics emulator." in said


def test_of_the_profile_only_the_noise_of_the_thrust_has_an_effect_in_rotorpy():
    setup = campaign_settings.setup_for(changes=["sitl.thrust_noise_frac=0.1", "lag_mismatch=0.2"])
    worlds.refuse_unused("rotorpy", setup)
    worlds.refuse_unused("emulator", campaign_settings.setup_for(changes=["sitl.motor_lag_s=0.1"]))
    with pytest.raises(ConfigError, match=r"sitl\.motor_lag_s is set"):
        worlds.refuse_unused(
            "rotorpy", campaign_settings.setup_for(changes=["sitl.motor_lag_s=0.1"])
        )


@pytest.mark.parametrize("name", worlds.WORLDS)
def test_a_value_that_only_flights_with_agents_use_is_refused(name):
    setup = campaign_settings.setup_for(changes=["sitl.gust_std_m_s2=0.5"])
    with pytest.raises(ConfigError, match="has no effect") as refused:
        worlds.refuse_unused(name, setup)
    assert "fly with" not in str(refused.value)


def test_all_scenes_of_the_suite_fly_in_each_physics():
    for scene in suite.scenes():
        for name in worlds.WORLDS:
            worlds.refuse_unused(name, scene_plans.setup(scene))


def test_an_intruder_has_its_velocity_at_the_start():
    pytest.importorskip("rotorpy")
    velocities = world_of("swap3", scripted_m_s=(1.0, 0.5, 0.0)).truth().velocity_enu_m_s
    np.testing.assert_array_equal(velocities[0, :, :2], [[0.0, 0.0], [0.0, 0.0], [1.0, 0.5]])


def test_vehicles_of_rotorpy_hover_and_an_intruder_flies_straight_on():
    pytest.importorskip("rotorpy")
    world = world_of("swap3", seeds=(0, 1), scripted_m_s=(1.0, 0.0, 0.0))
    begin = world.truth()
    hover_frac = campaign_settings.setup_for().fleet(3).vehicles["v0"].hover_thrust_frac

    for _ in range(10):
        level = np.zeros((*begin.position_enu_m.shape[:2], 4))
        level[..., 0] = 1.0
        world.advance(level, np.full(level.shape[:2], hover_frac), np.zeros((2, 3, 9)))

    moved = world.truth().position_enu_m - begin.position_enu_m
    np.testing.assert_allclose(moved[:, :2], 0.0, atol=1e-3)
    np.testing.assert_allclose(moved[:, 2], [[0.2, 0.0, 0.0]] * 2, atol=1e-9)

    world.keep(np.array([1]))
    np.testing.assert_allclose(world.truth().yaw_rad, 0.0, atol=1e-6)
    assert world.truth().position_enu_m.shape == (1, 3, 3)


@pytest.mark.long
def test_a_pair_changes_places_on_rotorpy():
    pytest.importorskip("rotorpy")
    setup = campaign_settings.setup_for()
    (flown,) = batch_flight.fly([scenarios.plan("swap2", 1000)], setup, physics="rotorpy")
    assert flown.outcome.is_success
    assert flown.outcome.min_separation_m > 0.8
    assert flown.outcome.makespan_s < 1.3 * flown.straight_line_s
