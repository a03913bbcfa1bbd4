"""Volumes: outlines that hold what they must, and falls that are not too short."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from groundstation.evidence.volumes import (
    Volumes,
    convex_hull,
    distance_outside_m,
    fall_time_s,
    geojson,
    volumes,
    widened,
)
from onboard.config.earth import Origin, east_north_m
from tests.groundstation.evidence.campaigns import SQUARE

INSIDE = (1.0, 1.0)
BESIDE = (5.0, 1.0)


def shapes(fleet, **changes):
    values = {
        "planned": [(0.0, 0.0, 1.0)],
        "undisturbed": SQUARE,
        "undisturbed_height_m": 1.2,
        "flown": [*SQUARE, BESIDE],
        "highest_m": 2.0,
        "fastest_m_s": 3.0,
        "wind_m_s": 4.0,
        "fleet": fleet,
    }
    return volumes(**{**values, **changes})


def test_the_hull_holds_only_corners_and_runs_counter_clockwise() -> None:
    assert convex_hull([*SQUARE, INSIDE, (1.0, 0.0)]) == SQUARE
    assert convex_hull([INSIDE, INSIDE]) == (INSIDE,)


def test_a_widened_outline_holds_everything_within_the_distance() -> None:
    wide = widened(SQUARE, 1.0)
    for angle in np.linspace(0.0, 2.0 * math.pi, 100):
        for east, north in SQUARE:
            point = (east + math.cos(angle), north + math.sin(angle))
            assert distance_outside_m(wide, point) < 1e-9
    assert distance_outside_m(wide, BESIDE) == pytest.approx(2.0, abs=0.02)


def test_the_distance_outside_is_that_to_the_nearest_edge_or_corner() -> None:
    assert distance_outside_m(SQUARE, INSIDE) == 0.0
    assert distance_outside_m(SQUARE, BESIDE) == pytest.approx(3.0)
    assert distance_outside_m(SQUARE, (5.0, 6.0)) == pytest.approx(5.0)
    assert distance_outside_m(((0.0, 0.0), (2.0, 0.0)), (1.0, 1.0)) == pytest.approx(1.0)


def test_a_fall_without_drag_takes_the_square_root_of_2_h_over_g_and_drag_makes_it_longer() -> None:
    assert fall_time_s(20.0, 0.0) == pytest.approx(math.sqrt(2.0 * 20.0 / 9.81), abs=0.01)
    # against the equation of a fall with linear drag, solved by hand for 2 s and 1/s
    fallen_m = 9.81 * (2.0 - (1.0 - math.exp(-2.0)))
    assert fall_time_s(fallen_m, 1.0) == pytest.approx(2.0, abs=0.01)


def test_the_contingency_volume_holds_the_farthest_place_and_the_highest(paper) -> None:
    found = shapes(paper)
    half_body_m = 0.5 * paper.fleet.body_diameter_m
    assert found.excursion_m == pytest.approx(3.0, abs=0.01)  # its middle 3 m less half a body
    assert distance_outside_m(found.contingency, (BESIDE[0] + half_body_m, BESIDE[1])) < 1e-6
    assert found.contingency_height_m == 2.0 + half_body_m
    assert found.geography_height_m == 1.2 + half_body_m


def test_the_buffer_is_wider_by_the_fall_with_the_speed_and_the_wind_with_its_gusts(paper) -> None:
    found = shapes(paper)
    reach_m = (3.0 + 1.25 * 4.0) * found.fall_s + 0.5 * paper.fleet.body_diameter_m
    assert found.fall_reach_m == pytest.approx(reach_m)
    assert found.fall_s >= math.sqrt(2.0 * found.contingency_height_m / 9.81) - 0.01
    assert shapes(paper, wind_m_s=8.0).fall_reach_m > found.fall_reach_m
    assert shapes(paper, highest_m=9.0).fall_reach_m > found.fall_reach_m


def test_a_fall_ends_on_the_lowest_ground_of_the_fleet(paper) -> None:
    fence = msgspec.structs.replace(paper.fleet.geofence_m, z=(-41.0, 10.0))
    vehicles = dict(paper.vehicles)
    vehicles["mav1"] = msgspec.structs.replace(vehicles["mav1"], start_enu_m=(0.0, -1.5, -40.0))
    deep = msgspec.structs.replace(
        paper, fleet=msgspec.structs.replace(paper.fleet, geofence_m=fence), vehicles=vehicles
    )

    found = shapes(deep)

    above_ground_m = 2.0 + 0.5 * paper.fleet.body_diameter_m + 40.0
    assert found.contingency_above_ground_m == pytest.approx(above_ground_m)
    assert found.fall_s == pytest.approx(shapes(paper, highest_m=42.0).fall_s)


def test_volumes_that_were_written_without_the_ground_are_read(paper) -> None:
    *written, _ = shapes(paper)
    assert msgspec.convert(written, Volumes) == shapes(paper)


def test_without_an_origin_the_geojson_says_that_it_is_in_metres(paper) -> None:
    written = geojson(shapes(paper), paper)
    assert "metres" in written["note"]
    rings = [feature["geometry"]["coordinates"][0] for feature in written["features"]]
    assert all(ring[0] == ring[-1] for ring in rings)
    assert len(rings) == 3


@pytest.mark.parametrize("longitude_deg", [8.5, 179.9999])
def test_with_an_origin_it_has_longitudes_and_latitudes_that_lead_back(
    paper, longitude_deg
) -> None:
    origin = Origin(latitude_deg=47.4, longitude_deg=longitude_deg, altitude_m=489.4)
    section = msgspec.structs.replace(paper.fleet, origin=origin)
    fleet = msgspec.structs.replace(paper, fleet=section)
    written = geojson(shapes(fleet), fleet)
    assert "note" not in written
    properties = written["features"][1]["properties"]
    assert properties["top_above_sea_m"] == pytest.approx(489.4 + properties["height_m"], abs=0.01)

    geography = shapes(fleet).geography
    ring = written["features"][0]["geometry"]["coordinates"][0][:-1]
    assert all(-180.0 <= longitude <= 180.0 for longitude, _ in ring)
    led_back = [east_north_m(origin, latitude, longitude) for longitude, latitude in ring]
    np.testing.assert_allclose(led_back, geography, atol=2e-3)
