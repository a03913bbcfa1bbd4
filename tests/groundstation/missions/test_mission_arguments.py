"""Arguments of Python missions: from the command line, of the kinds of their defaults, refused in
words.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from groundstation.cli import main
from groundstation.mission_files.loading import load_mission
from groundstation.mission_files.python_file import arguments_of, load_function
from onboard.config.fleet import ConfigError
from sitl.lockstep.flight import Lockstep

MISSION = """
FLEET = "paper"


async def mission(fleet, height_m=1.0, times=1, says="up", is_calm=True):
    fleet.say(f"{height_m!r} {times!r} {says!r} {is_calm!r}")
    await fleet.takeoff(height_m)
    await fleet.land()
"""


async def _mission(
    fleet: Any, height_m: float = 1.0, times: int = 1, says: str = "", is_calm: bool = True
) -> None:
    """Have arguments."""


async def _needing(fleet: Any, goal: Any) -> None:
    """Have one that must be given."""


def test_written_arguments_become_the_kinds_of_their_defaults() -> None:
    given = {"height_m": "1.5", "times": "3", "says": "7", "is_calm": "no"}
    assert arguments_of(_mission, given, "m.py") == {
        "height_m": 1.5,
        "times": 3,
        "says": "7",
        "is_calm": False,
    }
    assert arguments_of(_mission, {"height_m": "2"}, "m.py") == {"height_m": 2}
    assert arguments_of(_needing, {"goal": "(0, 1, 2)"}, "m.py") == {"goal": (0, 1, 2)}
    assert arguments_of(_needing, {"goal": "north"}, "m.py") == {"goal": "north"}


@pytest.mark.parametrize(
    ("function", "given", "words"),
    [
        (
            _mission,
            {"heigth_m": "1"},
            "has no argument 'heigth_m'; it has height_m, times, says, is_calm",
        ),
        (_mission, {"height_m": "high"}, "must be a number"),
        (_mission, {"times": "1.5"}, "whole number"),
        (_mission, {"times": "{[]: 1}"}, "whole number"),
        (_mission, {"is_calm": "perhaps"}, "true or false"),
        (_needing, {}, "--arg goal=VALUE"),
    ],
)
def test_wrong_arguments_are_refused_in_words(
    function: Any, given: dict[str, str], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        arguments_of(function, given, "m.py")


@pytest.mark.long
def test_the_command_line_and_a_test_give_arguments(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "m.py"
    path.write_text(MISSION, encoding="utf-8")
    assert main(["fly", str(path), "--lockstep", "--arg", "height=1"]) == 2
    assert "no argument 'height'" in capsys.readouterr().err
    assert main(["fly", "paper", "--lockstep", "--arg", "height_m=1"]) == 2
    assert "only Python missions" in capsys.readouterr().err
    with Lockstep("paper", seed=1) as flight:
        assert flight.fly(path, height_m=0.6, says="x").passed
        assert any(event.sentence == "0.6 1 'x' True" for event in flight.events)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("import os; os.environ['NO_SUCH_HALL']", "KeyError"),
        ("{}['x']", "KeyError: 'x'"),
        ("1 / 0", "ZeroDivisionError"),
        ("assert False", "AssertionError"),
        ("raise SystemExit(3)", "SystemExit: 3"),
        ("import sys; sys.exit('not today')", "SystemExit: not today"),
        ("raise RuntimeError('no camera')", "RuntimeError: no camera"),
    ],
)
def test_a_mission_that_cannot_be_imported_is_refused_in_words(
    tmp_path: Path, line: str, words: str
) -> None:
    path = tmp_path / "m.py"
    for text in (f"{line}\n{MISSION}", f"{MISSION}\n{line}\n"):
        path.write_text(text, encoding="utf-8")
        mission = load_mission(path)
        with pytest.raises(ConfigError, match=f"running it failed: {words}"):
            load_function(mission)
