"""The suite of the open benchmark: its units, its file, its table, and its command."""

import json
import pickle

import msgspec
import pytest

from groundstation.cli import main
from onboard.config.fleet import ConfigError
from onboard.config.law import BUILT_IN
from onboard.rollout import batch
from sitl.monte_carlo import process_chunks
from sitl.monte_carlo.law_map.results_file import ResultsFile
from sitl.monte_carlo.open_benchmark import (
    scene_file,
    scene_plans,
    suite,
    suite_command,
    suite_summary,
)

FLIGHT = {
    "seed": 1000,
    "success": True,
    "reason": None,
    "violation_s": 0.0,
    "collision": False,
    "min_separation_m": 0.9,
    "ratio": 1.2,
    "straight_line_s": 10.0,
    "slew_rms_m_s3": 20.0,
    "energy_hover_s": 12.5,
}

OTHERS = {"law": "edited:law", "vehicles": [0]}  # of a scene


def row_of(unit, **changes):
    """A unit as if it had been flown."""
    return {
        "cell": unit.cell,
        "stage": 0,
        "law": unit.law,
        "scene": unit.scene.name,
        "first_seed": unit.seeds[0],
        "flights": [{**FLIGHT, "seed": seed, **changes} for seed in unit.seeds],
        "busy_s": 1.0,
        "calls": 10_000,
    }


@pytest.fixture
def flown(monkeypatch):
    """Units that were flown, without flying."""
    units = []

    def fly(unit):
        units.append(unit)
        return row_of(unit)

    monkeypatch.setattr(suite, "fly", fly)
    monkeypatch.setattr(suite_command, "version", lambda: "a")
    monkeypatch.setattr(batch, "warm_up", lambda *, has_own_law: None)
    return units


@pytest.mark.parametrize(
    ("events", "count", "text"),
    [(0, 280, "0 = 0 % (0 to 1)"), (5, 280, "5 = 2 % (1 to 4)"), (2, 200, "2 = 1 % (0 to 4)")],
)
def test_a_share_is_printed_with_its_exact_interval(events, count, text):
    assert suite_summary.share(events, count) == text


def test_a_suite_has_each_seed_of_each_scene_once_and_another_law_other_units():
    units = suite.units("orca", range(1000, 1003))
    flights = [(unit.scene.name, seed) for unit in units for seed in unit.seeds]
    assert len(flights) == len(set(flights)) == 3 * len(suite.scenes())

    compiled = suite.units("covey", range(1000, 1007))
    flights = [(unit.scene.name, seed) for unit in compiled for seed in unit.seeds]
    assert len(flights) == len(set(flights)) == 7 * len(suite.scenes())
    assert len({unit.cell for unit in units + compiled}) == len(units + compiled)

    # processes and workers of a cluster get units in this way
    for unit in units:
        assert pickle.loads(pickle.dumps(unit)) == unit


def test_the_suite_flies_the_scenes_of_this_software_whatever_files_are_in_the_folder(
    tmp_path, monkeypatch
):
    scenes = suite.scenes()
    keys = [unit.cell for unit in suite.units("covey", range(1000, 1001))]
    edited = msgspec.structs.replace(scenes[0], jitter_m=0.5)
    (tmp_path / f"{edited.name}.json").write_bytes(msgspec.json.encode(edited))
    (tmp_path / "wind.json").write_text("[]", encoding="utf-8")
    (tmp_path / "sih").write_text("no fleet file", encoding="utf-8")

    monkeypatch.chdir(tmp_path)
    assert scene_file.load(f"{edited.name}.json") == edited
    assert suite.scenes() == scenes
    assert [unit.cell for unit in suite.units("covey", range(1000, 1001))] == keys


def test_each_built_in_law_is_judged_also_the_one_of_two_vehicles():
    for law in BUILT_IN:
        assert suite.units(law, range(1000, 1001))


