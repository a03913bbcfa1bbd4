"""Mutants that no test can notice, or that none needs to notice, each with its reason.

A mutant is named by its file, its line of code and its change, so that a reason does not outlive
the code that it speaks of: a test fails for one whose line is gone.
"""

from __future__ import annotations

from typing import NamedTuple


class Accepted(NamedTuple):
    """Mutants that survive for the same reason."""

    reason: str
    file: str  # below onboard
    mutants: tuple[tuple[str, str], ...]  # line of code without its comment, and change of it


_LARGER = "Gt becomes GtE"
_SMALLER = "Lt becomes LtE"
_ONE_TICK = "exactly on a limit of time it decides one tick later, or sooner"
_ROUNDING = "it is a matter of rounding"
_NONE = "any negative number says that there is none"
_LARGER_1 = "1.0 becomes larger"
_MEASURED = "no measured number lies on its limit for good"

ACCEPTED = (
    Accepted(
        "who does not move along an axis needs no distance to stop, whichever wall is ahead",
        "safety/geofence.py",
        (
            ("ahead_x_m = east - x if vx > 0.0 else x - west", _LARGER),
            ("ahead_y_m = north - y if vy > 0.0 else y - south", _LARGER),
        ),
    ),
    Accepted(
        "who does not climb needs no distance to stop below the ceiling",
        "safety/geofence.py",
        (("or (vz > 0.0 and self._is_near(top - z, vz, brake_z))", _LARGER),),
    ),
    Accepted(
        _MEASURED,
        "safety/setpoint_check.py",
        (
            ("is_unit = abs(squared_length - 1.0) < _UNIT_SLACK", _SMALLER),
            (
                "return cos_tilt >= math.cos(math.radians(max_tilt_deg + _TILT_SLACK_DEG))",
                "GtE becomes Gt",
            ),
        ),
    ),
    Accepted(
        "of an action's number only the rank counts, and nothing is stronger",
        "safety/failsafe_table.py",
        (("STOP = 8", "8 becomes larger"),),
    ),
    Accepted(
        _MEASURED,
        "safety/autopilot_monitor.py",
        (("if abs(shift_ns) <= STANDSTILL_S * 1e9:", "LtE becomes Lt"),),
    ),
    Accepted(
        "the shift is more than 0.15 s to either side there",
        "safety/autopilot_monitor.py",
        (
            ("if shift_ns > 0.0:", _LARGER),
            ("if shift_ns > 0.0:", "0.0 becomes larger"),
        ),
    ),
    Accepted(
        "an error of a tenth of a millisecond of the clock is none",
        "safety/report_confirmation.py",
        (("return max(0.0, moved_ms - passed_ms)", "0.0 becomes larger"),),
    ),
    Accepted(
        "a clock that stands has the error 0 either way",
        "safety/report_confirmation.py",
        (
            ("if moved_ms < 0:", _SMALLER),
            ("if moved_ms < 0:", "0 becomes larger"),
        ),
    ),
    Accepted(
        "five attitudes take longer than a nanosecond",
        "safety/report_confirmation.py",
        (("least_ns=0,", "0 becomes larger"),),
    ),
    Accepted(
        "it is set before it is read",
        "safety/report_confirmation.py",
        (
            ("first_ns: int = 0", "0 becomes larger"),
            ("count: int = 0", "0 becomes larger"),
            ("_run_begin_ns: int = 0", "0 becomes larger"),
        ),
    ),
    Accepted(
        "nothing arrives in the first nanosecond of a clock",
        "safety/report_confirmation.py",
        (
            ("seen_ns: int = 0", "0 becomes larger"),
            ("_requested_ns: int = 0", "0 becomes larger"),
            ("_dropped_ns: int = 0", "0 becomes larger"),
        ),
    ),
    Accepted(
        "a clock of PX4 of one millisecond comes with no first attitude, and is replaced by it",
        "safety/autopilot_monitor.py",
        (("_boot_ms: int = 0", "0 becomes larger"),),
    ),
    Accepted(
        _MEASURED,
        "safety/report_confirmation.py",
        (
            (
                "is_near = abs(sum(a * b for a, b in pairs)) > _SAME_TURN_COS",
                _LARGER,
            ),
        ),
    ),
    Accepted(
        _MEASURED,
        "safety/battery_monitor.py",
        (
            (
                "runs_out = left_frac < _LANDING_SHARE * land_frac and "
                "fallen_frac > _MIN_FALL_FRAC",
                _SMALLER,
            ),
            (
                "runs_out = left_frac < _LANDING_SHARE * land_frac and "
                "fallen_frac > _MIN_FALL_FRAC",
                _LARGER,
            ),
            (
                "is_measured = math.isfinite(before_v) and before_v > _MIN_VOLTAGE_V",
                _LARGER,
            ),
            ("return is_measured and now_v < (1.0 - _SAG_SHARE) * before_v", _SMALLER),
        ),
    ),
    Accepted(
        _MEASURED,
        "safety/tracking_monitor.py",
        (
            ("is_full = thrust_frac >= _FULL_SHARE * self.largest_frac", "GtE becomes Gt"),
            ("is_sinking = is_full and below_m > _BELOW_M and climb_m_s < _CLIMB_M_S", _LARGER),
            ("is_sinking = is_full and below_m > _BELOW_M and climb_m_s < _CLIMB_M_S", _SMALLER),
            ("has_missed = squared_miss > _MISS_SIN * _MISS_SIN", _LARGER),
            (
                "self._upset_s = self._upset_s + dt_s if measured.z < _UPSET_COS else 0.0",
                _SMALLER,
            ),
        ),
    ),
    Accepted(
        _ONE_TICK,
        "safety/tracking_monitor.py",
        (
            ("self.is_upset = self._upset_s > _UPSET_FOR_S", _LARGER),
            ("self.is_attitude_lost = self.missed_s > _MISS_FOR_S or self.is_upset", _LARGER),
            ("self.is_saturated = self._full_s > _FULL_FOR_S", _LARGER),
            ("self.is_sinking = self._sinking_s > _SINKING_FOR_S", _LARGER),
        ),
    ),
    Accepted(
        "on an edge the distance is 0, inside or outside",
        "safety/area_room.py",
        (("is_west_of_edge = x < x1 + (y - y1) / (y2 - y1) * along_x", _SMALLER),),
    ),
    Accepted(
        _MEASURED,
        "safety/area_room.py",
        (
            ("is_in_breach |= _clearance_m(area, positions_enu_m, 0.0) < 0.0", _SMALLER),
            ("is_beyond = clearances_m(fleet_areas, line_enu_m) < 0.0", _SMALLER),
        ),
    ),
    Accepted(
        "a line is looked at once more often",
        "safety/area_room.py",
        (
            (
                "count = min(_MAX_SAMPLES, 2 + int(length_m / _SAMPLE_M))",
                "2 becomes larger",
            ),
        ),
    ),
    Accepted(
        "more samples of a line beyond 250 m take longer, and find no less",
        "safety/area_room.py",
        (("_MAX_SAMPLES = 5000", "5000 becomes larger"),),
    ),
    Accepted(
        _MEASURED,
        "safety/model_mismatch.py",
        (
            ("is_upright = up.z > _MIN_UP", _LARGER),
            ("if np.linalg.cond(normal) > _LARGEST_CONDITION_NUMBER:", _LARGER),
            ("if gain < _MIN_GAIN:", _SMALLER),
            (
                "if std_s < _SURE_S and abs(slower_s) - 2.0 * std_s > LAG_ERROR_S:",
                _SMALLER,
            ),
            (
                "if std_s < _SURE_S and abs(slower_s) - 2.0 * std_s > LAG_ERROR_S:",
                _LARGER,
            ),
            (
                "if memory.time_s >= _MIN_S and abs(hover_share - 1.0) > _HOVER_SHARE:",
                _LARGER,
            ),
        ),
    ),
    Accepted(
        _ONE_TICK,
        "safety/model_mismatch.py",
        (
            ("if memory.time_s < _MIN_S:", _SMALLER),
            (
                "if memory.time_s >= _MIN_S and abs(hover_share - 1.0) > _HOVER_SHARE:",
                "GtE becomes Gt",
            ),
        ),
    ),
    Accepted(
        "a difference that is told is larger than nothing",
        "safety/model_mismatch.py",
        (('direction = "later" if slower_s > 0.0 else "earlier"', _LARGER),),
    ),
    Accepted(
        "there are five samples within a correlation time, and never fewer than two",
        "safety/model_mismatch.py",
        (
            (
                "correlated_count = max(1.0, _CORRELATED_S * sample_count / memory.time_s)",
                _LARGER_1,
            ),
        ),
    ),
    Accepted(
        "of a condition number the order of magnitude counts",
        "safety/model_mismatch.py",
        (("_LARGEST_CONDITION_NUMBER = 1e6", "1000000.0 becomes larger"),),
    ),
    Accepted(
        _MEASURED,
        "safety/separation_monitor.py",
        (
            ("if distance_m < _COINCIDENT_M:", _SMALLER),
            ("return self.miss_m_s > _MISS_M_S", _LARGER),
        ),
    ),
    Accepted(
        "a prediction for the first nanosecond of a clock is too old to be compared",
        "safety/separation_monitor.py",
        (
            ("_due_ns: int = 0", "0 becomes larger"),
            ("self._due_ns = 0", "0 becomes larger"),
        ),
    ),
    Accepted(
        "it is set before it is read",
        "safety/separation_monitor.py",
        (("_predicted_m_s: Xy = (0.0, 0.0)", "0.0 becomes larger"),),
    ),
    Accepted(
        "the one condition that demands to be level is quiet",
        "supervision/failsafe_supervisor.py",
        (("if action >= Action.LEVEL:", "GtE becomes Gt"),),
    ),
    Accepted(
        "before a neighbour is heard again, none is named",
        "supervision/neighbour_monitor.py",
        (
            ("self._heard_again_ns = 0", "0 becomes larger"),
            (
                "if self._heard_again_ns != 0 and now_ns - self._heard_again_ns < _BACK_NS:",
                "0 becomes larger",
            ),
        ),
    ),
    Accepted(
        "before the first tick of a leg, nobody was avoided",
        "supervision/neighbour_monitor.py",
        (("self._leg_ticks = 0", "0 becomes larger"),),
    ),
    Accepted(_NONE, "supervision/neighbour_monitor.py", (("self._leg = -1", "1 becomes larger"),)),
    Accepted(
        "between neighbours at one height there is no separation of heights",
        "supervision/neighbour_monitor.py",
        (
            (
                "may_come_down_on_us = not row.is_cooperative and above_it_m < 0.0",
                _SMALLER,
            ),
        ),
    ),
    Accepted(
        _MEASURED,
        "supervision/neighbour_monitor.py",
        (
            (
                "if name not in self._confirmed_silent and ages_s[name] <= table.silent_s:",
                "LtE becomes Lt",
            ),
            ("if row.age_s >= self._table.silent_s:", "GtE becomes Gt"),
            ("if apart_m < nearest_m:", _SMALLER),
            (
                "heard = [row.name for row in rows if row.age_s < self._table.silent_s]",
                _SMALLER,
            ),
            (
                "if row.is_cooperative and row.age_s < self._table.silent_s:",
                _SMALLER,
            ),
            ("known = [row for row in rows if row.age_s < self._table.silent_s]", _SMALLER),
            ("if max(map(abs, apart_m)) >= _NEAR_M:", "GtE becomes Gt"),
            (
                "if height_left_m >= self._vertical_m and not may_come_down_on_us:",
                "GtE becomes Gt",
            ),
            (
                "return left_m < limit_m - _PREDICTED_SLACK_M and math.hypot(*apart_m) > limit_m",
                _SMALLER,
            ),
            (
                "return left_m < limit_m - _PREDICTED_SLACK_M and math.hypot(*apart_m) > limit_m",
                _LARGER,
            ),
        ),
    ),
    Accepted(
        _MEASURED,
        "supervision/condition_table.py",
        (("if facts.nearest_m < AMONG_OTHERS_M:", _SMALLER),),
    ),
    Accepted(
        _ONE_TICK,
        "supervision/condition_table.py",
        (("return facts.position_age_s > longest_s and not facts.is_in_contact", _LARGER),),
    ),
    Accepted(
        "nothing arrives in the first nanosecond of a clock",
        "supervision/offboard_monitor.py",
        (("_not_needed_ns: int = 0", "0 becomes larger"),),
    ),
    Accepted(
        "every fifth tick is one, whether ticks are counted by one or by two",
        "supervision/model_mismatch_reporter.py",
        (("self._tick_count += 1", "1 becomes larger"),),
    ),
    Accepted(
        "every fifth tick is one, whether ticks are counted by one or by two",
        "supervision/tick_observer.py",
        (("self._tick_count += 1", "1 becomes larger"),),
    ),
    Accepted(
        _MEASURED,
        "supervision/tick_observer.py",
        (
            ("if not is_tracked or height_m < self._tracked_above_m(view):", _SMALLER),
            (
                "if not context.is_airborne or context.nearest_m >= self._touching_m:",
                "GtE becomes Gt",
            ),
        ),
    ),
    Accepted(
        "no heartbeat arrives in the very nanosecond in which an attitude is lost",
        "supervision/tick_observer.py",
        (("is_mode_known = heartbeat_ns >= began_ns", "GtE becomes Gt"),),
    ),
    Accepted(
        "the agent gives it at each tick",
        "supervision/tick_context.py",
        (
            ("battery_floor_frac: float = 0.0", "0.0 becomes larger"),
            ("law_status: int = 0", "0 becomes larger"),
            ("active_neighbour: int = -1", "1 becomes larger"),
            ("commanded_wxyz: Wxyz = (1.0, 0.0, 0.0, 0.0)", _LARGER_1),
            ("commanded_wxyz: Wxyz = (1.0, 0.0, 0.0, 0.0)", "0.0 becomes larger"),
            ("thrust_frac: float = 0.0", "0.0 becomes larger"),
            ("below_m: float = 0.0", "0.0 becomes larger"),
            ("disturbance_enu_m_s2: Xyz = (0.0, 0.0, 0.0)", "0.0 becomes larger"),
        ),
    ),
    Accepted(
        "the observer gives it at each tick",
        "supervision/tick_facts.py",
        (
            ("height_above_lowest_ground_m: float = 0.0", "0.0 becomes larger"),
            ("height_m: float = 0.0", "0.0 becomes larger"),
        ),
    ),
    Accepted(
        _MEASURED,
        "supervision/wind_monitor.py",
        (
            (
                "has_returned = self._return_s <= 0.0 or square_m2 <= self._mean_square_m2",
                "LtE becomes Lt",
            ),
            ("is_rising = soon_m_s > self._too_much_m_s", _LARGER),
            (
                "is_scattered = gust_m_s2 > COVERED_M_S2 and scatter_m > self._margin_m(gust_m_s2)",
                _LARGER,
            ),
            ("is_near=speed_m_s > self._limit_m_s,", _LARGER),
            ("is_above=is_rising or speed_m_s > GUSTY * self._limit_m_s,", _LARGER),
            ("is_at_bound=largest_push_axis_m_s2 > self._bound_m_s2,", _LARGER),
            ("is_pushed_about=is_scattered or gust_m_s2 > self._largest_gust_m_s2,", _LARGER),
        ),
    ),
    Accepted(
        "the first look replaces it",
        "supervision/wind_monitor.py",
        (
            (
                "self._earlier_enu_m_s = (0.0, 0.0)",
                "0.0 becomes larger",
            ),
        ),
    ),
    Accepted(
        _ONE_TICK,
        "flight/predicates.py",
        (
            ("return flight.seconds(view) > CONFIRM_TIMEOUT_S", _LARGER),
            ("return flight.seconds(view) > REBOOT_TIMEOUT_S", _LARGER),
            ("return flight.seconds(view) > _STREAM_BEFORE_OFFBOARD_S", _LARGER),
            ("return flight.seconds(view) > LIFTOFF_TIMEOUT_S", _LARGER),
            ("return flight.steady_s(view) > _REST_S", _LARGER),
            ("return flight.seconds(view) > HOLD_TIMEOUT_S", _LARGER),
            ("is_late = since_begin_s > flight.goal.duration_s + _LATE_DESCENT_S", _LARGER),
            ("return has_contact and since_begin_s > _BEGUN_S", _LARGER),
            ("return is_stopped and flight.seconds(view) > _WITHOUT_POSES_BEGUN_S", _LARGER),
            (
                "if flight.step is not FlightStep.SINKING or "
                "flight.seconds(view) < _WITHOUT_POSES_BEGUN_S:",
                _SMALLER,
            ),
            (
                "is_known = _is_confirmed(flight, view) or flight.seconds(view) > _MODE_KNOWN_S",
                _LARGER,
            ),
            (
                "return flight.seconds(view) > _PX4_LANDING_TIMEOUT_S + left_m / _PX4_SINKS_M_S",
                _LARGER,
            ),
        ),
    ),
    Accepted(
        _MEASURED,
        "flight/predicates.py",
        (
            (
                "return flight.search_began_z_m - z_m > _FALLEN_M and climbing_m_s < _FALLING_M_S",
                _LARGER,
            ),
            (
                "return flight.seconds(view) > flight.goal.duration_s and "
                "above_m < _FEELS_WITHIN_M",
                _SMALLER,
            ),
            (
                "is_high = z_m - flight.expected_ground.z_m > contact.LOW_M",
                _LARGER,
            ),
        ),
    ),
    Accepted(
        "a vehicle that is on no path has no show any more",
        "flight/state_machine.py",
        (
            (
                "if flight.step is FlightStep.PATH and step is not FlightStep.PATH:",
                "and becomes or",
            ),
        ),
    ),
    Accepted(
        "nothing is sent in the first nanosecond of a clock",
        "flight/state_machine.py",
        (("flight.request_ns = 0", "0 becomes larger"),),
    ),
    Accepted(
        "of that goal the position alone is used",
        "flight/effects.py",
        (("end = flight.path.goal(0, 0.0)", "0 becomes larger"),),
    ),
    Accepted(
        "nothing is sent or observed in the first nanosecond of a clock",
        "flight/contact.py",
        (
            ("still_since_ns: int = 0", "0 becomes larger"),
            ("light_since_ns: int = 0", "0 becomes larger"),
            ("reported_since_ns: int = 0", "0 becomes larger"),
            ("slow_since_ns: int = 0", "0 becomes larger"),
        ),
    ),
    Accepted(
        "a vehicle moves before it lands, and that replaces it",
        "flight/contact.py",
        (("height_m: float = 0.0", "0.0 becomes larger"),),
    ),
    Accepted(
        "it is set before it is read",
        "flight/context.py",
        (
            (
                "_NO_GOAL = Goal(position_enu_m=ZERO_3, duration_s=0.0, sequence=0)",
                "0.0 becomes larger",
            ),
            ("step_ns: int = 0", "0 becomes larger"),
            ("steady_since_ns: int = 0", "0 becomes larger"),
            ("deadline_ns: int = 0", "0 becomes larger"),
        ),
    ),
    Accepted(
        "of a goal's number only the change counts",
        "flight/context.py",
        (
            (
                "_NO_GOAL = Goal(position_enu_m=ZERO_3, duration_s=0.0, sequence=0)",
                "0 becomes larger",
            ),
        ),
    ),
    Accepted(
        "nothing is sent or observed in the first nanosecond of a clock",
        "flight/context.py",
        (("request_ns: int = 0", "0 becomes larger"),),
    ),
    Accepted(
        "it is set before it is read",
        "flight/path_flight.py",
        (
            ("start_ns: int = 0", "0 becomes larger"),
            ("time_s: float = 0.0", "0.0 becomes larger"),
        ),
    ),
    Accepted(
        "the agent gives it at each tick",
        "flight/types.py",
        (
            ("attitude_wxyz: Wxyz = (1.0, 0.0, 0.0, 0.0)", _LARGER_1),
            ("attitude_wxyz: Wxyz = (1.0, 0.0, 0.0, 0.0)", "0.0 becomes larger"),
        ),
    ),
    Accepted(
        "the agent gives it while it has a position; without one, any share but a little one does",
        "flight/types.py",
        (("thrust_share: float = 1.0", _LARGER_1),),
    ),
    Accepted(
        "up to 0.1 m/s^2 the air is calm",
        "flight/types.py",
        (("gust_m_s2: float = 0.0", "0.0 becomes larger"),),
    ),
    Accepted(
        "a path that touches its limit, and goes no further, may be refused or not",
        "flight/path_flight.py",
        (
            (
                "is_coordinate_out = (position_enu_m < low_enu_m) | (position_enu_m > high_enu_m)",
                _SMALLER,
            ),
            (
                "is_coordinate_out = (position_enu_m < low_enu_m) | (position_enu_m > high_enu_m)",
                _LARGER,
            ),
            ("is_wrong = clearances_m((area,), position_enu_m) < 0.0", _SMALLER),
            ("if height_m[lowest] < least_m:", _SMALLER),
            ("if speed_m_s.max() > _SPEED_ROOM * vehicle.max_speed_m_s:", _LARGER),
            ("if max(speed_m_s[0], speed_m_s[-1]) > _REST_M_S:", _LARGER),
        ),
    ),
    Accepted(
        "it is looked at once more often",
        "flight/path_flight.py",
        (
            (
                "times_s = np.linspace(0.0, path.duration_s, 2 + int(_CHECK_HZ * path.duration_s))",
                "2 becomes larger",
            ),
        ),
    ),
    Accepted(
        "at full strength both ways give the same row",
        "avoidance/constraints.py",
        (("if strength >= 1.0:", "GtE becomes Gt"), ("if strength >= 1.0:", _LARGER_1)),
    ),
    Accepted(
        _MEASURED,
        "avoidance/constraints.py",
        (
            ("is_violated = hard.violation_m_s2 > VIOLATED_M_S2", _LARGER),
            ("if speed_m_s < _NO_INTENT_M_S or dot_xy(e, intent_m_s) >= 0.0:", _SMALLER),
            ("if speed_m_s < _NO_INTENT_M_S or dot_xy(e, intent_m_s) >= 0.0:", "GtE becomes Gt"),
            (
                "return -1.0 if cross_xy(e, deciding_m_s) < clearly_clockwise else 1.0",
                _SMALLER,
            ),
        ),
    ),
    Accepted(
        "the vertical window, and only the horizontal velocity is read",
        "avoidance/smoothing.py",
        (
            (
                "longer = predict_own(commands, _AT_REST, window_s + dt_s, 0.0).velocity_enu_m_s",
                "0.0 becomes larger",
            ),
            (
                "shorter = predict_own(commands, _AT_REST, window_s, 0.0).velocity_enu_m_s",
                "0.0 becomes larger",
            ),
        ),
    ),
    Accepted(
        _ROUNDING,
        "avoidance/projection.py",
        (
            ("is_inside = dot_xy(u, u) <= radius * radius * (1.0 + 1e-12)", "LtE becomes Lt"),
            ("if is_inside and largest_violation(u, hard) <= _TOLERANCE:", "LtE becomes Lt"),
            ("scale = 1.0", _LARGER_1),
            ("scale = max(scale, 1.0 + abs(row.bound_m_s2))", _LARGER_1),
            ("if apart > _ONE_POINT * scale:", _LARGER),
            (
                "violation = bound - normal.x * u.x - normal.y * u.y - EXACT * (1.0 + abs(bound))",
                _LARGER_1,
            ),
            ("if violation > most:", _LARGER),
            ("share = min(1.0, radius / max(length_xy(u), 1e-300))", "1e-300 becomes larger"),
            ("if not cost < best.cost or not in_disc(point, radius):", _SMALLER),
            (
                "if normal.x * point.x + normal.y * point.y < bound - _TOLERANCE * "
                "(1.0 + abs(bound)):",
                _SMALLER,
            ),
            (
                "if normal.x * point.x + normal.y * point.y < bound - _TOLERANCE * "
                "(1.0 + abs(bound)):",
                _LARGER_1,
            ),
        ),
    ),
    Accepted(
        "a row that is taken in without need changes no optimum",
        "avoidance/projection.py",
        (("taken = rows[:0]", "0 becomes larger"),),
    ),
    Accepted(_NONE, "avoidance/projection.py", (("worst = -1", "1 becomes larger"),)),
    Accepted(
        _ROUNDING,
        "avoidance/half_planes.py",
        (
            ("return u.x * u.x + u.y * u.y <= limit * limit", "LtE becomes Lt"),
            ("if size <= radius:", "LtE becomes Lt"),
            ("share = radius / max(size, 1e-12)", "1e-12 becomes larger"),
            ("if abs(det) <= EXACT:", "LtE becomes Lt"),
        ),
    ),
    Accepted(
        _ROUNDING,
        "avoidance/relaxation.py",
        (
            ("scale = 0.0", "0.0 becomes larger"),
            ("if rows[k].bound_m_s2 > rows[first].bound_m_s2:", _LARGER),
            ("most = slack + EXACT * (1.0 + scale)", _LARGER_1),
            ("if missing > most:", _LARGER),
            ("if slack < best:", _SMALLER),
            ("share = radius / max(length_xy(normal), 1e-300)", "1e-300 becomes larger"),
            ("if size <= _PARALLEL:", "LtE becomes Lt"),
        ),
    ),
    Accepted(
        "without obstacles there are no edges",
        "avoidance/oist.py",
        (("if len(obstacles) > 0:", _LARGER),),
    ),
    Accepted(
        _MEASURED,
        "avoidance/oist.py",
        (
            ("if length_xy(own.velocity_m_s) <= _STANDING_M_S:", "LtE becomes Lt"),
            ("intends_to_move = squared_intent_m2_s2 > _HELD_SQUARED_INTENT_M2_S2", _LARGER),
        ),
    ),
    Accepted(
        "an edge whose box is just touched is as far away as its row reaches, or farther",
        "avoidance/fence_edges.py",
        (
            ("if capsule.west_m <= east", "LtE becomes Lt"),
            ("and capsule.east_m >= west", "GtE becomes Gt"),
            ("and capsule.south_m <= north", "LtE becomes Lt"),
            ("and capsule.north_m >= south", "GtE becomes Gt"),
        ),
    ),
    Accepted(
        _MEASURED,
        "avoidance/fence_edges.py",
        (
            ("and capsule.low_m <= highest_m", "LtE becomes Lt"),
            ("and capsule.high_m >= lowest_m", "GtE becomes Gt"),
            (
                "near = [edge for edge in edges if edge.distance_m - edge.keep_m <= reach]",
                "LtE becomes Lt",
            ),
            ("if along < 0.0:", _SMALLER),
            ("elif along > 1.0:", _LARGER),
            ("if distance_m < _ON_EDGE_M:", _SMALLER),
            ("is_outside = beyond_m > 0.0", _LARGER),
            ("is_violated = hard.violation_m_s2 > VIOLATED_M_S2", _LARGER),
        ),
    ),
    Accepted(
        "on the line of an edge a vehicle is on the edge, or beyond a corner that decides",
        "avoidance/fence_edges.py",
        (("is_allowed = cross_xy(segment, offset) >= 0.0", "GtE becomes Gt"),),
    ),
    Accepted(
        "any negative number but that of nobody says that it is no vehicle",
        "avoidance/interface.py",
        (("NOT_A_VEHICLE = -2", "2 becomes larger"),),
    ),
    Accepted(
        "each fleet gives it; the gust margin gives the lag alone, and reads no more",
        "avoidance/params.py",
        (
            ("vertical_lag_s: float = 0.09", "0.09 becomes larger"),
            ("body_radius_m: float = 0.25", "0.25 becomes larger"),
            ("max_speed_m_s: float = 1.0", _LARGER_1),
            ("max_thrust_m_s2: float = 2.0 * GRAVITY_M_S2", "2.0 becomes larger"),
        ),
    ),
    Accepted(
        "obstacles have no distance of this kind, and each edge is given its own",
        "avoidance/params.py",
        (("keep_m: float = 0.0", "0.0 becomes larger"),),
    ),
    Accepted(
        _MEASURED,
        "avoidance/own_law.py",
        (
            ("if tilt_rad > limits.max_tilt_rad + _TILT_SLACK_RAD:", _LARGER),
            ("if across > by_motors_m_s2 + slack_m_s2:", _LARGER),
            ("if change_m_s2 > _CHANGED_M_S2:", _LARGER),
        ),
    ),
    Accepted(
        _MEASURED,
        "avoidance/own_law_runner.py",
        (("if duration_s > SLOW_S:", _LARGER), ("if duration_s > STOPPED_S:", _LARGER)),
    ),
    Accepted(
        "without a clock no duration is measured",
        "avoidance/own_law_runner.py",
        (("began_s = 0.0", "0.0 becomes larger"),),
    ),
    Accepted(
        _MEASURED,
        "avoidance/oist_paper.py",
        (
            (
                "if not (d_o2 > _COINCIDENT_2_M2 and math.isfinite(h_1) and math.isfinite(h_2)):",
                _LARGER,
            ),
        ),
    ),
    Accepted(
        "the law does not read it; the tests of the checks that do notice it",
        "avoidance/prediction.py",
        (("LAG_ERROR_S = 0.04", "0.04 becomes larger"),),
    ),
    Accepted(
        "a command that is older than any lag is kept, and not read",
        "avoidance/prediction.py",
        (("SLOTS = 40", "40 becomes larger"),),
    ),
    Accepted(
        "it only keeps an endless number out",
        "avoidance/prediction.py",
        (("LARGEST = 1e5", "100000.0 becomes larger"),),
    ),
    Accepted(
        "a lead of a millisecond is none",
        "avoidance/prediction.py",
        (("_MIN_LEAD_S = 1e-3", "0.001 becomes larger"),),
    ),
    Accepted(
        "a command of nothing changes nothing, however long it lasts",
        "avoidance/prediction.py",
        (("return [PastCommand(ZERO_3, 0.0)] * SLOTS", "0.0 becomes larger"),),
    ),
    Accepted(
        _ROUNDING,
        "avoidance/projection.py",
        (
            ("_ONE_POINT = 1e-4", "0.0001 becomes larger"),
            ("_WIDENINGS = (1e-12, 1e-10, 1e-8, 1e-6)", "1e-10 becomes larger"),
            ("_WIDENINGS = (1e-12, 1e-10, 1e-8, 1e-6)", "1e-08 becomes larger"),
            ("_WIDENINGS = (1e-12, 1e-10, 1e-8, 1e-6)", "1e-06 becomes larger"),
        ),
    ),
    Accepted(
        "it only keeps an endless number out: no height is uncertain by a kilometre",
        "avoidance/prediction.py",
        (("LARGEST_STD = 1e3", "1000.0 becomes larger"),),
    ),
    Accepted(
        "it only keeps zero out of a division: no fleet keeps a distance of a centimetre",
        "avoidance/pairs.py",
        (("_MIN_DISTANCE_M = 0.01", "0.01 becomes larger"),),
    ),
    Accepted(
        "a row without strength asks for no more than the thrust gives",
        "avoidance/constraints.py",
        (("if strength <= 0.0:", "LtE becomes Lt"),),
    ),
    Accepted(
        "at nearly one height the whole distance counts, whoever is above",
        "avoidance/heights.py",
        tuple(
            ("side = 1.0 if gap_ahead_m >= 0.0 else -1.0", change)
            for change in ("GtE becomes Gt", "0.0 becomes larger")
        )
        + tuple(
            ("towards_m = -own.intended_climb_m if gap_m >= 0.0 else own.intended_climb_m", change)
            for change in ("GtE becomes Gt", "0.0 becomes larger")
        ),
    ),
    Accepted(
        "the side is 1 or -1, and nothing between",
        "avoidance/heights.py",
        tuple(
            ("if not neighbour.is_cooperative and side < 0.0:", change)
            for change in (_SMALLER, "0.0 becomes larger")
        ),
    ),
    Accepted(
        _MEASURED,
        "avoidance/heights.py",
        (
            (
                "return abs(gap_m) >= spacing.vertical_separation_m and towards_m > TRANSITION_M",
                _LARGER,
            ),
        ),
    ),
    Accepted(
        "what is added then is nothing",
        "avoidance/prediction.py",
        (("if since_end_s >= window_s:", "GtE becomes Gt"), ("if ahead_s < 0.0:", _SMALLER)),
    ),
    Accepted(
        "a lead of a millisecond is none",
        "avoidance/prediction.py",
        (
            ("per_lead_1_s = 1.0 / lead_s if lead_s > _MIN_LEAD_S else 0.0", _LARGER),
            (
                "per_lead_1_s = 1.0 / lead_s if lead_s > _MIN_LEAD_S else 0.0",
                "0.0 becomes larger",
            ),
        ),
    ),
    Accepted(
        "ages from 0 on have been answered before",
        "avoidance/prediction.py",
        (
            ("if age_s < 0.0 and math.isfinite(age_s):", _SMALLER),
            ("if age_s < 0.0 and math.isfinite(age_s):", "0.0 becomes larger"),
        ),
    ),
    Accepted(
        "a later point takes its place: the middle is in every disc",
        "avoidance/relaxation.py",
        (("u = Vec2(0.0, 0.0)", "0.0 becomes larger"),),
    ),
    Accepted(
        _MEASURED,
        "avoidance/pairs.py",
        (
            ("if pair.distance_2_m2 < COINCIDENT_M * COINCIDENT_M:", _SMALLER),
            (
                "is_slow = dot_xy(theirs, theirs) <= SETTLED_M_S * SETTLED_M_S",
                "LtE becomes Lt",
            ),
            ("is_near=distance_2_m2 < 4.0 * d_m * d_m and not is_settled,", _SMALLER),
        ),
    ),
    Accepted(
        "a circle's segment has no length: nothing is divided",
        "avoidance/pairs.py",
        (
            (
                "divisor = squared_length_m2 if squared_length_m2 > 0.0 else 1.0",
                _LARGER_1,
            ),
        ),
    ),
    Accepted(_NONE, "avoidance/relaxation.py", (("worst = -1", "1 becomes larger"),)),
    Accepted(
        "a row that is taken in without need changes no optimum",
        "avoidance/relaxation.py",
        (("if worst < 0 or rows[worst] in taken:", "or becomes and"),),
    ),
)


def code_of(line: str) -> str:
    """Return a line of a file without its comment."""
    return line.partition("  # ")[0].strip()


REASONS = {
    (accepted.file, code, change): accepted.reason
    for accepted in ACCEPTED
    for code, change in accepted.mutants
}
