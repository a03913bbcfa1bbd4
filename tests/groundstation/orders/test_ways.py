"""Times and limits of orders count the way around what stands still, not the straight line."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import pytest
from msgspec.structs import replace

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.mission_findings import mission_findings
from groundstation.orders.grammar import parse
from groundstation.orders.held_formation import HeldFormation
from groundstation.orders.plan import plan_order
from groundstation.orders.reachable_goals import route_length_m
from onboard.config.fleet import FleetConfig, fleet_from_mapping
from onboard.control.vertical_limits import planned_m_s2

WALL = [[-0.05, -2.5], [0.05, -2.5], [0.05, 3.2], [-0.05, 3.2]]
ACCELERATION_FACTOR = 10.0 / math.sqrt(3.0)  # of a quintic from rest to rest
BEGIN = (-1.5, -1.5, 1.0)
BEHIND = (1.5, 2.0, 1.0)


def fleet(*, has_wall: bool, hover_thrust_frac: float | None = None) -> FleetConfig:
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text())
    data["vehicles"] = {"mav0": data["vehicles"]["mav0"]}
    data["formations"] = {}
    if hover_thrust_frac is not None:
        for vehicle_type in data["types"].values():
            vehicle_type["hover_thrust_frac"] = hover_thrust_frac
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
        finding.title
        for finding in mission_findings(mission)
        if finding.status == "refused" and finding.name == "time"
    ]
    return course_step.durations_alone_s["mav0"], refused


def test_the_way_around_a_wall_is_longer_than_the_straight_line() -> None:
    straight_m = route_length_m(fleet(has_wall=False), "mav0", BEGIN, BEHIND)
    around_m = route_length_m(fleet(has_wall=True), "mav0", BEGIN, BEHIND)
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


def test_times_of_climbs_count_the_little_lift_of_a_heavy_vehicle() -> None:
    heavy = fleet(has_wall=False, hover_thrust_frac=0.9)
    climb_m = 2.0
    climb_s = math.sqrt(ACCELERATION_FACTOR * climb_m / planned_m_s2(0.9))
    assert climb_s > 5.0  # longer than the speeds of a climb take

    content = {"schema": 1, "step": [{"do": "takeoff", "height_m": climb_m}, {"do": "land"}]}
    mission = mission_from_mapping(content, path="heavy.toml", fleet=heavy)
    takeoff, land = mission.course()
    assert takeoff.durations_alone_s["mav0"] == pytest.approx(3.0 + climb_s, abs=0.1)
    assert land.durations_alone_s["mav0"] == pytest.approx(3.0 + climb_s, abs=0.1)

    home = parse(f"bring home all {climb_m}", heavy)
    planned = plan_order(home, heavy, None, held=HeldFormation(None), author="test", now_ns=0)
    assert planned.orders["mav0"].duration_s == pytest.approx(climb_s, abs=0.1)


def test_a_step_through_a_roof_is_refused_and_the_way_home_to_it_is_not() -> None:
    flown = fleet(has_wall=False)
    on_roof = replace(flown.vehicles["mav0"], start_enu_m=(0.0, 0.0, 1.0))
    roof = replace(flown, vehicles={"mav0": on_roof})
    steps: list[dict[str, object]] = [
        {"do": "takeoff", "height_m": 2.0},
        {"do": "goto", "goals": {"mav0": [0.0, 1.3, 2.0]}},
        {"do": "goto", "goals": {"mav0": [0.0, 1.3, 0.5]}},
        {"do": "home"},
    ]
    assert _unreached(roof, steps) == []

    # straight from above the roof to beside it
    (sentence,) = _unreached(roof, [steps[0], steps[2], steps[3]])
    assert "the raised ground of a take-off spot is in the way" in sentence

    # a landing on the roof stands on it, and the next take-off begins there
    assert _unreached(roof, [steps[0], {"do": "land"}, *steps]) == []


def _unreached(flown: FleetConfig, steps: list[dict[str, object]]) -> list[str]:
    mission = mission_from_mapping({"schema": 1, "step": steps}, path="roof.toml", fleet=flown)
    return [
        finding.sentence
        for finding in mission_findings(mission)
        if finding.name == "reach" and finding.status == "refused"
    ]


def times_s(ground_m: float, height_m: float) -> list[float]:
    """Return the times of a take-off and of a landing, from a spot at a height."""
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text())
    data["vehicles"] = {"mav0": data["vehicles"]["mav0"]}
    data["vehicles"]["mav0"]["start_enu_m"] = [0.0, 0.0, ground_m]
    data["fleet"]["geofence_m"]["z"] = [-30.0, 30.0]
    data["formations"] = {}
    content = {"schema": 1, "step": [{"do": "takeoff", "height_m": height_m}, {"do": "land"}]}
    mission = mission_from_mapping(content, path="hill.toml", fleet=fleet_from_mapping(data))
    return [step.durations_alone_s["mav0"] for step in mission.course()]


def test_times_of_climbs_and_descents_count_from_the_ground() -> None:
    assert times_s(20.0, 22.5) == pytest.approx(times_s(0.0, 2.5))
    assert times_s(-20.0, 2.5) == pytest.approx(times_s(0.0, 22.5))
