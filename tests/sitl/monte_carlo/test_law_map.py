"""The map of the law: interrupted and continued it is the same; a cell that fails stops; bad input
in words.
"""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor, Executor, Future
from pathlib import Path

import pytest

from groundstation.cli import main
from onboard.config.fleet import ConfigError
from onboard.feasibility.fleet_checks import fleet_findings
from onboard.feasibility.law_map import law_map_of
from sitl.monte_carlo import campaign_settings, executors
from sitl.monte_carlo.law_map import cells, map_summary, run, unit_flights
from sitl.monte_carlo.law_map.results_file import ResultsFile, digest

SMALL = ["vehicles=3", "speed_m_s=1", "delay_ms=20,50,100"]
BAD = "mocap 3 vehicles 1 m/s 100 ms 10 %"  # comes too near in its second stage


def flown(unit):
    """A row without flying, decided by the unit alone."""
    text = hashlib.sha256(repr(unit).encode()).hexdigest()[:12]
    is_bad = unit.cell.key == BAD and unit.stage == 1

    numbers = {
        "flights": unit.flights,
        "below": int(is_bad),
        "collisions": 0,
        "arrived": unit.flights,
    }
    return {
        "cell": unit.cell.key,
        "stage": unit.stage,
        **numbers,
        "worst_m": 0.7 if is_bad else 0.9,
        "worst_flight": "swap3 1000",
        "speed_m_s": 1.1,
        "ratio": 1.0,
        "digest": text,
    }


def fly_all(path, *, stages=4, jobs=1, tell=lambda _: None, selection=SMALL):
    with ResultsFile(path, "a") as file:
        run.run(cells.cells(selection), file, stages=stages, jobs=jobs, tell=tell)
        return dict(file.rows)


def test_the_map_has_the_cells_of_all_axes_the_screening_first_and_the_easy_ones_first(tmp_path):
    all_cells = cells.cells()
    assert len(all_cells) == 5 * 3 * 3 * 3 + 5 * 3 * 3
    assert all_cells[0] == cells.Cell(
        errors="mocap", vehicles=3, speed_m_s=1.0, delay_ms=20.0, loss_pct=0.0
    )

    with ResultsFile(tmp_path / "map.jsonl", "a") as file:
        units = run.missing(all_cells, 4, file)

    assert [unit.stage for unit in units[:180]] == [0] * 180
    assert [(unit.cell, unit.stage) for unit in units[180:183]] == [
        (all_cells[0], stage) for stage in (1, 2, 3)
    ]
    assert sum(unit.flights for unit in units if unit.cell == all_cells[0]) == 504


