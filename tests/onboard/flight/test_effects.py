"""The goal and the time limit that each begin gives a flight, as numbers; and what is overdue."""

from __future__ import annotations

import math
from typing import Any

import pytest
from msgspec.structs import replace

from onboard.autopilot import Snapshot
from onboard.avoidance.params import Capsule, params_of
from onboard.bus.schema import Order, OrderKind, PathOrder
from onboard.config.fleet import FleetConfig
from onboard.config.law import LawConfig
from onboard.control.climb_duration import climb_duration_s
from onboard.control.path import path_of
from onboard.control.router import surroundings
from onboard.flight import effects, state_machine
from onboard.flight.context import FlightContext, Overdue
from onboard.flight.expected_ground import ExpectedGround, ground_of_takeoff
from onboard.flight.path_flight import PathFlight
from onboard.flight.types import FlightStep, FlightView
from onboard.safety.failsafe_table import Situation
from onboard.types import Goal
from onboard.vectors import ZERO_3, Vec2, Vec3
from tests.onboard.agent.rig import fleet

_FLEET = fleet()
_VEHICLE = _FLEET.vehicles["mav0"]
_BY_SATELLITES = replace(_VEHICLE, mocap_required=False)
_NOW_NS = 50_000_000_000
_RAISED = ground_of_takeoff(2.0, 0.0)


def _flight(**changes: Any) -> FlightContext:
    goal = Goal(Vec3(0.0, 0.0, 1.0), 0.0, 1)
    return FlightContext(
        **{"fleet": _FLEET, "vehicle": _VEHICLE, "step_ns": _NOW_NS, "goal": goal, **changes}
    )


def _view(
    x: float = 0.0, y: float = 0.0, z: float = 1.0, *, after_s: float = 0.0, **changes: Any
) -> FlightView:
    view = FlightView(
        now_ns=_NOW_NS + round(after_s * 1e9),
        position_enu_m=(x, y, z),
        velocity_enu_m_s=(0.0, 0.0, 0.0),
        has_position=True,
        snapshot=Snapshot(),
    )
    return replace(view, **changes)


def _order(kind: OrderKind, **changes: Any) -> Order:
    return Order(order_id="o", author="x", kind=kind, stamp_ns=0, deadline_ns=0, **changes)


def _limit_s(flight: FlightContext) -> float:
    return (flight.deadline_ns - _NOW_NS) * 1e-9


# -- take-off --------------------------------------------------------------------------------------


def test_an_order_without_a_height_means_a_metre() -> None:
    assert effects.takeoff_height_m(None) == 1.0
    assert effects.takeoff_height_m(_order("takeoff")) == 1.0
    assert effects.takeoff_height_m(_order("takeoff", height_m=2.5)) == 2.5


def test_what_stands_takes_its_place_for_the_ground_and_has_not_fallen() -> None:
    flight = _flight(has_fallen=True)
    effects.stay_on_ground(flight, _view(0.5, -0.5, 0.2))
    assert flight.expected_ground.z_m == 0.2
    assert flight.goal.position_enu_m == (0.5, -0.5, 0.2)
    assert not flight.has_fallen


@pytest.mark.parametrize(("ordered_m", "top_m"), [(0.7, 0.7), (1.2, 1.2), (2.5, 1.2)])
def test_it_lifts_off_to_a_metre_above_the_ground_at_most(ordered_m: float, top_m: float) -> None:
    flight = _flight(order=_order("takeoff", height_m=ordered_m))
    effects.lift_off(flight, _view(0.5, -0.5, 0.2))
    assert flight.expected_ground.z_m == 0.2
    assert flight.goal.position_enu_m == pytest.approx((0.5, -0.5, top_m))
    assert flight.goal.sequence == 2
    up_s = climb_duration_s(top_m - 0.2, _VEHICLE.max_speed_m_s)
    assert flight.goal.duration_s == pytest.approx(max(1.5, up_s))


def test_the_shortest_climb_takes_one_and_a_half_seconds() -> None:
    flight = _flight(order=_order("takeoff", height_m=1.01))
    effects.climb_on(flight, _view())
    assert flight.goal.duration_s == 1.5


