"""The command line: sentences and exit statuses; nothing starts on wrong input."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tomllib
from itertools import pairwise
from pathlib import Path

import pytest

from groundstation import cli
from groundstation.flights.flight_settings import prepare
from onboard.config.fleet import ConfigError
from onboard.process import deploy

ROOT = Path(__file__).resolve().parents[3]
PAPER = str(ROOT / "configs/fleets/paper.toml")
MISSION = str(ROOT / "configs/missions/paper.toml")


def test_check_says_what_is_valid(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", PAPER, MISSION]) == 0
    out = capsys.readouterr().out
    assert "a valid fleet, 3 vehicles" in out
    assert "a valid mission, 5 steps" in out


def test_check_names_file_and_key_of_what_is_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
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
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("covey: ")
    assert "Traceback" not in captured.err
    assert captured.out == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words", [["fly", "none.toml"], ["identify", "--fleet", "none.toml", "--vehicle", "mav0"]]
)
def test_a_file_that_is_not_there_is_told_before_the_terminal_that_is_not_there(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(words) == 2
    assert "none.toml" in capsys.readouterr().err


def test_a_wrong_command_line_is_a_sentence_that_names_the_page_of_help(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for words, command, named in (
        (["fly"], "covey fly", "MISSION"),
        (["dance"], "covey", "dance"),
        (["demo", "--seed", "none"], "covey demo", "--seed"),
        (["demo", "--sead", "3"], "covey demo", "--seed"),
        (["check", "--errors", "none"], "covey check", "--errors"),
        (["check", "vehicles"], "covey check vehicles", "--fleet"),
        (["tui"], "covey tui", "--fleet"),
        (["px4", "parms"], "covey px4", "params"),
        (["px4", "params"], "covey px4 params", "--fleet"),
        (["log", "export"], "covey log export", "DIR"),
        (["simulate", "--jobs", "two", "form3"], "covey simulate", "two"),
    ):
        assert cli.main(words) == 2, words
        captured = capsys.readouterr()
        assert captured.out == "", words
        assert captured.err.startswith("covey: "), words
        assert named in captured.err, words
        assert f"'{command} --help' says more." in captured.err, words


def test_a_command_with_a_slip_of_the_pen_is_told_the_one_that_was_meant(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for typed, meant in (("chek", "check"), ("reprot", "report"), ("simulte", "simulate")):
        assert cli.main([typed]) == 2
        assert f"Did you mean '{meant}'?" in capsys.readouterr().err


def test_words_too_many_are_told_in_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["report", "flights/a", "flights/b", "flights/c"]) == 2
    assert "too many words: flights/b flights/c." in capsys.readouterr().err


WANTED = {"report", "log", "incident", "evidence"}  # commands that the list has room for


def test_the_list_of_commands_fits_a_screen_with_those_that_are_still_wanted(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    rows = [command for commands in cli.COMMANDS.values() for command in commands]
    still_wanted = WANTED - {command.name for command in rows}
    assert len(lines) + len(still_wanted) <= 24
    assert max(len(line) for line in lines) <= 79
    for group in cli.COMMANDS:
        assert any(line.startswith(f"{group} ") for line in lines)
    for command in rows:
        assert any(command.name in line.split()[:2] for line in lines), command.name


def all_commands() -> list[list[str]]:
    """The words of every command and of its parts."""
    words = []
    for commands in cli.COMMANDS.values():
        for command in commands:
            words.append([command.name])
            words += [[command.name, part.name] for part in command.parts]
    return words


@pytest.mark.parametrize("words", all_commands(), ids=" ".join)
def test_every_command_has_a_page_of_help_with_an_example_and_its_exit_statuses(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    if words == ["agent"]:  # the drone's own command line: tests/onboard/agent
        return
    page_words = ["px4", "params"] if words == ["px4"] else words
    assert cli.main([*page_words, "--help"]) == 0
    page = capsys.readouterr().out
    assert f"covey {' '.join(words)}" in page
    assert "xit status" in page


@pytest.mark.parametrize("columns", [60, 80, 130])
def test_prose_in_help_is_broken_only_at_the_edge_of_the_terminal(
    columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    assert cli.main(["simulate", "--help"]) == 0
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]

    for line, following in pairwise(lines):
        is_prose = line[:1].isalnum() and following[:1].isalnum()
        if is_prose:
            next_word, _, _ = following.partition(" ")
            assert len(line) + 1 + len(next_word) > columns, line


@pytest.mark.parametrize("old", sorted(cli.FORMER))
def test_a_former_command_works_on_and_names_its_new_words_on_standard_error(
    old: str, capsys: pytest.CaptureFixture[str]
) -> None:
    new = " ".join(cli.FORMER[old])
    assert cli.main([old, "--help"]) == 0
    page = capsys.readouterr()
    assert page.err == f"covey: 'covey {old}' is 'covey {new}' now; the old word goes on working.\n"
    assert cli.main([*cli.FORMER[old], "--help"]) == 0
    assert capsys.readouterr().out == page.out
    assert old not in [words[0] for words in all_commands()]


def test_a_former_command_keeps_its_exit_status_and_its_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    outputs = []
    for words in (["sitl-check"], ["check", "endpoint"]):
        assert cli.main([*words, "--list"]) == 0
        outputs.append(capsys.readouterr().out)
    assert outputs[0] == outputs[1] != ""
    assert cli.main(["doctor", str(tmp_path / "absent.toml"), "--json"]) == 2
    assert cli.main(["check", "computer", str(tmp_path / "absent.toml"), "--json"]) == 2


def test_check_without_a_file_says_which_command_answers_which_question(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["check"]) == 2
    lines = capsys.readouterr().out.splitlines()
    named = [line.split()[1:3] for line in lines if line.startswith("  covey ")]
    parts = [["check", part] for part in ("vehicles", "computer", "attack", "endpoint")]
    for words in [*parts, ["px4", "params"], ["px4", "compare"], ["keys", "list"]]:
        assert words in named
    assert max(len(line) for line in lines) <= 80


def test_without_a_command_the_list_is_shown_and_nothing_came_true(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main([]) == 2
    assert "simulate" in capsys.readouterr().out
    assert cli.main(["px4"]) == 2
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("covey ")


def test_the_shell_completes_commands_and_options() -> None:
    for shell in ("bash", "zsh", "fish"):
        script = cli.front_page(is_whole=True).generate_completion(shell=shell)
        assert "simulate" in script, shell
        assert "headless" in script, shell
        assert "endpoint" in script, shell


def test_bash_goes_on_completing_the_names_of_files() -> None:
    script = cli.front_page(["--install-completion"]).generate_completion(shell="bash")
    assert "complete -o default -F _covey covey" in script
    assert "compgen -f" in script.partition("# Bash completion")[0]
    assert "compgen -f" not in script.partition("# Bash completion")[2]


COMPLETED = [
    ("covey agent ", {"install", "status", "logs", "deploy"}),
    ("covey agent deploy --", {"--fleet", "--wheel", "--print"}),
    ("covey agent --law ", {"covey", "paper", "off"}),
    ("covey fly --law ", {"covey", "paper", "off"}),
    ("covey simulate --law p", {"paper"}),
    ("covey fly m", {"mission.toml", "my shows"}),
    ("covey fly ", {"mission.toml", "my shows", "script"}),
    ("covey check --fleet mi", {"mission.toml"}),
]


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash here")
def test_bash_completes_options_their_values_and_files(tmp_path: Path) -> None:
    (tmp_path / "mission.toml").touch()
    (tmp_path / "my shows").mkdir()
    script = tmp_path / "completion"
    whole = cli.front_page(["--install-completion"]).generate_completion(shell="bash")
    script.write_text(whole, encoding="utf-8")

    lines = [f"source {script}", "compopt() { :; }"]
    for typed, _ in COMPLETED:
        words = " ".join(f"'{word}'" for word in typed.split(" "))
        last = len(typed.split(" ")) - 1
        lines += [
            f"COMP_WORDS=({words}); COMP_CWORD={last}; COMPREPLY=(); _covey",
            'printf "%s\\n" "${COMPREPLY[@]}"; echo ---',
        ]
    done = subprocess.run(
        ["bash", "-c", "\n".join(lines)], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    offered = [set(part.split("\n")) for part in done.stdout.split("---\n")]
    for (typed, wanted), found in zip(COMPLETED, offered, strict=False):
        assert wanted <= found, (typed, found)


def test_the_pages_of_the_agent_look_like_all_others(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["agent", "deploy", "--help"]) == 0
    page = capsys.readouterr().out
    assert page.startswith("Usage: covey agent deploy --fleet FILE")
    for option in deploy.parser().parse_args(["--fleet", "f"]).__dict__:
        assert f"--{option.removesuffix('s') if option == 'prints' else option}" in page


def test_simulate_says_how_a_mission_is_flown(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["simulate", "mission.toml"]) == 2
    assert "covey fly mission.toml --lockstep" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--at", "21:30", "--lockstep"], "--at is for flights in real time"),
        (["--at", "noon", "--sitl"], "--at: 'noon' is no time of day"),
        (["--at", "2001-01-01 21:30", "--sitl"], "years ago"),
        (["--at", "2999-01-01T21:30", "--headless"], "from now; a start is at most 6 h ahead"),
    ],
)
def test_a_time_at_which_nothing_can_begin_is_refused_before_anything_starts(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["fly", "paper", "--record", str(tmp_path / "flight"), *words]) == 2
    assert sentence in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "flight").exists()


def test_an_agent_and_the_list_of_commands_need_no_library_of_the_ground() -> None:
    code = """
