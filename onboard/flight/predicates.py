"""Facts that the table of the flight decides on; the names are printed in docs/flight.md. Pure."""

from __future__ import annotations

import math

from onboard.flight import contact
from onboard.flight.arrival import has_turned, is_at, is_at_rest
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightStep, FlightView

CONFIRM_TIMEOUT_S = 5.0
PATH_END_TIMEOUT_S = 15.0
LIFTOFF_TIMEOUT_S, HOLD_TIMEOUT_S = 6.0, 15.0
_CLIMB_TIMEOUT_S, _PATIENCE = 40.0, 3.0  # or so many times the duration that was planned
_PX4_LANDING_TIMEOUT_S, _PX4_SINKS_M_S = 60.0, 0.5  # at least: MPC_LAND_SPEED is 0.7 m/s
_STREAM_BEFORE_OFFBOARD_S = 0.3
_LEAST_OFFBOARD_S = 0.1
_ARM_ON_ITS_WAY_S = 0.5  # an older request to arm has had its effect
_LIFTED_M = 0.12
_ARRIVED_S, _REST_S = 0.5, 0.3
_CONTACT_HEIGHT_M = 0.06
_BLIND_CONTACT_M, _BLIND_CONTACT_S, _BLIND_BEGUN_S = 0.12, 0.1, 0.6
_BEGUN_S = 0.3  # of a descent, before which nothing counts as its end
_FALLEN_M, _FALLING_M_S = 0.10, -0.3
_LATE_DESCENT_S, _LOWER_FLOOR_S = 1.0, 3.0  # after the time that was planned for it
_KEPT_OFF_M, _KEPT_OFF_S, _SINKS_M_S = 0.5, 2.0, -0.5
_DISARM_AFTER_S, _DISARM_AFTER_SEEN_S = 4.0, 0.5


def _is_confirmed(flight: FlightContext, view: FlightView) -> bool:
    """Whether a heartbeat has come since this step began; the one before it may be a second old."""
    return view.snapshot.heartbeat_ns > flight.step_ns


# -- what PX4 confirms -----------------------------------------------------------------------------


def px4_confirms_offboard(flight: FlightContext, view: FlightView) -> bool:
    """Whether a heartbeat since the step began says OFFBOARD."""
    return (
        view.snapshot.is_offboard
        and _is_confirmed(flight, view)
        and flight.seconds(view) > _LEAST_OFFBOARD_S
    )


def px4_confirms_armed(flight: FlightContext, view: FlightView) -> bool:
    """Whether a heartbeat since the step began says armed."""
    return view.snapshot.is_armed and _is_confirmed(flight, view)


def px4_confirms_disarmed(flight: FlightContext, view: FlightView) -> bool:
    """Whether a heartbeat since the step began says disarmed."""
    return not view.snapshot.is_armed and _is_confirmed(flight, view)


def px4_stays_disarmed(flight: FlightContext, view: FlightView) -> bool:
    """Whether a heartbeat says disarmed that is later than any effect of an older request to arm."""
    later_ns = view.snapshot.heartbeat_ns - flight.step_ns
    return not view.snapshot.is_armed and later_ns > 1e9 * _ARM_ON_ITS_WAY_S


def px4_has_not_confirmed_in_time(flight: FlightContext, view: FlightView) -> bool:
    """Whether PX4 has had five seconds to confirm what was requested."""
    return flight.seconds(view) > CONFIRM_TIMEOUT_S


def setpoints_have_streamed(flight: FlightContext, view: FlightView) -> bool:
    """Whether PX4 has had setpoints for long enough to accept OFFBOARD."""
    return flight.seconds(view) > _STREAM_BEFORE_OFFBOARD_S


def px4_is_armed(flight: FlightContext, view: FlightView) -> bool:
    """Whether the last heartbeat says armed."""
    return view.snapshot.is_armed


def px4_is_armed_in_the_air(flight: FlightContext, view: FlightView) -> bool:
    """Whether the last heartbeat says armed, and PX4 does not say that it is on the ground."""
    return view.snapshot.is_armed and not view.is_on_ground


def px4_is_disarmed_on_ground(flight: FlightContext, view: FlightView) -> bool:
    """Whether PX4 says disarmed, and its last report on the ground."""
    return not view.snapshot.is_armed and view.was_on_ground


