from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from groundstation.cli import main
from groundstation.recording import record_list
from groundstation.recording import timeline as timeline_module
from groundstation.recording.record_list import contents, flight_folders, summary
from groundstation.recording.timeline import Timeline
from onboard.bus.schema import Event, Severity
from onboard.bus.topics import Topic
from tests.groundstation.report.made_up import BEGIN_NS, rows, story, write


@pytest.fixture
def flights(tmp_path: Path) -> Path:
    folder = write(tmp_path / "flights" / "first", [*rows(length_s=2.0), *story("mav0")])
    (folder / "verdict.json").write_text('{"passed": false, "mission": "cross\\u001b[31m"}')
    cut = write(tmp_path / "flights" / "cut", rows(length_s=2.0))
    whole = (cut / "flight.mcap").read_bytes()
    (cut / "flight.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    return tmp_path / "flights"


def test_a_flight_is_summed_up_by_its_index(flights: Path) -> None:
    about = summary(flights / "first")

    assert about["vehicles"] == ["mav0", "mav1"]
    assert about["is_whole"]
    assert about["has_passed"] is False
    assert about["length_s"] == pytest.approx(3.0, abs=0.1)


@pytest.fixture
def public_folder() -> Iterator[Path]:
    """A folder that every user may enter, which is not true of `tmp_path`."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        yield folder


def test_a_folder_that_may_not_be_entered_is_left_out(public_folder: Path) -> None:
    flight = write(public_folder / "first", rows(length_s=1.0))
    (public_folder / "lost+found").mkdir(mode=0o000)

    user = os.geteuid()
    if user == 0:
        os.seteuid(65_534)  # nobody: root may enter every folder
    try:
        assert flight_folders(public_folder) == [flight]
    finally:
        os.seteuid(user)


def test_each_channel_has_its_number_of_messages(flights: Path) -> None:
    counts = contents(flights / "first")["channels"]

    assert counts["tick/mav0"] == 100
    assert counts["telemetry/mav1"] == 20
    assert counts["order/mav0"] == 1


def test_of_very_many_events_the_last_alarms_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(timeline_module, "MAX_MINOR_EVENTS", 3)
    told = rows(length_s=2.0)
    severities: list[Severity] = ["debug", "info", "debug", "info", "debug", "warning", "critical"]
    for number, severity in enumerate(severities):
        event = Event(
            vehicle="mav0",
            stamp_ns=BEGIN_NS + number,
            severity=severity,
            code="made-up",
            sentence=f"Event {number}.",
        )
        told.append((BEGIN_NS + number, Topic.EVENT, "mav0", event))
    flight = write(tmp_path, told)

    with contextlib.closing(Timeline(flight)) as timeline:
        kept = [event.severity for _, event in timeline.events]
    assert kept == ["debug", "info", "debug", "warning", "critical"]

    assert main(["log", "info", str(flight)]) == 0
    words = capsys.readouterr().out
    assert "7 events, 1 of them warnings and 1 critical." in words
    assert "2 events are left out: of debug and info events the first 3 are kept" in words


def test_info_says_that_a_record_is_damaged_in_its_middle(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = write(tmp_path, rows(length_s=4.0))
    assert main(["log", "info", str(flight)]) == 0
    assert "damaged" not in capsys.readouterr().out

    data = bytearray((flight / "flight.mcap").read_bytes())
    middle = len(data) // 2
    data[middle : middle + 40] = bytes(40)
    (flight / "flight.mcap").write_bytes(data)

    assert main(["log", "info", str(flight)]) == 0
    assert "A piece of the record is damaged" in capsys.readouterr().out
    assert not contents(flight)["is_whole"]


def test_the_list_names_flights_that_were_cut_off_and_runs_nothing_of_their_texts(
    flights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["log", "list", str(flights)]) == 0

    text = capsys.readouterr().out
    assert len(flight_folders(flights)) == 2
    assert "(cut off or damaged)" in text
    assert "FAILED" in text
    assert "\x1b" not in text


def test_of_more_flights_than_are_listed_the_newest_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record_list, "MAX_FOLDERS", 3)
    for number in range(9):
        record = tmp_path / f"flight{number}" / "flight.mcap"
        record.parent.mkdir()
        record.touch()
        os.utime(record, (1000.0 + number, 1000.0 + number))

    listed = [path.name for path in flight_folders(tmp_path)]

    assert listed == ["flight8", "flight7", "flight6"]


def test_the_list_goes_on_past_what_is_no_record(
    flights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (flights / "other").mkdir()
    (flights / "other" / "flight.mcap").write_bytes(b"nothing")

    assert main(["log", "list", str(flights), "--json"]) == 0

    listed = json.loads(capsys.readouterr().out)
    assert sum("refused" in one for one in listed) == 1
    assert len(listed) == 3


def test_an_export_of_nothing_is_refused(flights: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["log", "export", str(flights / "first")]) == 2

    assert "give --foxglove, --csv DIR or both" in capsys.readouterr().err


def test_paths_are_written_as_csv(flights: Path, tmp_path: Path) -> None:
    assert main(["log", "export", str(flights / "first"), "--csv", str(tmp_path / "out")]) == 0

    lines = (tmp_path / "out" / "mav0.csv").read_text().splitlines()
    assert lines[0] == "t,x,y,z,yaw"
    assert len(lines) > 15


def test_a_verdict_that_is_neither_true_nor_false_is_listed_as_none(
    flights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (flights / "first" / "verdict.json").write_text('{"passed": []}')
    assert main(["log", "list", str(flights)]) == 0
    assert "no verdict" in capsys.readouterr().out


def test_a_flight_that_its_operator_ended_is_listed_as_interrupted(
    flights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    verdict = '{"passed": false, "is_interrupted": true, "exit_status": 130}'
    (flights / "first" / "verdict.json").write_text(verdict)

    assert summary(flights / "first")["is_interrupted"] is True
    assert main(["log", "list", str(flights)]) == 0
    text = capsys.readouterr().out
    assert " interrupted " in text
    assert "FAILED" not in text


def test_warnings_and_critical_events_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = write(tmp_path / "first", [*rows(length_s=2.0), *story("mav0")])
    with contextlib.closing(Timeline(flight)) as timeline:
        severities = [event.severity for _, event in timeline.events]
    assert severities.count("warning") > 0

    assert main(["log", "info", str(flight)]) == 0
    counts = f"{severities.count('warning')} of them warnings and {severities.count('critical')}"
    assert f"{len(severities)} events, {counts} critical." in capsys.readouterr().out


def test_a_long_verdict_is_shown_whole_and_a_huge_one_is_cut_visibly(flights: Path) -> None:
    verdict = flights / "first" / "verdict.json"
    verdict.write_text(json.dumps({"passed": False, "summary": "word" * 400}))
    assert summary(flights / "first")["verdict"] == "word" * 400

    verdict.write_text(json.dumps({"passed": False, "summary": "x" * 1_000_000}))
    shown = summary(flights / "first")["verdict"]
    assert len(shown) < 10_000
    assert shown.endswith("x...")