import sys
from groundstation.cli import main
main({words!r})
print([name for name in {heavy!r} if name in sys.modules])
"""
    heavy = ["textual", "numba", "matplotlib", "mcap", "aiohttp", "pymavlink", "rich.markdown"]
    for words, names in (
        (["agent", "--fleet", "none.toml", "--vehicle", "a"], [*heavy, "cyclopts"]),
        (["--help"], heavy),
    ):
        done = subprocess.run(
            [sys.executable, "-c", code.format(words=words, heavy=names)],
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout.splitlines()[-1] == "[]", words


def test_a_value_that_begins_with_a_minus_is_the_value_of_its_option(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["fly", MISSION, "--lockstep", "--wind-m-s", "-99,0"]) == 2
    assert "--wind-m-s is '-99,0'; write it as EAST,NORTH" in capsys.readouterr().err
    words = ["init", str(tmp_path), "--vehicles", "2", "--position", "gps", "--companions", "here"]
    assert cli.main([*words, "--origin", "-33.9,18.4,40"]) == 0
    assert "latitude_deg = -33.9" in (tmp_path / "fleet.toml").read_text()


def test_the_folder_gets_the_files_that_are_really_used_and_a_flown_one_is_not_overwritten(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "flight"
    settings = prepare(
        MISSION,
        folder,
        fleet_path=None,
        law="off",
        is_simulated=True,
        has_free_ports=True,
        is_headless=True,
    )
    assert settings.mission.fleet.law.name == "off"
    assert "covey tui --fleet" in (folder / "fleet.toml").read_text()
    assert (folder / "mission.toml").read_text() == Path(MISSION).read_text()
    # on another computer there is no such folder
    assert "folder" not in tomllib.loads((folder / "fleet.toml").read_text())["law"]
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
        )


def test_a_lab_s_file_flies_in_simulation_on_ports_of_this_computer(tmp_path: Path) -> None:
    words = [
        "init",
        str(tmp_path),
        "--vehicles",
        "2",
        "--position",
        "vicon",
        "--companions",
        "10.0.0.11",
    ]
    assert cli.main(words) == 0
    settings = prepare(
        str(tmp_path / "mission.toml"),
        tmp_path / "flight",
        fleet_path=None,
        law=None,
        is_simulated=True,
        has_free_ports=False,
        is_headless=True,
    )
    for vehicle in settings.mission.fleet.vehicles.values():
        assert vehicle.host == "127.0.0.1"
        assert vehicle.autopilot.startswith("udpin://127.0.0.1:")


def test_a_flight_is_not_recorded_over_the_files_it_is_flown_from(tmp_path: Path) -> None:
    assert cli.main(["init", str(tmp_path), "--vehicles", "2", "--companions", "here"]) == 0
    fleet_path = tmp_path / "fleet.toml"
    own_text = fleet_path.read_text()

    with pytest.raises(ConfigError, match="the flight would overwrite it"):
        prepare(
            str(tmp_path / "mission.toml"),
            tmp_path,
            fleet_path=None,
            law="off",
            is_simulated=True,
            has_free_ports=True,
            is_headless=True,
        )
    assert fleet_path.read_text() == own_text


def test_import_does_not_overwrite_a_mission_that_is_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mission_path = tmp_path / "mission.toml"
    mission_path.write_text("mine")

    assert cli.main(["import", "configs/shows/thirty.skyc", "--out", str(tmp_path)]) == 2
    assert "mission.toml exists already" in capsys.readouterr().err
    assert mission_path.read_text() == "mine"


@pytest.mark.parametrize("words", [["init"], ["import", "configs/shows/thirty.skyc", "--out"]])
def test_a_place_where_nothing_can_be_written_is_one_sentence(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "file"
    file.write_text("")

    assert cli.main([*words, str(file)]) == 2
    assert f"{file}: this file or folder cannot be used (File exists)" in capsys.readouterr().err


def test_a_full_disk_is_one_sentence() -> None:
    command = [sys.executable, "-m", "groundstation", "check", "paper"]
    with open("/dev/full", "w") as full:
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)

    assert ended.returncode == 2
    assert ended.stderr.startswith("covey: nothing more can be written (No space left on device)")


def test_commands_to_type_next_can_be_typed_when_a_name_has_a_space(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "my fleet"
    assert cli.main(["init", str(folder), "--vehicles", "2", "--companions", "here"]) == 0
    assert f"covey check '{folder}/mission.toml'" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("kind", "line", "sentence"),
    [
        ("order", "3 fliege", "'fliege' is no order"),
        ("order", "3 move mav9 0 0 1", "mav9"),
        ("fault", "mav9 motor_dead at=3", "'mav9' is not emulated here"),
        ("fault", "mav1 motor_dead at=3 motor=77", "motor is 77.0; it must lie between 1 and 4"),
    ],
)
def test_an_order_or_a_fault_that_is_impossible_is_refused_before_the_flight_has_a_folder(
    kind: str, line: str, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "flight"

    words = ["fly", "paper", "--lockstep", "--record", str(folder)]
    assert cli.main([*words, f"--{kind}", line]) == 2
    printed = capsys.readouterr().err
    assert f"The {kind} '{line}': " in printed
    assert sentence in printed
    assert not folder.exists()


def test_what_a_law_prints_is_no_part_of_the_findings_for_programs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "talking_law.py").write_text("print('hello')\n\n\ndef law(memory, inputs): ...\n")
    fleet = tmp_path / "fleet.toml"
    text = Path("configs/fleets/paper.toml").read_text()
    assert 'name = "covey"' in text
    fleet.write_text(text.replace('name = "covey"', 'name = "talking_law:law"'))

    cli.main(["check", str(fleet), "--run-law", "--json"])

    printed = capsys.readouterr()
    assert json.loads(printed.out)
    assert "hello" in printed.err
