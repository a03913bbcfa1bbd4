"""Predicates of the flight table; docs/flight.md prints their names. Pure.

Each function answers one question about the flight at this tick. In the docstrings "it" is the
vehicle. Only :func:`is_steady` is not a predicate of a row. It says whether the condition that the
step waits for holds at this tick. The flight measures how long this condition has held.
"""

from __future__ import annotations

import math

from onboard.control.climb_duration import climb_duration_s
from onboard.flight import contact, takeover
from onboard.flight.arrival import has_turned, is_at, is_at_rest, is_near_and_slow
from onboard.flight.context import FlightContext
from onboard.flight.effects import LIFT_M, SLOW_CLIMB, TIME_LIMIT_FACTOR, takeoff_height_m
from onboard.flight.types import FlightStep, FlightView
from onboard.safety.limits import AUTOPILOT_SILENT_S

# what PX4 confirms
CONFIRM_TIMEOUT_S = 5.0
REBOOT_TIMEOUT_S = 30.0
_STREAM_BEFORE_OFFBOARD_S = 0.3  # setpoints are sent for this time before OFFBOARD is requested
_MIN_OFFBOARD_S = 0.1
_ARM_ON_ITS_WAY_S = 0.5  # a request to arm older than this has taken effect
_KILL_ON_ITS_WAY_S = 0.5  # a kill older than this has taken effect

# take-off, move, hold
LIFTOFF_TIMEOUT_S = 6.0
HOLD_TIMEOUT_S = 15.0
PATH_END_TIMEOUT_S = 15.0
_CLIMB_TIMEOUT_S = 40.0
# Height at which the landing gear has left the ground. Below it, the vehicle hardly tilts, and the
# wind carries it along. With 0.12 m here, a wind of 3 m/s carried it up to 1.4 m at a drag of 1/s.
_LIFTED_M = 0.05
_ARRIVED_S = 0.5  # a vehicle has arrived after this time at the goal
_MOVED_BY_GUSTS_S = 8.0  # the same if gusts keep the vehicle farther away than in calm air
_SEEN_S = 0.6  # a descent without poses ends when poses have arrived for this time
_REST_S = 0.3  # a hold is complete after this time at rest

# landing
_BEGUN_S = 0.3  # a descent does not end before this time
_LATE_DESCENT_S = 1.0  # a descent is late when it exceeds its planned end by this
_LOWER_GROUND_S = 3.0  # if a descent takes this much longer than planned, the ground is lower
_FEELS_WITHIN_M = 0.3  # largest distance from the height where the slow part of a landing starts
_FALLEN_M = 0.10  # a falling vehicle is more than this below the height of its contact
_FALLING_M_S = -0.3  # and its vertical speed is below this
_FREE_FALL_M_S = -1.5  # a disarmed vehicle with a vertical speed below this falls
# A vehicle counts as kept off its landing spot by others if it rests at least _KEPT_OFF_M beside
# the spot for _KEPT_OFF_S. A vehicle rests only if its vertical speed is above _SINKS_M_S.
_KEPT_OFF_M = 0.5
_KEPT_OFF_S = 2.0
_SINKS_M_S = -0.5
_DISARM_AFTER_S = 4.0  # PX4 disarms by itself within this time after the contact
_DISARM_AFTER_SEEN_S = 0.5  # it disarms within this time if it reports the ground

# landing by dead reckoning
_DISARMED_KNOWN_S = 1.5  # longest time from PX4's disarming to the heartbeat that says so
_WITHOUT_POSES_BEGUN_S = 0.6  # contact is checked only after this time

# PX4's own landing
_PX4_LANDING_TIMEOUT_S = 60.0
_MODE_KNOWN_S = 1.2  # PX4's heartbeat with its mode arrives once a second
_PX4_SINKS_M_S = 0.5  # least speed of its descent: MPC_LAND_SPEED is 0.7 m/s