def test_who_is_taken_over_stops_above_the_ground_of_its_place() -> None:
    flight = _flight(stands_in_for="mav1", expected_ground=ground_of_takeoff(9.0, 0.0))
    effects.take_over(flight, _view(0.5, 0.5, 1.2))
    assert flight.expected_ground.z_m == _FLEET.vehicles["mav1"].start_enu_m[2]
    assert flight.goal.position_enu_m == pytest.approx((0.5, 0.5, 1.2))
    assert flight.goal.duration_s == 0.0


# -- move and hold ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("ordered_s", "planned_s"), [(20.0, 20.0), (-5.0, 0.0), (0.0, 0.0)])
def test_a_move_may_take_half_a_minute_and_three_times_what_its_way_takes(
    ordered_s: float, planned_s: float
) -> None:
    order = _order("move", position_enu_m=(3.0, 0.0, 1.0), duration_s=ordered_s, yaw_deg=90.0)
    flight = _flight(order=order)
    effects.fly_leg(flight, _view())
    assert flight.goal.position_enu_m == (3.0, 0.0, 1.0)
    assert flight.goal.duration_s == planned_s
    assert flight.goal.yaw_rad == pytest.approx(math.pi / 2)
    assert flight.leg_count == 1
    alone_s = 1.9 * 3.0 / _VEHICLE.max_speed_m_s
    assert _limit_s(flight) == pytest.approx(30.0 + 3.0 * max(planned_s, alone_s))


def test_a_move_without_a_heading_keeps_the_one_that_it_has() -> None:
    flight = _flight(order=_order("move", position_enu_m=(3.0, 0.0, 1.0)))
    effects.fly_leg(flight, _view())
    assert math.isnan(flight.goal.yaw_rad)


def test_slowed_down_it_flies_the_rest_at_a_quarter_of_its_speed_with_more_time() -> None:
    goal = Goal(Vec3(3.0, 0.0, 1.0), 0.0, 1, yaw_rad=0.5)
    flight = _flight(goal=goal, deadline_ns=_NOW_NS)
    effects.slow_down(flight, _view())
    slow_s = 3.0 / (0.25 * _VEHICLE.max_speed_m_s)
    assert flight.is_slow
    assert flight.goal.position_enu_m == (3.0, 0.0, 1.0)
    assert flight.goal.yaw_rad == 0.5
    assert flight.goal.duration_s == pytest.approx(slow_s)
    assert _limit_s(flight) == pytest.approx(3.0 * slow_s)


def test_a_move_around_a_wall_may_take_as_long_as_its_way() -> None:
    wall = Capsule(Vec2(1.0, -20.0), Vec2(1.0, 20.0), 0.1)
    flight = _flight(
        order=_order("move", position_enu_m=(2.0, 0.0, 1.0)),
        surroundings=surroundings([wall], params_of(LawConfig())),
    )
    effects.fly_leg(flight, _view())
    assert _limit_s(flight) > 30.0 + 3.0 * 1.9 * 40.0 / _VEHICLE.max_speed_m_s

    effects.slow_down(flight, _view())
    assert flight.goal.duration_s > 40.0 / _VEHICLE.max_speed_m_s


@pytest.mark.parametrize(
    ("own_m", "goal_m", "climbs_m_s", "stop_m"),
    [(1.0, 2.0, 1.0, 1.15), (1.0, 1.1, 1.0, 1.1), (1.0, 0.5, 1.0, 1.0), (1.0, 0.5, -1.0, 0.85)],
)
def test_it_stops_at_a_height_between_its_own_and_the_ordered_one(
    own_m: float, goal_m: float, climbs_m_s: float, stop_m: float
) -> None:
    flight = _flight(goal=Goal(Vec3(0.0, 0.0, goal_m), 9.0, 1))
    effects.stop_here(flight, _view(z=own_m, velocity_enu_m_s=(0.0, 0.0, climbs_m_s)))
    assert flight.goal.position_enu_m == pytest.approx((0.0, 0.0, stop_m))
    assert flight.goal.duration_s == 0.0


@pytest.mark.parametrize("has_mocap", [True, False])
@pytest.mark.parametrize(("own_m", "goal_m"), [(0.05, 1.5), (0.05, 0.1), (0.9, 1.5)])
def test_a_hold_just_after_the_lift_off_climbs_to_the_least_height_of_a_goal(
    has_mocap: bool, own_m: float, goal_m: float
) -> None:
    vehicle = _FLEET.vehicles["mav0"] if has_mocap else _BY_SATELLITES
    flight = _flight(vehicle=vehicle, goal=Goal(Vec3(0.0, 0.0, goal_m), 9.0, 1))
    effects.stop_here(flight, _view(z=own_m))
    least_m = min(goal_m, 0.2 if has_mocap else 0.5)
    assert flight.goal.position_enu_m[2] == pytest.approx(max(own_m, least_m))


