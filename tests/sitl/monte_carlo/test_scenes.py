"""Scenes of the open benchmark: what their files may say, and the flights that come of them."""

import json
from typing import Any

import numpy as np
import pytest

from groundstation.cli import main
from onboard.config.fleet import ConfigError
from sitl.monte_carlo import batch_flight, results
from sitl.monte_carlo.open_benchmark import scene_file, scene_plans

SCENE: Any = {
    "schema": 1,
    "name": "two",
    "about": "Two vehicles change places.",
    "placing": {
        "type": "listed",
        "start_enu_m": [[-1.5, 0], [1.5, 0]],
        "goal_enu_m": [[1.5, 0], [-1.5, 0]],
    },
}


def scene_of(**changes):
    return scene_file.parsed(json.dumps({**SCENE, **changes}).encode(), "two.json")


def flown(scene, law="covey", seeds=(3,), changes=()):
    setup = scene_plans.setup(scene, law=law, changes=changes)
    return batch_flight.fly([scene_plans.plan(scene, seed) for seed in seeds], setup)


@pytest.mark.parametrize("name", scene_file.names())
def test_each_scene_of_the_package_can_be_flown_and_is_named_after_its_file(name):
    scene = scene_file.load(f"{name}.json")
    assert scene.name == name
    assert scene.about.endswith(".")
    scene_plans.setup(scene)


def test_the_seed_alone_decides_a_plan():
    scene = scene_file.load("random.json")
    one, again, other = (scene_plans.plan(scene, seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(one.start_enu_m, again.start_enu_m)
    np.testing.assert_array_equal(one.goal_enu_m, again.goal_enu_m)
    assert np.abs(one.goal_enu_m - other.goal_enu_m).max() > 0.5


def test_no_two_goals_of_a_lifelong_flight_are_near_each_other():
    plan = scene_plans.plan(scene_file.load("lifelong.json"), 0)
    points = [(x, y) for x, y, _ in plan.goals_enu_m.reshape(-1, 3).tolist()]
    assert len(points) == 18
    assert scene_file.least_distance_m(points) >= 1.4


def test_a_goal_may_be_where_another_vehicle_still_is_but_not_where_one_stays():
    plan = scene_plans.plan(scene_file.load("exchange.json"), 0)
    turns = plan.goals_enu_m[..., :2]
    assert turns.shape == (60, 6, 2)

    last = turns[-1]
    for turn in turns[:-1]:
        points = [(x, y) for x, y in np.concatenate([turn, last]).tolist()]
        assert scene_file.least_distance_m(points) >= 1.4
    consecutive = turns[1:20, :, None] - turns[:19, None, :]
    assert np.hypot(*np.moveaxis(consecutive, -1, 0)).min() < 0.8


@pytest.mark.long
def test_a_goal_beside_another_vehicle_is_reached_once_that_one_has_left():
    square = {
        "type": "square",
        "vehicles": 6,
        "side_m": 7.0,
        "goals_each": 8,
        "goals_apart": "last",
    }
    scene = scene_of(placing=square, within_s=200.0)
    for seed in range(3):
        (one,) = batch_flight.fly([scene_plans.plan(scene, seed)], scene_plans.setup(scene))
        assert one.outcome.is_success
        assert one.outcome.min_separation_m > 0.8


def test_points_are_drawn_clear_of_obstacles():
    pillars = [
        {"begin_enu_m": [x, y], "radius_m": 0.3} for x in (-3, -1, 1, 3) for y in (-3, -1, 1, 3)
    ]
    square = {"type": "square", "vehicles": 6, "side_m": 9.0}
    plan = scene_plans.plan(scene_of(placing=square, obstacles=pillars, jitter_m=0.0), 1)
    for points_enu_m in (plan.start_enu_m, plan.goal_enu_m):
        for x_m, y_m, _ in points_enu_m:
            gaps_m = [np.hypot(x_m - x, y_m - y) for x in (-3, -1, 1, 3) for y in (-3, -1, 1, 3)]
            assert min(gaps_m) >= 0.3 + 0.25 + 0.4


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"speed": 3}, "unknown key 'scene.speed'. Known keys here: schema, name"),
        ({"schema": 2}, 'Write "schema": 1'),
        ({"name": "../two"}, "'name' is '../two'"),
        ({"placing": {"type": "ring", "vehicles": 2}}, "scene.placing"),
        ({"placing": {"type": "circle", "vehicles": 251, "radius_m": 60}}, "between 1 and 250"),
        ({"placing": {"type": "square", "vehicles": 50, "side_m": 9.0}}, "placing.side_m"),
        ({"placing": {"type": "square", "vehicles": 50, "side_m": 9.0}}, "50 places that are"),
        ({"placing": {**SCENE["placing"], "goal_enu_m": [[0, 0]]}}, "2 starts and 1 goals"),
        ({"obstacles": [{"begin_enu_m": [0, 1e9], "radius_m": 1}]}, "obstacles.begin_enu_m"),
        ({"obstacles": [{"begin_enu_m": [0, 0], "radius_m": 0}]}, "obstacles.radius_m"),
        ({"obstacles": [{"begin_enu_m": [0, 0], "radius": 1}]}, "Did you mean 'radius_m'?"),
        ({"intruder": {"speed": 1}}, "Known keys here: "),
        ({"blind": [2]}, "'blind' is 2"),
        ({"others": {"law": "off", "vehicles": [-1]}}, "'others.vehicles' is -1"),
        ({"others": {"law": "orcca", "vehicles": [0]}}, "'others.law' is 'orcca', but there"),
        ({"within_s": 0}, "'within_s' is 0"),
        ({"jitter_m": 2}, "'jitter_m' is 2"),
        ({"set": {"wnd_m_s": 2.0}}, "'set' has wnd_m_s=2.0: there is no such key. Did you mean"),
        ({"set": {"delay_s": 9.0}}, "'set' has delay_s=9.0: the value must be a number from 0"),
    ],
)
def test_a_wrong_scene_is_refused_in_a_sentence_that_names_the_file_and_the_key(changes, words):
    with pytest.raises(ConfigError) as refusal:
        scene_of(**changes)
    assert str(refusal.value).startswith("two.json: ")
    assert words in str(refusal.value)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"[1]", "must be a table"),
        (b"{", "is no JSON"),
        (b"[" * 100 + b"]" * 100, "nested too deeply"),
        (b'{"schema": 1e999}', "is no JSON"),
    ],
)
def test_a_file_that_is_no_scene_is_refused_in_a_sentence(data, words):
    with pytest.raises(ConfigError, match=words):
        scene_file.parsed(data, "two.json")


