"""The facts that the flight table decides on, one by one: at their limits and a little beside them.

Each number of predicates.py and arrival.py stands here once more, as a literal.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import pytest
from msgspec.structs import replace

from onboard.autopilot import Landed, Snapshot
from onboard.bus.schema import Order, OrderKind
from onboard.control.climb_duration import climb_duration_s
from onboard.control.path import path_of
from onboard.flight import arrival, contact, predicates
from onboard.flight.contact import ContactSigns
from onboard.flight.context import FlightContext
from onboard.flight.expected_ground import ExpectedGround, ground_of_takeoff
from onboard.flight.path_flight import PathFlight
from onboard.flight.types import FlightStep, FlightView
from onboard.types import Goal
from onboard.vectors import ZERO_3, Vec3
from tests.onboard.agent.rig import fleet

_FLEET = fleet()
_VEHICLE = _FLEET.vehicles["mav0"]
_BY_SATELLITES = replace(_VEHICLE, mocap_required=False)
_BEGIN_NS = 50_000_000_000
_PATH = path_of([[1.0, *[0.0] * 32]])
_RAISED = ground_of_takeoff(2.0, 0.0)


def _flight(**changes: Any) -> FlightContext:
    """A flight whose step has just begun, with a goal a metre above the ground."""
    goal = Goal(Vec3(0.0, 0.0, 1.0), 0.0, 1)
    values = {
        "step": FlightStep.LEG,
        "step_ns": _BEGIN_NS,
        "steady_since_ns": _BEGIN_NS,
        "goal": goal,
    }
    return FlightContext(**{"fleet": _FLEET, "vehicle": _VEHICLE, **values, **changes})


def _view(after_s: float = 0.0, **changes: Any) -> FlightView:
    """What is seen so long after the step has begun; the rest may be of the view or of PX4."""
    now_ns = _BEGIN_NS + round(after_s * 1e9)
    in_view = {name: changes.pop(name) for name in list(changes) if hasattr(FlightView, name)}
    in_px4 = {"landed_ns": now_ns, "heartbeat_ns": now_ns, **changes}
    view = FlightView(
        now_ns=now_ns,
        position_enu_m=(0.0, 0.0, 1.0),
        velocity_enu_m_s=(0.0, 0.0, 0.0),
        has_position=True,
        snapshot=Snapshot(**in_px4),
    )
    return replace(view, **in_view)


def _order(kind: OrderKind, **changes: Any) -> Order:
    return Order(order_id="o", author="x", kind=kind, stamp_ns=0, deadline_ns=0, **changes)


def _ns(after_s: float) -> int:
    return _BEGIN_NS + round(after_s * 1e9)


# -- what PX4 confirms -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mode", "heard_s", "now_s", "is_confirmed"),
    [
        ("OFFBOARD", 0.001, 0.11, True),
        ("OFFBOARD", 0.0, 0.11, False),  # a heartbeat from before
        ("OFFBOARD", 0.001, 0.1, False),
        ("HOLD", 0.001, 0.11, False),
    ],
)
def test_offboard_is_confirmed_by_a_later_heartbeat(
    mode: str, heard_s: float, now_s: float, is_confirmed: bool
) -> None:
    view = _view(now_s, mode=mode, heartbeat_ns=_ns(heard_s))
    assert predicates.px4_confirms_offboard(_flight(), view) is is_confirmed


@pytest.mark.parametrize("is_armed", [True, False])
@pytest.mark.parametrize(("heard_s", "is_later"), [(0.001, True), (0.0, False)])
def test_armed_and_disarmed_are_confirmed_by_a_later_heartbeat(
    is_armed: bool, heard_s: float, is_later: bool
) -> None:
    view = _view(1.0, is_armed=is_armed, heartbeat_ns=_ns(heard_s))
    assert predicates.px4_confirms_armed(_flight(), view) is (is_armed and is_later)
    assert predicates.px4_confirms_disarmed(_flight(), view) is (not is_armed and is_later)


@pytest.mark.parametrize(
    ("is_armed", "heard_s", "stays"),
    [(False, 0.501, True), (False, 0.5, False), (True, 0.501, False)],
)
def test_px4_stays_disarmed_when_an_older_request_has_had_its_effect(
    is_armed: bool, heard_s: float, stays: bool
) -> None:
    view = _view(1.0, is_armed=is_armed, heartbeat_ns=_ns(heard_s))
    assert predicates.px4_stays_disarmed(_flight(), view) is stays


@pytest.mark.parametrize(
    ("predicate", "limit_s"),
    [
        (predicates.px4_has_not_confirmed_in_time, 5.0),
        (predicates.px4_has_not_rebooted_in_time, 30.0),
        (predicates.setpoints_have_streamed, 0.3),
        (predicates.lift_off_late, 6.0),
        (predicates.rest_late, 15.0),
        (predicates.climb_late, 40.0),
        (predicates.px4_landing_late, 62.0),  # a metre above the ground
    ],
)
def test_what_lasts_too_long_is_late_after_its_limit(predicate: Any, limit_s: float) -> None:
    assert predicate(_flight(), _view(limit_s + 0.001))
    assert not predicate(_flight(), _view(limit_s - 0.001))


def test_a_climb_that_is_planned_for_long_may_take_three_times_as_long() -> None:
    order = _order("takeoff", height_m=12.0)
    planned_s = climb_duration_s(12.0, _flight().vehicle.max_speed_m_s)
    for flight, factor in ((_flight(order=order), 3.0), (_flight(order=order, is_slow=True), 6.0)):
        assert predicates.climb_late(flight, _view(factor * planned_s + 0.001))
        assert not predicates.climb_late(flight, _view(factor * planned_s - 0.001))


def test_a_landing_by_px4_may_take_longer_only_where_its_height_is_known() -> None:
    low = _flight(expected_ground=ground_of_takeoff(3.0, 0.0))
    assert predicates.px4_landing_late(low, _view(60.001))
    unknown = _view(60.001, has_position=False, position_enu_m=(0.0, 0.0, 50.0))
    assert predicates.px4_landing_late(_flight(), unknown)
    assert not predicates.px4_landing_late(_flight(), _view(60.001))


@pytest.mark.parametrize(
    ("boot_ms", "heard_s", "has_rebooted"),
    [(1, 0.001, True), (1999, 2.0, True), (2000, 2.0, False), (0, 2.0, False), (1, 0.0, False)],
)
def test_px4_has_rebooted_when_its_clock_began_after_the_step(
    boot_ms: int, heard_s: float, has_rebooted: bool
) -> None:
    view = _view(2.0, px4_boot_ms=boot_ms, attitude_ns=_ns(2.0), heartbeat_ns=_ns(heard_s))
    assert predicates.px4_has_rebooted(_flight(), view) is has_rebooted


@pytest.mark.parametrize("is_armed", [True, False])
@pytest.mark.parametrize("landed", list(Landed))
@pytest.mark.parametrize("is_new", [True, False])
def test_what_px4_says_of_the_ground_and_of_its_motors(
    is_armed: bool, landed: Landed, is_new: bool
) -> None:
    reported_ns = _ns(8.501 if is_new else 8.5)
    view = _view(10.0, is_armed=is_armed, landed=landed, landed_ns=reported_ns)
    was_down = landed is Landed.ON_GROUND
    is_down = was_down and is_new

    assert predicates.px4_is_armed(_flight(), view) is is_armed
    assert predicates.px4_is_on_ground(_flight(), view) is was_down
    assert predicates.px4_reports_the_ground(_flight(), view) is is_down
    assert predicates.px4_is_armed_in_the_air(_flight(), view) is (is_armed and not is_down)
    assert predicates.px4_is_disarmed_on_ground(_flight(), view) is (not is_armed and was_down)
    assert predicates.px4_flies_without_agent(_flight(), view) is (is_armed and not was_down)
    assert predicates.landed(_flight(), view) is (not is_armed and (was_down or not is_new))
    with_order = _flight(order=_order("land"))
    assert not predicates.px4_flies_without_agent(with_order, view)


# -- take-off, move, hold --------------------------------------------------------------------------


def test_it_has_lifted_off_five_centimetres_above_the_ground() -> None:
    flight = _flight(expected_ground=_RAISED)
    assert predicates.lifted_off(flight, _view(position_enu_m=(0.0, 0.0, 2.051)))
    assert not predicates.lifted_off(flight, _view(position_enu_m=(0.0, 0.0, 2.05)))


@pytest.mark.parametrize(
    ("ordered_m", "height_m", "climbs_on"),
    [(3.0, 2.501, True), (3.0, 2.5, False), (2.9, 2.9, False), (2.8, 2.9, False)],
)
def test_it_climbs_on_at_the_middle_of_the_first_metre(
    ordered_m: float, height_m: float, climbs_on: bool
) -> None:
    goal = Goal(Vec3(0.0, 0.0, 2.9), 0.0, 1)
    flight = _flight(
        expected_ground=_RAISED, goal=goal, order=_order("takeoff", height_m=ordered_m)
    )
    assert predicates.climbs_on(flight, _view(position_enu_m=(0.0, 0.0, height_m))) is climbs_on


@pytest.mark.parametrize(
    ("steady_s", "beside_m", "has_arrived"),
    [
        (0.501, 0.119, True),
        (0.5, 0.119, False),
        (0.501, 0.12, False),
        (8.001, 5.0, True),
        (8.0, 5.0, False),
    ],
)
def test_it_has_arrived_after_half_a_second_near_its_goal_or_eight_where_gusts_move_it(
    steady_s: float, beside_m: float, has_arrived: bool
) -> None:
    view = _view(steady_s, position_enu_m=(beside_m, 0.0, 1.0))
    assert predicates.arrived(_flight(), view) is has_arrived

    to_land = _flight(order=_order("move", then_land=True))
    assert predicates.arrived_to_land(to_land, view) is has_arrived
    assert not predicates.arrived_to_land(_flight(order=_order("move")), view)
    assert not predicates.arrived_to_land(_flight(), view)


@pytest.mark.parametrize(
    ("time_s", "is_over", "is_late"),
    [(0.999, False, False), (1.0, True, False), (16.0, True, False), (16.001, True, True)],
)
def test_a_path_is_over_at_its_end_and_late_fifteen_seconds_after(
    time_s: float, is_over: bool, is_late: bool
) -> None:
    path = PathFlight(path=_PATH, time_s=time_s)
    flight = _flight(step=FlightStep.PATH, path=path, goal=Goal(ZERO_3, 0.0, 1))
    at_end = _view(0.501, position_enu_m=(0.0, 0.0, 0.0))
    assert predicates.path_ended(flight, at_end) is is_over
    assert predicates.is_steady(flight, at_end) is is_over
    assert not predicates.path_ended(flight, _view(0.4, position_enu_m=(0.0, 0.0, 0.0)))
    assert not predicates.is_steady(flight, _view(0.501, position_enu_m=(0.0, 0.7, 0.0)))
    assert predicates.path_late(flight, at_end) is is_late


@pytest.mark.parametrize(
    ("on_lag", "used_s", "is_lagging", "lands", "leaves"),
    [
        ("land", 10.0, True, True, True),
        ("hold", 10.0, True, False, True),
        ("land", 9.99, True, False, False),
        ("land", 10.0, False, False, False),
    ],
)
def test_who_is_left_behind_for_long_leaves_the_show_as_ordered(
    on_lag: Literal["land", "hold"], used_s: float, is_lagging: bool, lands: bool, leaves: bool
) -> None:
    path = PathFlight(path=_PATH, on_lag=on_lag, used_s=used_s, is_lagging=is_lagging)
    flight = _flight(step=FlightStep.PATH, path=path)
    assert predicates.left_behind_to_land(flight, _view()) is lands
    assert predicates.left_behind(flight, _view()) is leaves
    assert path.is_behind is (is_lagging and used_s < 10.0)


def test_it_rests_after_three_tenths_of_a_second() -> None:
    assert predicates.at_rest(_flight(), _view(0.301))
    assert not predicates.at_rest(_flight(), _view(0.299))


@pytest.mark.parametrize("is_slow", [True, False])
def test_an_order_is_slowed_down_once(is_slow: bool) -> None:
    assert predicates.not_slowed_yet(_flight(is_slow=is_slow), _view()) is not is_slow


# -- where it is, and how fast ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gust_m_s2", "has_mocap", "within_m", "below_m_s"),
    [
        (0.1, True, 0.12, 0.10),
        (0.5, True, 0.52, 0.34),
        (0.1, False, 0.6, 0.6),
        (0.5, False, 1.0, 0.84),
    ],
)
def test_it_is_at_its_goal_within_a_distance_that_gusts_widen_and_in_calm_air_also_slow(
    gust_m_s2: float, has_mocap: bool, within_m: float, below_m_s: float
) -> None:
    vehicle = _VEHICLE if has_mocap else _BY_SATELLITES
    calm_m = 0.12 if has_mocap else 0.6
    is_calm = gust_m_s2 == 0.1

    def seen(beside_m: float, speed_m_s: float) -> FlightView:
        return _view(
            position_enu_m=(beside_m, 0.0, 0.0),
            velocity_enu_m_s=(0.0, speed_m_s, 0.0),
            gust_m_s2=gust_m_s2,
            expected_gust_m_s2=gust_m_s2,
        )

    origin = (0.0, 0.0, 0.0)
    assert arrival.is_at(seen(within_m - 1e-9, below_m_s - 1e-9), origin, vehicle)
    assert not arrival.is_at(seen(within_m + 1e-9, 0.0), origin, vehicle)
    assert arrival.is_at(seen(0.0, below_m_s + 1e-9), origin, vehicle) is not is_calm
    assert arrival.is_near_and_slow(seen(calm_m - 1e-9, below_m_s - 1e-9), origin, vehicle)
    assert not arrival.is_near_and_slow(seen(calm_m, 0.0), origin, vehicle)
    assert not arrival.is_near_and_slow(seen(0.0, below_m_s + 1e-9), origin, vehicle)
    assert arrival.is_at_rest(seen(9.0, 1.5 * below_m_s - 1e-9), vehicle)
    assert not arrival.is_at_rest(seen(9.0, 1.5 * below_m_s + 1e-9), vehicle)


def test_at_the_limits_themselves_it_is_not_at_its_goal_and_does_not_rest() -> None:
    origin = (0.0, 0.0, 0.0)
    beside = _view(position_enu_m=(0.12, 0.0, 0.0))
    quick = _view(position_enu_m=origin, velocity_enu_m_s=(0.1, 0.0, 0.0))
    quicker = _view(position_enu_m=origin, velocity_enu_m_s=(1.5 * 0.1, 0.0, 0.0))
    assert not arrival.is_at(beside, origin, _VEHICLE)
    assert not arrival.is_at(quick, origin, _VEHICLE)
    assert not arrival.is_at_rest(quicker, _VEHICLE)
    assert arrival.has_turned(_view(yaw_rad=math.radians(10.0)), 0.0)


def test_calm_air_widens_nothing() -> None:
    assert arrival.moved_by_gusts(0.0) == (0.0, 0.0)
    assert arrival.moved_by_gusts(0.1) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("yaw_deg", "goal_deg", "has_turned"),
    [
        (9.9, 0.0, True),
        (-10.1, 0.0, False),
        (175.0, -179.0, True),
        (90.0, 0.0, False),
        (90.0, math.nan, True),
        (math.nan, 0.0, True),
    ],
)
def test_it_has_turned_within_ten_degrees_the_short_way_round(
    yaw_deg: float, goal_deg: float, has_turned: bool
) -> None:
    view = _view(yaw_rad=math.radians(yaw_deg))
    assert arrival.has_turned(view, math.radians(goal_deg)) is has_turned


def test_it_comes_to_rest_where_its_lag_and_its_acceleration_let_it() -> None:
    view = _view(position_enu_m=(0.1, 0.2, 1.0), velocity_enu_m_s=(0.6, -0.8, 0.4))
    brake_s = _VEHICLE.lag_s + math.hypot(0.6, 0.8, 0.4) / _VEHICLE.max_acceleration_m_s2
    stop_enu_m = arrival.stop_point(view, _VEHICLE, _FLEET)
    wanted_enu_m = (0.1 + 0.6 * brake_s, 0.2 - 0.8 * brake_s, 1.06)
    assert stop_enu_m == pytest.approx(wanted_enu_m)

    outside = _view(position_enu_m=(99.0, 0.0, 1.0))
    east_m = _FLEET.fleet.geofence_m.x[1]
    assert arrival.stop_point(outside, _VEHICLE, _FLEET)[0] == pytest.approx(east_m - 0.05)


# -- landing ---------------------------------------------------------------------------------------


def _stands(light_ms: float, still_ms: float, now_s: float) -> ContactSigns:
    now_ns = _ns(now_s)
    light_since_ns = now_ns - round(light_ms * 1e6)
    still_since_ns = now_ns - round(still_ms * 1e6)
    return ContactSigns(
        0.0, still_since_ns, light_since_ns, reported_since_ns=now_ns, slow_since_ns=now_ns
    )


@pytest.mark.parametrize("has_mocap", [True, False])
def test_no_touch_down_counts_at_the_begin_of_a_descent(has_mocap: bool) -> None:
    vehicle = _VEHICLE if has_mocap else _BY_SATELLITES
    for now_s, is_down in ((0.301, True), (0.299, False)):
        flight = _flight(vehicle=vehicle, contact=_stands(400, 400, now_s))
        assert predicates.touched_down(flight, _view(now_s)) is is_down
    flight = _flight(vehicle=vehicle, contact=_stands(0, 400, 9.0))
    assert not predicates.touched_down(flight, _view(9.0))


@pytest.mark.parametrize(("now_s", "is_down"), [(3.001, True), (2.999, False)])
def test_a_landing_is_late_a_second_after_its_plan(now_s: float, is_down: bool) -> None:
    goal = Goal(ZERO_3, 2.0, 1)
    flight = _flight(goal=goal, contact=_stands(0, 1600, now_s))
    view = _view(now_s, position_enu_m=(0.0, 0.0, 0.2))
    assert predicates.touched_down(flight, view) is is_down


@pytest.mark.parametrize("height_m", [0.0, 0.2])
def test_beside_a_roof_its_height_is_no_sign_of_contact(height_m: float) -> None:
    now_s = 9.0
    view = _view(now_s, position_enu_m=(0.0, 0.0, height_m), lift_share=0.96)
    goal = Goal(ZERO_3, 2.0, 1)
    still = _stands(0, 1600, now_s)
    assert predicates.touched_down(_flight(goal=goal, contact=still), view)
    beside = _flight(goal=goal, contact=still, expected_ground=ExpectedGround(landing_z_m=-1.0))
    assert not predicates.touched_down(beside, view)

    # with little thrust it stands, as on a roof that is larger than the file knows
    light = replace(still, light_since_ns=still.still_since_ns)
    stands = _flight(goal=goal, contact=light, expected_ground=ExpectedGround(landing_z_m=-1.0))
    assert predicates.touched_down(stands, view)


@pytest.mark.parametrize(("height_m", "is_down"), [(-0.01, True), (-0.035, False), (0.05, False)])
def test_a_hover_at_the_end_of_a_descent_above_lower_ground_is_no_contact(
    height_m: float, is_down: bool
) -> None:
    """In wind a vehicle hovers 0.035 to 0.05 m below the expected ground, with 0.96 of its lift."""
    now_s = 2.5
    flight = _flight(goal=Goal(ZERO_3, 2.0, 1), contact=_stands(0, 400, now_s))
    view = _view(now_s, position_enu_m=(0.0, 0.0, height_m), lift_share=0.96)
    assert predicates.touched_down(flight, view) is is_down


@pytest.mark.parametrize(("now_s", "counts"), [(0.601, True), (0.599, False)])
def test_a_descent_without_poses_has_to_have_begun(now_s: float, counts: bool) -> None:
    contact = _stands(0, 400, now_s)
    flight = _flight(step=FlightStep.SINKING, contact=contact)
    view = _view(now_s, position_enu_m=(0.0, 0.0, 0.2), is_dead_reckoned=True)
    assert predicates.touched_down_without_poses(flight, view) is counts
    assert predicates.may_have_ground_contact_without_poses(flight, view) is counts

    coasting = _flight(step=FlightStep.COASTING, contact=contact)
    assert not predicates.may_have_ground_contact_without_poses(coasting, view)
    high = _view(now_s, position_enu_m=(0.0, 0.0, 0.7))
    assert not predicates.touched_down_without_poses(flight, high)


def test_a_descent_without_poses_ends_when_they_have_come_for_a_while() -> None:
    flight = _flight(step=FlightStep.SINKING)
    assert not predicates.has_poses_again_for_a_while(flight, _view(0.5))
    assert predicates.has_poses_again_for_a_while(flight, _view(0.7))
    assert not predicates.has_poses_again_for_a_while(flight, _view(0.7, is_dead_reckoned=True))


@pytest.mark.parametrize("is_dead_reckoned", [True, False])
@pytest.mark.parametrize("kind", ["move", "follow_path", "takeoff", "land"])
def test_what_goes_on_when_its_position_is_measured_again(
    is_dead_reckoned: bool, kind: OrderKind
) -> None:
    view = _view(is_dead_reckoned=is_dead_reckoned)
    flight = _flight(order=_order(kind))
    assert predicates.has_order(flight, view)
    assert predicates.is_dead_reckoned(flight, view) is is_dead_reckoned
    assert predicates.has_poses_again(flight, view) is not is_dead_reckoned
    is_on_leg = not is_dead_reckoned and kind in ("move", "follow_path")
    assert predicates.has_poses_again_on_leg(flight, view) is is_on_leg
    is_climbing = not is_dead_reckoned and kind == "takeoff"
    assert predicates.has_poses_again_in_climb(flight, view) is is_climbing
    assert not predicates.has_order(_flight(), view)
    assert not predicates.has_poses_again_on_leg(_flight(), view)
    assert not predicates.has_poses_again_in_climb(_flight(), view)


@pytest.mark.parametrize(
    ("fallen_m", "speed_m_s", "falls"),
    [(0.11, 0.31, True), (0.09, 0.31, False), (0.11, 0.3, False)],
)
def test_it_falls_when_it_sinks_from_where_it_seemed_to_stand(
    fallen_m: float, speed_m_s: float, falls: bool
) -> None:
    view = _view(position_enu_m=(0.0, 0.0, 1.0), velocity_enu_m_s=(0.0, 0.0, -speed_m_s))
    assert predicates.falls(_flight(search_began_z_m=1.0 + fallen_m), view) is falls


def test_it_is_kept_off_after_two_seconds() -> None:
    assert predicates.is_kept_off(_flight(), _view(2.001))
    assert not predicates.is_kept_off(_flight(), _view(2.0))


@pytest.mark.parametrize(
    ("beside_m", "sinks_m_s", "is_kept"),
    [(0.51, 0.0, True), (0.5, 0.0, False), (0.51, 0.5, False), (0.51, -0.2, False)],
)
def test_it_is_kept_off_where_it_stands_beside_its_goal(
    beside_m: float, sinks_m_s: float, is_kept: bool
) -> None:
    flight = _flight(step=FlightStep.DESCENT)
    view = _view(
        position_enu_m=(0.0, beside_m, 1.0),
        velocity_enu_m_s=(0.0, 0.0, -sinks_m_s),
        gust_m_s2=0.0,
    )
    assert predicates.is_steady(flight, view) is is_kept


@pytest.mark.parametrize(("sinks_m_s", "is_kept"), [(0.49, True), (0.5, False)])
def test_in_gusts_it_is_kept_off_unless_it_sinks_as_a_landing_does(
    sinks_m_s: float, is_kept: bool
) -> None:
    flight = _flight(step=FlightStep.DESCENT)
    sinking = (0.0, 0.0, -sinks_m_s)
    view = _view(position_enu_m=(0.0, 1.0, 1.0), velocity_enu_m_s=sinking, gust_m_s2=1.1)
    assert predicates.is_steady(flight, view) is is_kept


@pytest.mark.parametrize(
    ("now_s", "above_m", "feels"),
    [(2.001, 0.29, True), (2.0, 0.29, False), (2.001, 0.31, False)],
)
def test_only_a_height_that_may_read_wrong_is_felt_for(
    now_s: float, above_m: float, feels: bool
) -> None:
    goal = Goal(Vec3(0.0, 0.0, 1.0), 2.0, 1)
    view = _view(now_s, position_enu_m=(0.0, 0.0, 1.0 + above_m))
    assert predicates.feels_for_ground(_flight(vehicle=_BY_SATELLITES, goal=goal), view) is feels
    assert not predicates.feels_for_ground(_flight(goal=goal), view)

    begun = goal._replace(is_on_path=True)
    assert predicates.feels_for_ground(_flight(vehicle=_BY_SATELLITES, goal=begun), _view())


@pytest.mark.parametrize(
    ("now_s", "height_m", "feels"),
    [(3.001, 1.979, True), (3.0, 1.979, False), (3.001, 1.981, False)],
)
def test_with_a_mocap_it_sinks_on_slowly_where_it_ends_below_the_ground(
    now_s: float, height_m: float, feels: bool
) -> None:
    goal = Goal(ZERO_3, 2.0, 1)
    view = _view(now_s, position_enu_m=(0.0, 0.0, height_m))
    assert predicates.feels_for_ground(_flight(goal=goal, expected_ground=_RAISED), view) is feels


@pytest.mark.parametrize(("height_m", "feels"), [(2.059, True), (2.061, False)])
def test_beside_a_roof_it_sinks_on_slowly_from_the_height_of_the_roof(
    height_m: float, feels: bool
) -> None:
    view = _view(3.001, position_enu_m=(0.0, 0.0, height_m))
    beside = _flight(
        goal=Goal(ZERO_3, 2.0, 1), expected_ground=ExpectedGround(z_m=2.0, landing_z_m=1.0)
    )
    assert predicates.feels_for_ground(beside, view) is feels


@pytest.mark.parametrize(
    ("now_s", "height_m", "is_lower"),
    [(5.001, 2.061, True), (5.0, 2.061, False), (5.001, 2.059, False)],
)
def test_the_ground_is_lower_where_a_descent_has_ended_in_the_air(
    now_s: float, height_m: float, is_lower: bool
) -> None:
    goal = Goal(ZERO_3, 2.0, 1)
    view = _view(now_s, position_enu_m=(0.0, 0.0, height_m))
    assert predicates.ground_is_lower(_flight(goal=goal, expected_ground=_RAISED), view) is is_lower
    by_satellites = _flight(vehicle=_BY_SATELLITES, goal=goal, expected_ground=_RAISED)
    assert not predicates.ground_is_lower(by_satellites, view)


@pytest.mark.parametrize(
    ("kind", "then_land", "is_done"),
    [
        ("land", False, True),
        ("hold", False, True),
        ("disarm", False, True),
        ("move", False, False),
        ("move", True, True),
        (None, False, False),
    ],
)
def test_a_landing_that_somebody_ordered_ends_its_order(
    kind: OrderKind | None, then_land: bool, is_done: bool
) -> None:
    order = None if kind is None else _order(kind, then_land=then_land)
    flight = _flight(order=order)
    down = _view(1.0, landed=Landed.ON_GROUND)
    assert predicates.landed_by_order(flight, down) is is_done
    assert not predicates.landed_by_order(flight, replace(down, snapshot=Snapshot(is_armed=True)))


@pytest.mark.parametrize(
    ("landed", "now_s", "should_have"),
    [
        (Landed.ON_GROUND, 0.501, True),
        (Landed.ON_GROUND, 0.5, False),
        (Landed.IN_AIR, 4.001, True),
        (Landed.IN_AIR, 4.0, False),
    ],
)
def test_px4_should_have_disarmed_half_a_second_after_it_sees_the_ground(
    landed: Landed, now_s: float, should_have: bool
) -> None:
    view = _view(now_s, landed=landed)
    assert predicates.px4_should_have_disarmed(_flight(), view) is should_have

    reported = replace(contact.ContactSigns(), reported_since_ns=_BEGIN_NS)
    flight = _flight(step_ns=0, contact=reported)
    is_down = landed is Landed.ON_GROUND
    assert predicates.px4_stays_armed_on_ground(flight, view) is (is_down and now_s > 4.0)


def test_px4_stays_armed_on_the_ground_that_it_has_reported_for_four_seconds() -> None:
    flight = _flight(contact=replace(ContactSigns(), reported_since_ns=_BEGIN_NS))
    on_ground = _view(4.001, landed=Landed.ON_GROUND)
    assert predicates.px4_stays_armed_on_ground(flight, on_ground)
    assert not predicates.px4_stays_armed_on_ground(flight, _view(4.0, landed=Landed.ON_GROUND))
    assert not predicates.px4_stays_armed_on_ground(flight, _view(4.001, landed=Landed.IN_AIR))


# -- a kill, and PX4's own landing -----------------------------------------------------------------


@pytest.mark.parametrize("was_killed", [True, False])
@pytest.mark.parametrize("is_armed", [True, False])
@pytest.mark.parametrize("heard_s", [0.0, 0.5, 0.501])
def test_a_kill_has_an_effect_or_none(was_killed: bool, is_armed: bool, heard_s: float) -> None:
    flight = _flight(step=FlightStep.KILLING, was_killed=was_killed)
    view = _view(1.0, is_armed=is_armed, heartbeat_ns=_ns(heard_s))
    has_fallen = was_killed and not is_armed and heard_s > 0.0
    has_no_effect = was_killed and is_armed and heard_s > 0.5
    assert predicates.falls_by_kill(flight, view) is has_fallen
    assert predicates.kill_had_no_effect(flight, view) is has_no_effect


@pytest.mark.parametrize(
    ("mode", "landed", "has_sticks", "heard_s", "now_s", "does_not_land"),
    [
        ("POSCTL", Landed.IN_AIR, False, 0.0, 0.1, True),
        ("LAND", Landed.IN_AIR, False, 0.0, 0.1, False),
        ("POSCTL", Landed.ON_GROUND, False, 0.0, 0.1, False),
        ("POSCTL", Landed.IN_AIR, True, 0.0, 1.199, False),  # a mode from before the step
        ("POSCTL", Landed.IN_AIR, True, 0.0, 1.201, True),
        ("POSCTL", Landed.IN_AIR, True, 0.05, 0.1, True),
    ],
)
def test_px4_does_not_land_in_another_mode_in_the_air(
    mode: str,
    landed: Landed,
    has_sticks: bool,
    heard_s: float,
    now_s: float,
    does_not_land: bool,
) -> None:
    now_ns = _ns(now_s)
    sticks_ns = now_ns if has_sticks else 0
    view = _view(
        now_s,
        mode=mode,
        landed=landed,
        heartbeat_ns=_ns(heard_s),
        sticks_ns=sticks_ns,
        sticks_before_ns=sticks_ns - 100_000_000 if has_sticks else 0,
    )
    assert predicates.px4_hears_sticks(_flight(), view) is has_sticks
    assert predicates.px4_does_not_land(_flight(), view) is does_not_land
    assert not predicates.px4_refuses_to_land(_flight(), view)


@pytest.mark.parametrize(
    ("packet_s", "now_s", "is_heard"),
    [
        (0.99, 0.99, True),
        (1.01, 1.01, False),  # PX4 is heard, and sends no sticks any more
        (0.99, 60.0, True),  # PX4 is silent: its last word counts
        (1.01, 60.0, False),
    ],
)
def test_sticks_are_as_old_as_what_px4_has_sent_since(
    packet_s: float, now_s: float, *, is_heard: bool
) -> None:
    view = _view(
        now_s, sticks_ns=_ns(0.0), sticks_before_ns=_ns(-0.2), last_packet_ns=_ns(packet_s)
    )
    assert predicates.px4_hears_sticks(_flight(), view) is is_heard


@pytest.mark.parametrize(
    ("mode", "now_s", "refuses"),
    [("HOLD", 5.001, True), ("HOLD", 5.0, False), ("LAND", 9.0, False)],
)
def test_px4_refuses_to_land_after_five_seconds(mode: str, now_s: float, refuses: bool) -> None:
    view = _view(now_s, mode=mode, landed=Landed.IN_AIR)
    assert predicates.px4_refuses_to_land(_flight(), view) is refuses


# -- what must last --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "beside_m", "speed_m_s", "turned_deg", "is_steady"),
    [
        (FlightStep.CLIMB, 0.1, 0.05, 90.0, True),
        (FlightStep.CLIMB, 0.13, 0.05, 0.0, False),
        (FlightStep.LEG, 0.1, 0.05, 5.0, True),
        (FlightStep.LEG, 0.1, 0.05, 15.0, False),
        (FlightStep.LEG, 0.13, 0.05, 5.0, False),
        (FlightStep.HOLDING, 5.0, 0.14, 0.0, True),
        (FlightStep.HOLDING, 0.0, 0.16, 0.0, False),
        (FlightStep.ARRIVED, 0.0, 0.0, 0.0, False),
    ],
)
def test_what_a_step_waits_for_holds_or_does_not(
    step: FlightStep, beside_m: float, speed_m_s: float, turned_deg: float, is_steady: bool
) -> None:
    flight = _flight(step=step, goal=Goal(Vec3(0.0, 0.0, 1.0), 0.0, 1, yaw_rad=0.0))
    view = _view(
        position_enu_m=(beside_m, 0.0, 1.0),
        velocity_enu_m_s=(0.0, speed_m_s, 0.0),
        yaw_rad=math.radians(turned_deg),
    )
    assert predicates.is_steady(flight, view) is is_steady