# -- a path ----------------------------------------------------------------------------------------


def _straight() -> PathFlight:
    """A path of two seconds, two metres to the east at one height."""
    x = [0.0, 1.0, *[0.0] * 6]
    height = [1.0, *[0.0] * 7]
    return PathFlight(path=path_of([[2.0, *x, *[0.0] * 8, *height, *[0.0] * 8]]), time_s=1.0)


def test_the_goal_of_a_path_is_its_end_and_it_can_be_flown_to_straight() -> None:
    flight = _flight(step=FlightStep.PATH, path=_straight())
    assert flight.goal_position_enu_m == pytest.approx((2.0, 0.0, 1.0))
    assert _flight(step=FlightStep.LEG, path=_straight()).goal_position_enu_m == (0.0, 0.0, 1.0)
    assert _flight(step=FlightStep.PATH).goal_position_enu_m == (0.0, 0.0, 1.0)

    effects.skip_to_end(flight, _view(-1.0))
    assert flight.goal.position_enu_m == pytest.approx((2.0, 0.0, 1.0))
    assert flight.goal.duration_s == 0.0
    assert (flight.goal.sequence, flight.leg_count) == (2, 1)
    alone_s = 1.9 * 3.0 / _VEHICLE.max_speed_m_s
    assert _limit_s(flight) == pytest.approx(30.0 + 3.0 * alone_s)


def test_it_stays_where_its_path_has_come_to() -> None:
    flight = _flight(step=FlightStep.PATH, path=_straight())
    effects.stay_at_end(flight, _view())
    assert flight.goal.position_enu_m == pytest.approx((1.0, 0.0, 1.0))
    assert flight.goal.duration_s == 0.0


def test_a_path_begins_at_its_begin_and_its_goal_goes_on_with_its_clock() -> None:
    begins = PathOrder(path_id="p", show_id="s", start_ns=_NOW_NS, on_lag="hold")
    flight = _flight(order=_order("follow_path", path=begins), path=_straight())
    effects.begin_path(flight, _view(after_s=0.0))
    assert (flight.path.show_id, flight.leg_count) == ("s", 1)
    assert (flight.goal.sequence, flight.goal.is_on_path) == (2, True)
    assert flight.goal.position_enu_m == pytest.approx((_VEHICLE.lag_s, 0.0, 1.0))

    effects.follow_path(flight, _view(after_s=0.5, period_s=0.5))
    assert flight.goal.sequence == 2
    assert flight.goal.position_enu_m == pytest.approx((0.5 + _VEHICLE.lag_s, 0.0, 1.0))


def test_a_failsafe_asks_for_a_slow_second() -> None:
    flight = _flight()
    effects.slow_path(flight, _view())
    assert flight.path.slow_until_ns == _NOW_NS + 1_000_000_000


# -- landing ---------------------------------------------------------------------------------------


def test_a_landing_ends_a_decimetre_below_the_ground_within_three_times_its_plan() -> None:
    flight = _flight(expected_ground=ground_of_takeoff(0.5, 0.0))
    effects.descend(flight, _view(z=2.5, velocity_enu_m_s=(0.6, 0.8, 0.0)))
    down_s = climb_duration_s(2.0, _VEHICLE.max_speed_m_s)
    brakes_s = 2.0 / _VEHICLE.max_acceleration_m_s2
    assert flight.goal.position_enu_m[2] == pytest.approx(0.4)
    assert flight.goal.duration_s == pytest.approx(down_s + brakes_s)
    assert _limit_s(flight) == pytest.approx(20.0 + 3.0 * flight.goal.duration_s)
    assert (flight.search_began_z_m, flight.lowest_z_m) == (2.5, math.inf)


def _with_roof(height_m: float) -> FleetConfig:
    """The fleet, with the spot of mav1 on a roof."""
    x, y, _ = _FLEET.vehicles["mav1"].start_enu_m
    on_roof = replace(_FLEET.vehicles["mav1"], start_enu_m=(x, y, height_m))
    return replace(_FLEET, vehicles={**_FLEET.vehicles, "mav1": on_roof})


