"""Flights to goals do not lead through the ground at raised take-off spots."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from onboard.config.fleet import FleetConfig, load_fleet
from onboard.control.raised_ground import ground_in_the_way, height_over_ground_m
from onboard.tuples import Xyz

PAPER = Path(__file__).resolve().parents[3] / "configs/fleets/paper.toml"
ROOF_M = 3.0


def roof(height_m: float = ROOF_M) -> FleetConfig:
    """A fleet in which mav0 begins on a roof at the origin, and the others 8 m away."""
    fleet = load_fleet(PAPER)
    starts = {"mav0": (0.0, 0.0, height_m), "mav1": (8.0, 0.0, 0.0), "mav2": (8.0, 3.0, 0.0)}
    vehicles = {
        name: replace(fleet.vehicles[name], start_enu_m=start) for name, start in starts.items()
    }
    return replace(fleet, vehicles=vehicles)


def words_of(begin: Xyz, goal: Xyz, *, height_m: float = ROOF_M, mocap: bool = True) -> str:
    fleet = roof(height_m)
    vehicle = replace(fleet.vehicles["mav1"], mocap_required=mocap)
    return ground_in_the_way(fleet, vehicle, begin, goal)


@pytest.mark.parametrize(
    ("begin", "goal", "words"),
    [
        # along the yard, through the roof and past it
        ((3.0, 0.0, 0.8), (-3.0, 0.0, 0.8), "a climb to 3.10 m, and a flight at that height, it"),
        ((3.0, 1.1, 0.8), (-3.0, 1.1, 0.8), ""),
        # up to a place above the roof, from its side and from above
        ((3.0, 0.0, 0.8), (0.0, 0.0, 4.0), "after a climb to 3.10 m it can"),
        ((3.0, 0.0, 3.1), (0.0, 0.0, 4.0), ""),
        # down to the yard: onto the roof's edge, and beyond it
        ((0.0, 0.0, 4.0), (3.0, 0.0, 0.8), "beside that ground, after a flight at 4.00 m, it can"),
        ((0.0, 0.0, 4.0), (5.0, 0.0, 1.0), ""),
        ((0.0, 0.0, 4.0), (3.0, 0.0, 4.0), ""),
        # across the roof at its least height, and a little lower
        ((3.0, 0.0, 3.1), (-3.0, 0.0, 3.1), ""),
        ((3.0, 0.0, 3.09), (-3.0, 0.0, 3.09), "after a climb to 3.10 m, and"),
        # from a place low above the roof
        ((0.0, 0.0, 3.02), (3.0, 0.0, 3.02), ""),
        ((0.0, 0.0, 3.02), (0.0, 0.0, 4.0), ""),
        ((0.0, 0.0, 3.08), (3.0, 0.0, 2.0), "is in the way"),
    ],
)
def test_a_flight_does_not_lead_through_a_roof(begin: Xyz, goal: Xyz, words: str) -> None:
    found = words_of(begin, goal)
    assert words in found
    assert bool(found) == bool(words)


def test_by_satellites_a_flight_keeps_higher_above_a_roof() -> None:
    across = (3.0, 0.0, 3.2), (-3.0, 0.0, 3.2)
    assert words_of(*across) == ""
    assert "after a climb to 3.30 m, and" in words_of(*across, mocap=False)


def test_level_ground_is_in_nobodys_way() -> None:
    assert words_of((3.0, 0.0, 0.0), (-3.0, 0.0, 0.0), height_m=0.0) == ""


@pytest.mark.parametrize(
    ("begin", "goal", "height_m"),
    [
        ((5.0, 0.0, 4.0), (0.0, 0.0, 4.0), 4.0),  # it passes over the roof as it is
        # at the roof's edge, after two thirds of the way, it is as high as the roof and a bit
        ((3.0, 0.0, 0.8), (0.0, 0.0, 3.2), 0.8 + 1.5 * (ROOF_M + 0.1 + 0.2 - 0.8)),
    ],
)
def test_a_goal_is_so_high_that_the_way_passes_over_the_roof(
    begin: Xyz, goal: Xyz, height_m: float
) -> None:
    fleet = roof()
    x, y, _ = goal
    found_m = height_over_ground_m(fleet, fleet.vehicles["mav0"], begin, goal)
    assert found_m == pytest.approx(height_m, abs=0.1)
    assert ground_in_the_way(fleet, fleet.vehicles["mav0"], begin, (x, y, found_m)) == ""
