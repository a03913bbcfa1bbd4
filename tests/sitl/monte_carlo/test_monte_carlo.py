"""``covey simulate``: the same digits for the same seed, honest judgement, bad input refused."""

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from groundstation.cli import main
from groundstation.cli import main as covey
from onboard.config.fleet import ConfigError
from onboard.control.pipeline import pipeline_params
from onboard.rollout import batch as rollout_batch
from onboard.rollout import layouts
from sitl.monte_carlo import (
    batch_flight,
    campaign_settings,
    process_chunks,
    radio,
    results,
    scenarios,
)

KEYS = {
    *(
        "scenario",
        "seed",
        "law",
        "success",
        "min_separation_m",
        "violation_s",
        "collision",
        "makespan_s",
    ),
    *(
        "straight_line_s",
        "relaxed_share",
        "ratio",
        "reason",
        "slew_rms_m_s3",
        "max_speed_m_s",
        "violation_depth_m",
    ),
    *("intervention_m_s2", "path_ratio"),
}
STILL = ("delay_s=0", "loss_share=0", "gust_m_s2=0", "lag_mismatch=0", "gain=0")


def fly(name, seeds, *, setup=None, has_trace=True):
    setup = setup or campaign_settings.setup_for()
    return batch_flight.fly(
        [scenarios.plan(name, seed, scale=setup.scale) for seed in seeds],
        setup,
        has_trace=has_trace,
    )


def judged(trace, limit_m, body_m):
    """Independent of the judge: smallest horizontal distance, time below the limit, collision."""
    nearest = [
        min(np.hypot(*(sample[i] - sample[j])[:2]) for i in range(len(sample)) for j in range(i))
        for sample in trace["position_enu_m"]
    ]
    step_s = np.diff(trace["t_s"])[0]
    return min(nearest), step_s * sum(d < limit_m for d in nearest), min(nearest) < body_m


@pytest.mark.parametrize(
    ("name", "errors", "types"),
    [
        pytest.param("form3", "mocap", "sih", marks=pytest.mark.long),
        ("swap2x", "mocap", "sih,ardrone"),
        ("rand4", "vision", "sih"),
        ("intruder2@2", "none", "sih"),
        ("lost4", "mocap", "sih"),  # a new leg in the middle of one flight of the batch
        pytest.param("rand1", "mocap", "sih", marks=pytest.mark.long),
    ],
)
def test_flight_alone_is_bit_for_bit_the_same_flight_in_a_batch(name, errors, types):
    setup = campaign_settings.setup_for(errors=errors, types=types)
    together = fly(name, range(5, 8), setup=setup)
    alone = fly(name, [6], setup=setup)
    assert (
        together[1].outcome.trace.position_enu_m.tobytes()
        == alone[0].outcome.trace.position_enu_m.tobytes()
    )
    one, two = (results.line(results.record(flown, setup)) for flown in (together[1], alone[0]))
    assert one == two


@pytest.mark.long
def test_lines_are_the_same_again_in_other_chunks_and_over_two_processes(capsys):
    lines = []
    for words in (["--seeds", "0:4"], ["--seeds", "0:4", "--jobs", "2"], ["--seeds", "0:3"]):
        assert main(["simulate", "form3", "--json", *words]) == 0
        lines.append(capsys.readouterr().out.splitlines())
    assert lines[0] == lines[1]
    assert lines[0][:3] == lines[2]
    values = [json.loads(line) for line in lines[0]]
    assert [value["seed"] for value in values] == [0, 1, 2, 3]
    assert all(value.keys() >= KEYS for value in values)


def test_the_simulated_fleet_is_valid_for_many_vehicles_at_the_largest_distance():
    setup = campaign_settings.setup_for(changes=["fleet.safety_distance_m=50"])
    assert len(setup.fleet(255).vehicles) == 255


def test_what_an_own_law_prints_does_not_come_between_the_lines(tmp_path, capsys, monkeypatch):
    (tmp_path / "law_that_prints.py").write_text(
        """\
print("imported")


def law(memory, inputs):
    if memory is None:
        print("begins")
    return 1, inputs.baseline
"""
    )
    monkeypatch.chdir(tmp_path)
    words = ["simulate", "rand1", "--law", "law_that_prints:law", "--seeds", "0", "--json"]
    assert main(words) == 0
    printed = capsys.readouterr()
    (line,) = printed.out.splitlines()
    assert json.loads(line)["law"] == "law_that_prints:law"
    assert {"imported", "begins"} <= set(printed.err.splitlines())