def test_a_scene_that_is_not_there_is_refused_with_those_that_are(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"circl.json: there is no such scene.* circle.json, "):
        scene_file.load("circl.json")


def test_one_picture_for_many_flights_is_refused_with_how_to_fly_one(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "circle.json", "--plot", "circle.png"]) == 2
    assert "--seeds 0:1" in capsys.readouterr().err


def test_a_scene_that_cannot_be_held_is_refused_before_it_flies():
    near = {**SCENE["placing"], "goal_enu_m": [[0.3, 0], [-0.3, 0]]}
    with pytest.raises(ConfigError, match=r"two vehicles end 0.60 m from each other"):
        scene_plans.setup(scene_of(placing=near))

    pillar = {"begin_enu_m": [1.5, 0.2], "radius_m": 0.3}
    with pytest.raises(ConfigError, match="would start in an obstacle"):
        scene_plans.setup(scene_of(obstacles=[pillar]))


def test_values_of_the_scene_are_set_and_those_of_the_command_come_after_them():
    scene = scene_of(set={"delay_s": 0.3, "vehicle.max_speed_m_s": 2.0})
    setup = scene_plans.setup(scene, changes=["delay_s=0.1"])
    assert setup.perturbation.delay_s == 0.1
    assert setup.fleet(1).vehicles["v0"].max_speed_m_s == 2.0


def test_a_scene_that_names_no_type_flies_with_the_first_type_of_a_fleet_file(tmp_path):
    assert main(["init", str(tmp_path / "made")]) == 0
    fleet_path = str(tmp_path / "made" / "fleet.toml")
    assert "sih" not in scene_plans.setup(scene_of(), fleet_path=fleet_path).types
    assert scene_plans.setup(scene_of()).types == ("sih",)
    with pytest.raises(ConfigError, match="There is no vehicle type 'paper'"):
        scene_plans.setup(scene_of(type="paper"), fleet_path=fleet_path)


@pytest.mark.long
def test_a_blind_vehicle_flies_straight_on_and_the_other_one_gives_way():
    (one,) = flown(scene_of(jitter_m=0.0, blind=[0]))
    assert one.outcome.min_separation_m > 0.8

    (both,) = flown(scene_of(jitter_m=0.0, blind=[0, 1]))
    assert both.outcome.min_separation_m < 0.3


@pytest.mark.long
def test_vehicles_of_another_law_fly_by_it():
    others = {"law": "off", "vehicles": [0, 1]}
    (all_off,) = flown(scene_of(jitter_m=0.0, others=others))
    (off,) = flown(scene_of(jitter_m=0.0), law="off")
    assert all_off.outcome.min_separation_m == off.outcome.min_separation_m < 0.3


def test_a_law_is_called_for_its_own_vehicles_and_each_refused_law_is_named(tmp_path, monkeypatch):
    (tmp_path / "west.py").write_text(
        "def law(memory, inputs):\n"
        "    east_m, north_m, _ = inputs.state.position_enu_m\n"
        "    assert east_m < 0 and north_m < 2, 'another vehicle'\n"
        "    return None, inputs.baseline\n"
    )
    (tmp_path / "idle.py").write_text("def law(memory, inputs):\n    return None\n")
    monkeypatch.chdir(tmp_path)
    intruder = {"start_enu_m": [-1, 5], "velocity_enu_m_s": [0, 1], "leaves_s": 1}
    others = {"law": "idle:law", "vehicles": [1]}
    refusal = "idle:law returned nothing instead of the pair (memory, thrust)"

    def refused(law):
        scene = scene_of(intruder=intruder, others=others, within_s=1.0)
        [one] = flown(scene, law=law)
        return one.law_refusal

    assert refused("west:law") == refusal
    assert refused("covey") == refusal
    assert refused("idle:law") == f"{refusal}; {refusal}"


