"""The commands and the motion of a vehicle that identification reads from a record."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
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


@pytest.mark.parametrize("has_mocap", [True, False])
def test_a_sample_with_an_absurd_number_is_left_out(tmp_path: Path, has_mocap: bool) -> None:
    fleet = load_fleet(FLEET)
    told = rows()
    if has_mocap:
        body = fleet.vehicles["mav0"].body
        assert body is not None
        told += poses(body, lambda time_s: position(0, time_s), 0.0, 10.0)
    for index in (600, len(told) - 250):
        stamp_ns, topic, name, message = told[index]
        absurd = msgspec.structs.replace(message, position_enu_m=(1e300, 0.0, 1.0))
        told[index] = (stamp_ns, topic, name, absurd)

    log = logs_of(write(tmp_path / "flight", told), fleet, ["mav0"])["mav0"]

    assert (log.attitude_age_s == 0.0) == has_mocap
    assert log.position_time_s.size > 300
    assert abs(log.position_enu_m).max() < 10.0


@pytest.mark.parametrize(("start_m", "is_high"), [(0.0, True), (-3.0, True), (0.9, False)])
def test_the_height_counts_from_the_take_off_spot(
    tmp_path: Path, start_m: float, is_high: bool
) -> None:
    fleet = load_fleet(FLEET)
    vehicle = msgspec.structs.replace(fleet.vehicles["mav0"], start_enu_m=(0.0, 0.0, start_m))
    fleet = msgspec.structs.replace(fleet, vehicles={**fleet.vehicles, "mav0": vehicle})
    told = [
        (stamp_ns, topic, name, _at_height(message, 1.0 + min(start_m, 0.0)))
        for stamp_ns, topic, name, message in rows()
    ]

    logs = logs_of(write(tmp_path / "flight", told), fleet, ["mav0"])

    assert ("mav0" in logs) is is_high


def _at_height(message: Any, height_m: float) -> Any:
    x, y, _ = message.position_enu_m
    return msgspec.structs.replace(message, position_enu_m=(x, y, height_m))
