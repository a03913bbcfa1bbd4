"""A show from a .skyc, imported and flown as it was written."""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path

import pytest

from groundstation.mission_files.loading import load_mission
from groundstation.shows.output import write_show
from groundstation.shows.skyc import read_skyc
from sitl.lockstep.flight import Lockstep
from tests.groundstation.shows.made_shows import line_of, write_skyc


@pytest.mark.long
def test_an_imported_show_is_flown_within_its_promise(
    lockstep: Callable[..., Lockstep], tmp_path: Path
) -> None:
    lights = {
        "version": 1,
        "data": base64.b64encode(bytes([7, 100, 4, 255, 0, 0, 100, 0])).decode(),
    }
    show = read_skyc(write_skyc(tmp_path / "line.skyc", line_of(3), 12.0, lights=lights))
    write_show(show, tmp_path / "out", "line.skyc", None, None)
    mission = load_mission(tmp_path / "out" / "mission.toml")
    flight = lockstep(mission.fleet)
    verdict = flight.fly(mission)
    assert verdict.passed, verdict.sentences
    assert flight.min_separation_m > 0.8
    assert {view.light for view in flight.state.vehicles.values()} == {(255, 0, 0)}
