"""The command line: sentences and exit statuses; nothing starts on wrong input."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation import cli
from groundstation.commands.flight import prepare
from onboard.config.fleet import ConfigError

ROOT = Path(__file__).resolve().parents[3]
PAPER = str(ROOT / "configs/fleets/paper.toml")
MISSION = str(ROOT / "configs/missions/paper.toml")


def test_check_says_what_is_valid(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", PAPER, MISSION]) == 0
    out = capsys.readouterr().out
    assert "a valid fleet, 3 vehicles" in out
    assert "a valid mission, 5 steps" in out


def test_check_names_file_and_key_of_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "f.toml"
    path.write_text(Path(PAPER).read_text().replace("safety_distance_m", "safety_distanz_m"))
    assert cli.main(["check", str(path), str(tmp_path / "absent.toml")]) == 2
    err = capsys.readouterr().err
    assert "fleet.safety_distanz_m" in err
    assert "absent.toml" in err


@pytest.mark.parametrize(
    "words",
    [
        ["demo", "--headless", "--fleet", "/nowhere/f.toml"],
        ["demo", "--headless", "--mission", "/nowhere/m.toml"],
        ["demo", "--headless", "--seed", "-1"],
        ["demo"],  # without a terminal
        ["fly", MISSION, "--headless", "--law", "off"],
        ["tui", "--fleet", "/nowhere/f.toml"],
    ],
    ids=" ".join,
)
def test_wrong_input_is_one_sentence_and_exit_status_two(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("covey: ")
    assert "Traceback" not in captured.err
    assert captured.out == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words", [["fly", "none.toml"], ["identify", "--fleet", "none.toml", "--vehicle", "mav0"]])
def test_a_file_that_is_not_there_is_told_before_the_terminal_that_is_not_there(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(words) == 2
    assert "none.toml" in capsys.readouterr().err


@pytest.mark.parametrize("words", [[], ["fly"], ["dance"], ["demo", "--law", "none"]])
def test_a_command_line_that_is_none_is_exit_status_two(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        cli.main(words)
    assert caught.value.code == 2


def test_the_folder_gets_the_files_that_are_really_used_and_a_flown_one_is_not_overwritten(tmp_path: Path) -> None:
    folder = tmp_path / "flight"
    settings = prepare(
        MISSION,
        folder,
        fleet_path=None,
        law="off",
        is_simulated=True,
        has_free_ports=True,
        is_headless=True,
        seed=0,
    )
    assert settings.mission.fleet.law.name == "off"
    assert "covey tui --fleet" in (folder / "fleet.toml").read_text()
    assert (folder / "mission.toml").read_text() == Path(MISSION).read_text()
    assert cli.main(["check", str(folder / "fleet.toml")]) == 0
    (folder / "flight.mcap").write_bytes(b"")
    with pytest.raises(ConfigError, match="holds a flight already"):
        prepare(
            MISSION,
            folder,
            fleet_path=None,
            law=None,
            is_simulated=True,
            has_free_ports=True,
            is_headless=True,
            seed=0,
        )
