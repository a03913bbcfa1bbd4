"""How much wind a vehicle may fly in: from its own keys, and from tilt, thrust and drag."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from msgspec.structs import replace

from onboard.config.fleet import FleetConfig, load_fleet
from onboard.config.wind_limit import largest_push_m_s2, tilt_acceleration_m_s2, wind_limit_m_s

FLEETS = Path(__file__).parents[3] / "configs/fleets"


def limit(fleet: FleetConfig, **changes: object) -> float:
    return wind_limit_m_s(fleet, replace(fleet.vehicles["mav0"], **changes))


def test_the_shipped_types_may_fly_in_what_was_measured() -> None:
    paper = load_fleet(FLEETS / "paper.toml")
    sih = load_fleet(FLEETS / "sih.toml")
    assert limit(paper) == pytest.approx(8.13, abs=0.02)
    assert limit(sih) == pytest.approx(3.02, abs=0.02)


def test_the_limit_is_not_known_without_a_drag() -> None:
    assert math.isnan(limit(load_fleet(FLEETS / "paper.toml"), drag_1_s=0.0, max_wind_m_s=3.0))


def test_keys_of_type_and_fleet_come_before_what_is_derived_and_the_lower_one_counts() -> None:
    paper = load_fleet(FLEETS / "paper.toml")
    assert limit(paper, max_wind_m_s=12.0) == 12.0
    windy = replace(paper, fleet=replace(paper.fleet, max_wind_m_s=2.5))
    assert limit(windy, max_wind_m_s=12.0) == 2.5
    assert limit(windy, max_wind_m_s=1.5) == 1.5
    assert limit(windy) == 2.5


def test_a_weak_motor_limits_the_lean_before_the_tilt_does() -> None:
    paper = load_fleet(FLEETS / "paper.toml").vehicles["mav0"]
    weak = replace(paper, hover_thrust_frac=0.9)
    assert tilt_acceleration_m_s2(weak) < tilt_acceleration_m_s2(paper)
    assert largest_push_m_s2(replace(paper, max_tilt_deg=5.0)) == 1.5