def test_trace_shows_what_the_line_says_and_without_the_law_they_collide(tmp_path, capsys):
    assert (
        main(
            [
                "simulate",
                "form3",
                "--law",
                "off",
                "--seeds",
                "0:6",
                "--json",
                "--trace",
                str(tmp_path),
            ]
        )
        == 1
    )
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert sum(line["collision"] for line in lines) >= 2
    for line in lines:
        with np.load(tmp_path / f"form3-{line['seed']}.npz") as trace:
            nearest, violation_s, is_collision = judged(trace, 0.8, 0.5)
            assert line["min_separation_m"] == pytest.approx(nearest, abs=1e-8)
            assert line["violation_s"] == pytest.approx(violation_s, abs=1e-8)
            assert line["collision"] == is_collision
            steps = np.diff(trace["t_s"])
            assert steps.max() <= 0.02 + 1e-9
            assert trace["position_enu_m"].shape == (len(trace["t_s"]), 3, 3)
            assert trace["t_s"][-1] == pytest.approx(line["duration_s"])
            away = np.linalg.norm(trace["position_enu_m"] - trace["goal_enu_m"], axis=-1)
            arrived = trace["t_s"] >= line["makespan_s"] - 1e-9
            assert away[arrived].max() < 0.15


@pytest.mark.long
def test_law_off_takes_the_straight_line_time_and_the_law_at_least_that():
    setup = campaign_settings.setup_for(law="off")
    for flown in fly("swap3x", [1, 2], setup=setup, has_trace=False):
        assert flown.outcome.makespan_s == flown.straight_line_s
    for flown in fly("swap3x", [1, 2], has_trace=False):
        assert flown.outcome.is_success
        assert 1.0 <= flown.outcome.makespan_s / flown.straight_line_s < 2.0
        assert flown.outcome.min_separation_m >= 0.8


def test_two_laws_meet_the_same_vehicles_noise_and_straight_line():
    covey_ = fly("rand4", [3])
    off = fly("rand4", [3], setup=campaign_settings.setup_for(law="off"))
    assert covey_[0].straight_line_s == off[0].straight_line_s
    first, second = (flown[0].outcome.trace.position_enu_m[:10] for flown in (covey_, off))
    np.testing.assert_allclose(first, second, atol=1e-3)


@pytest.mark.long
def test_goal_that_nobody_reaches_in_time_is_a_failure_with_a_reason():
    setup = campaign_settings.setup_for(changes=["law.design_margin_m=1.5"])
    plan = scenarios.plan("squeeze", 0)
    outcome = batch_flight.fly([plan], setup)[0].outcome
    assert not outcome.is_success
    assert outcome.reason in ("deadlock", "livelock", "time")
    assert outcome.duration_s > 12.0


def test_lone_vehicle_has_no_separation_and_arrives_without_errors_to_fight():
    flown = fly("rand1", [10], setup=campaign_settings.setup_for(errors="none", changes=STILL))[0]
    values = results.record(flown, campaign_settings.setup_for())
    assert values["min_separation_m"] is None
    assert values["success"]
    assert values["ratio"] == 1.0
    assert json.loads(results.line(values)) == values


def test_perturbations_and_vehicle_values_have_their_effect():
    def spread(*changes, **options):
        flown = fly(
            "rand1", [10], setup=campaign_settings.setup_for(changes=[*STILL, *changes], **options)
        )[0]
        return flown.outcome.trace.position_enu_m[:50]

    calm = spread(errors="none")
    for change in (
        "gust_m_s2=0.5",
        "lag_mismatch=0.5",
        "gain=0.3",
        "drag_mismatch=0.5",
        "lag_error_s=0.1",
        "tilt_deg=6",
    ):
        assert np.abs(spread(change, errors="none") - calm).max() > 1e-3, change
    assert np.abs(spread(errors="vision") - calm).max() > 1e-2
    assert np.abs(spread(errors="mocap") - calm).max() > 1e-6


@pytest.mark.long
def test_vehicles_that_gusts_move_about_their_goals_have_arrived():
    gusty = campaign_settings.setup_for(changes=[*STILL, "wind_m_s=3", "gust_m_s=0.45"])
    assert all(one.outcome.is_success for one in fly("swap4", [1, 2], setup=gusty))


@pytest.mark.parametrize("changes", [["loss_share=1"], ["burst_s=60", "burst_every_s=0.1"]])
def test_messages_that_never_arrive_let_the_vehicles_fly_into_each_other(changes):
    outcome = fly("form3", [4], setup=campaign_settings.setup_for(changes=changes, errors="none"))[
        0
    ].outcome
    assert outcome.is_collision
    assert 0.1 < outcome.contact_m_s < 2.0 * 1.6  # both fly with less than 1.6 m/s


