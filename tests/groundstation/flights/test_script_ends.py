"""How a script ends that fails in one of several tasks: its sentence, and no trace beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from groundstation.flights.script_flight import (
    fly_script,
    fly_script_emulated,
    refuse_what_is_no_script,
)
from groundstation.missions.connection import RealTime
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.exit_status import EXIT_FAILED, EXIT_WRONG_INPUT

SCRIPT = """
import asyncio
from groundstation.orders.grammar import OrderError

async def leg():
    raise OrderError("The goal lies outside the fence.")

async def main():
    async with asyncio.TaskGroup() as outer:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(leg())

asyncio.run(main())
"""


def test_the_failure_of_a_task_of_a_script_is_told_in_its_own_sentence(
    fleet: FleetConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script = tmp_path / "show.py"
    script.write_text(SCRIPT)
    host: Any = RealTime(fleet, folder=tmp_path, say=lambda line: None)
    assert fly_script(str(script), (), host, tmp_path) == EXIT_FAILED
    told = capsys.readouterr().err
    assert told == f"{script}: The goal lies outside the fence.\n"


def test_a_script_that_is_refused_before_it_connects_is_wrong_input(
    fleet: FleetConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script = tmp_path / "show.py"
    script.write_text(
        "from groundstation.crazyswarm import Crazyswarm\nCrazyswarm().cmdPosition()\n"
    )
    host: Any = RealTime(fleet, folder=tmp_path, say=lambda line: None)
    assert fly_script(str(script), (), host, tmp_path) == EXIT_WRONG_INPUT
    told = capsys.readouterr().err
    assert told.startswith(f"{script} calls cmdPosition (line 2), which is refused")
    assert told.count("show.py") == 1


def test_an_emulator_that_cannot_start_is_refused_in_a_sentence(
    fleet: FleetConfig, tmp_path: Path
) -> None:
    (tmp_path / "sitl.log").mkdir()  # so that the log cannot be opened
    with pytest.raises(ConfigError, match="sitl cannot be started"):
        fly_script_emulated("show.py", (), fleet, tmp_path, seed=0)


def test_a_mission_and_a_fleet_file_are_no_scripts(tmp_path: Path) -> None:
    mission = "configs/missions/paper.toml"
    with pytest.raises(ConfigError, match=f"is a mission, .* covey fly {mission}$"):
        refuse_what_is_no_script(mission)

    fleet_path = "configs/fleets/paper.toml"
    with pytest.raises(ConfigError, match=f"is a fleet file, .* SCRIPT --fleet {fleet_path}$"):
        refuse_what_is_no_script(fleet_path)

    python_mission = tmp_path / "mission.py"
    python_mission.write_text("async def mission(fleet):\n    await fleet.land()\n")
    with pytest.raises(ConfigError, match="is a mission, 'async def"):
        refuse_what_is_no_script(str(python_mission))
