"""First files of new users: each combination of answers passes the checks, flies, and overwrites
nothing.
"""

from __future__ import annotations

import builtins
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import pytest

from groundstation import cli
from groundstation.cli import main
from groundstation.file_checks.examination import examine
from groundstation.processes.free_ports import PX4_OFFSET
from groundstation.processes.supervisor import most_agents
from groundstation.starter.starter_files import (
    Answers,
    Position,
    companion_addresses,
    endpoint_lines,
    starter,
)
from onboard.config.fleet import ConfigError, fleet_from_mapping, parking_distance_m
from sitl.lockstep.flight import Lockstep


def port_of(endpoint: str) -> int:
    return int(endpoint.rsplit(":", 1)[1])


def test_every_combination_of_answers_passes_the_check(tmp_path: Path) -> None:
    for position in get_args(Position):
        for count in (1, 5, 13) if position in ("bus", "gps") else (3,):
            for kind in ("ardrone", "own"):
                made = starter(
                    Answers(vehicles=count, position=position, type=kind, companions="10.0.0.11")
                )
                (tmp_path / "fleet.toml").write_text(made.fleet_text)
                (tmp_path / "mission.toml").write_text(made.mission_text)
                findings = examine(str(tmp_path / "mission.toml"))[2]  # with those of its fleet
                left = {finding.name for finding in findings if finding.status == "warning"}
                # the paper's drones are slow
                known = {"kappas", "keys of the bus"}
                known |= {"airtime"} if count > 12 else set()  # much for one Wi-Fi channel
                assert left <= known, (position, count, kind)
                assert all(finding.status != "refused" for finding in findings)


def test_the_files_say_where_each_computer_is() -> None:
    made = starter(
        Answers(
            vehicles=3, position="vicon", companions="10.0.0.9", autopilot="udpin://0.0.0.0:14540"
        )
    )
    assert [vehicle.host for vehicle in made.fleet.vehicles.values()] == [
        "10.0.0.9",
        "10.0.0.10",
        "10.0.0.11",
    ]
    assert made.fleet.mocap.type == "vicon"
    assert companion_addresses("one.local, two.local", 2) == ["one.local", "two.local"]


def test_no_two_of_250_vehicles_on_one_computer_share_a_port() -> None:
    tables = [tomllib.loads("\n".join(endpoint_lines(index))) for index in range(250)]
    agents = [port_of(table["agent"]) for table in tables]
    assert len(set(agents)) == 250

    onboard = [port_of(table["autopilot"]) for table in tables]
    px4 = [port + PX4_OFFSET for port in onboard]
    direct = [port_of(table["direct"]) for table in tables]
    assert len({*onboard, *px4, *direct}) == 3 * 250


def test_the_first_fifty_vehicles_on_one_computer_have_px4s_ports() -> None:
    for index in range(50):
        table = tomllib.loads("\n".join(endpoint_lines(index)))
        more = 0 if index < 10 else 1000
        assert port_of(table["autopilot"]) == 14540 + more + index
        assert port_of(table["direct"]) == 18570 + more + index


