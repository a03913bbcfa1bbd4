"""Changes of a recorded flight that make no sense are refused."""

from __future__ import annotations

import pytest

from groundstation.flights.changes import FlightOrigin, changed, parse_change
from groundstation.flights.simulation_settings import SimulationSettings
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