def _is_confirmed(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4's newest heartbeat has come since this step began."""
    return view.snapshot.heartbeat_ns > flight.step_ns


# -- what PX4 confirms -----------------------------------------------------------------------------


def px4_confirms_offboard(flight: FlightContext, view: FlightView) -> bool:
    """Return whether a heartbeat since the step began says OFFBOARD."""
    is_offboard = view.snapshot.is_offboard and _is_confirmed(flight, view)
    return is_offboard and flight.seconds(view) > _MIN_OFFBOARD_S


def px4_is_taken_over(flight: FlightContext, view: FlightView) -> bool:
    """Return whether a heartbeat since the step began says OFFBOARD and armed."""
    return view.snapshot.is_armed and px4_confirms_offboard(flight, view)


def px4_left_its_hold(flight: FlightContext, view: FlightView) -> bool:
    """Return whether a heartbeat since the step began says neither PX4's hold nor OFFBOARD."""
    has_left = view.snapshot.mode not in (takeover.HOLD, "OFFBOARD")
    return has_left and _is_confirmed(flight, view)


def px4_confirms_armed(flight: FlightContext, view: FlightView) -> bool:
    """Return whether a heartbeat since the step began says armed."""
    return view.snapshot.is_armed and _is_confirmed(flight, view)


def px4_confirms_disarmed(flight: FlightContext, view: FlightView) -> bool:
    """Return whether a heartbeat since the step began says disarmed."""
    return not view.snapshot.is_armed and _is_confirmed(flight, view)


def px4_stays_disarmed(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 says disarmed, late enough that no request to arm can still be on its
    way.
    """
    later_ns = view.snapshot.heartbeat_ns - flight.step_ns
    return not view.snapshot.is_armed and later_ns > 1e9 * _ARM_ON_ITS_WAY_S


def px4_has_not_confirmed_in_time(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 has had five seconds to confirm the request."""
    return flight.seconds(view) > CONFIRM_TIMEOUT_S


def px4_has_rebooted(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4's clock started after this step did, and a heartbeat has arrived since."""
    boot_ms = view.snapshot.px4_boot_ms
    began_ns = view.snapshot.attitude_ns - 1_000_000 * boot_ms
    is_new = boot_ms > 0 and began_ns > flight.step_ns
    return is_new and _is_confirmed(flight, view)


def px4_has_not_rebooted_in_time(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 has had half a minute to restart."""
    return flight.seconds(view) > REBOOT_TIMEOUT_S


def setpoints_have_streamed(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 has had setpoints for long enough to accept OFFBOARD."""
    return flight.seconds(view) > _STREAM_BEFORE_OFFBOARD_S


def px4_is_armed(flight: FlightContext, view: FlightView) -> bool:
    """Return whether the last heartbeat says armed."""
    return view.snapshot.is_armed


def px4_is_armed_in_the_air(flight: FlightContext, view: FlightView) -> bool:
    """Return whether the last heartbeat says armed, and PX4 does not report the ground."""
    return view.snapshot.is_armed and not view.is_on_ground


def px4_is_disarmed_on_ground(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 says disarmed and last reported the ground, and the vehicle does not fall.

    PX4 reports the ground of every vehicle that is disarmed, also of one that falls.
    """
    return not view.snapshot.is_armed and view.was_on_ground and not _is_sinking(view, _FALLING_M_S)


def px4_is_on_ground(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 last reported the ground."""
    return view.was_on_ground


def px4_reports_the_ground(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 reports the ground, and the report is not old."""
    return view.is_on_ground


def px4_flies_without_agent(flight: FlightContext, view: FlightView) -> bool:
    """Return whether the vehicle is in the air although this agent has not begun a flight."""
    return view.snapshot.is_armed and not view.was_on_ground and flight.order is None


# -- take-off, move, hold --------------------------------------------------------------------------


def lifted_off(flight: FlightContext, view: FlightView) -> bool:
    """Return whether it has clearly left the ground."""
    _, _, z_m = view.position_enu_m
    return z_m > flight.expected_ground.z_m + _LIFTED_M


def climbs_on(flight: FlightContext, view: FlightView) -> bool:
    """Return whether half of the first leg of a climb is flown, and a second leg follows.

    In its middle, the leg is at top speed and does not accelerate. The second leg continues at that
    speed.
    """
    _, _, z_m = view.position_enu_m
    _, _, goal_z_m = flight.goal_position_enu_m
    has_second_leg = takeoff_height_m(flight.order) > goal_z_m
    return has_second_leg and z_m > flight.expected_ground.z_m + 0.5 * LIFT_M


def lift_off_unseen(flight: FlightContext, view: FlightView) -> bool:
    """Return whether it has not lifted off in time, although PX4 reports that it flies."""
    return lift_off_late(flight, view) and px4_is_armed_in_the_air(flight, view)


def lift_off_late(flight: FlightContext, view: FlightView) -> bool:
    """Return whether it has not lifted off in time."""
    return flight.seconds(view) > LIFTOFF_TIMEOUT_S


def arrived(flight: FlightContext, view: FlightView) -> bool:
    """Return whether it has been at its goal for half a second.

    Gusts move a vehicle that has arrived, so its goal is wider in gusts. It has arrived when it is
    as near as in calm air, or after some seconds anywhere in the wider goal.
    """
    at_goal_s = flight.steady_s(view)
    if at_goal_s > _MOVED_BY_GUSTS_S:
        return True
    if at_goal_s <= _ARRIVED_S:
        return False
    return is_near_and_slow(view, flight.goal_position_enu_m, flight.vehicle)


def arrived_to_land(flight: FlightContext, view: FlightView) -> bool:
    """Return whether it has arrived, and its order is to land there."""
    order = flight.order
    return order is not None and order.then_land and arrived(flight, view)


def path_ended(flight: FlightContext, view: FlightView) -> bool:
    """Return whether the path is over and the vehicle has been at its end for half a second."""
    return flight.path.left_s <= 0.0 and arrived(flight, view)


def path_skipped(flight: FlightContext, view: FlightView) -> bool:
    """Return whether an order requests that it skips the rest of its path."""
    return flight.path.is_skipped


def path_late(flight: FlightContext, view: FlightView) -> bool:
    """Return whether the path ended long ago, without the vehicle at its end."""
    return flight.path.left_s < -PATH_END_TIMEOUT_S


def left_behind_to_land(flight: FlightContext, view: FlightView) -> bool:
    """Return whether it has been behind its path for too long, and therefore must land."""
    return flight.path.is_lost and flight.path.on_lag == "land"


def left_behind(flight: FlightContext, view: FlightView) -> bool:
    """Return whether it has been behind its path for too long, so that it leaves the show."""
    return flight.path.is_lost


def at_goal(flight: FlightContext, view: FlightView) -> bool:
    """Return whether it is at its goal and slow."""
    return is_at(view, flight.goal_position_enu_m, flight.vehicle)


def climb_late(flight: FlightContext, view: FlightView) -> bool:
    """Return whether it has not reached its height in time."""
    height_m = takeoff_height_m(flight.order) - flight.expected_ground.z_m
    planned_s = climb_duration_s(height_m, flight.vehicle.max_speed_m_s)
    if flight.is_slow:
        planned_s = SLOW_CLIMB * planned_s
    return flight.seconds(view) > max(_CLIMB_TIMEOUT_S, TIME_LIMIT_FACTOR * planned_s)


def at_rest(flight: FlightContext, view: FlightView) -> bool:
    """Return whether it has been at rest for a moment."""
    return flight.steady_s(view) > _REST_S


def rest_late(flight: FlightContext, view: FlightView) -> bool:
    """Return whether it has not come to rest in time."""
    return flight.seconds(view) > HOLD_TIMEOUT_S


def not_slowed_yet(flight: FlightContext, view: FlightView) -> bool:
    """Return whether the order still continues at full speed."""
    return not flight.is_slow


# -- landing ---------------------------------------------------------------------------------------


def touched_down(flight: FlightContext, view: FlightView) -> bool:
    """Return whether it has had contact with the ground for a moment, by several signs."""
    since_begin_s = flight.seconds(view)
    ground = flight.expected_ground
    if not flight.vehicle.mocap_required or ground.may_be_lower:  # its height is no sign
        has_contact = contact.has_ground_contact_by_thrust(flight.contact, view)
        return has_contact and since_begin_s > _BEGUN_S

    is_late = since_begin_s > flight.goal.duration_s + _LATE_DESCENT_S
    has_contact = contact.has_ground_contact(flight.contact, view, ground.z_m, is_late)
    return has_contact and since_begin_s > _BEGUN_S


def touched_down_without_poses(flight: FlightContext, view: FlightView) -> bool:
    """Return whether it stands on the ground by PX4's motion."""
    is_stopped = contact.has_ground_contact_without_poses(
        flight.contact, view, flight.expected_ground.z_m, flight.lowest_ground_m
    )
    return is_stopped and flight.seconds(view) > _WITHOUT_POSES_BEGUN_S


def may_have_ground_contact_without_poses(flight: FlightContext, view: FlightView) -> bool:
    """Return whether it may have met the ground, by PX4's motion."""
    if flight.step is not FlightStep.SINKING or flight.seconds(view) < _WITHOUT_POSES_BEGUN_S:
        return False
    ground_z_m = flight.expected_ground.z_m
    return contact.may_have_ground_contact_without_poses(flight.contact, view, ground_z_m)


def is_dead_reckoned(flight: FlightContext, view: FlightView) -> bool:
    """Return whether position and velocity come from dead reckoning."""
    return view.is_dead_reckoned


def has_order(flight: FlightContext, view: FlightView) -> bool:
    """Return whether an order is in progress."""
    return flight.order is not None


def has_poses_again_on_leg(flight: FlightContext, view: FlightView) -> bool:
    """Return whether its position is measured again, with an order in progress that has a goal.

    An order to follow a path has a goal only after a skip. Without a skip, it ended when the poses
    stopped.
    """
    order = flight.order
    return not view.is_dead_reckoned and order is not None and order.kind in ("move", "follow_path")


def has_poses_again_in_climb(flight: FlightContext, view: FlightView) -> bool:
    """Return whether its position is measured again, with an order to take off in progress."""
    return not view.is_dead_reckoned and flight.order is not None and flight.order.kind == "takeoff"


def has_poses_again(flight: FlightContext, view: FlightView) -> bool:
    """Return whether its position is measured again."""
    return not view.is_dead_reckoned


def has_poses_again_for_a_while(flight: FlightContext, view: FlightView) -> bool:
    """Return whether its position has again been measured for a while, in a descent without poses.

    Intermittent poses must not keep restarting the descent and the search for signs of the ground.
    """
    return not view.is_dead_reckoned and flight.steady_s(view) > _SEEN_S


def falls(flight: FlightContext, view: FlightView) -> bool:
    """Return whether it falls below the height of its supposed contact."""
    _, _, z_m = view.position_enu_m
    _, _, climbing_m_s = view.velocity_enu_m_s
    return flight.search_began_z_m - z_m > _FALLEN_M and climbing_m_s < _FALLING_M_S


def is_kept_off(flight: FlightContext, view: FlightView) -> bool:
    """Return whether it rests beside its landing spot because others keep it away."""
    return flight.steady_s(view) > _KEPT_OFF_S


def feels_for_ground(flight: FlightContext, view: FlightView) -> bool:
    """Return whether it is in the slow part of a landing.

    Without a mocap its height may be wrong. With a mocap, the ground is lower than expected.
    """
    if flight.goal.is_on_path:
        return True

    _, _, z_m = view.position_enu_m
    if flight.vehicle.mocap_required:
        lower_from_m = contact.UNDER_GROUND_M
        if flight.expected_ground.may_be_lower:
            lower_from_m = contact.LOW_M
        is_lower = z_m - flight.expected_ground.z_m < lower_from_m
        return is_lower and flight.seconds(view) > flight.goal.duration_s + _LATE_DESCENT_S

    above_m = z_m - flight.goal.position_enu_m.z
    return flight.seconds(view) > flight.goal.duration_s and above_m < _FEELS_WITHIN_M


def ground_is_lower(flight: FlightContext, view: FlightView) -> bool:
    """Return whether the descent has ended above the ground, which is lower than at take-off."""
    if not flight.vehicle.mocap_required:
        return False
    _, _, z_m = view.position_enu_m
    is_high = z_m - flight.expected_ground.z_m > contact.LOW_M
    return is_high and flight.seconds(view) > flight.goal.duration_s + _LOWER_GROUND_S


def landed_by_order(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 confirms the end of a landing that an operator ordered.

    A hold or a disarm during the lift-off also orders a landing.
    """
    order = flight.order
    if order is None or not landed(flight, view):
        return False
    return order.then_land or order.kind in ("land", "hold", "disarm")


def landed(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 confirms that it is disarmed on the ground.

    If PX4 reports no landed state, disarmed is enough, because PX4 disarms only on the ground.
    """
    is_down = view.was_on_ground or not view.has_landed_report
    return is_down and px4_confirms_disarmed(flight, view)


def px4_should_have_disarmed(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 has had time to disarm by itself. It needs less time once it reports
    ground.
    """
    limit_s = _DISARM_AFTER_S
    if view.is_on_ground:
        limit_s = _DISARM_AFTER_SEEN_S
    return flight.seconds(view) > limit_s


def px4_stays_armed_on_ground(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 has reported the ground for long enough that it should have disarmed."""
    reported_s = 1e-9 * (view.now_ns - flight.contact.reported_since_ns)
    return view.is_on_ground and reported_s > _DISARM_AFTER_S


def falls_by_kill(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 confirms that it is disarmed after a kill."""
    return flight.was_killed and px4_confirms_disarmed(flight, view)


def falls_disarmed(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 is disarmed without a kill of this agent, and the vehicle falls."""
    if flight.was_killed:
        return False
    return not view.snapshot.is_armed and _is_sinking(view, _FREE_FALL_M_S)


def stopped_while_sinking(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 has disarmed in a descent by dead reckoning, before it saw the ground.

    PX4 reports the ground as soon as it is disarmed, and its heartbeat says disarmed up to a second
    later. If it has reported the ground for longer than that, it has disarmed after a landing.
    """
    reported_s = 1e-9 * (view.now_ns - flight.contact.reported_since_ns)
    is_new = view.has_landed_report and reported_s < _DISARMED_KNOWN_S
    return is_new and px4_confirms_disarmed(flight, view)


def _is_sinking(view: FlightView, least_m_s: float) -> bool:
    """Return whether a vehicle with a measured position has a vertical speed below this."""
    _, _, climbing_m_s = view.velocity_enu_m_s
    return view.has_position and not view.is_dead_reckoned and climbing_m_s < least_m_s


def kill_had_no_effect(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 still says armed when a kill must have taken effect."""
    later_ns = view.snapshot.heartbeat_ns - flight.step_ns
    is_effect_known = later_ns > 1e9 * _KILL_ON_ITS_WAY_S
    return flight.was_killed and view.snapshot.is_armed and is_effect_known


def px4_hears_sticks(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 receives a pilot's sticks, so that the pilot may be flying it."""
    return view.hears_sticks


def px4_cannot_tell_of_a_pilot(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 is silent during an order to land that must not land a pilot."""
    silent_s = 1e-9 * (view.now_ns - view.snapshot.last_packet_ns)
    return not flight.lands_for_a_person and silent_s > AUTOPILOT_SILENT_S


def px4_does_not_land(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 is in another mode than LAND, and does not report the ground.

    If PX4 receives sticks, the mode must have been reported since this step began, because a pilot
    may have taken over.
    """
    is_known = _is_confirmed(flight, view) or flight.seconds(view) > _MODE_KNOWN_S
    if view.hears_sticks and not is_known:
        return False
    return view.snapshot.mode != "LAND" and not view.is_on_ground


def px4_refuses_to_land(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4 is still in another mode after five seconds."""
    return px4_does_not_land(flight, view) and flight.seconds(view) > CONFIRM_TIMEOUT_S


def px4_landing_late(flight: FlightContext, view: FlightView) -> bool:
    """Return whether PX4's landing has taken too long, given the remaining height."""
    left_m = 0.0
    if view.has_position:
        _, _, z_m = view.position_enu_m
        left_m = max(0.0, z_m - flight.lowest_ground_m)
    return flight.seconds(view) > _PX4_LANDING_TIMEOUT_S + left_m / _PX4_SINKS_M_S


# -- what must last --------------------------------------------------------------------------------


def is_steady(flight: FlightContext, view: FlightView) -> bool:
    """Return whether the condition that the step waits for holds at this tick."""
    match flight.step:
        case FlightStep.CLIMB:
            return at_goal(flight, view)
        case FlightStep.LEG:
            return at_goal(flight, view) and has_turned(view, flight.goal.yaw_rad)
        case FlightStep.PATH:
            return flight.path.left_s <= 0.0 and at_goal(flight, view)
        case FlightStep.HOLDING:
            return is_at_rest(view, flight.vehicle)
        case FlightStep.DESCENT:
            return _is_kept_beside_its_goal(flight, view)
        case FlightStep.SINKING:
            return not view.is_dead_reckoned
    return False


def _is_kept_beside_its_goal(flight: FlightContext, view: FlightView) -> bool:
    """Return whether a landing vehicle stands still in the air, beside its landing spot."""
    x, y, _ = view.position_enu_m
    goal_x, goal_y, _ = flight.goal_position_enu_m
    is_beside = math.hypot(goal_x - x, goal_y - y) > _KEPT_OFF_M
    _, _, climbing_m_s = view.velocity_enu_m_s
    is_standing = is_at_rest(view, flight.vehicle) and climbing_m_s > _SINKS_M_S
    return is_beside and is_standing
