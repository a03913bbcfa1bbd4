"""The geofence, with positions and velocities that were judged by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from onboard.config.areas import Area
from onboard.config.fleet import Geofence
from onboard.safety.geofence import FenceBox, FenceStatus, fence_of
from tests.onboard.agent.rig import fleet

ROOM = FenceBox((-4.0, -4.0, 0.0), (4.0, 4.0, 3.0), (2.0, 2.0, 4.0), reaction_s=0.2)
INSIDE = FenceStatus(False, False, False)
NEAR = FenceStatus(True, False, False)
OUTSIDE = FenceStatus(False, True, False)
ABOVE = FenceStatus(False, False, True)


CASES = [
    ((0.0, 0.0, 1.0), (1.0, 1.0, 0.0), INSIDE),
    ((4.0, -4.0, 3.0), (0.0, 0.0, 0.0), INSIDE),  # on the wall
    ((4.01, 0.0, 1.0), (0.0, 0.0, 0.0), OUTSIDE),
    ((0.0, -4.3, 1.0), (0.0, 1.0, 0.0), OUTSIDE),
    ((0.0, 0.0, 3.1), (0.0, 0.0, -1.0), ABOVE),
    ((4.1, 0.0, 3.1), (0.0, 0.0, 0.0), FenceStatus(False, True, True)),
    ((0.0, 0.0, -0.4), (0.0, 0.0, -1.0), INSIDE),  # landed, a bit below where it is measured
    ((0.0, 0.0, -0.6), (0.0, 0.0, 0.0), OUTSIDE),
    ((3.5, 0.0, 1.0), (1.0, 0.0, 0.0), INSIDE),  # stops within 0.45 m
    ((3.6, 0.0, 1.0), (1.0, 0.0, 0.0), NEAR),
    ((-3.6, 0.0, 1.0), (1.0, 0.0, 0.0), INSIDE),  # flies away from that wall
    ((0.0, -3.6, 1.0), (0.0, -1.0, 0.0), NEAR),
    ((0.0, 0.0, 2.8), (0.0, 0.0, 1.0), NEAR),
    ((0.0, 0.0, 0.1), (0.0, 0.0, -2.0), INSIDE),  # sinking ends on the floor
    ((0.0, 0.0, -0.5), (0.0, 0.0, 0.0), INSIDE),  # as far below the floor as it may seem
    ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0), INSIDE),  # climbs, far below the ceiling
    ((3.95, 0.0, 1.0), (1.0, 0.0, 0.0), NEAR),  # a hand's breadth from the wall
    ((3.995, 0.0, 1.0), (0.05, 0.0, 0.0), NEAR),  # creeps towards it
    ((0.0, 3.995, 1.0), (0.0, 0.05, 0.0), NEAR),
    ((0.0, 0.0, 2.995), (0.0, 0.0, 0.05), NEAR),
    ((math.nan, 0.0, 1.0), (0.0, 0.0, 0.0), OUTSIDE),
    ((0.0, 0.0, math.inf), (0.0, 0.0, 0.0), OUTSIDE),
]


def test_a_vehicle_is_inside_near_outside_or_above() -> None:
    for position, velocity, expected in CASES:
        assert ROOM.status(position, velocity) == expected, f"{position} {velocity}"


def test_the_fence_of_a_fleet_has_its_walls_and_brakes_as_the_vehicle_does() -> None:
    vehicle = fleet().vehicles["mav0"]
    fence = fence_of(Geofence(x=(-1.0, 2.0), y=(-3.0, 4.0), z=(-0.5, 6.0)), vehicle)
    assert fence.low_enu_m == (-1.0, -3.0, -0.5)
    assert fence.high_enu_m == (2.0, 4.0, 6.0)
    assert fence.reaction_s == vehicle.lag_s

    brake_x, brake_y, brake_z = fence.brake_m_s2
    tilt_m_s2 = 9.80665 * math.tan(math.radians(vehicle.max_tilt_deg))
    assert brake_x == brake_y == pytest.approx(0.6 * tilt_m_s2, rel=1e-4)
    assert brake_z == pytest.approx(4.903, abs=0.01)


def test_how_far_a_vehicle_gets_that_crosses_the_fence() -> None:
    across_m, upwards_m = ROOM.farthest_m(2.0)
    assert across_m == pytest.approx(math.hypot(8.0, 8.0) + 2.0 * 0.2 + 2.0 * 2.0 / 4.0)
    assert upwards_m == pytest.approx(3.0 + 2.0 * 0.2 + 2.0 * 2.0 / 8.0)


HOUSE = Area(
    name="house",
    keeps_in=False,
    corners_enu_m=((1.0, 1.0), (1.0, 2.0), (2.0, 2.0), (2.0, 1.0)),
    center_enu_m=(0.0, 0.0),
    radius_m=0.0,
    low_m=0.0,
    high_m=2.0,
    buffer_m=0.0,
)
FIELD = HOUSE._replace(
    name="field",
    keeps_in=True,
    corners_enu_m=((-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0)),
    high_m=2.5,
)
IN_AREAS = [
    ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), INSIDE),
    ((3.1, 0.0, 1.0), (0.0, 0.0, 0.0), OUTSIDE),
    ((1.5, 1.5, 1.0), (0.0, 0.0, 0.0), OUTSIDE),  # in the house
    ((1.5, 1.5, 2.2), (0.0, 0.0, 0.0), INSIDE),  # above it
    ((1.5, 1.5, 2.2), (0.0, 0.0, -1.0), NEAR),  # and about to sink into it
    ((0.6, 1.5, 1.0), (1.0, 0.0, 0.0), NEAR),  # stops within 0.45 m
    ((0.5, 1.5, 1.0), (1.0, 0.0, 0.0), INSIDE),
    ((0.6, 1.5, 1.0), (-1.0, 0.0, 0.0), INSIDE),  # flies away from it
    ((0.9, 0.4, 1.0), (0.0, 1.0, 0.0), INSIDE),  # passes beside it
    ((2.6, 0.0, 1.0), (1.0, 0.0, 0.0), NEAR),  # about to leave the field
    ((0.0, 0.0, 2.5), (0.0, 0.0, 0.0), INSIDE),  # at its top
    ((0.0, 0.0, 2.6), (0.0, 0.0, 0.0), ABOVE),  # above the field
    ((0.0, 0.0, 2.3), (0.0, 0.0, 1.0), NEAR),
    ((4.01, 0.0, 1.0), (0.0, 0.0, 0.0), OUTSIDE),  # out of the box, too
    ((math.nan, 0.0, 1.0), (0.0, 0.0, 0.0), OUTSIDE),
]


def test_a_vehicle_is_inside_near_or_outside_of_areas_within_the_box() -> None:
    for position, velocity, expected in IN_AREAS:
        found = ROOM.status_in((FIELD, HOUSE), position, velocity)
        assert found == expected, f"{position} {velocity}"


def test_a_circle_is_about_to_be_crossed_where_the_way_to_stop_reaches_it() -> None:
    pond = HOUSE._replace(corners_enu_m=(), center_enu_m=(1.0, 0.0), radius_m=0.5)
    assert ROOM.status_in((pond,), (0.1, 0.0, 1.0), (1.0, 0.0, 0.0)) == NEAR
    assert ROOM.status_in((pond,), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)) == INSIDE
    assert ROOM.status_in((pond,), (1.0, 0.2, 1.0), (0.0, 0.0, 0.0)) == OUTSIDE


@pytest.mark.parametrize("brake_m_s2", [(1.0, 2.0, 4.0), (2.0, 1.0, 4.0)])
def test_the_weaker_of_both_horizontal_brakes_says_where_a_vehicle_stops(
    brake_m_s2: tuple[float, float, float],
) -> None:
    box = replace(ROOM, brake_m_s2=brake_m_s2)
    # 1 m/s: 0.2 m until it brakes, then 0.5 m with 1 m/s^2, or 0.25 m with 2 m/s^2
    assert box.status_in((HOUSE,), (0.4, 1.5, 1.0), (1.0, 0.0, 0.0)) == NEAR
    assert box.status_in((HOUSE,), (0.2, 1.5, 1.0), (1.0, 0.0, 0.0)) == INSIDE
