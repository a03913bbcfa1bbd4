"""The commands and the motion of a vehicle that identification reads from a record."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.identification.recorded_motion import logs_of
from onboard.config.fleet import load_fleet
from tests.groundstation.recorded import FLEET, SECOND
from tests.groundstation.report.made_up import ahead, poses, position, rows, write


@pytest.mark.parametrize("ahead_s", [0, 2400])
def test_the_mocap_belongs_to_the_ticks_whatever_the_vehicles_clock_is(
    tmp_path: Path, ahead_s: int
) -> None:
    fleet = load_fleet(FLEET)
    body = fleet.vehicles["mav0"].body
    assert body is not None
    seen = poses(body, lambda time_s: position(0, time_s), 0.0, 10.0)
    told = ahead(rows(), "mav0", ahead_s * SECOND)
    folder = write(tmp_path / "flight", [*told, *seen])

    log = logs_of(folder, fleet, ["mav0"])["mav0"]

    assert log.attitude_age_s == 0.0, "it has the mocap's attitudes, not those of the link"
    assert log.position_time_s[0] == pytest.approx(log.command_time_s[0], abs=0.1)
