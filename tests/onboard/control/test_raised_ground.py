"""Flights to goals do not lead through the raised ground of take-off spots."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from msgspec.structs import replace

from onboard.avoidance.params import law_params, still
from onboard.config.fences import Fence
from onboard.config.fleet import FleetConfig, load_fleet
from onboard.control.raised_ground import (
    CLEARANCE_IN_MISSION,
    CLEARANCE_IN_ORDER,
    CLEARANCE_ON_VEHICLE,
    ground_refusal,
    height_over_ground_m,
)
from onboard.control.router import Surroundings, surroundings
from onboard.tuples import Xyz

PAPER = Path(__file__).resolve().parents[3] / "configs/fleets/paper.toml"
ROOF_M = 3.0


def roof(height_m: float = ROOF_M, fences: tuple[Fence, ...] = ()) -> FleetConfig:
    """A fleet in which mav0 begins on a roof at the origin, and the others 8 m away."""
    fleet = load_fleet(PAPER)
    starts = {"mav0": (0.0, 0.0, height_m), "mav1": (8.0, 0.0, 0.0), "mav2": (8.0, 3.0, 0.0)}
    vehicles = {
        name: replace(fleet.vehicles[name], start_enu_m=start) for name, start in starts.items()
    }
    wide = replace(fleet.fleet.geofence_m, x=(-20.0, 20.0), y=(-20.0, 20.0), z=(0.0, 9.0))
    section = replace(fleet.fleet, geofence_m=wide)
    return replace(fleet, fleet=section, vehicles=vehicles, fences=fences)


def around(fleet: FleetConfig) -> Surroundings:
    return surroundings(still(fleet), law_params(fleet, "mav1"))


def words_of(
    begin: Xyz,
    goal: Xyz,
    *,
    fleet: FleetConfig | None = None,
    mocap: bool = True,
    clearance_share: float = CLEARANCE_ON_VEHICLE,
) -> str:
    fleet = fleet or roof()
    vehicle = replace(fleet.vehicles["mav1"], mocap_required=mocap)
    return ground_refusal(fleet, vehicle, around(fleet), begin, goal, clearance_share)


@pytest.mark.parametrize(
    ("begin", "goal", "words"),
    [
        # along the yard, through the roof and past it
        ((3.0, 0.0, 0.8), (-3.0, 0.0, 0.8), "first climb to 3.30 m and fly past it at that"),
        ((3.0, 1.1, 0.8), (-3.0, 1.1, 0.8), ""),
        # up to a goal above the roof, from its side and from above
        ((3.0, 0.0, 0.8), (0.0, 0.0, 4.0), "; first climb to 3.30 m"),
        ((3.0, 0.0, 3.1), (0.0, 0.0, 4.0), ""),
        # down to the yard: onto the roof's edge, and beyond it
        ((0.0, 0.0, 4.0), (3.0, 0.0, 0.8), "; first fly at 4.00 m to a point beside it"),
        ((0.0, 0.0, 4.0), (5.0, 0.0, 1.0), ""),
        ((0.0, 0.0, 4.0), (3.0, 0.0, 4.0), ""),
        # from low above the roof
        ((0.0, 0.0, 3.02), (3.0, 0.0, 3.02), ""),
        ((0.0, 0.0, 3.02), (0.0, 0.0, 4.0), ""),
        ((0.0, 0.0, 3.08), (3.0, 0.0, 2.0), "is in the way"),
        # from beside the roof's wall, still within a metre of the spot: aside, up, and through
        ((0.9, 0.0, 0.8), (3.0, 0.0, 0.8), ""),
        ((0.9, 0.0, 0.8), (0.9, 0.0, 3.3), ""),
        ((0.9, 0.0, 0.8), (-3.0, 0.0, 0.8), "is in the way"),
    ],
)
def test_a_flight_does_not_lead_through_a_roof(begin: Xyz, goal: Xyz, words: str) -> None:
    found = words_of(begin, goal)
    assert words in found
    assert bool(found) == bool(words)


@pytest.mark.parametrize("mocap", [True, False])
def test_each_check_leaves_something_to_the_next_one(mocap: bool) -> None:
    least_m = 0.2 if mocap else 0.5
    lowest = []
    for clearance_share in (CLEARANCE_ON_VEHICLE, CLEARANCE_IN_ORDER, CLEARANCE_IN_MISSION):
        height_m = ROOF_M + clearance_share * least_m
        lowest.append(height_m)
        for above_m, is_free in ((1e-6, True), (-1e-6, False)):
            begin = (3.0, 0.0, height_m + above_m)
            goal = (-3.0, 0.0, height_m + above_m)
            found = words_of(begin, goal, mocap=mocap, clearance_share=clearance_share)
            assert bool(found) is not is_free
            if found:  # the climb that is advised passes every check
                advised_m = float(found.partition("climb to ")[2].partition(" m")[0])
                assert advised_m >= ROOF_M + 1.25 * least_m - 1e-6
    assert lowest == sorted(set(lowest))


def test_level_ground_is_in_nobodys_way() -> None:
    assert words_of((3.0, 0.0, 0.0), (-3.0, 0.0, 0.0), fleet=roof(0.0)) == ""


def test_a_route_around_a_fence_is_judged_instead_of_the_straight_line() -> None:
    wall = [[-1.2, -1.2], [1.2, -1.2], [1.2, 1.2], [-1.2, 1.2]]
    low = {"name": "yard", "keep": "out", "height_m": [0.0, 2.5], "buffer_m": 0.3}
    fences = msgspec.convert([{**low, "polygon_enu_m": wall}], tuple[Fence, ...])
    begin, goal = (4.0, 0.0, 0.8), (-4.0, 0.1, 0.8)
    assert words_of(begin, goal, fleet=roof(fences=fences)) == ""
    assert "is in the way" in words_of(begin, goal)


@pytest.mark.parametrize(
    ("begin", "goal", "height_m"),
    [
        ((5.0, 0.0, 4.0), (0.0, 0.0, 4.0), 4.0),  # it passes over the roof as it is
        # at the roof's edge, after two thirds of the flight, it is as high as the roof and a bit
        ((3.0, 0.0, 0.8), (0.0, 0.0, 3.2), 0.8 + 1.5 * (ROOF_M + 0.3 - 0.8)),
        # it would pass low above the edge
        ((2.5, 0.0, 2.9), (0.0, 0.0, 3.2), 2.9 + 2.5 / 1.5 * (ROOF_M + 0.3 - 2.9)),
    ],
)
def test_a_goal_is_so_high_that_the_flight_passes_over_the_roof(
    begin: Xyz, goal: Xyz, height_m: float
) -> None:
    fleet = roof()
    vehicle = fleet.vehicles["mav0"]
    x, y, _ = goal
    found_m = height_over_ground_m(fleet, vehicle, around(fleet), (begin,), goal)
    assert found_m == pytest.approx(height_m, abs=0.1)
    # the vehicle still passes when it has moved on for a moment
    begin_x, begin_y, begin_z = begin
    later = (begin_x - 0.2, begin_y, begin_z)
    found = ground_refusal(
        fleet, vehicle, around(fleet), later, (x, y, found_m), clearance_share=CLEARANCE_ON_VEHICLE
    )
    assert found == ""


def test_of_several_begins_the_one_nearest_to_the_roof_decides() -> None:
    fleet = roof()
    begins = (3.0, 0.0, 0.8), (2.0, 0.0, 0.8)
    heights_m = [
        height_over_ground_m(fleet, fleet.vehicles["mav0"], around(fleet), some, (0.0, 0.0, 3.2))
        for some in (begins[:1], begins[1:], begins)
    ]
    assert heights_m[0] < heights_m[1] == heights_m[2]