def test_a_landing_on_a_higher_spot_and_a_descent_without_poses_expect_its_height() -> None:
    fleet = _with_roof(2.0)
    x, y, _ = fleet.vehicles["mav1"].start_enu_m
    for effect, below_m in ((effects.descend, 0.1), (effects.sink, 0.0)):
        flight = _flight(fleet=fleet)
        effects.lift_off(flight, _view(*fleet.vehicles["mav0"].start_enu_m[:2], 0.02))
        effect(flight, _view(x, y, 4.0))
        assert flight.goal.position_enu_m[2] == pytest.approx(2.02 - below_m)


def test_a_landing_beside_a_roof_expects_the_height_of_the_roof_and_has_time_to_sink_on() -> None:
    fleet = _with_roof(2.0)
    flight = _flight(fleet=fleet)
    effects.lift_off(flight, _view(*fleet.vehicles["mav1"].start_enu_m))
    effects.descend(flight, _view(9.0, 9.0, 4.0))
    assert flight.goal.position_enu_m[2] == pytest.approx(1.9)
    assert flight.lowest_ground_m == pytest.approx(0.0)
    assert _limit_s(flight) == pytest.approx(20.0 + 3.0 * flight.goal.duration_s + 2.0 / 0.4)


@pytest.mark.parametrize(("spot_m", "may_be_lower"), [(0.061, True), (0.059, False), (0.0, False)])
def test_ground_a_few_centimetres_lower_is_the_same_ground(
    spot_m: float, may_be_lower: bool
) -> None:
    fleet = _with_roof(spot_m)
    spot = fleet.vehicles["mav1"].start_enu_m
    flight = _flight(fleet=fleet)
    effects.lift_off(flight, _view(*spot))
    effects.descend(flight, _view(9.0, 9.0, 4.0))
    assert flight.expected_ground.may_be_lower is may_be_lower
    effects.descend(flight, _view(*spot))
    assert not flight.expected_ground.may_be_lower


def test_a_landing_from_below_the_ground_does_not_climb_and_takes_a_second() -> None:
    flight = _flight(expected_ground=ground_of_takeoff(0.5, 0.0))
    effects.descend(flight, _view(z=0.2))
    assert flight.goal.position_enu_m[2] == pytest.approx(0.1)
    assert flight.goal.duration_s == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("told_m", "own_m", "end_m"),
    [(0.1, 9.0, 0.8), (0.5, 9.0, 1.5), (4.0, 9.0, 3.0), (0.5, 0.3, 0.3)],
)
def test_where_the_height_may_read_wrong_a_descent_ends_above_the_ground(
    told_m: float, own_m: float, end_m: float
) -> None:
    flight = _flight(vehicle=_BY_SATELLITES)
    effects.descend(flight, _view(z=own_m, snapshot=Snapshot(height_accuracy_m=told_m)))
    assert flight.goal.position_enu_m[2] == pytest.approx(end_m)


def test_it_feels_for_the_ground_faster_and_faster_up_to_a_low_speed() -> None:
    flight = _flight(goal=Goal(Vec3(1.0, 2.0, 0.8), 4.0, 7))
    effects.feel_for_ground(flight, _view(period_s=0.1))
    assert flight.goal.velocity_enu_m_s == pytest.approx((0.0, 0.0, -0.05))
    assert flight.goal.position_enu_m == pytest.approx((1.0, 2.0, 0.795))
    assert (flight.goal.is_on_path, flight.goal.sequence, flight.goal.duration_s) == (True, 8, 0.0)
    for _ in range(20):
        effects.feel_for_ground(flight, _view(period_s=0.1))
    assert flight.goal.velocity_enu_m_s == pytest.approx((0.0, 0.0, -0.4))
    assert flight.goal.sequence == 8


def test_where_the_ground_is_lower_it_goes_on_down_slowly() -> None:
    flight = _flight(goal=Goal(Vec3(0.0, 0.0, -0.1), 4.0, 1))
    effects.descend_further(flight, _view(z=0.2))
    assert flight.goal.position_enu_m == pytest.approx((0.0, 0.0, -0.4))
    assert flight.goal.duration_s == 1.0
    effects.descend_further(flight, _view(z=-0.6))
    assert flight.goal.position_enu_m[2] == pytest.approx(-0.9)


