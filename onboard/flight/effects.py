"""Effects of the flight table: functions that set the goal and the time limit of a step.

A row of the flight table names one of these functions. The state machine calls it right after the
step has begun. No other code writes a flight's goal.
"""

from __future__ import annotations

import math

from onboard.bus.schema import Order
from onboard.config.ground import ground_at_m, least_height_m
from onboard.control.climb_duration import climb_duration_s
from onboard.control.path import point_at
from onboard.flight.arrival import stop_point
from onboard.flight.context import FlightContext
from onboard.flight.expected_ground import ground_of_landing, ground_of_takeoff
from onboard.flight.types import FlightView
from onboard.tuples import Xyz
from onboard.types import Goal
from onboard.vectors import Vec3 as Point

DEFAULT_HEIGHT_M = 1.0

_MIN_CLIMB_S = 1.5
LIFT_M = 1.0  # height above the ground of the first leg of a climb
_MIN_DESCENT_S = 1.0
_UNDER_GROUND_M = 0.10  # a descent ends below the ground, so that it does not slow down above it
_LOWER_BY_M = 0.3  # step of a descent if the ground is lower than at the take-off

# PX4's own height may be wrong by three times the standard deviation that PX4 reports, within these
# bounds. With satellites the error has a standard deviation of 0.28 m (measured on SIH, where PX4
# reports 0.3 m). A landing becomes slow at this height above the take-off ground, and continues to
# sink until the vehicle stands.
_UNSURE_SIGMAS = 3.0
_MIN_UNSURE_M = 0.8
_MAX_UNSURE_M = 3.0
_FEEL_M_S = 0.4  # speed of the slow part
_FEEL_M_S2 = 0.5  # acceleration to that speed

_SLOW_SHARE = 0.25  # mean speed of a slowed move, as a share of the top speed
SLOW_CLIMB = 2.0  # a slowed climb takes this many times as long
_SLOW_PATH_S = 1.0  # one request slows a show for this time

# A move or a landing may take this time, plus TIME_LIMIT_FACTOR times its duration without other
# vehicles.
_LEG_LIMIT_S = 30.0
_LANDING_LIMIT_S = 20.0
TIME_LIMIT_FACTOR = 3.0

_PEAK_OF_MEAN = 1.9  # trajectory.PEAK_OF_MEAN_SPEED, rounded up


def takeoff_height_m(order: Order | None) -> float:
    """Return the height [m] above the fleet's origin that an order to take off leads to."""
    if order is None or order.height_m is None:
        return DEFAULT_HEIGHT_M
    return order.height_m


# -- take-off --------------------------------------------------------------------------------------


def stay_on_ground(flight: FlightContext, view: FlightView) -> None:
    """Take the present position as the ground and as the goal."""
    _set_ground(flight, view.position_enu_m)
    flight.has_fallen = False
    flight.was_killed = False
    flight.goal = flight.goal._replace(position_enu_m=Point(*view.position_enu_m))


def lift_off(flight: FlightContext, view: FlightView) -> None:
    """Go straight up by one metre at most.

    A longer climb would start more slowly. Near the ground, a vehicle cannot tilt much against the
    wind, so it must leave the ground soon.
    """
    _set_ground(flight, view.position_enu_m)
    top_m = min(takeoff_height_m(flight.order), flight.expected_ground.z_m + LIFT_M)
    _climb_above(flight, view, view.position_enu_m, top_m)


def climb_on(flight: FlightContext, view: FlightView) -> None:
    """Continue to the ordered height."""
    _climb_above(flight, view, flight.goal_position_enu_m, takeoff_height_m(flight.order))


def take_over(flight: FlightContext, view: FlightView) -> None:
    """Stop here, and take the height of the start as the ground.

    This agent was not in control at the take-off, so it does not know the height of the ground.
    """
    flight.was_killed = False
    _set_ground(flight, flight.fleet.vehicles[flight.slot_owner].start_enu_m)
    _set_goal(flight, stop_point(view, flight.vehicle, flight.fleet), 0.0)