def px4_is_on_ground(flight: FlightContext, view: FlightView) -> bool:
    """Whether PX4's last report says that it is on the ground."""
    return view.was_on_ground


def px4_flies_without_agent(flight: FlightContext, view: FlightView) -> bool:
    """Whether the vehicle is in the air although this agent has not begun a flight."""
    return view.snapshot.is_armed and not view.was_on_ground and flight.order is None


# -- take-off, move, hold --------------------------------------------------------------------------


def lifted_off(flight: FlightContext, view: FlightView) -> bool:
    """Whether it has clearly left the ground."""
    return view.position_enu_m[2] > flight.ground_z_m + _LIFTED_M


def lift_off_late(flight: FlightContext, view: FlightView) -> bool:
    """Whether it should have lifted off long since."""
    return flight.seconds(view) > LIFTOFF_TIMEOUT_S


def arrived(flight: FlightContext, view: FlightView) -> bool:
    """Whether it has been at its goal for half a second."""
    return flight.steady_s(view) > _ARRIVED_S


def arrived_to_land(flight: FlightContext, view: FlightView) -> bool:
    """Whether it has arrived where its order has it land."""
    return arrived(flight, view) and flight.order is not None and flight.order.then_land


def path_ended(flight: FlightContext, view: FlightView) -> bool:
    """Whether the path is over and the vehicle has been at its end for half a second."""
    return flight.path.left_s <= 0.0 and arrived(flight, view)


def path_late(flight: FlightContext, view: FlightView) -> bool:
    """Whether the vehicle should have been at the end of its path long since."""
    return flight.path.left_s < -PATH_END_TIMEOUT_S


def left_behind_to_land(flight: FlightContext, view: FlightView) -> bool:
    """Whether it is behind its path for so long that it leaves the others, by landing."""
    return flight.path.is_lost and flight.path.on_lag == "land"


def left_behind(flight: FlightContext, view: FlightView) -> bool:
    """Whether it is behind its path for so long that it leaves the others."""
    return flight.path.is_lost


def at_goal(flight: FlightContext, view: FlightView) -> bool:
    """Whether it is at its goal and slow."""
    return is_at(view, flight.goal_position_enu_m, flight.vehicle)


def climb_late(flight: FlightContext, view: FlightView) -> bool:
    """Whether it should have been at its height long since."""
    return flight.seconds(view) > max(_CLIMB_TIMEOUT_S, _PATIENCE * flight.goal.duration_s)


def at_rest(flight: FlightContext, view: FlightView) -> bool:
    """Whether it has been at rest for a moment."""
    return flight.steady_s(view) > _REST_S


def rest_late(flight: FlightContext, view: FlightView) -> bool:
    """Whether it should have come to rest long since."""
    return flight.seconds(view) > HOLD_TIMEOUT_S


def not_slowed_yet(flight: FlightContext, view: FlightView) -> bool:
    """Whether the order still goes on at full speed."""
    return not flight.is_slow


# -- landing ---------------------------------------------------------------------------------------


def touched_down(flight: FlightContext, view: FlightView) -> bool:
    """Whether several signs have agreed for a moment that it stands on the ground."""
    is_late = flight.seconds(view) > flight.goal.duration_s + _LATE_DESCENT_S
    return (
        contact.is_agreed(flight.contact, view, flight.ground_z_m, is_late)
        and flight.seconds(view) > _BEGUN_S
    )


def touched_down_blind(flight: FlightContext, view: FlightView) -> bool:
    """Whether it has been at the ground for a moment, as far as dead reckoning can tell, or PX4's
    motion says so.
    """
    is_stopped = contact.is_agreed_blind(flight.contact, view, flight.ground_z_m)
    return flight.steady_s(view) > _BLIND_CONTACT_S or (
        is_stopped and flight.seconds(view) > _BLIND_BEGUN_S
    )


def is_blind(flight: FlightContext, view: FlightView) -> bool:
    """Whether position and velocity come from dead reckoning."""
    return view.is_blind


def has_order(flight: FlightContext, view: FlightView) -> bool:
    """Whether an order is in progress."""
    return flight.order is not None


def sees_again_on_leg(flight: FlightContext, view: FlightView) -> bool:
    """Whether its position is measured again, and an order to move in progress."""
    return not view.is_blind and flight.order is not None and flight.order.kind == "move"


