"""Which vehicles pass above others, and that it makes crossings shorter."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from onboard.config.fleet import FleetConfig, load_fleet
from onboard.config.obstacles import Circle, Obstacle
from onboard.control import passing
from onboard.control.pipeline_numbers import pipeline_params
from onboard.feasibility.blind_descent import blind_descent_findings
from sitl.monte_carlo import batch_flight, campaign_settings, scenarios

ROOT = Path(__file__).resolve().parents[3]
RISE_M = 1.5  # 1.2 m of vertical separation, and 0.3 m


@pytest.fixture
def above() -> FleetConfig:
    """Return a fleet below a ceiling of 5 m whose vehicles may pass above each other."""
    fleet = load_fleet(ROOT / "configs" / "fleets" / "above.toml")
    return replace(fleet, law=replace(fleet.law, passing_heights=2))


def rises_m(fleet: FleetConfig) -> list[float]:
    return [pipeline_params(fleet, name).trajectory.rise_m for name in fleet.vehicles]


def test_every_second_vehicle_rises(above: FleetConfig) -> None:
    assert rises_m(above) == pytest.approx([0.0, RISE_M, 0.0])
    assert pipeline_params(above, "mav1").trajectory.highest_m == 4.5


def test_nobody_rises_on_one_height_or_without_a_law(above: FleetConfig) -> None:
    assert rises_m(replace(above, law=replace(above.law, passing_heights=1))) == [0.0] * 3
    assert pipeline_params(above, "mav1", law="off").trajectory.rise_m == 0.0


def test_nobody_rises_among_obstacles(above: FleetConfig) -> None:
    pillar = Obstacle(name="pillar", circle=Circle(center_enu_m=(0.0, 0.0), radius_m=0.2))
    assert rises_m(replace(above, obstacles=(pillar,))) == [0.0] * 3


@pytest.mark.parametrize(("level_m", "top_m"), [(1.0, 2.5), (3.0, 4.5), (3.1, 3.1)])
def test_the_top_of_a_move_is_below_the_ceiling(
    above: FleetConfig, level_m: float, top_m: float
) -> None:
    assert passing.top_m(above, "mav1", level_m) == top_m
    assert passing.top_m(above, "mav0", level_m) == level_m


def test_the_descent_without_poses_begins_at_the_top_of_a_move(above: FleetConfig) -> None:
    spots = {"mav0": (0.0, 0.0, 1.0), "mav1": (3.0, 0.0, 1.0)}
    (risen,) = blind_descent_findings(above, spots, "here")
    level = replace(above, law=replace(above.law, passing_heights=1))
    (flat,) = blind_descent_findings(level, spots, "here")
    assert "mav1 is down from 2.5 m" in risen.sentence
    assert "is down from 1.0 m" in flat.sentence


def test_a_crossing_of_sixteen_is_shorter_on_two_heights_and_keeps_the_promise() -> None:
    times_s = []
    for heights in (1, 2):
        changes = [f"law.passing_heights={heights}", "fleet.vertical_separation_m=1.2"]
        setup = campaign_settings.setup_for(changes=changes)
        plan = scenarios.plan("swap16", 1000)
        (flown,) = batch_flight.fly([plan], setup, has_trace=True)
        outcome = flown.outcome
        assert outcome.is_success
        assert outcome.min_separation_m > 0.8
        assert outcome.trace is not None
        assert outcome.trace.position_enu_m[..., 2].min() > plan.start_enu_m[0, 2] - 0.1
        times_s.append(outcome.makespan_s)
    assert times_s[1] < 0.9 * times_s[0]
