"""PX4's local frame in the fleet's: whose origin, what happens at a jump, and where a second flight
begins.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import pytest
from msgspec.structs import replace

from onboard.autopilot import Landed, Snapshot
from onboard.config.fleet import Origin
from onboard.localization.local_frame import LocalFrame, ReckonedPosition

ORIGIN = Origin(latitude_deg=47.397742, longitude_deg=8.545594, altitude_m=489.4)
DEGREE_M = math.radians(1.0) * 6_371_000.0


def place(east_m: float, north_m: float) -> tuple[float, float, float]:
    """Latitude, longitude and some altitude of a place near the origin."""
    latitude = ORIGIN.latitude_deg + north_m / DEGREE_M
    return (
        latitude,
        ORIGIN.longitude_deg + east_m / DEGREE_M / math.cos(math.radians(latitude)),
        512.0,
    )


def parked(time_s: float, ned: tuple[float, float, float], **changes: object) -> Snapshot:
    """What PX4 tells while it stands."""
    seen = Snapshot(
        local_position_ns=round(1e9 + 1e9 * time_s),
        position_local_ned_m=ned,
        landed=Landed.ON_GROUND,
    )
    return replace(seen, **changes)


def flying(time_s: float, ned: tuple[float, float, float], **changes: object) -> Snapshot:
    """What PX4 tells while it flies, at rest unless told otherwise."""
    return parked(time_s, ned, is_armed=True, landed=Landed.IN_AIR, **changes)


def test_two_vehicles_with_different_local_origins_agree_where_a_place_is() -> None:
    west = LocalFrame((-20.0, 0.0, 0.0), ORIGIN)
    east = LocalFrame((30.0, 0.0, 0.0), ORIGIN)
    # both hover over the fleet's (5, 8): 25 m east of one origin, 25 m west of the other
    for frame, at, ned in (
        (west, place(-20.0, 3.0), (5.0, 25.0, -2.0)),
        (east, place(30.0, -1.0), (9.0, -25.0, -2.0)),
    ):
        frame.take(parked(0.0, (0.0, 0.0, 0.0), global_origin=at))
        assert frame.take(flying(20.0, ned, global_origin=at)) == pytest.approx(
            (5.0, 8.0, 2.0), abs=0.01
        )


def test_height_is_counted_from_the_ground_whatever_the_satellites_say() -> None:
    frame = LocalFrame((0.0, 0.0, 0.0), ORIGIN)
    frame.take(parked(0.0, (0.0, 0.0, 0.37), global_origin=place(0.0, 0.0)))
    assert frame.take(
        flying(0.02, (0.0, 0.0, 0.37), global_origin=place(0.0, 0.0))
    ) == pytest.approx((0, 0, 0))


def test_without_a_global_origin_nothing_is_claimed_where_the_fleet_has_one() -> None:
    assert LocalFrame((0.0, 0.0, 0.0), ORIGIN).take(parked(0.0, (0.0, 0.0, 0.0))) is None


def test_without_a_fleet_origin_the_take_off_place_counts_once_and_not_where_it_landed() -> None:
    frame = LocalFrame((2.0, 1.0, 0.0), None)
    assert frame.take(parked(0.0, (0.1, 0.2, 0.0))) == pytest.approx((2.0, 1.0, 0.0))
    frame.take(flying(1.0, (0.1, 0.2, -1.0), velocity_local_ned_m_s=(0.0, 0.0, -1.0)))
    landed_away = frame.take(parked(60.0, (3.1, 0.2, 0.0)))
    assert landed_away == pytest.approx((2.0, 4.0, 0.0))


def test_an_agent_that_starts_in_the_air_claims_no_position_until_it_stands() -> None:
    frame = LocalFrame((1.0, 2.0, 0.0), ORIGIN)
    at = place(1.0, 2.0)
    assert frame.take(flying(0.0, (0.0, 0.0, -5.0), global_origin=at)) is None
    assert frame.take(flying(0.1, (0.0, 0.0, -4.0), global_origin=at)) is None
    landed = frame.take(parked(9.0, (0.0, 0.0, 0.2), global_origin=at))
    assert landed == pytest.approx((1.0, 2.0, 0.0), abs=0.01)


def test_a_jump_of_the_estimate_in_the_air_moves_nothing_at_once() -> None:
    for origin in (ORIGIN, None):
        frame = LocalFrame((0.0, 0.0, 0.0), origin)
        at = place(0.0, 0.0)
        frame.take(parked(0.0, (0.0, 0.0, 0.0), global_origin=at))
        before = frame.take(flying(5.0, (0.0, 4.0, -2.0), global_origin=at))
        after = frame.take(flying(5.02, (0.0, 6.0, -3.5), global_origin=at))
        assert before is not None
        assert after is not None
        assert math.dist(before, after) < 0.01
        assert frame.jumps >= 1


def test_a_horizontal_jump_is_given_back_slowly_and_one_in_height_is_not() -> None:
    frame = LocalFrame((0.0, 0.0, 0.0), ORIGIN)
    at = place(0.0, 0.0)
    frame.take(parked(0.0, (0.0, 0.0, 0.0), global_origin=at))
    frame.take(flying(0.02, (0.0, 0.0, 0.0), global_origin=at))
    positions = [
        frame.take(flying(0.04 + 0.02 * count, (0.0, 2.0, -1.5), global_origin=at))
        for count in range(1000)
    ]
    steps = [math.dist(a, b) for a, b in itertools.pairwise(positions) if a and b]
    assert positions[0] == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
    assert max(steps) < 0.005
    assert positions[-1] == pytest.approx((2.0, 0.0, 0.0), abs=0.01)


def test_fast_flight_and_a_gap_in_the_stream_are_no_jump() -> None:
    frame = LocalFrame((0.0, 0.0, 0.0), ORIGIN)
    at = place(0.0, 0.0)
    frame.take(parked(0.0, (0.0, 0.0, 0.0), global_origin=at))
    speed = (0.0, 5.0, 0.0)
    found = None
    for time_s in (0.02, 0.04, 0.06, 0.46, 0.48):
        found = frame.take(
            flying(time_s, (0.0, 5.0 * time_s, 0.0), velocity_local_ned_m_s=speed, global_origin=at)
        )
    assert frame.jumps == 0
    assert found == pytest.approx((2.4, 0.0, 0.0), abs=0.01)


# -- restarts in a fleet without an origin on Earth ------------------------------------------------

_SPOT = (2.0, 1.0, 0.0)


def flown(*, lands_at_ned: tuple[float, float, float]) -> LocalFrame:
    """Return the frame of a vehicle that has flown and landed."""
    frame = LocalFrame(_SPOT, None)
    frame.take(parked(0.0, (0.0, 0.0, 0.0)))
    frame.take(flying(1.0, (0.0, 0.0, -1.0), velocity_local_ned_m_s=(0.0, 0.0, -1.0)))
    assert frame.take(parked(60.0, lands_at_ned)) is not None
    return frame


def test_without_a_fleet_origin_px4_that_restarts_away_from_the_spot_leaves_no_position() -> None:
    frame = flown(lands_at_ned=(0.0, 4.0, 0.0))
    for seconds in (70.0, 71.0):
        assert frame.take(parked(seconds, (0.0, 0.0, 0.0), restarts=1)) is None
        assert frame.displaced_m == pytest.approx(4.0)

    # Another restart of PX4 says nothing about where it stands now.
    assert frame.take(parked(80.0, (0.0, 0.0, 0.0), restarts=2)) is None


def test_without_a_fleet_origin_px4_may_restart_on_the_spot() -> None:
    frame = flown(lands_at_ned=(0.3, 0.2, 0.0))
    restarted = frame.take(parked(70.0, (0.1, 0.0, 0.0), restarts=1))
    assert restarted == pytest.approx(_SPOT)
    assert frame.displaced_m == 0.0

    # PX4 restarts before a flight, too.
    assert frame.take(parked(80.0, (0.0, 0.0, 0.0), restarts=2)) == pytest.approx(_SPOT)


def test_without_a_fleet_origin_an_agent_that_starts_beside_a_moved_vehicle_has_no_position() -> (
    None
):
    frame = LocalFrame(_SPOT, None)
    assert frame.take(parked(0.0, (0.0, 4.0, 0.0))) is None
    assert frame.displaced_m == pytest.approx(4.0)

    # PX4 restarts on the spot.
    assert frame.take(parked(60.0, (0.0, 0.0, 0.0), restarts=1)) == pytest.approx(_SPOT)
    assert frame.displaced_m == 0.0


def test_a_position_that_wanders_by_its_accuracy_before_the_agent_starts_is_taken() -> None:
    frame = LocalFrame(_SPOT, None)
    wandered = parked(0.0, (1.5, 2.0, 0.0), position_accuracy_m=0.6)
    assert frame.take(wandered) == pytest.approx(_SPOT)


def test_with_a_fleet_origin_a_restart_moves_nothing() -> None:
    frame = LocalFrame((0.0, 0.0, 0.0), ORIGIN)
    frame.take(parked(0.0, (0.0, 0.0, 0.0), global_origin=place(0.0, 0.0)))
    frame.take(flying(1.0, (0.0, 4.0, -1.0), global_origin=place(0.0, 0.0)))
    restarted = frame.take(parked(60.0, (0.0, 0.0, 0.0), global_origin=place(4.0, 0.0), restarts=1))
    assert restarted == pytest.approx((4.0, 0.0, 0.0), abs=0.01)


# -- an origin that PX4 moves in flight ------------------------------------------------------------


def hover_with_moved_origin(*, local_jumps_at_s: float, origin_moves_at_s: float) -> float:
    """Return the largest error [m] of a vehicle that hovers at (0, 4) north of the fleet's origin.

    PX4 moves its origin by 15 m to the east, so its local position moves by 15 m to the west.
    """
    frame = LocalFrame((0.0, 0.0, 0.0), ORIGIN)
    frame.take(parked(0.0, (0.0, 0.0, 0.0), global_origin=place(0.0, 0.0)))
    error_m = 0.0
    for tick in range(1, 1500):
        time_s = 0.02 * tick
        east_m = -15.0 if time_s > local_jumps_at_s else 0.0
        origin = place(15.0 if time_s > origin_moves_at_s else 0.0, 0.0)
        position = frame.take(flying(time_s, (0.0, east_m, -2.0), global_origin=origin))
        assert position is not None
        error_m = max(error_m, math.dist(position[:2], (0.0, 0.0)))
    return error_m


@pytest.mark.parametrize("origin_moves_at_s", [4.5, 5.0, 6.0])
def test_an_origin_that_moves_with_the_local_position_leads_nobody_away(
    origin_moves_at_s: float,
) -> None:
    error_m = hover_with_moved_origin(local_jumps_at_s=5.0, origin_moves_at_s=origin_moves_at_s)
    assert error_m < 0.25


def test_a_new_origin_that_does_not_fit_moves_nothing() -> None:
    assert hover_with_moved_origin(local_jumps_at_s=1e9, origin_moves_at_s=5.0) < 0.01


# -- ground of another height ----------------------------------------------------------------------


def landed_at(
    east_m: float,
    height_m: float,
    ground_at: Callable[[float, float], float] | None = None,
    **changes: object,
) -> tuple[float, float, float]:
    """Return the position of a vehicle that has landed and is parked."""
    frame = LocalFrame((0.0, 0.0, 0.0), ORIGIN, ground_at)
    at = place(0.0, 0.0)
    frame.take(parked(0.0, (0.0, 0.0, 0.0), global_origin=at))
    climbed_m = 0.0
    for tick in range(1, 200):
        climbed_m = 0.005 * tick * height_m
        ned = (0.0, 0.005 * tick * east_m, -climbed_m)
        frame.take(flying(0.1 * tick, ned, global_origin=at))
    ned = (0.0, east_m, -height_m)
    position = frame.take(parked(30.0, ned, global_origin=at, **changes))
    assert position is not None
    return position


def test_a_vehicle_that_lands_on_other_ground_keeps_the_height_of_its_flight() -> None:
    assert landed_at(20.0, 10.0) == pytest.approx((20.0, 0.0, 10.0), abs=0.01)
    assert landed_at(20.0, -3.5, height_accuracy_m=0.5) == pytest.approx(
        (20.0, 0.0, -3.5), abs=0.01
    )
    assert landed_at(20.0, 5.0, height_accuracy_m=3.0)[2] == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("east_m", "height_m", "kept_m"),
    [
        (20.0, -1.8, -2.0),
        (20.0, -0.9, 0.0),  # nearer to the ground of the take-off
        (20.0, -1.1, -2.0),
        (20.0, -4.4, -2.0),
        (20.0, -4.6, -4.6),
        (1.0, -1.8, 0.0),
    ],
)
def test_a_vehicle_that_lands_where_the_ground_is_lower_by_the_fleet_file_stands_there(
    east_m: float, height_m: float, kept_m: float
) -> None:
    def ground_at(x_m: float, y_m: float) -> float:
        return 0.0 if math.hypot(x_m, y_m) < 1.5 else -2.0

    position = landed_at(east_m, height_m, ground_at, height_accuracy_m=0.3)
    assert position[2] == pytest.approx(kept_m, abs=0.01)


def test_a_vehicle_that_stands_on_another_roof_stays_there_while_its_position_wanders() -> None:
    def ground_at(x_m: float, y_m: float) -> float:
        return 2.0 if math.hypot(x_m - 20.0, y_m) < 1.0 else 0.0

    frame = LocalFrame((0.0, 0.0, 0.0), ORIGIN, ground_at)
    at = place(0.0, 0.0)
    frame.take(parked(0.0, (0.0, 0.0, 0.0), global_origin=at))
    for tick in range(1, 200):
        frame.take(flying(0.1 * tick, (0.0, 0.1 * tick, -0.01 * tick), global_origin=at))

    for tick, east_m in enumerate((19.5, 18.9, 19.5)):
        position = frame.take(parked(30.0 + tick, (0.0, east_m, -2.0), global_origin=at))
        assert position == pytest.approx((east_m, 0.0, 2.0), abs=0.01)


def test_an_error_of_px4s_height_is_forgotten_after_a_landing() -> None:
    assert landed_at(20.0, 2.0)[2] == pytest.approx(0.0)
    assert landed_at(20.0, 2.5, height_accuracy_m=1.0)[2] == pytest.approx(0.0)
    assert landed_at(1.0, 10.0)[2] == pytest.approx(0.0), "on its spot"


def test_poses_of_another_program_in_the_fleets_frame_are_no_restart_away_from_the_spot() -> None:
    frame = LocalFrame((4.0, 1.0, 0.0), None)
    assert frame.take(parked(0.0, (1.1, 4.0, 0.0))) == pytest.approx((4.0, 1.0, 0.0))
    assert frame.displaced_m == 0.0


def _reckoned(
    east_m: float, north_m: float, up_m: float, *, push_m_s2: float = 0.0
) -> ReckonedPosition:
    return ReckonedPosition((east_m, north_m, up_m), push_m_s2=push_m_s2)


def _after_a_gap(moved_m: float, reckoned_north_m: float = 0.0) -> tuple[LocalFrame, float]:
    """A vehicle hovers, nothing corrects PX4's position for a second, then it comes back.

    Returns:
        The frame, and how far north the vehicle is by the first position after the gap.
    """
    frame = LocalFrame((0.0, 0.0, 0.0), None)
    frame.take(parked(0.0, (0.0, 0.0, 0.0)))
    frame.take(flying(1.0, (0.0, 0.0, -1.0)))
    for tick in range(10):  # PX4's own position drifts away meanwhile
        frame.skip(flying(1.1 + 0.1 * tick, (0.08 * tick, 0.0, -1.0)))
    back = flying(2.1, (moved_m, 0.0, -1.0))
    position_enu_m = frame.take(back, _reckoned(0.0, reckoned_north_m, 1.0))
    assert position_enu_m is not None
    return frame, position_enu_m[1]


def test_a_camera_that_comes_back_where_it_was_is_believed() -> None:
    frame, north_m = _after_a_gap(0.1, reckoned_north_m=0.3)
    assert north_m == pytest.approx(0.1)
    assert frame.jumps == 0
    assert frame.offset_std_m == 0.0


@pytest.mark.parametrize("moved_m", [-2.0, 0.6, 5.0])
def test_a_vehicle_whose_camera_begins_anew_stays_where_its_dead_reckoning_is(
    moved_m: float,
) -> None:
    frame, north_m = _after_a_gap(moved_m, reckoned_north_m=0.1)
    assert north_m == pytest.approx(0.1)
    assert frame.jumps == 1
    assert frame.offset_std_m > 0.05


def test_a_jump_of_the_height_moves_nothing_while_positions_are_not_taken() -> None:
    frame = LocalFrame((0.0, 0.0, 0.0), None)
    frame.take(parked(0.0, (0.0, 0.0, 0.0)))
    frame.take(flying(1.0, (0.0, 0.0, -2.0)))
    frame.skip(flying(1.1, (0.0, 0.0, -1.9)))
    anew = flying(1.2, (0.0, 0.0, 0.0))
    frame.skip(anew)
    vertical = frame.vertical(anew, anew.local_position_ns)
    assert vertical is not None
    assert vertical.height_m == pytest.approx(1.9)
    assert frame.take(flying(1.3, (0.0, 0.0, 0.0)), _reckoned(0.0, 0.0, 1.9)) == pytest.approx(
        (0.0, 0.0, 1.9)
    )


def test_a_height_that_comes_back_with_a_jump_across_is_not_a_jump_of_the_height() -> None:
    """A PX4 that drifts for a second is 0.6 m beside and a quarter of a metre above the truth."""
    frame = LocalFrame((0.0, 0.0, 0.0), None)
    frame.take(parked(0.0, (0.0, 0.0, 0.0)))
    frame.take(flying(1.0, (0.0, 0.0, -1.0)))
    for tick in range(1, 11):
        drifted = (0.06 * tick, 0.0, -1.0 - 0.025 * tick)
        frame.skip(flying(1.0 + 0.1 * tick, drifted))
    back = frame.take(flying(2.1, (0.0, 0.0, -1.0)), _reckoned(0.0, 0.0, 1.2))
    assert back == pytest.approx((0.0, 0.0, 1.0))


@pytest.mark.parametrize("push_m_s2", [0.0, 2.0])
@pytest.mark.parametrize(("moved_m", "knows_its_place"), [(0.2, True), (2.0, False)])
def test_a_camera_that_begins_anew_after_the_landing_leaves_no_position(
    moved_m: float, knows_its_place: bool, push_m_s2: float
) -> None:
    frame = LocalFrame((0.0, 0.0, 0.0), None)
    frame.take(parked(0.0, (0.0, 0.0, 0.0)))
    frame.take(flying(1.0, (0.0, 2.0, -1.0)))
    frame.skip(flying(1.1, (0.0, 2.0, -1.0)))
    frame.skip(parked(4.0, (0.0, 2.0, 0.0)))
    reckoned = _reckoned(2.0, 0.0, 0.0, push_m_s2=push_m_s2)
    for time_s in (30.0, 31.0):
        back = frame.take(parked(time_s, (0.0, 2.0 - moved_m, 0.0)), reckoned)
        assert (back is not None) is knows_its_place
        assert (frame.displaced_m > 0.0) is not knows_its_place


def test_errors_of_several_gaps_add_up_until_px4_restarts_on_the_spot() -> None:
    frame, _ = _after_a_gap(1.0)
    once_m = frame.offset_std_m
    frame.skip(flying(2.2, (1.0, 0.0, -1.0)))
    frame.take(flying(3.2, (4.0, 0.0, -1.0)), _reckoned(0.0, 0.0, 1.0))
    assert frame.offset_std_m > 1.2 * once_m

    frame.take(parked(5.0, (4.0, 0.0, 0.0)))
    frame.take(parked(6.0, (0.0, 0.0, 0.0), restarts=1))
    assert frame.offset_std_m == 0.0


@pytest.mark.parametrize(("push_m_s2", "is_believed"), [(0.0, False), (2.0, True)])
def test_the_wind_makes_dead_reckoning_worse_and_a_camera_more_credible(
    push_m_s2: float, is_believed: bool
) -> None:
    """Two seconds in a wind of 6.7 m/s; the camera has not moved."""
    frame = LocalFrame((0.0, 0.0, 0.0), None)
    frame.take(parked(0.0, (0.0, 0.0, 0.0)))
    frame.take(flying(1.0, (0.0, 0.0, -1.0)))
    frame.skip(flying(1.1, (0.0, 0.0, -1.0)))
    reckoned = _reckoned(0.0, 1.28, 1.0, push_m_s2=push_m_s2)
    position_enu_m = frame.take(flying(3.0, (0.0, 0.0, -1.0)), reckoned)
    assert position_enu_m is not None
    assert (position_enu_m[1] == pytest.approx(0.0)) is is_believed

    # on the ground nothing has to be believed
    assert frame.take(parked(9.0, (0.0, 0.0, 0.0))) is None
    assert frame.displaced_m > 0.0


@pytest.mark.parametrize(
    ("heading_ratio", "turned_s", "knows_its_place"),
    [(2.0, 0.2, True), (2.0, 0.5, False), (math.nan, 0.5, True), (math.nan, 1.5, False)],
)
def test_a_camera_whose_heading_has_differed_from_px4s_is_not_believed_any_more(
    heading_ratio: float, turned_s: float, knows_its_place: bool
) -> None:
    """PX4 follows its heading within some seconds, and then it looks as if all were right."""
    frame = LocalFrame((0.0, 0.0, 0.0), None)
    frame.take(parked(0.0, (0.0, 0.0, 0.0)))
    frame.take(flying(1.0, (0.0, 0.0, -1.0)))
    for tick in range(round(10 * turned_s)):
        turned = flying(1.1 + 0.1 * tick, (0.0, 0.0, -1.0), heading_ratio=heading_ratio)
        frame.skip(turned, is_turned=True)
    back = flying(1.2 + turned_s, (0.1, 0.0, -1.0))
    assert (frame.take(back, _reckoned(0.0, 0.0, 1.0)) is not None) is knows_its_place

    landed = frame.take(parked(20.0, (0.1, 0.0, 0.0)))
    assert (landed is not None) is knows_its_place
    assert (frame.displaced_m > 0.0) is not knows_its_place


@pytest.mark.parametrize(("gap_s", "knows_its_place"), [(1.0, True), (2.0, False)])
def test_a_place_by_dead_reckoning_is_given_up_after_the_landing(
    gap_s: float, knows_its_place: bool
) -> None:
    frame = LocalFrame((0.0, 0.0, 0.0), None)
    frame.take(parked(0.0, (0.0, 0.0, 0.0)))
    frame.take(flying(1.0, (0.0, 0.0, -1.0)))
    frame.skip(flying(1.1, (0.0, 0.0, -1.0)))
    frame.take(flying(1.0 + gap_s, (5.0, 0.0, -1.0)), _reckoned(0.0, 0.3, 1.0))
    landed = frame.take(parked(9.0, (5.0, 0.0, 0.0)))
    assert (landed is not None) is knows_its_place
    assert (frame.displaced_m > 0.0) is not knows_its_place


@pytest.mark.parametrize("begin", [parked, flying])
@pytest.mark.parametrize(
    ("restarts", "turns_at_s", "is_turned"),
    [(0, 0.5, False), (0, 1.5, True), (1, 50.5, False), (1, 51.5, True)],
)
def test_a_jump_of_px4s_heading_turns_the_frame_unless_px4_has_just_started(
    begin: Callable[..., Snapshot], restarts: int, turns_at_s: float, is_turned: bool
) -> None:
    """PX4 follows at once a camera that says that it has begun anew."""
    frame = LocalFrame((0.0, 0.0, 0.0), None)
    frame.take(parked(0.0, (0.0, 0.0, 0.0)))
    if restarts:
        frame.take(parked(50.0, (0.0, 0.0, 0.0), restarts=restarts))

    newest = begin(turns_at_s, (0.0, 0.0, 0.0), restarts=restarts)
    frame.take(newest)
    frame.turn(newest)
    later = begin(turns_at_s + 0.1, (0.0, 0.0, 0.0), restarts=restarts)
    assert (frame.take(later) is None) is is_turned


def test_a_camera_that_has_turned_before_px4_restarts_leaves_no_position() -> None:
    frame = LocalFrame((0.0, 0.0, 0.0), None)
    frame.take(parked(0.0, (0.0, 0.0, 0.0)))
    flown = flying(6.0, (0.0, 0.0, -1.0))
    frame.take(flown)
    frame.turn(flown)
    assert frame.take(parked(9.0, (0.0, 0.0, 0.0), restarts=1)) is None
    assert frame.displaced_m > 0.0


def test_flights_before_the_place_is_known_do_not_count() -> None:
    """A pilot flies the vehicle to its spot, where PX4 restarts and its position settles."""
    frame = LocalFrame((0.0, 0.0, 0.0), None)
    frame.take(parked(0.0, (5.0, 0.0, 0.0)))
    frame.take(flying(1.0, (5.0, 0.0, -1.0)))
    assert frame.displaced_m > 0.0
    for settling_m in (0.0, 0.3):
        settled = parked(9.0 + settling_m, (settling_m, 0.0, 0.0), restarts=1)
        assert frame.take(settled) == pytest.approx((0.0, 0.0, 0.0))
