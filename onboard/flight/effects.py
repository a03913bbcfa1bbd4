"""Goals and limits of what begins: the only writers of a flight's goal besides the state machine
that calls them.
"""

from __future__ import annotations

import math

from onboard.autopilot import Vec3
from onboard.bus.schema import Order
from onboard.control.vertical import vertical_s
from onboard.flight.arrival import stop_point
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightView
from onboard.types import Goal
from onboard.vectors import Vec3 as Point

DEFAULT_HEIGHT_M = 1.0
_LEAST_CLIMB_S, _LEAST_DESCENT_S = 1.5, 1.0
_SLOW_SHARE = 0.25  # of the top speed on average
_PEAK_OF_MEAN = 1.9  # speed of a quintic: its peak over its mean
_UNDER_GROUND_M, _LOWER_BY_M = 0.10, 0.3
# without a position each second costs accuracy; and the ground may lie lower than PX4's height says
_BLIND_SINK_M_S, _BLIND_UNDER_GROUND_M = 0.9, 0.3
_BLIND_STOP_SHARE = 0.6  # of the way in which it stops comfortably
_LEG_LIMIT_S, _LANDING_LIMIT_S = 30.0, 20.0
_SLOW_PATH_S = 1.0
_PATIENCE = 3.0  # times the duration that the way would take alone


def takeoff_height_m(order: Order | None) -> float:
    """Return the height that an order to take off means, above the fleet's origin."""
    return DEFAULT_HEIGHT_M if order is None or order.height_m is None else order.height_m


def stay_on_ground(flight: FlightContext, view: FlightView) -> None:
    """Take this position for the ground and the goal."""
    flight.ground_z_m = view.position_enu_m[2]
    flight.goal = flight.goal._replace(position_enu_m=Point(*view.position_enu_m))


def climb(flight: FlightContext, view: FlightView) -> None:
    """Go straight up to the ordered height."""
    flight.ground_z_m = view.position_enu_m[2]
    _climb_above(flight, view, view.position_enu_m)


def fly_leg(flight: FlightContext, view: FlightView) -> None:
    """Go to the ordered position, within a time that grows with the way."""
    order = flight.order
    assert order is not None
    assert order.position_enu_m is not None
    duration_s = max(0.0, order.duration_s)
    _set_goal(flight, order.position_enu_m, duration_s, _ordered_yaw_rad(order))
    flight.leg_count += 1
    alone_s = (
        _PEAK_OF_MEAN
        * math.dist(order.position_enu_m, view.position_enu_m)
        / flight.vehicle.max_speed_m_s
    )
    _limit(flight, view, _LEG_LIMIT_S + _PATIENCE * max(duration_s, alone_s))


def begin_path(flight: FlightContext, view: FlightView) -> None:
    """Wait at the begin of the loaded path for the ordered instant."""
    order = flight.order
    assert order is not None
    assert order.path is not None
    flight.path.begin(order.path)
    flight.leg_count += 1
    flight.goal = flight.goal._replace(sequence=flight.goal.sequence + 1)
    follow_path(flight, view)


def follow_path(flight: FlightContext, view: FlightView) -> None:
    """Move the path's clock on; the goal is the path's motion when a command given now acts."""
    flight.path.advance(view.now_ns, view.period_s, view.position_enu_m, view.other_clocks)
    flight.goal = flight.path.goal(flight.goal.sequence, flight.vehicle.lag_s)


def slow_path(flight: FlightContext, view: FlightView) -> None:
    """Ask all for slow flight for the next second."""
    flight.path.slow_until_ns = view.now_ns + round(_SLOW_PATH_S * 1e9)


def stay_at_end(flight: FlightContext, view: FlightView) -> None:
    """Stay where the path ends."""
    _set_goal(flight, flight.path.goal(0, 0.0).position_enu_m, 0.0)


def slow_down(flight: FlightContext, view: FlightView) -> None:
    """Fly the rest of the leg at reduced speed, with more time for it."""
    flight.is_slow = True
    left_m = math.dist(flight.goal_position_enu_m, view.position_enu_m)
    duration_s = left_m / (_SLOW_SHARE * flight.vehicle.max_speed_m_s)
    _set_goal(flight, flight.goal_position_enu_m, duration_s, flight.goal.yaw_rad)
    flight.deadline_ns += round(_PATIENCE * duration_s * 1e9)