def test_a_run_goes_on_where_it_was_and_one_file_keeps_several_laws(tmp_path, flown):
    keep = tmp_path / "kept.jsonl"
    assert suite_command.judge("orca", range(1000, 1001), keep=keep)
    assert len(flown) == len(suite.scenes())

    assert suite_command.judge("orca", range(1000, 1002), keep=keep)
    assert len(flown) == 2 * len(suite.scenes())

    assert suite_command.judge("off", range(1000, 1002), keep=keep)
    with ResultsFile(keep, "a", kind=suite.KIND) as file:
        assert {row["law"] for row in file.rows.values()} == {"orca", "off"}


def test_a_file_of_another_kind_or_version_is_refused_in_a_sentence(tmp_path, flown, monkeypatch):
    keep = tmp_path / "map.jsonl"
    keep.write_text('{"law_map": 1, "version": "a"}\n')
    with pytest.raises(ConfigError, match="no file of `covey simulate --suite open`"):
        suite_command.judge("orca", range(1), keep=keep)

    keep = tmp_path / "kept.jsonl"
    suite_command.judge("orca", range(1), keep=keep)
    monkeypatch.setattr(suite_command, "version", lambda: "b")
    with pytest.raises(ConfigError, match=r"another version .* --keep"):
        suite_command.judge("orca", range(1), keep=keep)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda flight: flight.pop("energy_hover_s"), "missing required field `energy_hover_s`"),
        (lambda flight: flight.pop("straight_line_s"), "missing required field `straight_line_s`"),
        (lambda flight: flight.update(violation_s="0.1"), "Expected `float`, got `str`"),
        (None, "flights are missing in orca"),
    ],
)
def test_a_kept_flight_that_lacks_a_number_is_refused_in_a_sentence(tmp_path, change, words):
    [unit, *_] = suite.units("orca", range(1000, 1001))
    row = row_of(unit)
    if change is None:
        row["flights"] = []
    else:
        change(row["flights"][0])
    keep = tmp_path / "kept.jsonl"
    keep.write_text('{"open_benchmark": 1, "version": "a"}\n' + json.dumps(row) + "\n")
    with pytest.raises(ConfigError) as refusal:
        ResultsFile(keep, "a", kind=suite.KIND)
    assert words in str(refusal.value)
    assert "or begin anew with --anew" in str(refusal.value)


def test_a_law_that_is_edited_meanwhile_is_refused_and_not_kept_as_the_first_one(
    tmp_path, monkeypatch
):
    file = tmp_path / "edited.py"
    file.write_text("def law(memory, inputs):\n    return None, inputs.baseline\n")
    monkeypatch.chdir(tmp_path)
    unit = suite.units("edited:law", range(1000, 1001))[0]
    others = {**json.loads(msgspec.json.encode(unit.scene)), "others": OTHERS}
    scene = scene_file.parsed(json.dumps(others).encode(), "others.json")
    by_name = scene_plans.setup(scene, law="edited:law")
    by_scene = scene_plans.setup(scene)

    file.write_text(file.read_text() + "# edited\n")
    refusal = "The source of edited:law was edited while it was flying"
    with pytest.raises(ConfigError, match=refusal):
        suite.fly(unit)
    for setup in (by_name, by_scene):
        with pytest.raises(ConfigError, match=refusal):
            list(process_chunks.campaign([scene], [1000], setup))


def test_a_flight_counts_once_where_units_overlap():
    """covey flies five seeds a unit: 0:3 first, and 0:5 after more seeds were asked for."""
    rows = [
        row_of(unit)
        for seeds in (range(3), range(5))
        for unit in suite.units("covey", seeds)
        if unit.scene.name == "circle"
    ]
    assert [len(row["flights"]) for row in rows] == [3, 5]
    assert len(suite.flights_of(rows)) == 5