def slow_climb(flight: FlightContext, view: FlightView) -> None:
    """Climb on at reduced speed."""
    flight.is_slow = True
    goal_enu_m = flight.goal_position_enu_m
    _, _, top_m = goal_enu_m
    _climb_above(flight, view, goal_enu_m, top_m)


# -- move and hold ---------------------------------------------------------------------------------


def fly_leg(flight: FlightContext, view: FlightView) -> None:
    """Go to the ordered position, within a time that grows with the length of the route."""
    order = flight.order
    assert order is not None
    assert order.position_enu_m is not None

    duration_s = max(0.0, order.duration_s)
    _set_goal(flight, order.position_enu_m, duration_s, _ordered_yaw_rad(order))
    flight.leg_count += 1

    distance_m = flight.route_length_m(view, order.position_enu_m)
    alone_s = _PEAK_OF_MEAN * distance_m / flight.vehicle.max_speed_m_s
    _limit(flight, view, _LEG_LIMIT_S + TIME_LIMIT_FACTOR * max(duration_s, alone_s))


def slow_down(flight: FlightContext, view: FlightView) -> None:
    """Fly the rest of the leg at reduced speed, with more time for it."""
    flight.is_slow = True
    left_m = flight.route_length_m(view, flight.goal_position_enu_m)
    duration_s = left_m / (_SLOW_SHARE * flight.vehicle.max_speed_m_s)
    _set_goal(flight, flight.goal_position_enu_m, duration_s, flight.goal.yaw_rad)
    flight.deadline_ns += round(TIME_LIMIT_FACTOR * duration_s * 1e9)


def stop_here(flight: FlightContext, view: FlightView) -> None:
    """Stop inside the fence, as soon as the acceleration allows.

    The height of the stop lies between the vehicle's height and the ordered one. A vehicle that has
    just lifted off climbs on to the least height of a goal, so that it does not touch the ground.
    """
    x, y, stop_z_m = stop_point(view, flight.vehicle, flight.fleet)
    _, _, own_z_m = view.position_enu_m
    _, _, goal_z_m = flight.goal_position_enu_m
    _, middle_z_m, _ = sorted((own_z_m, goal_z_m, stop_z_m))
    ground_z_m = flight.expected_ground.z_of(float(ground_at_m(flight.fleet, x, y)))
    least_z_m = min(goal_z_m, ground_z_m + least_height_m(flight.vehicle))
    _set_goal(flight, (x, y, max(middle_z_m, least_z_m)), 0.0)


# -- a path ----------------------------------------------------------------------------------------


def begin_path(flight: FlightContext, view: FlightView) -> None:
    """Begin the loaded path, whose clock starts at the ordered time."""
    order = flight.order
    assert order is not None
    assert order.path is not None

    flight.path.begin(order.path)
    flight.leg_count += 1
    flight.goal = flight.goal._replace(sequence=flight.goal.sequence + 1)
    follow_path(flight, view)


def follow_path(flight: FlightContext, view: FlightView) -> None:
    """Advance the path's clock. The goal is the path's motion one lag ahead of that clock."""
    flight.path.advance(view.now_ns, view.period_s, view.position_enu_m, view.other_clocks)
    flight.goal = flight.path.goal(flight.goal.sequence, flight.vehicle.lag_s)


def slow_path(flight: FlightContext, view: FlightView) -> None:
    """Request slow flight from all vehicles of the show, for the next second."""
    flight.path.slow_until_ns = view.now_ns + round(_SLOW_PATH_S * 1e9)


def stay_at_end(flight: FlightContext, view: FlightView) -> None:
    """Stay where the path ends."""
    end = flight.path.goal(0, 0.0)
    _set_goal(flight, end.position_enu_m, 0.0)


