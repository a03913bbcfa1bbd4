"""The height of the ground that a fleet file knows."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onboard.agent.core import AgentCore
from onboard.config.fleet import FleetConfig, fleet_from_mapping
from onboard.config.ground import ground_at_m, lowest_ground_m, touchable_ground_at_m
from sitl.fleet_emulator import emulator_of

PAPER = Path(__file__).parents[3] / "configs/fleets/paper.toml"


def fleet_with(**keys: Any) -> FleetConfig:
    """The fleet of the paper, with these keys for all vehicles."""
    data = tomllib.loads(PAPER.read_text())
    for vehicle in data["vehicles"].values():
        vehicle.update(keys)
    return fleet_from_mapping(data)


def test_an_agent_starts_and_reports_in_a_fleet_without_enabled_vehicles() -> None:
    fleet = fleet_with(enabled=False)
    assert lowest_ground_m(fleet) == 0.0
    core = AgentCore(fleet, "mav0", boot_id=1)
    for tick in range(1, 20):
        core.tick(tick * 20_000_000)
    assert any("disables this vehicle" in sentence for sentence in core.preflight.not_ready)


def test_the_ground_near_a_raised_spot_is_as_high_as_the_spot() -> None:
    data = tomllib.loads(PAPER.read_text())
    data["vehicles"]["mav1"]["start_enu_m"] = [1.0, 0.0, 0.4]
    fleet = fleet_from_mapping(data)
    x_m = 1.0 + np.array([0.0, 0.99, 1.01])
    assert touchable_ground_at_m(fleet, x_m, np.zeros(3)).tolist() == [0.4, 0.4, 0.0]
    assert float(touchable_ground_at_m(fleet, 1.0, 1.01)) == 0.0


def test_a_goal_beside_a_table_keeps_the_distance_of_a_body_from_it() -> None:
    data = tomllib.loads(PAPER.read_text())
    data["vehicles"]["mav0"]["start_enu_m"] = [0.0, 0.0, 0.75]
    data["vehicles"]["mav1"]["start_enu_m"] = [0.85, 0.0, 0.0]
    fleet = fleet_from_mapping(data)
    x_m = np.array([0.45, fleet.fleet.body_diameter_m, fleet.fleet.body_diameter_m + 0.01])
    assert touchable_ground_at_m(fleet, x_m, np.zeros(3)).tolist() == [0.75, 0.75, 0.0]
    assert float(ground_at_m(fleet, 0.45, 0.0)) == 0.0


def test_the_emulated_ground_is_the_one_that_agents_expect() -> None:
    data = tomllib.loads(PAPER.read_text())
    for name, start_enu_m in (
        ("mav0", [0.0, 0.0, 0.75]),
        ("mav1", [1.2, 0.0, 0.3]),
        ("mav2", [-3.0, 0.0, 0.0]),
    ):
        data["vehicles"][name]["start_enu_m"] = start_enu_m
    fleet = fleet_from_mapping(data)
    world = emulator_of(fleet, list(fleet.vehicles.values()), seed=0).world
    for x_m in np.linspace(-3.9, 3.9, 40):
        world.vehicles.motion["position"][0] = (0.0, x_m, -2.0)
        expected_m = float(ground_at_m(fleet, x_m, 0.0))
        assert world.vehicles.height_m(0) == pytest.approx(2.0 - expected_m)


def test_between_two_spots_the_ground_is_as_high_as_the_nearer_one() -> None:
    data = tomllib.loads(PAPER.read_text())
    data["fleet"]["geofence_m"]["z"] = [-1.0, 3.0]
    for name, start_enu_m in (
        ("mav0", [3.0, 0.0, 0.0]),
        ("mav1", [3.8, 0.0, 0.4]),
        ("mav2", [-3.0, 0.0, -0.2]),
    ):
        data["vehicles"][name]["start_enu_m"] = start_enu_m
    fleet = fleet_from_mapping(data)
    x_m = np.array([2.1, 3.3, 3.5, 4.7, 5.0, -3.0])
    assert ground_at_m(fleet, x_m, np.zeros(6)).tolist() == [0.0, 0.0, 0.4, 0.4, -0.2, -0.2]