@pytest.mark.long
def test_the_next_goal_is_given_on_arrival_and_all_must_be_reached():
    square = {"type": "square", "vehicles": 2, "side_m": 6.0, "goals_each": 3}
    scene = scene_of(placing=square)
    plan = scene_plans.plan(scene, 3)
    setup = scene_plans.setup(scene)
    (one,) = batch_flight.fly([plan], setup, has_trace=True)

    assert one.outcome.is_success
    assert one.outcome.path_ratio == pytest.approx(1.0, abs=0.25)
    assert one.outcome.trace is not None
    for vehicle in range(2):
        path = one.outcome.trace.position_enu_m[:, vehicle]
        for goal in plan.goals_enu_m[:, vehicle]:
            assert np.linalg.norm(path - goal, axis=1).min() < 0.15


def test_a_flight_fails_after_the_time_of_its_scene_and_has_no_ratio():
    (one,) = flown(scene_of(within_s=1.0))
    assert not one.outcome.is_success
    assert one.outcome.duration_s == pytest.approx(1.5)

    endless = batch_flight.Flown(one.plan, one.outcome, straight_line_s=np.inf)
    assert np.isnan(results.ratio(one))
    assert np.isnan(results.ratio(endless))


@pytest.mark.long
def test_hovering_for_a_second_costs_a_second_of_hovering():
    still = {**SCENE["placing"], "goal_enu_m": SCENE["placing"]["start_enu_m"]}
    calm = {"gust_m_s2": 0.0, "lag_mismatch": 0.0, "gain": 0.0}
    (one,) = flown(scene_of(placing=still, jitter_m=0.0, errors="none", set=calm))
    assert one.outcome.energy_hover_s == pytest.approx(one.outcome.duration_s, rel=0.01)


WALKER = {"start_enu_m": [-5.0, 0.1], "velocity_enu_m_s": [1.0, 0.0], "leaves_s": 10.0}
HOVERING = {"type": "listed", "start_enu_m": [[0.0, 0.0]], "goal_enu_m": [[0.0, 0.0]]}


def test_an_intruder_flies_by_no_commands_that_could_be_measured():
    calm = {"gust_m_s2": 0.0, "lag_mismatch": 0.0, "gain": 0.0}
    passer = {**WALKER, "start_enu_m": [-30.0, 0.0], "leaves_s": 2.0}
    scene = scene_of(placing=HOVERING, intruder=passer, jitter_m=0.0, errors="none", set=calm)
    [one] = flown(scene)

    outcome = one.outcome
    assert outcome.energy_hover_s == pytest.approx(outcome.duration_s, rel=0.01)
    assert outcome.slew_rms_m_s3 < 0.1
    assert outcome.intervention_m_s2 < 0.01


def test_the_distance_from_a_person_is_measured_and_kept_to_the_circle():
    def nearest_m(law, radius_m):
        intruder = {**WALKER, "person_radius_m": radius_m}
        scene = scene_of(placing=HOVERING, intruder=intruder, jitter_m=0.0)
        [one] = flown(scene, law=law)
        return one.outcome.min_separation_m

    assert nearest_m("off", 0.4) == pytest.approx(nearest_m("off", 0.0) - 0.4, abs=1e-9)
    assert nearest_m("covey", 0.4) > 0.8
    assert 0.8 < nearest_m("covey", 0.0) < nearest_m("covey", 0.4) + 0.4


# Flies into a wall beside the way to the goal, and only then to the goal.
_LAW_INTO_A_WALL = """
def law(memory, inputs):
    ((east, north, _),) = inputs.baseline
    if inputs.state.position_enu_m[0] < 0:
        north = 1.5
    return None, inputs.limited(east, north)
"""


@pytest.mark.parametrize(
    ("law", "sentence"),
    [
        (_LAW_INTO_A_WALL, "a body touched an obstacle or another body"),
        ("def law(memory, inputs):\n    return 1 / 0\n", "Covey's law took over"),
    ],
)
def test_a_flight_through_a_wall_or_by_another_law_is_no_success_of_a_law(
    law, sentence, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(law)
    placing = {"type": "listed", "start_enu_m": [[-3, 0]], "goal_enu_m": [[3, 0]]}
    wall = {"begin_enu_m": [-4, 0.9], "end_enu_m": [4, 0.9], "radius_m": 0.2}
    scene = {**SCENE, "name": "one", "placing": placing, "obstacles": [wall]}
    (tmp_path / "one.json").write_text(json.dumps(scene))

    assert main(["simulate", "one.json", "--seeds", "0", "--law", "mine:law"]) == 1
    printed = " ".join(capsys.readouterr().out.split())
    assert f"one seed 0: {sentence}" in printed
