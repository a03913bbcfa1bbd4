"""``covey init``: a commented fleet file and a first mission, from a few questions or options.

Examples:
  covey init lab
  covey init lab --vehicles 4 --position optitrack --mocap-host 192.168.1.2
  covey init field --vehicles 3 --position gps --origin 47.3977,8.5456,489.4
  covey init mine --law my_law
  covey init sandbox --vehicles 6 --companions here --type ardrone

In a terminal it asks for each value that no option gives; elsewhere it takes
the defaults.

Exit status: 0 written; 2 wrong input, nothing written.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, get_args

from cyclopts import CoercionError, Parameter, Token

from groundstation.recording.output_file import write_together
from groundstation.starter.law_files import law_module, own_law_texts, with_own_law
from groundstation.starter.starter_files import (
    HERE,
    NOT_POSITIONS,
    Answers,
    Position,
    refuse_wrong_answer,
    starter,
    type_names,
)
from onboard.config.fleet import ConfigError
from onboard.exit_status import EXIT_OK
from onboard.plain_text import numbered


def _position(_: object, tokens: Sequence[Token]) -> str:
    """Return the word of --position, if it is a known source of positions.

    Raises:
        CoercionError: it is unknown; the message says what to do instead.
    """
    word = tokens[0].value
    known = get_args(Position)
    if word in known:
        return word

    instead = NOT_POSITIONS.get(word.lower(), "")
    sentence = f"'{word}' is none of {', '.join(known)}. {instead}".strip()
    raise CoercionError(msg=sentence)


_Host = Annotated[str | None, Parameter(metavar="HOST")]


def init(
    folder: Annotated[Path, Parameter(name="DIR")] = Path("."),
    /,
    *,
    name: str | None = None,
    vehicles: Annotated[int | None, Parameter(metavar="N")] = None,
    position: Annotated[Position | None, Parameter(converter=_position)] = None,
    mocap_host: _Host = None,
    origin: Annotated[
        str | None, Parameter(metavar="LAT,LON,ALT", allow_leading_hyphen=True)
    ] = None,
    companions: Annotated[str | None, Parameter(metavar="HOSTS")] = None,
    autopilot: Annotated[str | None, Parameter(metavar="ENDPOINT")] = None,
    spacing: Annotated[float | None, Parameter(metavar="METRES")] = None,
    type: Annotated[str | None, Parameter(metavar="TYPE")] = None,
    mass: Annotated[float | None, Parameter(metavar="KG")] = None,
    law: Annotated[str | None, Parameter(metavar="NAME")] = None,
    force: bool = False,
) -> int:
    """Write DIR/fleet.toml and DIR/mission.toml, with comments; both pass covey check.

    Args:
        folder: folder of the files
        name: name of the fleet, which is a part of its topics on the bus
        vehicles: number of vehicles
        position: source of positions: the motion capture indoors; "bus" for poses from your own
            program or from the emulator; "gps" outdoors
        mocap_host: computer on which the motion capture's program runs
        origin: latitude, longitude and altitude of the fleet's 0, 0, 0 outdoors (--position gps)
        companions: address of the first companion computer, from which the others count up, or all
            addresses with commas; "here" to simulate
        autopilot: endpoint of PX4 on each companion computer
        spacing: distance of the take-off spots
        type: a type of the examples, or a new name
        mass: mass of a new type
        law: also write a law of your own, NAME.py, and a test of it: docs/own-law.md
        force: overwrite files that are there
    """
    fleet_path = folder / "fleet.toml"
    mission_path = folder / "mission.toml"
    law_path = None
    law_test_path = None
    if law is not None:
        law_path = folder / f"{law_module(law)}.py"
        law_test_path = folder / f"test_{law}.py"
    if not force:
        _refuse_existing(fleet_path, mission_path, law_path, law_test_path)

    options: dict[str, Any] = {
        "name": name,
        "vehicles": vehicles,
        "position": position,
        "mocap_host": mocap_host,
        "origin": origin,
        "companions": companions,
        "autopilot": autopilot,
        "spacing_m": spacing,
        "type": type,
        "mass_kg": mass,
    }
    answers = {key: value for key, value in options.items() if value is not None}
    if sys.stdin.isatty() and sys.stdout.isatty():
        try:
            _ask_for_rest(answers)
        except EOFError:  # Ctrl-D ends the command as Ctrl-C does
            raise KeyboardInterrupt from None
    wanted = Answers(**answers)
    _refuse_unused(options, wanted)
    starter_files = starter(wanted)

    fleet_text = starter_files.fleet_text
    if law is not None:
        fleet_text = with_own_law(fleet_text, law)

    texts = {fleet_path: fleet_text, mission_path: starter_files.mission_text}
    if law_path is not None and law_test_path is not None:
        texts[law_path], texts[law_test_path] = own_law_texts()
    write_together({path: text.encode() for path, text in texts.items()})

    count = numbered(len(starter_files.fleet.vehicles), "vehicle")
    print(f"Written: {fleet_path} for {count}, and {mission_path}.")

    if law_path is not None and law_test_path is not None:
        print(
            f"Written: {law_path}, a law of your own, and {law_test_path}. "
            "What it may do: docs/own-law.md."
        )

    _print_next(fleet_path, mission_path)
    return EXIT_OK


def _refuse_unused(options: Mapping[str, object], answers: Answers) -> None:
    """Refuse an option whose value would not be written.

    Args:
        options: value of each option by its key; None: not given.
        answers: the answers of all questions.

    Raises:
        ConfigError: an option would be without effect.
    """
    is_by_mocap = answers.position not in ("gps", "bus")
    # key of an option -> whether its value is written, and what it needs
    needs = {
        "origin": (answers.position == "gps", "a fleet that flies by satellites: --position gps"),
        "mocap_host": (is_by_mocap, "a fleet that flies by a motion capture: --position optitrack"),
        "autopilot": (answers.companions != HERE, "companion computers: --companions HOSTS"),
        "mass_kg": (answers.type not in type_names(), "a new type of vehicle: --type NAME"),
    }
    for key, (is_written, need) in needs.items():
        if options[key] is not None and not is_written:
            option = "--" + key.removesuffix("_kg").replace("_", "-")
            raise ConfigError(f"{option} needs {need}. Add that, or leave {option} out.")


def _refuse_existing(*paths: Path | None) -> None:
    """Refuse to overwrite files; a path may be None.

    Raises:
        ConfigError: one of them exists.
    """
    existing = [str(path) for path in paths if path is not None and path.exists()]
    if existing:
        raise ConfigError(
            f"{' and '.join(existing)} exist already. "
            "Name another folder, or overwrite with --force."
        )


def _print_next(fleet_path: Path, mission_path: Path) -> None:
    """Print which commands come next, and what each does."""
    mission = shlex.quote(str(mission_path))
    fleet = shlex.quote(str(fleet_path))
    print("fleet.toml and mission.toml have comments on what to measure and to look up. Next:")
    for command, effect in (
        (f"covey check {mission}", "what can be flown, and how closely"),
        (f"covey fly {mission} --lockstep", "the flight in simulated time: seconds"),
        (f"covey fly {mission} --sitl", "the same with console, agents and emulated PX4s"),
        (
            f"covey check vehicles --fleet {fleet}",
            "the real vehicles; first read docs/deployment.md",
        ),
    ):
        print(f"  {command:<50} {effect}")


def _ask_for_rest(answers: dict[str, Any]) -> None:
    """Ask for the answers that no option has given; an empty line takes the default."""
    positions = get_args(Position)

    _ask(answers, "vehicles", "How many vehicles", int)
    _ask_for_position(answers, f"Where do their positions come from ({', '.join(positions)})")
    if answers["position"] == "gps":
        _ask(answers, "origin", "Latitude, longitude, altitude of the fleet's 0, 0, 0")
    elif answers["position"] != "bus":
        _ask(answers, "mocap_host", "Address of the computer on which its program runs")

    _ask(
        answers,
        "companions",
        f"Address of the first companion computer, or all with commas ('{HERE}' to simulate)",
    )
    if answers["companions"] != HERE:
        _ask(answers, "autopilot", "PX4 as each companion sees it")

    _ask(answers, "type", f"Type of the vehicles ({', '.join(type_names())}, or a new name)")
    if answers["type"] not in type_names():
        _ask(answers, "mass_kg", "Mass with battery in kg", float)

    _ask(
        answers,
        "spacing_m",
        "Distance of the take-off spots in metres",
        float,
        shown="enough for the law",
    )


def _ask(
    answers: dict[str, Any],
    key: str,
    question: str,
    kind: type[int] | type[float] | type[str] = str,
    *,
    shown: str = "",
) -> None:
    """Ask until the answer is valid and of this kind, unless an option has given one.

    Args:
        answers: the answers so far, to which this one is added.
        key: key of the answer.
        question: the question.
        kind: type of the answer.
        shown: words for the default; empty: its value.
    """
    default = _default(key)
    while key not in answers:
        word = input(f"{question} [{shown or default}]: ").strip()
        if not word:
            answers[key] = default
            return
        try:
            answer = kind(word)
        except ValueError:
            print(f"'{word}' is no number.")
            continue

        try:
            refuse_wrong_answer(key, Answers(**{**answers, key: answer}))
        except ConfigError as error:
            print(error)
            continue
        answers[key] = answer


def _ask_for_position(answers: dict[str, Any], question: str) -> None:
    """Ask until the answer is a source of positions that Covey knows."""
    positions = get_args(Position)
    _ask(answers, "position", question)
    while answers["position"] not in positions:
        instead = NOT_POSITIONS.get(answers["position"].lower(), "")
        print(f"One of {', '.join(positions)}. {instead}".strip())
        del answers["position"]
        _ask(answers, "position", question)


def _default(key: str) -> Any:
    """Return the default of an answer."""
    defaults = {field.name: field.default for field in fields(Answers)}
    return defaults[key]