def skip_to_end(flight: FlightContext, view: FlightView) -> None:
    """Go to the end of the path, within a time that grows with the length of the route."""
    assert flight.path.path is not None
    end = point_at(flight.path.path, flight.path.path.duration_s)
    _set_goal(flight, end.position_enu_m, 0.0, end.yaw_rad)
    flight.leg_count += 1

    distance_m = flight.route_length_m(view, end.position_enu_m)
    alone_s = _PEAK_OF_MEAN * distance_m / flight.vehicle.max_speed_m_s
    _limit(flight, view, _LEG_LIMIT_S + TIME_LIMIT_FACTOR * alone_s)


# -- landing ---------------------------------------------------------------------------------------


def descend(flight: FlightContext, view: FlightView) -> None:
    """Brake, and go straight down to below the ground."""
    look_for_ground(flight, view)
    x, y, _ = stop_point(view, flight.vehicle, flight.fleet)
    _expect_ground(flight, x, y)

    goal_z_m = _end_of_descent_m(flight, view)
    _, _, own_z_m = view.position_enu_m
    height_m = own_z_m - max(flight.expected_ground.z_m, goal_z_m)
    down_s = climb_duration_s(height_m, flight.vehicle.max_speed_m_s)
    speed_m_s = math.hypot(*view.velocity_enu_m_s)
    braking_s = 2.0 * speed_m_s / flight.vehicle.max_acceleration_m_s2
    duration_s = max(_MIN_DESCENT_S, down_s) + braking_s

    _set_goal(flight, (x, y, goal_z_m), duration_s)
    lower_s = (flight.expected_ground.z_m - flight.lowest_ground_m) / _FEEL_M_S
    _limit(flight, view, _LANDING_LIMIT_S + TIME_LIMIT_FACTOR * duration_s + lower_s)


def _end_of_descent_m(flight: FlightContext, view: FlightView) -> float:
    """Return the height at which the planned part of a descent ends.

    With a mocap, it is below the ground. Without a mocap, it is the largest height at which the
    ground may be, and the vehicle sinks slowly from there (:func:`feel_for_ground`).
    """
    # the end is never above the vehicle, so that a height that reads too low does not make it climb
    _, _, own_m = view.position_enu_m
    if flight.vehicle.mocap_required:
        return min(flight.expected_ground.z_m, own_m) - _UNDER_GROUND_M

    reported_m = _UNSURE_SIGMAS * view.snapshot.height_accuracy_m
    unsure_m = min(max(reported_m, _MIN_UNSURE_M), _MAX_UNSURE_M)
    return min(flight.expected_ground.z_m + unsure_m, own_m)


def feel_for_ground(flight: FlightContext, view: FlightView) -> None:
    """Continue to sink at a low constant speed, even below the expected ground."""
    goal = flight.goal
    sequence = goal.sequence
    if not goal.is_on_path:  # this is the goal of the planned part, so the slow part starts now
        sequence += 1

    speed_m_s = min(_FEEL_M_S, -goal.velocity_enu_m_s.z + _FEEL_M_S2 * view.period_s)
    x, y, z = goal.position_enu_m
    flight.goal = Goal(
        position_enu_m=Point(x, y, z - speed_m_s * view.period_s),
        duration_s=0.0,
        sequence=sequence,
        is_on_path=True,
        velocity_enu_m_s=Point(0.0, 0.0, -speed_m_s),
    )


def descend_here(flight: FlightContext, view: FlightView) -> None:
    """Go straight down from here, with the deadline that the landing already had."""
    deadline_ns = flight.deadline_ns
    descend(flight, view)
    flight.deadline_ns = deadline_ns


def descend_further(flight: FlightContext, view: FlightView) -> None:
    """Descend slowly by another step, because the ground is lower than expected."""
    x, y, goal_z_m = flight.goal_position_enu_m
    _, _, own_z_m = view.position_enu_m
    lower_z_m = min(goal_z_m, own_z_m) - _LOWER_BY_M
    _set_goal(flight, (x, y, lower_z_m), 1.0)


def look_for_ground(flight: FlightContext, view: FlightView) -> None:
    """Begin to look for the ground: forget the lowest height, and keep the present one."""
    flight.lowest_z_m = math.inf
    _, _, flight.search_began_z_m = view.position_enu_m


