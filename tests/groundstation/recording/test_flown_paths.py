"""What was flown, as CSVs that fly again."""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Collection, Iterator
from pathlib import Path

import pytest

from groundstation.cli import main
from groundstation.paths.path_files import load_path
from groundstation.recording.flown_paths import flown_paths, write_csvs
from groundstation.recording.reader import Sample
from groundstation.recording.timeline import Timeline
from groundstation.recording.writer import RecordFiles
from onboard.bus.schema import Message
from onboard.bus.topics import Topic
from onboard.control.path import point_at
from tests.groundstation.recorded import SECOND, record, spot, tick
from tests.groundstation.recording.test_damaged_records import write


def test_a_record_becomes_paths_that_lead_where_it_flew(tmp_path: Path) -> None:
    flown = record(tmp_path / "flight", 10.0)
    assert main(["replay", str(flown), "--csv", str(tmp_path / "csv")]) == 0
    assert sorted(file.name for file in (tmp_path / "csv").iterdir()) == [
        "mav0.csv",
        "mav1.csv",
        "mav2.csv",
    ]
    path = load_path(tmp_path / "csv" / "mav0.csv")
    assert point_at(path, 5.25).position_enu_m == pytest.approx(spot(0, 5.0), abs=0.02)
    assert main(["replay", str(tmp_path), "--csv", str(tmp_path / "none")]) == 2


def test_a_name_in_a_record_never_leads_out_of_the_folder(tmp_path: Path) -> None:
    names = ("mav0", "../outside", "/tmp/outside", "..")
    write(tmp_path / "flight", [(Topic.TICK, name, tick(SECOND)) for name in names])

    paths, notes = write_csvs(tmp_path / "flight", tmp_path / "out" / "csv")

    assert paths == [tmp_path / "out" / "csv" / "mav0.csv"]
    assert not notes
    assert list(tmp_path.rglob("*.csv")) == paths


def test_csvs_of_another_flight_in_the_folder_are_told(tmp_path: Path) -> None:
    for names in (("mav0", "mav1"), ("mav0",)):
        folder = tmp_path / f"flight{len(names)}"
        write(folder, [(Topic.TICK, name, tick(SECOND)) for name in names])
        paths, notes = write_csvs(folder, tmp_path / "csv")

    assert paths == [tmp_path / "csv" / "mav0.csv"]
    assert notes == [
        f"{tmp_path / 'csv'} also has CSVs that are not of this flight, for instance mav1.csv."
        " Delete them, or give another folder with --csv."
    ]


def test_csvs_of_a_record_that_was_cut_off_say_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flown = record(tmp_path / "flight", 4.0)
    file = flown / "flight.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    for command in (["replay"], ["log", "export"]):
        assert main([*command, str(flown), "--csv", str(tmp_path / "csv")]) == 0
        printed = capsys.readouterr()
        assert f"covey: {flown}: The record was cut off" in printed.err
        assert "cut off" not in printed.out


def test_gaps_of_a_record_are_said_beside_the_csvs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told: list[tuple[Topic, str, Message]] = []
    for step in range(100):
        told.append((Topic.TICK, "mav0", tick(SECOND + step * SECOND // 10)))
        is_heard = not 20 < step < 30 and not 60 < step < 90
        if is_heard:
            told.append((Topic.TICK, "mav1", tick(SECOND + step * SECOND // 10)))
    write(tmp_path / "flight", told)

    assert main(["replay", str(tmp_path / "flight"), "--csv", str(tmp_path / "csv")]) == 0
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(
        "The record has no positions for mav1.csv from 6.0 s to 9.0 s (2 gaps in all)."
        " Flown from this file, the path leads straight across."
    )


def test_a_file_of_other_columns_is_not_overwritten_and_no_other_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flown = record(tmp_path / "flight", 1.0)
    out = tmp_path / "csv"
    assert main(["replay", str(flown), "--csv", str(out)]) == 0
    assert main(["log", "export", str(flown), "--csv", str(out)]) == 0

    (out / "mav0.csv").unlink()
    (out / "mav1.csv").write_text("battery,note\n0.9,mine\n", encoding="utf-8")
    for command in (["replay"], ["log", "export"]):
        assert main([*command, str(flown), "--csv", str(out)]) == 2
        assert "it is not overwritten. Name another with --csv." in capsys.readouterr().err
    assert "mine" in (out / "mav1.csv").read_text(encoding="utf-8")
    assert not (out / "mav0.csv").exists()


def test_vehicles_with_clocks_of_their_own_have_one_zero_of_time(tmp_path: Path) -> None:
    folder = tmp_path / "flight"
    folder.mkdir()
    files = RecordFiles(folder, (folder / "flight.mcap").open("wb"), begin_ns=0, begin="a test")
    for step in range(200):
        now_ns = SECOND + step * SECOND // 10
        for name, ahead_s in (("mav0", 0), ("mav1", 2400)):
            files.write(Topic.TICK, name, tick(now_ns + ahead_s * SECOND), now_ns)
        if step % 10 == 9:
            files.flush()
    files.finish()
    files.close()

    paths, _ = write_csvs(folder, tmp_path / "csv")
    for path in paths:
        _, first, *_ = path.read_text(encoding="utf-8").splitlines()
        assert float(first.partition(",")[0]) < 1.0, path.name


class _LongRecord(Timeline):
    """A record of 100 s of one vehicle, read message by message."""

    def __init__(self) -> None:
        pass

    def samples(self, topics: Collection[str]) -> Iterator[Sample]:
        text = json.dumps({"position_enu_m": [1.0, 2.0, 3.0], "others": [0.5] * 50})
        for step in range(5000):
            yield Sample("tick/mav0", step * SECOND // 50, json.loads(text))


def test_a_long_record_is_not_kept_whole_in_memory() -> None:
    tracemalloc.start()
    try:
        paths = flown_paths(_LongRecord(), 10.0)
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(paths["mav0"].lines) == 1000
    assert peak_bytes < 2_000_000
