"""Python missions and scripts in which an ``await`` was left out: they fail, with its line."""

from __future__ import annotations

import textwrap
import warnings
from pathlib import Path

import pytest

from groundstation import cli
from groundstation.missions.left_out_awaits import left_out_awaits

SCRIPT = """
import asyncio
from groundstation import Fleet


async def main():
    async with Fleet.connect() as fleet:
        fleet.takeoff()


asyncio.run(main())
"""


def _fly(folder: Path, body: str) -> int:
    """Fly a mission with these lines; return the exit status."""
    mission = folder / "hasty.py"
    head = "FLEET = 'paper'\n\n\nasync def mission(fleet):\n"
    mission.write_text(head + textwrap.indent(textwrap.dedent(body), "    "))
    return cli.main(["fly", str(mission), "--lockstep", "--record", str(folder / "flight")])


@pytest.mark.parametrize("call", ["fleet.takeoff()", "kept = fleet.takeoff()"])
def test_a_mission_without_an_await_fails(
    call: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _fly(tmp_path, f"{call}\nawait fleet.wait(0.1)") == 1

    printed = capsys.readouterr().out
    sentence = "coroutine 'Group.takeoff' was never awaited, so nothing of it was done."
    assert f'hasty.py", line 5, in mission: {call}: {sentence}' in printed
    assert "FAILED" in printed


def test_a_mission_that_fails_otherwise_says_which_await_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _fly(tmp_path, "fleet.takeoff()\nawait fleet.move((0.0, 0.0, 1.0))") == 1

    printed = capsys.readouterr().out
    assert "coroutine 'Group.takeoff' was never awaited" in printed
    assert "order take-off first" in printed


def test_a_script_without_an_await_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script = tmp_path / "hasty_script.py"
    script.write_text(SCRIPT)
    words = ["fly", "script", str(script), "--fleet", "paper", "--lockstep"]

    assert cli.main([*words, "--record", str(tmp_path / "flight")]) == 1
    assert "line 8, in main: fleet.takeoff(): coroutine 'Group.takeoff'" in capsys.readouterr().out


def test_other_warnings_are_shown_as_before() -> None:
    with (
        pytest.warns(UserWarning, match="the lens is dirty"),
        left_out_awaits() as left_out,
    ):
        warnings.warn("the lens is dirty", stacklevel=1)
    assert left_out == []