@pytest.mark.parametrize("is_armed", [True, False])
def test_it_remembers_motors_that_have_stopped(is_armed: bool) -> None:
    flight = _flight()
    effects.note_fall(flight, _view(snapshot=Snapshot(is_armed=is_armed)))
    assert flight.has_fallen is not is_armed


# -- without poses ---------------------------------------------------------------------------------


def test_without_poses_it_sinks_to_the_ground_and_holds_later_where_it_was() -> None:
    flight = _flight(expected_ground=ground_of_takeoff(0.2, 0.0), lowest_z_m=0.0)
    effects.sink(flight, _view(0.5, 0.5, 1.4))
    assert flight.goal.position_enu_m == pytest.approx((0.5, 0.5, 0.2))
    assert flight.goal.duration_s == 0.0
    assert flight.seen_goal.position_enu_m[2] == 1.0
    assert (flight.search_began_z_m, flight.lowest_z_m) == (1.4, math.inf)

    effects.hold_again(flight, _view(0.6, 0.5, 0.8))
    assert flight.goal.position_enu_m == pytest.approx((0.6, 0.5, 1.0))
    assert flight.goal.duration_s == 0.0


@pytest.mark.parametrize(("is_slow", "ordered_s"), [(False, 7.0), (False, -1.0), (True, 7.0)])
def test_seeing_again_it_goes_on_with_its_move_at_its_pace(is_slow: bool, ordered_s: float) -> None:
    order = _order("move", position_enu_m=(3.0, 0.0, 1.0), duration_s=ordered_s, yaw_deg=90.0)
    flight = _flight(order=order, is_slow=is_slow)
    effects.resume(flight, _view())
    assert flight.goal.position_enu_m == (3.0, 0.0, 1.0)
    assert flight.goal.yaw_rad == pytest.approx(math.pi / 2)
    slow_s = 3.0 / (0.25 * _VEHICLE.max_speed_m_s)
    assert flight.goal.duration_s == pytest.approx(slow_s if is_slow else max(0.0, ordered_s))


def test_seeing_again_after_a_skip_it_goes_on_to_the_end_of_its_path() -> None:
    end = Goal(Vec3(3.0, 0.0, 1.0), 0.0, 4, yaw_rad=1.5)
    flight = _flight(order=_order("follow_path"), goal=end)
    effects.sink(flight, _view(z=0.9))
    flight.path.path = None  # another path is loaded already
    effects.resume(flight, _view(z=0.8))
    assert flight.goal._replace(sequence=0) == end._replace(sequence=0)


@pytest.mark.parametrize("order", [None, _order("takeoff", height_m=2.0)])
def test_seeing_again_without_a_goal_it_climbs_on(order: Order | None) -> None:
    flight = _flight(order=order)
    effects.resume(flight, _view())
    assert flight.goal.position_enu_m[2] == effects.takeoff_height_m(order)


# -- what a flight says of itself ------------------------------------------------------------------


def test_what_is_overdue() -> None:
    descent = _flight(step=FlightStep.DESCENT, lowest_z_m=1.0, deadline_ns=_NOW_NS)
    assert descent.overdue(_view(z=1.5)) is None
    assert descent.overdue(_view(z=1.51)) == Overdue("it has risen by 0.51 m")
    assert descent.overdue(_view(z=1.51, is_dead_reckoned=True)) is None
    assert descent.overdue(_view(z=1.51, has_position=False)) is None
    assert descent.overdue(_view(after_s=0.001)) == Overdue("")

    wandering = _flight(step=FlightStep.CONTACT, lowest_z_m=1.0, vehicle=_BY_SATELLITES)
    assert wandering.overdue(_view(z=2.5)) is None
    assert wandering.overdue(_view(z=2.51)) == Overdue("it has risen by 1.51 m")
    assert wandering.overdue(_view(after_s=8.0)) is None
    assert wandering.overdue(_view(after_s=8.001)) == Overdue("PX4 does not see that it is down")

    leg = _flight(step=FlightStep.LEG, lowest_z_m=0.0, deadline_ns=_NOW_NS)
    assert leg.overdue(_view(z=3.0)) is None
    assert leg.overdue(_view(after_s=0.001)) == Overdue("")
    assert _flight(step=FlightStep.PATH).overdue(_view(z=3.0, after_s=99.0)) is None