def sees_again_in_climb(flight: FlightContext, view: FlightView) -> bool:
    """Whether its position is measured again, and an order to take off in progress."""
    return not view.is_blind and flight.order is not None and flight.order.kind == "takeoff"


def sees_again(flight: FlightContext, view: FlightView) -> bool:
    """Whether its position is measured again."""
    return not view.is_blind


def falls(flight: FlightContext, view: FlightView) -> bool:
    """Whether it sinks from where it seemed to stand: it did not."""
    fallen_m = flight.contact_z_m - view.position_enu_m[2]
    return fallen_m > _FALLEN_M and view.velocity_enu_m_s[2] < _FALLING_M_S


def is_kept_off(flight: FlightContext, view: FlightView) -> bool:
    """Whether others keep it from the place below which it wanted to land: it has stood still
    beside it.
    """
    return flight.steady_s(view) > _KEPT_OFF_S


def floor_is_lower(flight: FlightContext, view: FlightView) -> bool:
    """Whether the descent is over and the ground is not reached: it is lower here than at the
    take-off.
    """
    is_high = view.position_enu_m[2] - flight.ground_z_m > _CONTACT_HEIGHT_M
    return is_high and flight.seconds(view) > flight.goal.duration_s + _LOWER_FLOOR_S


def landed_by_order(flight: FlightContext, view: FlightView) -> bool:
    """Whether PX4 confirms the end of a landing that an operator ordered; so do a hold and a disarm
    during lift-off.
    """
    order = flight.order
    return (
        landed(flight, view)
        and order is not None
        and (order.then_land or order.kind in ("land", "hold", "disarm"))
    )


def landed(flight: FlightContext, view: FlightView) -> bool:
    """Whether PX4 confirms that it is disarmed on the ground; where it tells no landed state, that
    it is disarmed.
    """
    # it disarms by itself or by order on the ground only
    is_down = view.was_on_ground or not view.has_landed_report
    return is_down and px4_confirms_disarmed(flight, view)


def px4_should_have_disarmed(flight: FlightContext, view: FlightView) -> bool:
    """Whether PX4 sees that it is down, or had the time to disarm by itself."""
    return flight.seconds(view) > (_DISARM_AFTER_SEEN_S if view.is_on_ground else _DISARM_AFTER_S)


def px4_does_not_land(flight: FlightContext, view: FlightView) -> bool:
    """Whether PX4 is in another mode, and in the air."""
    return view.snapshot.mode != "LAND" and not view.is_on_ground


def px4_refuses_to_land(flight: FlightContext, view: FlightView) -> bool:
    """Whether PX4 is still in another mode after five seconds."""
    return px4_does_not_land(flight, view) and flight.seconds(view) > CONFIRM_TIMEOUT_S


def px4_landing_late(flight: FlightContext, view: FlightView) -> bool:
    """Whether PX4 should have landed long since, and even from where it is now."""
    left_m = max(0.0, view.position_enu_m[2] - flight.ground_z_m) if view.has_position else 0.0
    return flight.seconds(view) > _PX4_LANDING_TIMEOUT_S + left_m / _PX4_SINKS_M_S


# -- what must last --------------------------------------------------------------------------------


def is_steady(flight: FlightContext, view: FlightView) -> bool:
    """Whether what the step waits for holds at this tick; the step counts for how long."""
    step = flight.step
    if step is FlightStep.PATH and flight.path.left_s > 0.0:
        return False
    if step in (FlightStep.CLIMB, FlightStep.LEG, FlightStep.PATH):
        return at_goal(flight, view) and (
            step is not FlightStep.LEG or has_turned(view, flight.goal.yaw_rad)
        )
    if step is FlightStep.DESCENT:
        (x, y, _), (goal_x, goal_y, _) = view.position_enu_m, flight.goal_position_enu_m
        is_beside = math.hypot(goal_x - x, goal_y - y) > _KEPT_OFF_M
        return (
            is_beside and is_at_rest(view, flight.vehicle) and view.velocity_enu_m_s[2] > _SINKS_M_S
        )
    if step in (FlightStep.COASTING, FlightStep.SINKING):
        return view.position_enu_m[2] - flight.ground_z_m < _BLIND_CONTACT_M
    return step is FlightStep.HOLDING and is_at_rest(view, flight.vehicle)