def test_the_table_counts_what_happened():
    units = [unit for unit in suite.units("orca", range(4)) if unit.scene.name == "circle"]
    good, other, touching, near = units
    bad = row_of(near, success=False, ratio=None, violation_s=0.1, min_separation_m=0.5)
    row = suite_summary.table_row(
        [row_of(good), row_of(other), row_of(touching, collision=True), bad]
    )
    named = dict(zip(suite_summary.COLUMNS, row, strict=True))
    assert named == {
        "flights": "4",
        "flawless": "50 %",
        "below 0.80 m (95 %)": "1 = 25 % (1 to 81)",
        "collisions": "1",
        "arrived": "75 %",
        "worst m": "0.500",
        "ratio": "1.20",
        "slew m/s^3": "20",
        "energy": "1.25",
        "us a step": "100",
    }


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--suite", "closed"], "there is only the suite 'open'"),
        (["--suite", "open", "swap8"], "--suite flies its own scenes"),
        (["--suite", "open", "--errors", "vision"], "--suite flies its own scenes"),
        (["--suite", "open", "--cells", "vehicles=3"], "--suite flies its own scenes"),
        (["--suite", "open", "--flights", "500"], "leave out --flights."),
        (["--suite", "open", "--map-file", "law-map.jsonl"], "leave out --map-file."),
        (["--suite", "open", "--errors", "mocap"], "leave out --errors."),
        (["--suite", "open", "--anew"], "Add --keep FILE, or leave --anew out."),
        (["--suite", "open", "--seeds", "3:3"], "holds no seed"),
        (["--suite", "open", "--law", "nowhere:law"], "the module nowhere cannot be imported"),
        (["swap8", "--keep", "kept.jsonl"], "--keep is for --suite"),
        (["circle.json", "swap8"], "name one file with a scene"),
        (["circle.json", "--errors", "vision"], "says types, errors and places itself"),
        (["nowhere.json"], "there is no such scene"),
    ],
)
def test_wrong_words_are_refused_before_anything_is_flown(capsys, words, sentence):
    assert main(["simulate", *words]) == 2
    assert sentence in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("words", "seeds"),
    [([], range(1000, 1020)), (["--seeds", "0:10"], range(10)), (["--seeds", "7"], range(7, 8))],
)
def test_the_suite_flies_the_seeds_of_the_command_line(monkeypatch, words, seeds):
    flown_seeds = []

    def judge(_law, seeds, **_options):
        flown_seeds.append(seeds)
        return True

    monkeypatch.setattr(suite_command, "judge", judge)
    assert main(["simulate", "--suite", "open", *words]) == 0
    assert flown_seeds == [seeds]


@pytest.mark.long
def test_a_law_of_thirty_lines_is_judged_from_an_empty_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(
        "def law(memory, inputs):\n    return None, inputs.baseline\n"
    )
    two = [scene for scene in suite.scenes() if scene.name in ("symmetry", "circle")]
    monkeypatch.setattr(suite, "scenes", lambda: two)

    words = ["simulate", "--suite", "open", "--law", "mine:law", "--seeds", "1000:1001"]
    assert main([*words, "--keep", "kept.jsonl"]) == 1
    printed = capsys.readouterr().out
    assert "2 = 100 % (22 to 100)" in printed

    rows = [json.loads(line) for line in (tmp_path / "kept.jsonl").read_text().splitlines()[1:]]
    assert [row["scene"] for row in rows] == ["circle", "symmetry"]
    assert rows[0]["calls"] > 1000
    assert not any(flight["success"] and flight["reason"] for flight in suite.flights_of(rows))


def test_what_a_law_prints_does_not_come_into_the_table(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "chatty.py").write_text(
        "print('imported')\ndef law(memory, inputs):\n    print('called')\n    return 1 / 0\n"
    )
    monkeypatch.setattr(suite, "scenes", lambda: [scene_file.packaged("symmetry")])
    [unit] = suite.units("chatty:law", range(1000, 1001))
    suite.fly(unit)
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "imported" in printed.err
    assert "called" in printed.err


@pytest.mark.long
def test_a_law_that_raises_has_failed_and_the_table_says_why(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "raises.py").write_text("def law(memory, inputs):\n    return 1 / 0\n")
    one = [scene for scene in suite.scenes() if scene.name == "symmetry"]
    monkeypatch.setattr(suite, "scenes", lambda: one)

    words = ["simulate", "--suite", "open", "--law", "raises:law", "--seeds", "1000:1001"]
    assert main(words) == 1
    printed = " ".join(capsys.readouterr().out.split())
    assert "In 1 flights the law was refused. The first: law raises:law raised Zero" in printed