def note_fall(flight: FlightContext, view: FlightView) -> None:
    """Remember whether the motors have stopped. Replies to later orders mention it."""
    flight.has_fallen = not view.snapshot.is_armed
    flight.was_killed = False


# -- a kill ----------------------------------------------------------------------------------------


def note_kill(flight: FlightContext, view: FlightView) -> None:
    """Remember the kill. Replies to later orders mention it."""
    flight.was_killed = True


def forget_kill(flight: FlightContext, view: FlightView) -> None:
    """Forget an earlier kill, because the new step has a different reason."""
    flight.was_killed = False


# -- without poses ---------------------------------------------------------------------------------


def sink(flight: FlightContext, view: FlightView) -> None:
    """Brake and descend by dead reckoning, which is accurate for a few seconds."""
    look_for_ground(flight, view)
    flight.seen_goal = flight.goal
    x, y, _ = stop_point(view, flight.vehicle, flight.fleet)
    _expect_ground(flight, x, y)
    _set_goal(flight, (x, y, flight.expected_ground.z_m), 0.0)


def hold_again(flight: FlightContext, view: FlightView) -> None:
    """Stop here, at the height of the goal before dead reckoning."""
    x, y, _ = stop_point(view, flight.vehicle, flight.fleet)
    _set_goal(flight, (x, y, flight.seen_goal.position_enu_m.z), 0.0)


def resume(flight: FlightContext, view: FlightView) -> None:
    """Continue the order that dead reckoning has interrupted, at the same speed."""
    order = flight.order
    if order is not None and order.kind == "follow_path":  # the vehicle skips the rest of the path
        seen = flight.seen_goal
        _set_goal(flight, seen.position_enu_m, 0.0, seen.yaw_rad)
    elif order is not None and order.position_enu_m is not None:
        duration_s = max(0.0, order.duration_s)
        _set_goal(flight, order.position_enu_m, duration_s, _ordered_yaw_rad(order))
    else:
        climb_on(flight, view)
        return

    if flight.is_slow:
        slow_down(flight, view)


# -- helpers ---------------------------------------------------------------------------------------


def _set_ground(flight: FlightContext, position_enu_m: Xyz) -> None:
    """Take a position as the ground."""
    x, y, z_m = position_enu_m
    flight.expected_ground = ground_of_takeoff(z_m, float(ground_at_m(flight.fleet, x, y)))


def _expect_ground(flight: FlightContext, x_m: float, y_m: float) -> None:
    """Take over what the fleet file says about the ground of a landing here."""
    by_file_m = float(ground_at_m(flight.fleet, x_m, y_m))
    flight.expected_ground = ground_of_landing(flight.expected_ground, by_file_m)


def _climb_above(
    flight: FlightContext, view: FlightView, position_enu_m: Xyz, top_m: float
) -> None:
    """Go to a height above a position."""
    x, y, _ = position_enu_m
    _, _, own_z_m = view.position_enu_m
    up_s = climb_duration_s(top_m - own_z_m, flight.vehicle.max_speed_m_s)
    if flight.is_slow:
        up_s = SLOW_CLIMB * up_s
    _set_goal(flight, (x, y, top_m), max(_MIN_CLIMB_S, up_s))


def _ordered_yaw_rad(order: Order) -> float:
    """Return the ordered heading; NaN: the vehicle keeps its heading."""
    return math.nan if order.yaw_deg is None else math.radians(order.yaw_deg)


def _set_goal(
    flight: FlightContext, position_enu_m: Xyz, duration_s: float, yaw_rad: float = math.nan
) -> None:
    sequence = flight.goal.sequence + 1
    flight.goal = Goal(Point(*position_enu_m), duration_s, sequence, yaw_rad=yaw_rad)


def _limit(flight: FlightContext, view: FlightView, limit_s: float) -> None:
    """Set the deadline of the step, as a time from now."""
    flight.deadline_ns = view.now_ns + round(limit_s * 1e9)