def stop_here(flight: FlightContext, view: FlightView) -> None:
    """Stop as soon as the acceleration allows, inside the fence, and no higher or lower than was
    ordered.
    """
    x, y, z = stop_point(view, flight.vehicle, flight.fleet)
    height_m = sorted((view.position_enu_m[2], flight.goal_position_enu_m[2], z))[1]
    _set_goal(flight, (x, y, height_m), 0.0)


def take_over(flight: FlightContext, view: FlightView) -> None:
    """Stop here; the ground is at the height of the start, since the take-off was not seen."""
    flight.ground_z_m = flight.vehicle.start_enu_m[2]
    _set_goal(flight, stop_point(view, flight.vehicle, flight.fleet), 0.0)


def descend(flight: FlightContext, view: FlightView) -> None:
    """Brake, and go straight down to below the ground."""
    expect_contact(flight, view)
    x, y, _ = stop_point(view, flight.vehicle, flight.fleet)
    down_s = vertical_s(view.position_enu_m[2] - flight.ground_z_m, flight.vehicle.max_speed_m_s)
    braking_s = 2.0 * math.hypot(*view.velocity_enu_m_s) / flight.vehicle.max_acceleration_m_s2
    duration_s = max(_LEAST_DESCENT_S, down_s) + braking_s
    # a height that reads too low must not make it climb
    ground_m = min(flight.ground_z_m, view.position_enu_m[2])
    _set_goal(flight, (x, y, ground_m - _UNDER_GROUND_M), duration_s)
    _limit(flight, view, _LANDING_LIMIT_S + _PATIENCE * duration_s)


def descend_here(flight: FlightContext, view: FlightView) -> None:
    """Go straight down from here instead, within the time that the landing had."""
    deadline_ns = flight.deadline_ns
    descend(flight, view)
    flight.deadline_ns = deadline_ns


def sink(flight: FlightContext, view: FlightView) -> None:
    """Brake and go down quickly, by dead reckoning: it is good for a few seconds."""
    expect_contact(flight, view)
    (x, y, _), (at_x, at_y, _) = stop_point(view, flight.vehicle, flight.fleet), view.position_enu_m
    x, y = at_x + _BLIND_STOP_SHARE * (x - at_x), at_y + _BLIND_STOP_SHARE * (y - at_y)
    bottom_m = flight.ground_z_m - _BLIND_UNDER_GROUND_M
    duration_s = _PEAK_OF_MEAN * max(0.0, view.position_enu_m[2] - bottom_m) / _BLIND_SINK_M_S
    _set_goal(flight, (x, y, bottom_m), duration_s)


def resume(flight: FlightContext, view: FlightView) -> None:
    """Go on with the order that dead reckoning has interrupted, at its pace."""
    order = flight.order
    if order is not None and order.position_enu_m is not None:
        _set_goal(flight, order.position_enu_m, max(0.0, order.duration_s), _ordered_yaw_rad(order))
        if flight.is_slow:
            slow_down(flight, view)
    else:
        _climb_above(flight, view, flight.goal_position_enu_m)


def descend_further(flight: FlightContext, view: FlightView) -> None:
    """Go on down slowly."""
    x, y, z = flight.goal_position_enu_m
    _set_goal(flight, (x, y, min(z, view.position_enu_m[2]) - _LOWER_BY_M), 1.0)


def expect_contact(flight: FlightContext, view: FlightView) -> None:
    """Forget how low it was before, and remember where it stands."""
    flight.lowest_m, flight.contact_z_m = math.inf, view.position_enu_m[2]


def _climb_above(flight: FlightContext, view: FlightView, place_enu_m: Vec3) -> None:
    """Go to the ordered height above a place."""
    x, y, _ = place_enu_m
    top_m = takeoff_height_m(flight.order)
    up_s = vertical_s(top_m - view.position_enu_m[2], flight.vehicle.max_speed_m_s)
    _set_goal(flight, (x, y, top_m), max(_LEAST_CLIMB_S, up_s))


def _ordered_yaw_rad(order: Order) -> float:
    return math.nan if order.yaw_deg is None else math.radians(order.yaw_deg)


def _set_goal(
    flight: FlightContext, position_enu_m: Vec3, duration_s: float, yaw_rad: float = math.nan
) -> None:
    flight.goal = Goal(
        Point(*position_enu_m), duration_s, flight.goal.sequence + 1, yaw_rad=yaw_rad
    )


def _limit(flight: FlightContext, view: FlightView, limit_s: float) -> None:
    flight.deadline_ns = view.now_ns + round(limit_s * 1e9)
