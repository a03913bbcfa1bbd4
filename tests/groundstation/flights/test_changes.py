"""Changes of a recorded flight that make no sense are refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.flights.changes import FlightOrigin, changed, parse_change
from groundstation.flights.recorded_flight import open_recorded
from groundstation.flights.simulation_settings import SimulationSettings, write_settings
from onboard.config.fleet import ConfigError

FAULT = "mav1 motor_dead motor=2 at=1"


@pytest.mark.parametrize(
    ("text", "at_s"),
    [
        ("seed=nan", None),
        ("seed=inf", None),
        ("seed=1.7", None),
        ("seed=-3", None),
        ("without_fault=nan", None),
        ("without_fault=1.9", 5.0),
        ("gust=nan", None),
        ("gust=-1", None),
        ("gust=1000", 5.0),
        ("gust=nan", 5.0),
        ("law.kappa_1_1_s=nan", 5.0),
    ],
)
def test_a_number_that_makes_no_sense_is_refused(text: str, at_s: float | None) -> None:
    settings = SimulationSettings(is_lockstep=True, faults=(FAULT,))
    origin = FlightOrigin(fleet_text="", mission_text="", settings=settings)
    with pytest.raises(ConfigError):
        changed(origin, [parse_change(text)], at_s)


@pytest.mark.parametrize("text", ["wnd=5", "bus=0.1", "without_fualt=1", "wind.east=3"])
def test_a_change_that_does_not_exist_is_refused_with_those_that_do(text: str) -> None:
    with pytest.raises(ConfigError) as refused:
        parse_change(text)
    sentence = str(refused.value)
    assert sentence.startswith(f"--what-if {text}: there is no such change.")
    assert "Give wind, gust, fault, order, " in sentence


def test_a_flight_in_real_time_is_refused_with_the_command_that_records_one_in_lockstep(
    tmp_path: Path,
) -> None:
    write_settings(tmp_path, SimulationSettings(is_lockstep=False))
    with pytest.raises(ConfigError, match=r"record it with covey fly MISSION --lockstep\."):
        open_recorded(tmp_path)


def test_a_flight_is_opened_by_its_record_as_by_its_folder(tmp_path: Path) -> None:
    write_settings(tmp_path, SimulationSettings(is_lockstep=True))
    for name in ("fleet.toml", "mission.toml", "flight.mcap"):
        (tmp_path / name).touch()
    assert open_recorded(tmp_path / "flight.mcap") == open_recorded(tmp_path)
