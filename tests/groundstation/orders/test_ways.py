"""Times and limits of orders count the way around what stands still, not the straight line."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.mission_findings import mission_findings
from groundstation.orders.reachable_goals import way_m
from onboard.config.fleet import FleetConfig, fleet_from_mapping

WALL = [[-0.05, -2.5], [0.05, -2.5], [0.05, 3.2], [-0.05, 3.2]]
BEGIN = (-1.5, -1.5, 1.0)
BEHIND = (1.5, 2.0, 1.0)


def fleet(*, has_wall: bool) -> FleetConfig:
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text())
    data["vehicles"] = {"mav0": data["vehicles"]["mav0"]}
    data["formations"] = {}
    if has_wall:
        data["obstacles"] = [{"name": "wall", "polygon_enu_m": WALL}]
    return fleet_from_mapping(data)


def alone_s(flown: FleetConfig, timeout_s: float = 40.0, **move: object) -> tuple[float, list[str]]:
    """Return the expected time of a move behind the wall, and the findings about its time."""
    mission = mission_from_mapping(
        {
            "schema": 1,
            "step": [
                {"do": "takeoff", "height_m": 1.0},
                {"do": "move", "vehicles": ["mav0"], "position_enu_m": BEHIND}
                | {"timeout_s": timeout_s, **move},
                {"do": "land"},
            ],
        },
        path="behind.toml",
        fleet=flown,
    )
    course_step = list(mission.course())[1]
    refused = [
        finding.name
        for finding in mission_findings(mission)
        if finding.status == "refused" and finding.name.startswith("time")
    ]
    return course_step.alone_s["mav0"], refused


def test_the_way_around_a_wall_is_longer_than_the_straight_line() -> None:
    straight_m = way_m(fleet(has_wall=False), "mav0", BEGIN, BEHIND)
    around_m = way_m(fleet(has_wall=True), "mav0", BEGIN, BEHIND)
    assert straight_m == pytest.approx(4.61, abs=0.01)
    assert around_m > 1.3 * straight_m


def test_a_step_whose_time_is_enough_for_the_straight_line_only_is_refused() -> None:
    straight_s, refused = alone_s(fleet(has_wall=False), timeout_s=11.0)
    assert straight_s < 11.0
    assert refused == []

    around_s, refused = alone_s(fleet(has_wall=True), timeout_s=11.0)
    assert around_s > 1.3 * straight_s
    assert len(refused) == 1


def test_a_speed_is_that_along_the_way() -> None:
    straight_s, _ = alone_s(fleet(has_wall=False), speed_m_s=0.5)
    around_s, _ = alone_s(fleet(has_wall=True), speed_m_s=0.5)
    assert around_s > 1.3 * straight_s