def test_poses_of_the_mocap_keep_vehicles_apart_that_hear_nobody():
    setup = campaign_settings.setup_for(changes=["loss_share=1"])
    assert all(one.outcome.min_separation_m > 0.8 for one in fly("form3", range(6), setup=setup))


@pytest.mark.long
def test_a_forest_and_a_gap_are_flown_through_and_without_a_law_vehicles_meet_there():
    for name in ("forest4", "gap4"):
        flown = fly(name, range(3))
        assert all(one.outcome.is_success and not one.outcome.is_collision for one in flown), name
        assert min(one.outcome.min_clearance_m for one in flown) > 0.05, name

    # The ways around the pillars lead every law, so that only the other vehicles are hit.
    (without,) = fly("forest4", [0], setup=campaign_settings.setup_for(law="off"))
    assert without.outcome.min_clearance_m > 0.0
    assert without.outcome.min_separation_m < 0.5
    assert without.outcome.is_collision


@pytest.mark.long
def test_vehicle_that_dies_in_a_crossing_is_avoided_by_its_poses():
    flown = fly("lost8@dead", range(3))
    assert all(one.outcome.min_separation_m > 0.8 for one in flown)
    blind = fly("lost8@dead", range(3), setup=campaign_settings.setup_for(errors="none"))
    assert any(one.outcome.min_separation_m < 0.8 for one in blind)


@pytest.mark.parametrize(("delay_s", "ticks"), [(0.0, 1), (0.04, 2), (0.05, 3), (0.2, 10)])
def test_message_is_as_old_as_it_says(delay_s, ticks):
    def moved(tick):
        states = layouts.STATE.rows((1, 2))
        states["position_enu_m"] = float(tick)
        return states

    nobody = np.zeros((1, 2), bool)
    station = radio.Radio(
        moved(0),
        nobody,
        campaign_settings.SimulatedErrors(delay_s=delay_s, loss_share=0.0),
        radius_m=np.zeros((1, 2)),
    )
    vehicles = campaign_settings.setup_for().fleet(2)
    pilots = rollout_batch.FleetPipeline(
        [pipeline_params(vehicles, name) for name in vehicles.vehicles], np.zeros((1, 2, 3))
    )
    received = station.receive(np.ones((1, 2, 2)), nobody, nobody, None)
    published = pilots.step(
        moved(0), layouts.GOAL.rows((1, 2)), received, np.ones((1, 2, 1), bool), 0.02
    )
    for tick in range(30):
        heard = station.receive(np.full((1, 2, 2), 0.5), nobody, nobody, None)
        if tick > ticks:
            assert heard["position_enu_m"][0, 0, 0, 0] == tick - ticks
            assert heard["age_s"][0, 0, 0] == pytest.approx(0.02 * ticks)
        station.publish(moved(tick), published)


def test_quick_and_slow_vehicles_pass_as_quietly_as_vehicles_of_one_type():
    # each kept its own distance, and so they pushed each other: 30 and 57 m/s^3
    setup = campaign_settings.setup_for(types="sih,ardrone")
    for flown in fly("swap8x", range(1000, 1002), setup=setup):
        assert flown.outcome.is_success
        assert flown.outcome.min_separation_m > 0.8
        assert flown.outcome.slew_rms_m_s3 < 12.0


def test_an_intruder_that_nobody_can_outrun_is_avoided():
    """The mocap has tracked the intruder before the flight begins. Without that, the first and the
    last of these flights came to 0.72 and 0.76 m.
    """
    for flown in fly("intruder6@3", [1022, 1041, 1047, 1116, 1158]):
        assert flown.outcome.min_separation_m > 0.8


@pytest.mark.long
def test_intruder_moves_as_announced_and_the_formation_makes_way():
    flown = fly("intruder4@2", [3])[0]
    trace = flown.outcome.trace
    plan = flown.plan
    expected = plan.start_enu_m[-1] + trace.t_s[:, None] * plan.intruder_m_s
    np.testing.assert_allclose(trace.position_enu_m[:, -1], expected, atol=1e-9)
    off = fly("intruder4@2", [3], setup=campaign_settings.setup_for(law="off"))[0]
    assert flown.outcome.min_separation_m > off.outcome.min_separation_m


def test_frozen_vehicle_stops_for_good_and_its_arrival_is_not_asked_for():
    flown = fly("lost4@frozen", [1])[0]
    place, time_s, _ = flown.plan.lost
    trace = flown.outcome.trace
    late = trace.position_enu_m[trace.t_s > time_s + 3.0, place]
    assert np.ptp(late, axis=0).max() < 0.15
    assert np.linalg.norm(late[-1] - flown.plan.goal_enu_m[place]) > 0.3