@pytest.mark.parametrize(
    ("answers", "words"),
    [
        ({"vehicles": 0}, "between 1 and"),
        ({"name": "\U0001f681"}, "'fleet.name' is '\U0001f681'"),
        ({"mocap_host": "a\x7fb"}, "--mocap-host is .* cannot be printed"),
        ({"mocap_host": "a\udcffb"}, "--mocap-host is .* cannot be printed"),
        ({"spacing_m": 0.9}, f"{parking_distance_m(starter(Answers()).fleet):.2f} m or more"),
        ({"spacing_m": float("nan")}, "between 0.1 and 100"),
        ({"companions": "one,two"}, "all 3 with commas"),
        ({"companions": "drone-one"}, "all 3 with commas"),
        ({"companions": "192.168.1.253"}, "ends in 1 to 252, or all 3 with commas"),
        ({"companions": "192.168.1.0"}, "ends in 1 to 252, or all 3 with commas"),
        ({"position": "gps", "origin": "47,8"}, "LATITUDE,LONGITUDE,ALTITUDE"),
        ({"name": 'a"b'}, "fleet.name"),
        ({"type": 'a"b'}, "--type"),
        ({"companions": "10.0.0.1", "autopilot": 'x"'}, "autopilot"),
        ({"mass_kg": -1.0}, "mass_kg"),
    ],
)
def test_a_wrong_answer_is_refused_in_words(answers: dict[str, object], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        starter(Answers(**answers))  # type: ignore[arg-type]


@pytest.mark.parametrize("text", ["caf\u00e9.local", "\U0001f681.local", 'a "b" \\c'])
def test_an_answer_with_any_letters_is_in_the_file(text: str) -> None:
    made = starter(Answers(position="vicon", mocap_host=text, companions="here"))
    assert made.fleet.mocap.hostname == text


@pytest.mark.parametrize(
    ("line", "need"),
    [
        ("--origin nan,0,0", "--position gps. Add that, or leave --origin out."),
        ("--position optitrack --origin 47,8,400", "--position gps."),
        ("--mocap-host 10.0.0.9", "--position optitrack. Add that, or leave --mocap-host out."),
        ("--position gps --mocap-host 10.0.0.9", "--position optitrack."),
        ("--autopilot udpin://0.0.0.0:14540", "--companions HOSTS."),
        ("--type ardrone --mass 2.5", "--type NAME. Add that, or leave --mass out."),
    ],
)
def test_an_option_that_would_be_without_effect_is_refused(
    tmp_path: Path, line: str, need: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "lab"
    assert cli.main(["init", str(folder), *line.split()]) == 2
    assert need in capsys.readouterr().err
    assert not folder.exists()


def test_init_writes_two_files_and_overwrites_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert (
        cli.main(
            [
                "init",
                "lab",
                "--vehicles",
                "4",
                "--position",
                "optitrack",
                "--companions",
                "10.0.0.11",
            ]
        )
        == 0
    )
    assert "covey fly lab/mission.toml --lockstep" in capsys.readouterr().out
    assert cli.main(["check", "lab/fleet.toml", "lab/mission.toml"]) == 0
    text = (tmp_path / "lab/fleet.toml").read_text()
    assert cli.main(["init", "lab", "--vehicles", "5"]) == 2
    assert "exist already" in capsys.readouterr().err
    assert (tmp_path / "lab/fleet.toml").read_text() == text
    assert cli.main(["init", "lab", "--vehicles", "5", "--force"]) == 0
    assert "[vehicles.mav4]" in (tmp_path / "lab/fleet.toml").read_text()


def test_in_a_terminal_init_asks_for_what_no_option_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["five", "5", "radar", "qualisys", "10.1.1.1", "10.1.1.11", "", "racer", "0.4", ""]
    asked = []

    def answer(question: str) -> str:
        asked.append(question)
        return words[len(asked) - 1]

    monkeypatch.setattr(builtins, "input", answer)
    for stream in (sys.stdin, sys.stdout):
        monkeypatch.setattr(stream, "isatty", lambda: True, raising=False)
    assert cli.main(["init", str(tmp_path), "--name", "lab"]) == 0
    assert len(asked) == len(words)
    text = (tmp_path / "fleet.toml").read_text()
    for part in (
        "mav4",
        'type = "qualisys"',
        "10.1.1.15:7460",
        "[types.racer]",
        "mass_kg = 0.4",
        "serial:///dev/ttyAMA0",
    ):
        assert part in text, part


def _in_terminal(monkeypatch: pytest.MonkeyPatch, answer: Callable[[str], str]) -> None:
    monkeypatch.setattr(builtins, "input", answer)
    for stream in (sys.stdin, sys.stdout):
        monkeypatch.setattr(stream, "isatty", lambda: True, raising=False)


def test_an_end_of_the_input_ends_the_questions_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def end(_question: str) -> str:
        raise EOFError

    _in_terminal(monkeypatch, end)
    assert cli.main(["init", str(tmp_path)]) == 130
    assert list(tmp_path.iterdir()) == []


def test_a_spacing_that_is_no_number_is_asked_for_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    spacings = iter(["1,5", "2.5"])

    def answer(question: str) -> str:
        return next(spacings) if "spots" in question else ""

    _in_terminal(monkeypatch, answer)
    assert cli.main(["init", str(tmp_path), "--name", "lab"]) == 0
    assert "'1,5' is no number" in capsys.readouterr().out
    assert next(spacings, None) is None


def test_an_answer_that_is_wrong_is_asked_for_again_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = {
        "many": ["0", "2"],
        "positions": ["gps"],
        "Latitude": ["Paris", "48.8, 2.3, 35"],
        "first companion": ["10.0.0.1,10.0.0.2,10.0.0.3", "10.0.0.300", "10.0.0.1"],
        "Type": ["my quad", "quad4"],
        "spots": ["0.01", ""],
    }

    def answer(question: str) -> str:
        for word, given in words.items():
            if word in question:
                return given.pop(0)
        return ""

    _in_terminal(monkeypatch, answer)
    assert cli.main(["init", str(tmp_path), "--name", "lab"]) == 0
    assert not any(words.values())
    told = capsys.readouterr().out
    for wrong in ("0", "'Paris'", "'10.0.0.1,10.0.0.2,10.0.0.3'", "'10.0.0.300'", "'my quad'"):
        assert f" is {wrong};" in told
    assert "0.01; it must lie" in told


def test_the_first_mission_flies() -> None:
    made = starter(Answers(vehicles=1, position="optitrack", companions="10.0.0.11"))
    with Lockstep(made.fleet, seed=1) as flight:
        assert flight.fly(made.mission).passed


def test_the_demo_flies_no_more_than_the_machine_can(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["demo", "--headless", "--vehicles", str(most_agents() + 1)]) == 2
    assert "--lockstep" in capsys.readouterr().err
    assert cli.main(["demo", "--vehicles", "3", "--mission", "paper"]) == 2
    assert list(tmp_path.iterdir()) == []


def test_a_position_that_is_not_flown_is_refused_with_what_to_do_instead(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for word, instead in (
        ("vision", 'px4_position = "vision"'),
        ("vio", 'px4_position = "vision"'),
        ("rtk", "--position gps"),
        ("gsp", ""),
    ):
        assert main(["init", str(tmp_path / "lab"), "--position", word]) == 2
        said = capsys.readouterr().err
        assert f"'{word}' is none of optitrack, vicon" in said
        assert instead in said
        assert "Did you mean" not in said


def test_what_init_writes_is_flown_by_cameras_once_its_type_says_so() -> None:
    text = starter(Answers(vehicles=3, position="bus")).fleet_text
    by_vision = text.replace(
        "mocap_required = true", 'mocap_required = false\npx4_position = "vision"'
    )
    fleet = fleet_from_mapping(tomllib.loads(by_vision), path="fleet.toml", text=by_vision)
    assert all(vehicle.flies_by_vision for vehicle in fleet.vehicles.values())


def test_a_fleet_outdoors_has_corrections_that_count_once_the_signs_are_taken_away() -> None:
    text = starter(Answers(vehicles=3, position="gps", origin="47.4,8.5,489.4")).fleet_text
    lines = text.splitlines()
    begin = lines.index("# [corrections]")
    for number in range(begin, begin + 4):
        lines[number] = lines[number].removeprefix("# ")
    table = tomllib.loads("\n".join(lines))
    fleet = fleet_from_mapping(table, path="fleet.toml", text="\n".join(lines))
    assert fleet.corrections is not None
    assert fleet.corrections.fix == "rtk_fixed"
    assert "[corrections]" not in starter(Answers(vehicles=3)).fleet_text
