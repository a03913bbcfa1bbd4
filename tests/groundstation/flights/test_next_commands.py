"""The commands that are printed after a flight with the console."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from groundstation.cli import main
from groundstation.flights.mission_flight import next_commands
from onboard.bus.topics import Topic
from tests.groundstation.report.made_up import rows, story, write


def test_a_flight_below_the_current_folder_is_named_by_its_relative_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = write(tmp_path / "flights" / "first", rows(length_s=1.0))
    lines = next_commands(folder, "mission.toml")
    assert lines == [
        "Record, events and logs: flights/first",
        "  see it again:    covey replay flights/first",
        "  in a browser:    covey report flights/first",
        "  draw it:         covey plot flights/first",
        "  how closely this can be flown: covey check flights/first/mission.toml"
        " --fleet flights/first/fleet.toml",
    ]


def test_a_verdict_is_named_only_if_there_is_one(tmp_path: Path) -> None:
    folder = write(tmp_path, rows(length_s=1.0))
    assert next_commands(folder, "mission.toml")[0] == f"Record, events and logs: {folder}"

    (folder / "verdict.json").write_text("{}", encoding="utf-8")
    first = next_commands(folder, "mission.toml")[0]
    assert first == f"Record, events, logs and verdict: {folder}"


def test_a_flight_elsewhere_is_named_by_its_whole_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    lines = next_commands(write(tmp_path / "there", rows(length_s=1.0)), "mission.toml")
    assert lines[1].endswith(f" covey replay {tmp_path / 'there'}")


def test_a_path_with_a_space_can_be_copied_into_a_shell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = write(tmp_path / "my flights" / "first", rows(length_s=1.0))
    lines = next_commands(folder, "mission.toml")
    assert lines[3].endswith(" covey plot 'my flights/first'")


@pytest.mark.parametrize(
    ("topics", "commands"),
    [
        ((), ["check"]),
        ((Topic.EVENT,), ["check"]),
        ((Topic.EVENT, Topic.TELEMETRY), ["replay", "report", "check"]),
        ((Topic.TICK,), ["replay", "report", "plot", "check"]),
    ],
)
def test_only_commands_that_the_record_allows_are_named(
    topics: tuple[Topic, ...], commands: list[str], tmp_path: Path
) -> None:
    told = [row for row in [*rows(length_s=1.0), *story("mav0")] if row[1] in topics]
    folder = write(tmp_path / "first", told)

    _, *lines = next_commands(folder, "mission.toml")
    assert [line.partition(" covey ")[2].split()[0] for line in lines] == commands
    for line, command in zip(lines[:-1], commands[:-1], strict=True):
        if command != "replay":
            assert main(line.partition(" covey ")[2].split()) == 0


@pytest.mark.realtime
def test_the_first_line_of_a_flight_names_its_folder_from_the_current_one(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "groundstation", "demo", "--headless"]
    process = subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
    assert "everything goes to flights/" in line
