"""A script that fails in its rehearsal never meets the fleet; one that passes does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from groundstation.commands import run
from onboard.config.fleet import ConfigError
from onboard.exit_status import EXIT_OK

PAPER = str(Path(__file__).resolve().parents[3] / "configs/fleets/paper.toml")


@pytest.fixture
def met(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the scripts that have met the real agents."""
    scripts: list[str] = []

    def meet(script: str, *_: Any) -> int:
        scripts.append(Path(script).name)
        return EXIT_OK

    monkeypatch.setattr(run, "fly_script_in_real_time", meet)
    return scripts


@pytest.mark.long
def test_a_script_that_fails_in_its_rehearsal_does_not_take_off(
    met: list[str], tmp_path: Path
) -> None:
    script = tmp_path / "wrong.py"
    script.write_text("raise ValueError('a file that is not there')\n")
    with pytest.raises(ConfigError, match=r"The rehearsal of .* nothing has taken off"):
        run.run(str(script), fleet=PAPER, record=tmp_path / "flight", rehearse=True)
    assert met == []


@pytest.mark.long
def test_a_script_that_was_rehearsed_flies(met: list[str], tmp_path: Path) -> None:
    script = tmp_path / "hop.py"
    script.write_text(
        "from groundstation import BlockingFleet\n"
        "with BlockingFleet() as fleet:\n"
        "    fleet.takeoff(1.0)\n"
        "    fleet.land()\n"
    )
    status = run.run(str(script), fleet=PAPER, record=tmp_path / "flight", rehearse=True)
    assert status == EXIT_OK
    assert met == ["hop.py"]
    assert (tmp_path / "flight" / "rehearsal" / "verdict.json").is_file()


def test_a_flight_in_simulated_time_needs_no_rehearsal(tmp_path: Path) -> None:
    script = tmp_path / "hop.py"
    script.write_text("pass\n")
    with pytest.raises(ConfigError, match="leave --rehearse out"):
        run.run(str(script), fleet=PAPER, lockstep=True, rehearse=True)


@pytest.mark.parametrize(
    ("line", "changes", "is_rehearsed"),
    [
        ("from pycrazyswarm import *", {}, True),
        ("from crazyflie_py.uav_trajectory import Trajectory", {}, True),
        ("from groundstation.crazyswarm import Crazyswarm", {}, True),
        ("from groundstation import Fleet", {}, False),
        ("from pycrazyswarm import *", {"no_rehearse": True}, False),
        ("from pycrazyswarm import *", {"sitl": True}, False),
    ],
)
def test_a_script_of_crazyswarm_is_rehearsed_before_it_meets_real_agents(
    line: str,
    changes: dict[str, bool],
    is_rehearsed: bool,
    tmp_path: Path,
    met: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rehearsed: list[str] = []
    monkeypatch.setattr(run, "_rehearse", lambda script, *_: rehearsed.append(script))
    monkeypatch.setattr(run, "fly_script_emulated", lambda *_: EXIT_OK)
    script = tmp_path / "show.py"
    script.write_text(f"{line}\n")
    status = run.run(str(script), fleet=PAPER, record=tmp_path / "flight", **changes)  # type: ignore[arg-type]
    assert status == EXIT_OK
    assert rehearsed == ([str(script)] if is_rehearsed else [])
    assert met == ([] if "sitl" in changes else ["show.py"])
