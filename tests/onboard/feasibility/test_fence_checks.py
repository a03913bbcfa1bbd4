"""What ``covey check`` says about fences: room to stop, buffers in the wind, and straight lines."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.mission_findings import mission_findings
from onboard.config.fleet import FleetConfig, fleet_from_mapping
from onboard.feasibility.fence_checks import braking_room_m
from onboard.feasibility.finding import Finding
from onboard.feasibility.fleet_checks import fleet_findings

ELL = [[-3, -3], [6, -3], [6, 0.6], [0.6, 0.6], [0.6, 6], [-3, 6]]


def fleet(buffer_m: float | None = 0.4, **section: Any) -> FleetConfig:
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text())
    data["fleet"]["geofence_m"] = {"x": [-8, 8], "y": [-8, 8], "z": [0, 3]}
    data["fleet"] |= section
    if buffer_m is not None:
        fence = {"name": "field", "keep": "in", "polygon_enu_m": ELL, "buffer_m": buffer_m}
        data["fences"] = [fence]
    return fleet_from_mapping(data)


def named(findings: tuple[Finding, ...], name: str) -> Finding:
    (found,) = [finding for finding in findings if finding.name == name]
    return found


def test_a_buffer_narrower_than_the_wind_asks_for_draws_a_warning() -> None:
    windy = named(fleet_findings(fleet(0.1)), "braking before fences")
    assert windy.status == "warning"
    assert "in the 8.1 m/s of its max_wind_m_s, with gusts, mav" in windy.sentence
    assert named(fleet_findings(fleet(0.6)), "braking before fences").status == "ok"
    calm = fleet(0.1, max_wind_m_s=1.0)
    assert named(fleet_findings(calm), "braking before fences").status == "ok"
    assert not [one for one in fleet_findings(fleet(None)) if one.name == "braking before fences"]


def test_braking_room_grows_with_wind_and_speed() -> None:
    rooms = [
        braking_room_m(one, one.vehicles["mav0"])
        for one in (fleet(max_wind_m_s=1.0), fleet(max_wind_m_s=4.0), fleet(max_wind_m_s=8.0))
    ]
    assert rooms == sorted(rooms)
    assert rooms[0] == pytest.approx(0.11, abs=0.02)
    assert rooms[2] > rooms[0] + 0.1


def test_a_spot_near_a_buffer_is_told_with_the_fences_name() -> None:
    finding = named(fleet_findings(fleet(1.2)), "fence")
    assert finding.status == "warning"
    assert "from the buffer of the fence 'field', stopping from 1 m/s" in finding.sentence


def test_a_straight_way_across_the_bay_of_a_field_draws_a_warning() -> None:
    steps = [
        {"do": "takeoff", "height_m": 1.0},
        {"do": "move", "vehicles": "mav0", "position_enu_m": [-1.5, 5.0, 1.0]},
        {"do": "move", "vehicles": "mav0", "position_enu_m": [5.0, -1.8, 1.0]},
        {"do": "land"},
    ]
    mission = mission_from_mapping({"schema": 1, "step": steps}, path="m.toml", fleet=fleet())
    finding = named(mission_findings(mission), "ways")
    assert finding.status == "warning"
    assert finding.value == pytest.approx(4.18, abs=0.06)  # from x = 0.2 to y = 0.2 m
    assert "of the straight line from mav0 to its goal lie beyond a fence" in finding.sentence

    del steps[1]
    mission = mission_from_mapping({"schema": 1, "step": steps}, path="m.toml", fleet=fleet())
    assert named(mission_findings(mission), "ways").status == "ok"


def test_a_goal_behind_a_wall_without_a_door_is_refused_before_the_flight() -> None:
    corners = [[2.0, -9.0], [2.2, -9.0], [2.2, 9.0], [2.0, 9.0]]
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text())
    data["obstacles"] = [{"name": "wall", "polygon_enu_m": corners}]
    steps = [
        {"do": "takeoff", "height_m": 1.0},
        {"do": "move", "vehicles": "mav0", "position_enu_m": [3.2, 0.0, 1.0]},
        {"do": "land"},
    ]
    walled = fleet_from_mapping(data)
    mission = mission_from_mapping({"schema": 1, "step": steps}, path="m.toml", fleet=walled)
    finding = named(mission_findings(mission), "reach")
    assert finding.status == "refused"
    assert "the goal of mav0 cannot be reached" in finding.sentence

    data["obstacles"][0]["polygon_enu_m"] = [[x, min(y, 2.0)] for x, y in corners]
    with_way = fleet_from_mapping(data)
    mission = mission_from_mapping({"schema": 1, "step": steps}, path="m.toml", fleet=with_way)
    assert not [one for one in mission_findings(mission) if one.name == "reach"]