@pytest.mark.long
def test_goal_beside_a_frozen_vehicle_is_blocked_and_any_other_is_reached():
    near, free = fly("lost4@frozen", [4, 5])

    def gap_to_the_goals_m(flown):
        place, _, _ = flown.plan.lost
        rest = flown.outcome.trace.position_enu_m[-1, place, :2]
        others = np.delete(flown.plan.goal_enu_m[:, :2], place, axis=0)
        return np.linalg.norm(others - rest, axis=1).min()

    assert near.outcome.reason == "blocked"
    assert gap_to_the_goals_m(near) < 1.0
    assert free.outcome.is_success
    assert gap_to_the_goals_m(free) > 1.0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere"], "'nowhere' is not a scenario"),
        (["circle"], "circle is the name of a scene. Write circle.json to fly it."),
        (
            ["form3", "--law", "nothing"],
            "covey: --law is 'nothing', but there are only covey, paper, off",
        ),
        (["form3", "--law", ""], "covey: --law is '', but there are only covey, paper, off"),
        (["form3", "--errors", "lidar"], "--errors is 'lidar'"),
        (["form3", "--type", "jet"], "no vehicle type 'jet'"),
        (["form3", "--seeds", "5:5"], "holds no seed"),
        (["form3", "--seeds", "x"], "--seeds is 'x'"),
        (["form3", "--jobs", "0"], "--jobs is 0"),
        (["form3", "--scale", "nan"], "--scale is nan"),
        (["form3", "--set", "law.kappa=4"], "there is no such key"),
        (["form3", "--set", "dely_s=1"], "Did you mean 'delay_s'?"),
        (["form3", "--set", "delay_s"], "write it as key=value"),
        (["form3", "--set", "loss_share=2"], "from 0 to 1"),
        (["form3", "--set", "law.kappa_1_1_s=inf"], "must be finite"),
        (["form3", "--set", "law.kappa_1_1_s=fast"], "law.kappa_1_1_s"),
        (["form3", "--set", "fleet.safety_distance_m=abc"], "it must be a number, not a text"),
        (["form3", "--set", "vehicle.max_tilt_deg=80"], "max_tilt_deg"),
        (["swap8", "--law", "paper"], "ring"),
        (["form3", "--set", "delay_s=[1]"], "from 0 to 2"),
        (["form3", "--set", "delay_s=2020-01-01"], "from 0 to 2"),
        (["form3", "--set", "law.kappa_1_1_s=NaN"], "must be finite"),
        (["form3", "--type", ""], "no vehicle type ''"),
        (["form3", "--trace", "/proc"], "nothing can be written there"),
        (["form3", "--trace", "/proc/self/status"], "nothing can be written there"),
        (["form3", "--plot", "/proc/picture.png", "--seeds", "0"], "nothing can be written there"),
        (["form3", "--plot", "/proc/pictures"], "nothing can be written there"),
        (["form3", "--fleet", "/nowhere.toml"], "no such fleet file"),
        (["form3", "--plot", "one.png", "--seeds", "0:2"], "name a folder"),
        (["form3", "--plot", "one.docx", "--seeds", "0"], "one.docx"),
    ],
)
def test_bad_input_is_a_sentence_and_status_2(words, said, capsys):
    assert covey(["simulate", *words]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert said in captured.err
    assert captured.err.startswith("covey: ")
    assert captured.err.rstrip().endswith(".")


@pytest.mark.parametrize(
    ("option", "place", "name"),
    [
        ("--trace", "out", "form3-1.npz"),
        ("--plot", "out", "form3-1.png"),
        ("--plot", "out/mine.svg", "mine.svg"),
    ],
)
def test_files_of_others_are_not_overwritten(option, place, name, tmp_path, capsys):
    other = tmp_path / "out" / name
    other.parent.mkdir()
    other.write_bytes(b"PK, Matplotlib and t_s.npy")

    assert covey(["simulate", "form3", "--seeds", "1", option, str(tmp_path / place)]) == 2
    refusal = capsys.readouterr().err
    assert f"{other}: this file is there already and is no" in refusal
    assert f"Name another with {option}." in refusal
    assert other.read_bytes() == b"PK, Matplotlib and t_s.npy"


def test_a_trace_may_be_replaced_by_a_newer_one(tmp_path):
    (flown,) = fly("form3", [1])
    for _ in range(2):
        path = results.write_trace(tmp_path, flown, campaign_settings.setup_for())
        assert results.is_trace(path.read_bytes())
    assert list(tmp_path.iterdir()) == [path]


def test_each_key_of_set_is_one_of_a_fleet_file():
    names = campaign_settings.keys()
    unknown = []
    for key in names:
        try:
            campaign_settings.setup_for(changes=[f"{key}=0.5"]).fleet(1)
        except ConfigError as error:
            if "unknown key" in str(error):
                unknown.append(key)
    assert unknown == []


@pytest.mark.parametrize(
    ("text", "value"), [(".7", 0.7), ("+.7", 0.7), ("0.7", 0.7), ("7e-1", 0.7), ("1", 1)]
)
def test_numbers_of_set_may_be_written_as_anybody_writes_them(text, value):
    setup = campaign_settings.setup_for(
        changes=[f"law.shortfall_gain={text}", f"vehicle.drag_1_s={text}", f"delay_s={text}"]
    )
    assert setup.law_table["shortfall_gain"] == value
    assert setup.fleet(2).law.shortfall_gain == value
    assert setup.fleet(2).vehicles["v1"].drag_1_s == value
    assert setup.perturbation.delay_s == value


def test_last_of_two_values_for_a_key_counts():
    setup = campaign_settings.setup_for(
        changes=["tilt_deg=20", "vehicle.max_tilt_deg=22", "delay_s=0.1", "delay_s=0.2"]
    )
    assert setup.fleet(2).vehicles["v0"].max_tilt_deg == 22
    assert setup.perturbation.delay_s == 0.2


def test_chunks_are_flown_by_the_pool_whose_processes_end_with_this_one(monkeypatch):
    jobs_of_pools = []

    def pool(jobs):
        jobs_of_pools.append(jobs)
        return ThreadPoolExecutor(jobs)

    monkeypatch.setattr(process_chunks, "worker_pool", pool)
    monkeypatch.setattr(process_chunks, "_fly_chunk", lambda chunk: [*chunk[1]])
    setup = campaign_settings.setup_for()
    assert list(process_chunks.campaign(["swap2"], range(4), setup, jobs=2)) == [[0, 1], [2, 3]]
    assert jobs_of_pools == [2]


def test_table_counts_flights_and_bounds_the_rate_of_violations(capsys):
    assert main(["simulate", "swap2", "form3", "--seeds", "0:2", "--set", "law.kappa_1_1_s=5"]) == 0
    out = capsys.readouterr().out
    assert "swap2" in out
    assert "form3" in out
    assert "all" in out


def test_fleet_file_gives_types_law_and_distances(tmp_path):
    text = Path("configs/fleets/paper.toml").read_text(encoding="utf-8")
    text = text.replace("safety_distance_m = 0.80", "safety_distance_m = 0.90")
    text = text.replace('name = "covey"', 'name = "covey"\nkappa_1_1_s = 3.5').replace(
        "[defaults]", "[defaults]\nmax_acceleration_m_s2 = 1.25"
    )
    (tmp_path / "fleet.toml").write_text(text, encoding="utf-8")
    setup = campaign_settings.setup_for(fleet_path=str(tmp_path / "fleet.toml"))
    assert setup.types == ("ardrone",)
    fleet = setup.fleet(4)
    assert {vehicle.hover_thrust_frac for vehicle in fleet.vehicles.values()} == {0.75}
    assert {vehicle.max_acceleration_m_s2 for vehicle in fleet.vehicles.values()} == {1.25}
    assert fleet.fleet.safety_distance_m == 0.9
    assert fleet.law.kappa_1_1_s == 3.5
    changed = campaign_settings.setup_for(
        fleet_path=str(tmp_path / "fleet.toml"), changes=["law.kappa_1_1_s=4", "tilt_deg=20"]
    )
    assert changed.fleet(2).law.kappa_1_1_s == 4.0
    assert changed.fleet(2).vehicles["v1"].max_tilt_deg == 20.0
    assert (
        campaign_settings.setup_for(types="sih,ardrone").fleet(3).vehicles["v1"].type == "ardrone"
    )


@pytest.mark.long
@pytest.mark.parametrize("name", ["intruder3@2", "intruder9@2"])
def test_picture_of_a_flight_is_drawn_for_few_and_for_many_vehicles(name, tmp_path):
    assert main(
        ["simulate", name, "--seeds", "1", "--plot", str(tmp_path / "pictures"), "--json"]
    ) in (0, 1)
    picture = tmp_path / "pictures" / f"{name}-1.png"
    assert picture.read_bytes()[:4] == b"\x89PNG"
    assert picture.stat().st_size > 50_000