def test_interrupted_at_every_unit_and_continued_it_has_the_digest_of_one_that_was_not(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(unit_flights, "fly", flown)
    whole = fly_all(tmp_path / "whole.jsonl")
    # the bad cell ended after its second stage
    assert sum(row["flights"] for row in whole.values()) == 8 * 504 + 102

    def _once(unit, left=[0]):  # noqa: B006 a counter of the calls since the last interruption
        left[0] += 1
        if left[0] % 3 == 0:
            raise KeyboardInterrupt
        return flown(unit)

    monkeypatch.setattr(unit_flights, "fly", _once)
    path = tmp_path / "often.jsonl"
    interruptions = 0
    while True:
        try:
            rows = fly_all(path)
            break
        except KeyboardInterrupt:
            interruptions += 1

    assert interruptions > 5
    assert digest(rows) == digest(whole)

    lines = path.read_text().splitlines()[1:]
    assert (
        len(lines)
        == len({(row["cell"], row["stage"]) for row in map(json.loads, lines)})
        == len(whole)
    )


def test_a_cell_that_fails_in_its_last_stage_counts_once_as_done(tmp_path, monkeypatch):
    monkeypatch.setattr(unit_flights, "fly", flown)
    sentences: list[str] = []

    fly_all(tmp_path / "map.jsonl", stages=2, tell=sentences.append)

    # one of the nine cells fails in its second stage, which is the last one here
    assert sentences[-1].startswith("law map: 9 of 9 cells done (1 failed), ")


def test_half_a_line_of_a_killed_run_is_cut_off_and_flown_again(tmp_path, monkeypatch):
    monkeypatch.setattr(unit_flights, "fly", flown)
    path = tmp_path / "map.jsonl"
    rows = fly_all(path, stages=1)

    path.write_bytes(path.read_bytes()[:-30])

    assert digest(fly_all(path, stages=1)) == digest(rows)


class Dying(Executor):
    """A cluster whose scheduler dies after some units."""

    def __init__(self, left, error=None):
        self.left = left
        self.error = error or BrokenExecutor("gone")

    def shutdown(self, wait=True):  # type: ignore[override]  # as Dask's: of no other word
        pass

    def submit(self, fn, /, *args, **kwargs):
        future: Future = Future()
        self.left -= 1
        if self.left < 0:
            future.set_exception(self.error)
        else:
            future.set_result(fn(*args, **kwargs))
        return future


def test_a_scheduler_that_dies_is_said_in_words_and_its_flights_are_flown_again_here(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(unit_flights, "fly", flown)
    whole = fly_all(tmp_path / "whole.jsonl")

    monkeypatch.setattr(executors, "cluster", lambda _: (Dying(5), 4))
    sentences: list[str] = []

    with ResultsFile(tmp_path / "map.jsonl", "a") as file:
        run.run(
            cells.cells(SMALL), file, stages=4, scheduler="tcp://there:8786", tell=sentences.append
        )
        assert digest(file.rows) == digest(whole)

    assert any("scheduler at tcp://there:8786 is gone" in sentence for sentence in sentences)


def test_a_cluster_whose_workers_die_is_said_in_words_and_one_can_be_interrupted(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(unit_flights, "fly", flown)
    for error, goes_on in ((RuntimeError("KilledWorker"), True), (KeyboardInterrupt(), False)):
        monkeypatch.setattr(executors, "cluster", lambda _, error=error: (Dying(5, error), 4))
        sentences: list[str] = []

        with ResultsFile(tmp_path / f"{goes_on}.jsonl", "a") as file:
            try:
                run.run(
                    cells.cells(SMALL),
                    file,
                    stages=1,
                    scheduler="tcp://there:8786",
                    tell=sentences.append,
                )
            except KeyboardInterrupt:
                assert not goes_on
            assert (len(file.rows) == 9) is goes_on

        assert (
            any("has lost its workers (RuntimeError)" in sentence for sentence in sentences)
            is goes_on
        )


def test_an_error_of_a_file_in_a_flight_is_no_lost_process_and_the_flight_is_not_repeated(
    tmp_path, monkeypatch
):
    flights = []

    def fly(unit):
        flights.append(unit)
        raise FileNotFoundError("weights.npz")

    monkeypatch.setattr(unit_flights, "fly", fly)
    sentences: list[str] = []
    with (
        ResultsFile(tmp_path / "map.jsonl", "a") as file,
        pytest.raises(FileNotFoundError, match="weights"),
    ):
        run.run(cells.cells(SMALL), file, stages=1, tell=sentences.append)
    assert len(flights) == 1
    assert not any("process has ended" in sentence for sentence in sentences)


def test_a_file_of_another_version_another_kind_or_in_use_is_refused_in_words(tmp_path, capsys):
    path = tmp_path / "map.jsonl"
    with ResultsFile(path, "a"), pytest.raises(ConfigError, match="another run is writing"):
        ResultsFile(path, "a")

    with pytest.raises(ConfigError, match=r"another version of the law.*--anew"):
        ResultsFile(path, "b")

    with ResultsFile(path, "b", is_anew=True) as file:
        assert file.rows == {}
    assert path.with_name("map.jsonl.old").exists()

    with ResultsFile(path, "c", is_anew=True):
        pass
    assert '"version": "a"' in path.with_name("map.jsonl.old").read_text()
    assert '"version": "b"' in path.with_name("map.jsonl.old2").read_text()
    assert f"the former results are kept in {path}.old2" in capsys.readouterr().err

    for text in ("[1, 2]\n", "not json\n", '{"law_map": 99, "version": "b"}\n', '{"a": 1}\n'):
        path.write_text(text)
        with pytest.raises(ConfigError, match=r"map\.jsonl"):
            ResultsFile(path, "b")

    with pytest.raises(ConfigError, match="Name another file"):
        ResultsFile(tmp_path / "map.jsonl" / "below", "b")


def test_a_map_begun_anew_takes_no_file_from_another_run_and_none_of_another_kind(tmp_path):
    path = tmp_path / "map.jsonl"
    with (
        ResultsFile(path, "a") as file,
        pytest.raises(ConfigError, match="another run is writing"),
    ):
        ResultsFile(path, "a", is_anew=True)
    assert file.path.exists()

    path.write_text("precious notes")
    with pytest.raises(ConfigError, match="no file of"):
        ResultsFile(path, "a", is_anew=True)
    assert path.read_text() == "precious notes"
    assert [entry.name for entry in tmp_path.iterdir()] == ["map.jsonl"]


@pytest.mark.parametrize("left", [{}, {"below": None}, {"below": "none", "flights": 21}])
def test_a_damaged_map_is_refused_in_words_and_what_is_no_map_is_left_as_it_is(tmp_path, left):
    row = {
        "cell": BAD,
        "stage": 0,
        "worst_m": 0.9,
        "speed_m_s": 1.0,
        "ratio": None,
        "collisions": 0,
        "arrived": 1,
    }
    damaged = "".join(
        json.dumps(line) + "\n" for line in ({"law_map": 1, "version": "a"}, row | left)
    )

    path = tmp_path / "map.jsonl"
    for text in (damaged, "precious notes", "precious\nnotes"):
        path.write_text(text)
        with pytest.raises(ConfigError, match="no file of"):
            ResultsFile(path, "a")
        assert path.read_text() == text


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--cells", "height=3"], "write AXIS=VALUE"),
        (["--cells", "vehicles=4"], "'4' is not on the map; there are 3, 8, 16"),
        (["--cells", "errors=vision", "--cells", "vehicles=3"], "no such cell"),
        (["--flights", "600"], "up to 504 are flown"),
        (["--flights", "0"], "--flights is 0"),
        (["swap8"], "--map flies its own scenarios"),
        (["--errors", "vision"], "--cells errors=vision"),
        (["--seeds", "0:3"], "--map flies its own scenarios"),
        (["--seeds", "0:10"], "leave out --seeds."),
        (["swap8", "--physics", "emulator"], "leave out swap8, --physics."),
        (["--jobs", "0"], "--jobs is 0"),
    ],
)
def test_wrong_words_are_refused_before_anything_is_flown(tmp_path, capsys, words, sentence):
    assert main(["simulate", "--map", "--map-file", str(tmp_path / "map.jsonl"), *words]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "map.jsonl").exists()


@pytest.mark.parametrize(
    "words",
    [
        ["--cells", "errors=vision"],
        ["--map-file", "my.jsonl"],
        ["--map-file", "law-map.jsonl"],
        ["--flights", "9"],
        ["--flights", "500"],
        ["--anew"],
    ],
)
def test_options_of_the_map_are_refused_for_scenarios(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", "form3", *words]) == 2
    assert "are for --map" in capsys.readouterr().err


def test_scheduler_without_its_package_or_without_an_answer_is_refused_in_words(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match="pip install distributed"):
        executors.cluster("tcp://127.0.0.1:1")


@pytest.mark.long
def test_one_cell_flown_by_the_command_holds_and_its_own_commands_fly_the_same_flights(
    tmp_path, capsys
):
    path = tmp_path / "map.jsonl"
    words = [
        "--cells",
        "vehicles=3",
        "--cells",
        "speed_m_s=1",
        "--cells",
        "delay_ms=200",
        "--cells",
        "loss_pct=30",
    ]
    assert main(["simulate", "--map", "--map-file", str(path), *words, "--flights", "20"]) == 0

    printed = capsys.readouterr().out
    assert "screened" in printed
    assert "digest" in printed

    row = json.loads(path.read_text().splitlines()[1])
    assert (row["flights"], row["below"]) == (21, 0)

    scenario, seed = row["worst_flight"].split()
    (cell,) = cells.cells(words[1::2])
    command = next(text for text in cells.commands(cell) if f" {scenario} " in text).split()[1:]
    command[command.index("--seeds") + 1] = seed

    assert main([*command, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["min_separation_m"] == row["worst_m"]


def test_a_cell_flies_with_what_check_demands_and_holds_its_top_speed():
    for cell in cells.cells(["vehicles=8", "errors=mocap", "loss_pct=30"]):
        fleet = campaign_settings.setup_for(changes=cells.changes(cell)).fleet(8)
        refused = [finding.name for finding in fleet_findings(fleet) if finding.status == "refused"]
        assert set(refused) <= {"map of the law"}, (cell, refused)


@pytest.mark.long
def test_summary_is_what_check_reads(tmp_path, monkeypatch):
    import tomllib

    monkeypatch.setattr(unit_flights, "fly", flown)

    rows = fly_all(tmp_path / "map.jsonl")
    law_map = law_map_of(tomllib.loads(map_summary.toml_summary(cells.cells(), rows, "a")))
    by_verdict = [map_summary.verdict(cell) for cell in law_map.cells]
    assert (by_verdict.count("holds"), by_verdict.count("failed"), len(by_verdict)) == (8, 1, 9)
    assert law_map.law["mocap"]["kappa_1_1_s"] == 4.0


@pytest.mark.long
def test_killed_by_force_with_two_processes_and_continued_it_has_the_same_digest(tmp_path):
    command = [
        sys.executable,
        "-m",
        "groundstation",
        "simulate",
        "--map",
        "--jobs",
        "2",
        "--flights",
        "100",
    ]
    command += [
        word
        for axis in ("vehicles=3", "speed_m_s=1", "delay_ms=20,100")
        for word in ("--cells", axis)
    ]

    killed = tmp_path / "killed.jsonl"
    whole = tmp_path / "whole.jsonl"

    def lines(path: Path) -> int:
        return len(path.read_text().splitlines()) if path.exists() else 0

    process = subprocess.Popen([*command, "--map-file", str(killed)], start_new_session=True)

    deadline = time.monotonic() + 120.0
    while lines(killed) < 4 and time.monotonic() < deadline:
        time.sleep(0.05)

    os.kill(process.pid, signal.SIGKILL)
    process.wait()

    before = lines(killed)
    assert 4 <= before < 13

    digests = []
    for path in (killed, whole):
        done = subprocess.run(
            [*command, "--map-file", str(path)], capture_output=True, text=True, check=True
        )
        digests.append(done.stdout.rsplit("digest", 1)[1].strip())

    assert digests[0] == digests[1]
    assert lines(killed) == lines(whole) == 13


@pytest.mark.long
def test_cells_that_the_shipped_map_promises_hold_in_flights_of_other_seeds():
    from onboard.feasibility.law_map import shipped
    from sitl.monte_carlo import process_chunks

    promised = [cell for cell in shipped().cells if cell.is_promised]
    for kept in promised[:: max(1, len(promised) // 6)]:
        cell = cells.Cell(
            errors=kept.errors,
            vehicles=kept.vehicles,
            speed_m_s=kept.speed_m_s,
            delay_ms=1e3 * kept.delay_s,
            loss_pct=1e2 * kept.loss_frac,
        )
        for name in cell.scenarios:
            for records in process_chunks.campaign(
                [name], range(2000, 2008), cells.setup(cell, name)
            ):
                assert all(record["violation_s"] == 0.0 for record in records), (cell.key, name)