@pytest.mark.parametrize(
    ("step", "height_m", "is_avoiding"),
    [
        (FlightStep.LIFTOFF, 2.49, False),
        (FlightStep.LIFTOFF, 2.5, True),
        (FlightStep.DESCENT, 2.49, False),
        (FlightStep.SINKING, 2.49, False),
        (FlightStep.LEG, 2.49, True),
        (FlightStep.CONTACT, 2.51, False),
        (FlightStep.PX4_LANDING, 3.5, False),
    ],
)
def test_others_count_on_it_while_it_can_go_aside(
    step: FlightStep, height_m: float, is_avoiding: bool
) -> None:
    assert _flight(step=step, expected_ground=_RAISED).is_avoiding(_view(z=height_m)) is is_avoiding


def test_what_it_says_of_its_step_its_order_and_its_place() -> None:
    assert _flight(step=FlightStep.COASTING).state == "holding"
    assert _flight(step=FlightStep.COASTING, order=_order("move")).state == "flying"
    assert _flight(step=FlightStep.LEG).state == "flying"
    assert _flight(step=FlightStep.LEG).situation is Situation.FLYING

    assert _flight(step=FlightStep.LEG).expected == (True, "OFFBOARD")
    assert _flight(step=FlightStep.DESCENT).expected == (False, "OFFBOARD")
    assert _flight(step=FlightStep.PX4_LANDING).expected == (False, "LAND")
    assert _flight(step=FlightStep.TAKEOVER).expected == (False, "")

    assert _flight(order=_order("land")).lands_for_a_person
    assert not _flight(order=_order("land", reason="a mission")).lands_for_a_person
    assert not _flight(order=_order("hold")).lands_for_a_person
    assert not _flight().lands_for_a_person

    assert _flight().slot_owner == "mav0"
    assert _flight(stands_in_for="mav1").slot_owner == "mav1"


def test_how_long_a_step_has_lasted_and_been_steady() -> None:
    flight = _flight(steady_since_ns=_NOW_NS + 500_000_000)
    assert flight.seconds(_view(after_s=2.0)) == pytest.approx(2.0)
    assert flight.steady_s(_view(after_s=2.0)) == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("z_m", "has_mocap", "may_touch"),
    [
        (2.05, True, True),
        (2.07, True, False),
        (1.5, True, False),  # between the take-off spot and lower ground it flies
        (0.95, True, True),
        (0.75, True, False),
        (1.5, False, True),  # PX4's height is no sign
        (2.07, False, False),
    ],
)
def test_a_landing_vehicle_may_touch_the_ground_only_near_a_height_of_the_ground(
    z_m: float, has_mocap: bool, may_touch: bool
) -> None:
    vehicle = _FLEET.vehicles["mav0"] if has_mocap else _BY_SATELLITES
    lower = ExpectedGround(z_m=2.0, landing_z_m=0.9)
    flight = _flight(step=FlightStep.DESCENT, vehicle=vehicle, expected_ground=lower)
    assert flight.may_touch_the_ground(_view(z=z_m)) is may_touch


# -- the lowest height, and steadiness, at each tick -----------------------------------------------


@pytest.mark.parametrize(
    ("climbs_m_s", "after_s", "counts"),
    [(0.0, 0.1, True), (-0.1, 0.1, True), (0.1, 1.0, False), (0.1, 1.001, True)],
)
def test_a_vehicle_that_still_rises_when_its_landing_begins_has_no_lowest_height_yet(
    climbs_m_s: float, after_s: float, counts: bool
) -> None:
    flight = _flight(step=FlightStep.DESCENT, goal=Goal(ZERO_3, 9.0, 1))
    view = _view(z=1.3, after_s=after_s, velocity_enu_m_s=(0.0, 0.0, climbs_m_s))
    state_machine.advance(flight, view)
    assert flight.lowest_z_m == (1.3 if counts else math.inf)


def test_steadiness_counts_from_the_last_tick_without_it() -> None:
    flight = _flight(step=FlightStep.LEG, deadline_ns=2 * _NOW_NS)
    for after_s, x in ((0.1, 1.0), (0.2, 0.0), (0.3, 0.0)):
        state_machine.advance(flight, _view(x, after_s=after_s))
    assert flight.steady_s(_view(after_s=0.3)) == pytest.approx(0.2)
