"""Trajectories to a goal, regardless of obstacles: quintics of bounded speed and acceleration.

A leg is the flight to one goal. Its first form is one quintic per axis, from the present setpoint
to rest at the goal. It continues the setpoint's position, velocity and acceleration. A quintic that
starts with an acceleration may exceed the bounds at any duration, and one that starts with a
velocity and takes long leads far past its goal. So there is a second form: it brakes to rest on the
shortest polynomial that keeps the bounds, and then flies a quintic from rest. The vehicle flies the
first form if it is sooner, keeps the bounds, and leads nowhere that the brake does not need. A
quintic from rest over the distance D in the time T has the peak speed 15/8 D/T and the peak
acceleration 10/sqrt(3) D/T^2.

A climb or descent ends at once if it would pass the height of the new goal, both on one quintic
and with a smooth brake. The baseline brakes harder than the bounds of a leg, and a climbing vehicle
that is ordered to land must not climb further.

A vehicle that passes above others rises within a level leg and comes down again before its end. The
rise is added to the leg's heights. It keeps the bounds on its own: its vertical speed and
acceleration are at most the leg's.

The setpoint of time t refers to t + lead_s, when a command given at t takes effect. A new leg
begins at the present setpoint. Its duration is shortened by lead_s, so that it ends on time.

A goal on a path already holds the path's motion at the time of the setpoint. This motion becomes
the setpoint unchanged, and the next leg continues it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.types import NO_SEQUENCE, Goal, TrajectorySetpoint
from onboard.vectors import ZERO_3, Vec3, add, add_scaled, is_finite, length, scaled, subtract

# Duration of a leg that has just begun: not 0, so that its setpoint is the motion of its start.
_ANY_DURATION_S = 1.0

# factors of D/T and D/T^2 that give the peak speed and acceleration of a quintic from rest to rest
PEAK_OF_MEAN_SPEED = 15.0 / 8.0
_ACCELERATION_FACTOR = 10.0 / math.sqrt(3.0)

# Durations to try, as factors of a first guess. They form a geometric series, from 0.35 to 8 for a
# brake and from 0.5 to 4 for a quintic straight to the goal.
_BRAKE_FACTORS: tuple[float, ...] = tuple(0.35 * (8.0 / 0.35) ** (k / 31.0) for k in range(32))
_DIRECT_FACTORS: tuple[float, ...] = tuple(0.5 * 8.0 ** (k / 31.0) for k in range(32))
# A quintic straight to the goal may take this much longer than a stop and a quintic from rest. The
# durations that are tried are 7 % apart, and a vehicle whose goal moves must not stop each time.
_DIRECT_TIME_FACTOR = 1.1
_SAMPLES = 40  # the bounds are tested at the ends of this many intervals of a quintic
_FITS = 1.0 + 1e-9  # because of rounding, a value divided by its bound may be this large

# No leg is shorter than this share of the time to full speed, so that a vehicle does not tilt for a
# goal that is only a few millimetres away.
_MIN_SHARE = 0.8

# A leg may lead astray by this share of the square of the top speed divided by the acceleration,
# which is twice the shortest way from the top speed to rest.
_ASTRAY_SHARE = 0.03

_LEVEL_M = 0.3  # a leg is level if the heights of its ends differ by at most this
_RISE_END_SHARE = 0.95  # share of a leg's time at which a rise has ended
_MIN_ABOVE_S = 1.0  # a leg does not rise if it would stay above for less than this time
_RISE_AHEAD_S = 1.0  # a vehicle announces the rise that it will have reached after this time


class TrajectoryParams(NamedTuple):
    """Bounds of the setpoint's motion."""

    max_speed_m_s: float = 1.0
    max_acceleration_m_s2: float = 1.5
    max_vertical_m_s2: float = math.inf  # limit of the vertical acceleration
    lead_s: float = 0.0  # time by which a tick's setpoint is ahead of the tick
    rise_m: float = 0.0  # height by which this vehicle rises in level legs; 0: it stays level
    highest_m: float = math.inf  # a leg that would rise above this height stays level


class TrajectoryMemory(NamedTuple):
    """The leg being flown: start -> via (at rest) -> goal."""

    start_position_enu_m: Vec3
    start_velocity_enu_m_s: Vec3
    start_acceleration_enu_m_s2: Vec3
    via_position_enu_m: Vec3
    goal_position_enu_m: Vec3
    first_duration_s: float  # from the start's motion to rest at via
    second_duration_s: float  # from via to the goal; 0 if via is the goal
    elapsed_s: float
    # rate of the clock at the last tick; it scales the setpoint's velocity, which a new leg starts
    # with
    clock_rate: float
    sequence: int  # sequence of the goal
    rise_m: float  # height by which the leg rises between its ends
    rise_s: float  # duration of the rise, and of the descent from it


class _Parts(NamedTuple):
    """The two parts of a leg, whose start and goal are known."""

    via_m: Vec3  # point at which the vehicle is at rest
    first_s: float  # duration of the part to that point
    second_s: float  # duration of the part from there to the goal; 0 if it is the goal


class _Quintic(NamedTuple):
    """A polynomial from a motion to rest at the end."""

    begin_m: Vec3
    velocity_m_s: Vec3
    acceleration_m_s2: Vec3
    end_m: Vec3
    duration_s: float


def initial(position_enu_m: Vec3) -> TrajectoryMemory:
    """Return the memory of a vehicle at rest at a position [m], ENU, that has no leg yet."""
    return TrajectoryMemory(
        start_position_enu_m=position_enu_m,
        start_velocity_enu_m_s=ZERO_3,
        start_acceleration_enu_m_s2=ZERO_3,
        via_position_enu_m=position_enu_m,
        goal_position_enu_m=position_enu_m,
        first_duration_s=0.0,
        second_duration_s=0.0,
        elapsed_s=0.0,
        clock_rate=1.0,
        sequence=NO_SEQUENCE,
        rise_m=0.0,
        rise_s=0.0,
    )


def leg_begun_with(
    position_enu_m: Vec3,
    velocity_enu_m_s: Vec3,
    acceleration_enu_m_s2: Vec3,
    sequence: int,
    clock_rate: float,
) -> TrajectoryMemory:
    """Return a leg that has just begun with a motion, so that the next leg continues it.

    Args:
        position_enu_m, velocity_enu_m_s, acceleration_enu_m_s2: the motion.
        sequence: sequence of the goal.
        clock_rate: rate of the path's clock, from 0 to 1.
    """
    return TrajectoryMemory(
        start_position_enu_m=position_enu_m,
        start_velocity_enu_m_s=velocity_enu_m_s,
        start_acceleration_enu_m_s2=acceleration_enu_m_s2,
        via_position_enu_m=position_enu_m,
        goal_position_enu_m=position_enu_m,
        first_duration_s=_ANY_DURATION_S,
        second_duration_s=0.0,
        elapsed_s=0.0,
        clock_rate=clock_rate,
        sequence=sequence,
        rise_m=0.0,
        rise_s=0.0,
    )


def moving(position_enu_m: Vec3, velocity_enu_m_s: Vec3) -> TrajectoryMemory:
    """Return the memory of a vehicle in motion, ENU [m, m/s], that has no leg yet.

    The leg to the next goal begins with this motion.
    """
    return leg_begun_with(position_enu_m, velocity_enu_m_s, ZERO_3, NO_SEQUENCE, 1.0)


def step(
    memory: TrajectoryMemory, goal: Goal, params: TrajectoryParams, dt_s: float, clock_rate: float
) -> tuple[TrajectoryMemory, TrajectorySetpoint]:
    """Return memory and setpoint after one tick along the leg.

    A new ``goal.sequence`` plans a new leg from the present setpoint.

    Args:
        memory: memory of the last tick.
        goal: present goal. A goal that is not finite is ignored, and the old leg continues.
        params: bounds.
        dt_s: length of the tick.
        clock_rate: rate of the trajectory's clock, in [0, 1]. It slows while the law holds the
            vehicle back (anti-windup). Velocity scales with it, and acceleration with its square.
            It must change smoothly.
    Returns:
        Memory, and the setpoint.
    Properties: at a clock rate of 1 continuous in position, velocity and acceleration, except for
        the height where a climb or descent ends at once; from rest the bounds hold exactly;
        equivariant under translation and rotation about the vertical; homogeneous in length and
        time; ends at rest on the goal.
    """
    if goal.is_on_path:
        return _on_path(goal)

    is_new = goal.sequence != memory.sequence
    if is_new and is_finite(goal.position_enu_m) and math.isfinite(goal.duration_s):
        memory = _planned(memory, goal, params)

    rate = 1.0
    if math.isfinite(clock_rate):
        rate = min(max(clock_rate, 0.0), 1.0)

    after = TrajectoryMemory(
        start_position_enu_m=memory.start_position_enu_m,
        start_velocity_enu_m_s=memory.start_velocity_enu_m_s,
        start_acceleration_enu_m_s2=memory.start_acceleration_enu_m_s2,
        via_position_enu_m=memory.via_position_enu_m,
        goal_position_enu_m=memory.goal_position_enu_m,
        first_duration_s=memory.first_duration_s,
        second_duration_s=memory.second_duration_s,
        elapsed_s=min(memory.elapsed_s + rate * dt_s, duration_s(memory)),
        clock_rate=rate,
        sequence=memory.sequence,
        rise_m=memory.rise_m,
        rise_s=memory.rise_s,
    )
    return after, setpoint(after)


def _on_path(goal: Goal) -> tuple[TrajectoryMemory, TrajectorySetpoint]:
    """Return the path's motion, as a leg that has just started with it."""
    memory = leg_begun_with(
        goal.position_enu_m,
        goal.velocity_enu_m_s,
        goal.acceleration_enu_m_s2,
        goal.sequence,
        min(max(goal.clock_rate_frac, 0.0), 1.0),
    )
    return memory, setpoint(memory)


def setpoint(memory: TrajectoryMemory) -> TrajectorySetpoint:
    """Return the setpoint at the leg's present time."""
    leg, tau = _present(memory)
    position = _position(leg, tau)
    velocity = _velocity(leg, tau)
    acceleration = _acceleration(leg, tau)

    if memory.rise_m > 0.0:
        rise, rise_tau = _rise(memory, memory.elapsed_s)
        position = add(position, _position(rise, rise_tau))
        velocity = add(velocity, _velocity(rise, rise_tau))
        acceleration = add(acceleration, _acceleration(rise, rise_tau))

    rate = memory.clock_rate
    return TrajectorySetpoint(position, scaled(rate, velocity), scaled(rate * rate, acceleration))


def setpoint_position(memory: TrajectoryMemory) -> Vec3:
    """Return only the position of the setpoint [m], ENU."""
    leg, tau = _present(memory)
    position = _position(leg, tau)
    return Vec3(position.x, position.y, position.z + _risen_m(memory, memory.elapsed_s))


def rise_soon_m(memory: TrajectoryMemory) -> float:
    """Return the height above the level leg [m] that is reached soon at a clock rate of 1."""
    return _risen_m(memory, memory.elapsed_s + _RISE_AHEAD_S)


def _risen_m(memory: TrajectoryMemory, elapsed_s: float) -> float:
    """Return the height above the level leg at a time after its start."""
    if memory.rise_m == 0.0:
        return 0.0
    rise, tau = _rise(memory, elapsed_s)
    return _position(rise, tau).z


def _rise(memory: TrajectoryMemory, elapsed_s: float) -> tuple[_Quintic, float]:
    """Return the motion above the level leg at a time after its start, and the share of it flown.

    The motion is a quintic up. When the vehicle comes down again, it is another quintic down.
    """
    begin_m = ZERO_3
    end_m = Vec3(0.0, 0.0, memory.rise_m)
    since_s = elapsed_s

    down_s = _RISE_END_SHARE * duration_s(memory) - memory.rise_s
    if elapsed_s > down_s:
        begin_m, end_m = end_m, begin_m
        since_s = elapsed_s - down_s

    rise = _Quintic(
        begin_m=begin_m,
        velocity_m_s=ZERO_3,
        acceleration_m_s2=ZERO_3,
        end_m=end_m,
        duration_s=memory.rise_s,
    )
    return rise, min(since_s / memory.rise_s, 1.0)


def _present(memory: TrajectoryMemory) -> tuple[_Quintic, float]:
    """Return the quintic being flown and the share of its duration that has passed."""
    elapsed_s = memory.elapsed_s
    if elapsed_s < memory.first_duration_s:
        leg = _Quintic(
            begin_m=memory.start_position_enu_m,
            velocity_m_s=memory.start_velocity_enu_m_s,
            acceleration_m_s2=memory.start_acceleration_enu_m_s2,
            end_m=memory.via_position_enu_m,
            duration_s=memory.first_duration_s,
        )
    else:
        elapsed_s -= memory.first_duration_s
        # a leg without duration goes nowhere, so any duration but 0 gives the same setpoint
        second_s = 1.0
        if memory.second_duration_s > 0.0:
            second_s = memory.second_duration_s
        leg = _Quintic(
            begin_m=memory.via_position_enu_m,
            velocity_m_s=ZERO_3,
            acceleration_m_s2=ZERO_3,
            end_m=memory.goal_position_enu_m,
            duration_s=second_s,
        )
    return leg, min(elapsed_s / leg.duration_s, 1.0)


def duration_s(memory: TrajectoryMemory) -> float:
    """Return the duration of the whole leg."""
    return memory.first_duration_s + memory.second_duration_s


def shortest_duration_s(distance_m: float, climb_m: float, params: TrajectoryParams) -> float:
    """Return the shortest duration [s] of a leg from rest to rest that keeps the bounds.

    A tiny leg takes longer than the bounds require (see _MIN_SHARE).

    Args:
        distance_m: distance from start to end.
        climb_m: height of the end above the start; negative for a descent.
        params: bounds.
    """
    speed_m_s = params.max_speed_m_s
    acceleration_m_s2 = params.max_acceleration_m_s2
    by_speed_s = PEAK_OF_MEAN_SPEED * distance_m / speed_m_s
    by_acceleration_s = math.sqrt(_ACCELERATION_FACTOR * distance_m / acceleration_m_s2)
    by_climb_s = math.sqrt(_ACCELERATION_FACTOR * abs(climb_m) / params.max_vertical_m_s2)
    least_s = _MIN_SHARE * speed_m_s / acceleration_m_s2
    return max(by_speed_s, by_acceleration_s, by_climb_s, least_s)


# The quintic at tau = t/duration in [0, 1] is a sum of three polynomials: of the displacement, the
# initial velocity and the initial acceleration. They have short forms with r = 1 - tau.


def _position(leg: _Quintic, tau: float) -> Vec3:
    t = leg.duration_s
    r = 1.0 - tau
    r_3 = r * r * r
    tau_2 = tau * tau

    along = tau_2 * tau * (10.0 - 15.0 * tau + 6.0 * tau_2)
    by_velocity = t * (tau * r_3 * (1.0 + 3.0 * tau))
    by_acceleration = t * t * (0.5 * tau_2 * r_3)

    position = add_scaled(leg.begin_m, along, subtract(leg.end_m, leg.begin_m))
    position = add_scaled(position, by_velocity, leg.velocity_m_s)
    return add_scaled(position, by_acceleration, leg.acceleration_m_s2)


def _velocity(leg: _Quintic, tau: float) -> Vec3:
    t = leg.duration_s
    r = 1.0 - tau
    r_2 = r * r
    tau_2 = tau * tau

    along = 30.0 * tau_2 * r_2 / t
    by_velocity = r_2 * (1.0 + 2.0 * tau - 15.0 * tau_2)
    by_acceleration = t * (0.5 * tau * r_2 * (2.0 - 5.0 * tau))

    velocity = scaled(along, subtract(leg.end_m, leg.begin_m))
    velocity = add_scaled(velocity, by_velocity, leg.velocity_m_s)
    return add_scaled(velocity, by_acceleration, leg.acceleration_m_s2)


def _acceleration(leg: _Quintic, tau: float) -> Vec3:
    t = leg.duration_s
    r = 1.0 - tau

    along = 60.0 * tau * r * (1.0 - 2.0 * tau) / (t * t)
    by_velocity = tau * r * (60.0 * tau - 36.0) / t
    by_acceleration = r * (1.0 - 8.0 * tau + 10.0 * tau * tau)

    acceleration = scaled(along, subtract(leg.end_m, leg.begin_m))
    acceleration = add_scaled(acceleration, by_velocity, leg.velocity_m_s)
    return add_scaled(acceleration, by_acceleration, leg.acceleration_m_s2)


def _excess(leg: _Quintic, params: TrajectoryParams, enough: float) -> float:
    """Return the largest of speed and accelerations along a quintic, each divided by its bound.

    The search stops early at the first value beyond ``enough``, which is then returned.
    """
    excess = 0.0
    for k in range(_SAMPLES + 1):
        tau = k / _SAMPLES
        excess = max(excess, length(_velocity(leg, tau)) / params.max_speed_m_s)
        acceleration = _acceleration(leg, tau)
        excess = max(excess, length(acceleration) / params.max_acceleration_m_s2)
        excess = max(excess, abs(acceleration.z) / params.max_vertical_m_s2)
        if excess > enough:
            break
    return excess


def _planned(memory: TrajectoryMemory, goal: Goal, params: TrajectoryParams) -> TrajectoryMemory:
    """Return the memory with a new leg from the present setpoint."""
    target = goal.position_enu_m
    ordered_s = 0.0  # 0: the order names no duration
    if goal.duration_s > 0.0:
        ordered_s = max(goal.duration_s - params.lead_s, 0.0)

    # A climb or a descent that leads past the goal ends at once, unless one quintic to the goal
    # does not.
    start = setpoint(memory)
    direct_s = 0.0  # duration of one quintic to the goal, the first form; 0: none
    if _leads_past(start, target, params):
        direct_s = _climb_to_rest_s(start, target, ordered_s, params)
        if direct_s == 0.0:
            start = _levelled(start, target, params)

    parts = _brake_and_quintic(start, target, ordered_s, params)
    if direct_s == 0.0 and not _is_at_rest(start, params):
        direct_s = _sooner_direct_s(start, target, parts, ordered_s, params)
    if direct_s > 0.0:
        parts = _Parts(via_m=target, first_s=direct_s, second_s=0.0)

    rise_m = 0.0
    whole_s = parts.first_s + parts.second_s
    if _rises(start.position_enu_m.z, target.z, whole_s, params):
        rise_m = params.rise_m
    return TrajectoryMemory(
        start_position_enu_m=start.position_enu_m,
        start_velocity_enu_m_s=start.velocity_enu_m_s,
        start_acceleration_enu_m_s2=start.acceleration_enu_m_s2,
        via_position_enu_m=parts.via_m,
        goal_position_enu_m=target,
        first_duration_s=parts.first_s,
        second_duration_s=parts.second_s,
        elapsed_s=0.0,
        clock_rate=memory.clock_rate,
        sequence=goal.sequence,
        rise_m=rise_m,
        rise_s=_rise_duration_s(params),
    )


def _levelled(
    start: TrajectorySetpoint, target: Vec3, params: TrajectoryParams
) -> TrajectorySetpoint:
    """Return a motion without its climb or descent.

    The setpoint is lead_s ahead of the vehicle. Its height becomes that of the goal, clipped to the
    range from the vehicle's height to the setpoint's height.
    """
    p = start.position_enu_m
    v = start.velocity_enu_m_s
    a = start.acceleration_enu_m_s2

    vehicle_z_m = p.z - params.lead_s * v.z
    low_m = min(vehicle_z_m, p.z)
    high_m = max(vehicle_z_m, p.z)
    return TrajectorySetpoint(
        Vec3(p.x, p.y, min(max(target.z, low_m), high_m)),
        Vec3(v.x, v.y, 0.0),
        Vec3(a.x, a.y, 0.0),
    )


def _brake_and_quintic(
    start: TrajectorySetpoint, target: Vec3, ordered_s: float, params: TrajectoryParams
) -> _Parts:
    """Return the second form: a brake to rest, unless it is at rest, and a quintic to the goal."""
    via = start.position_enu_m
    first_s = 0.0
    if not _is_at_rest(start, params):
        first_s = _brake_duration_s(start, params)
        via = _stop(start, first_s)

    second_s = 0.0
    if via != target:
        way = subtract(target, via)
        from_rest_s = shortest_duration_s(length(way), way.z, params)
        second_s = max(from_rest_s, ordered_s - first_s, 0.0)
    return _Parts(via_m=via, first_s=first_s, second_s=second_s)


def _sooner_direct_s(
    start: TrajectorySetpoint,
    target: Vec3,
    parts: _Parts,
    ordered_s: float,
    params: TrajectoryParams,
) -> float:
    """Return the duration [s] of one quintic to the goal that is sooner than the second form.

    Return 0 if there is none.
    """
    guess = _direct_guess(start, target, params)
    longest_s = max(_DIRECT_TIME_FACTOR * (parts.first_s + parts.second_s), ordered_s)
    return _direct_duration_s(guess, parts.via_m, ordered_s, longest_s, params)


def _is_at_rest(start: TrajectorySetpoint, params: TrajectoryParams) -> bool:
    """Return whether a motion is at rest."""
    max_m_s = params.max_speed_m_s
    max_m_s2 = params.max_acceleration_m_s2
    is_slow = length(start.velocity_enu_m_s) <= 1e-9 * max_m_s
    return is_slow and length(start.acceleration_enu_m_s2) <= 1e-9 * max_m_s2


def _time_to_rest_s(v: Vec3, params: TrajectoryParams) -> float:
    """Return about the shortest time [s] from a velocity to rest, and never a very short one."""
    speed_m_s = max(length(v), _MIN_SHARE * params.max_speed_m_s)
    return max(speed_m_s / params.max_acceleration_m_s2, abs(v.z) / params.max_vertical_m_s2)


def _direct_guess(start: TrajectorySetpoint, target: Vec3, params: TrajectoryParams) -> _Quintic:
    """Return the quintic from a motion straight to a goal, with a first guess of its duration."""
    way = subtract(target, start.position_enu_m)
    from_rest_s = shortest_duration_s(length(way), way.z, params)
    to_rest_s = _time_to_rest_s(start.velocity_enu_m_s, params)
    return _Quintic(
        begin_m=start.position_enu_m,
        velocity_m_s=start.velocity_enu_m_s,
        acceleration_m_s2=start.acceleration_enu_m_s2,
        end_m=target,
        duration_s=max(from_rest_s, to_rest_s),
    )


def _climb_to_rest_s(
    start: TrajectorySetpoint, target: Vec3, ordered_s: float, params: TrajectoryParams
) -> float:
    """Return the duration [s] of one quintic to a goal that a climb or descent leads to.

    The quintic does not pass the height of the goal. It may need a shorter way than a brake, which
    comes to rest as if there were no goal. Return 0 if there is none, or if the goal's height is
    behind.
    """
    if (target.z - start.position_enu_m.z) * start.velocity_enu_m_s.z <= 0.0:
        return 0.0
    guess = _direct_guess(start, target, params)
    return _direct_duration_s(guess, target, ordered_s, math.inf, params)


def _rises(begin_m: float, end_m: float, whole_s: float, params: TrajectoryParams) -> bool:
    """Whether a leg between two heights rises: it is level, long enough, and below the ceiling."""
    if params.rise_m == 0.0 or abs(end_m - begin_m) > _LEVEL_M:
        return False
    if max(begin_m, end_m) + params.rise_m > params.highest_m:
        return False
    above_s = _RISE_END_SHARE * whole_s - 2.0 * _rise_duration_s(params)
    return above_s >= _MIN_ABOVE_S


def _rise_duration_s(params: TrajectoryParams) -> float:
    """Return the duration [s] of a rise within a level leg, and of the descent from it."""
    return shortest_duration_s(params.rise_m, params.rise_m, params)


def _leads_past(start: TrajectorySetpoint, target: Vec3, params: TrajectoryParams) -> bool:
    """Whether a climb or a descent would pass the goal's height even with a smooth brake."""
    height_m = start.position_enu_m.z
    climb_m_s = start.velocity_enu_m_s.z
    # braking distance of the polynomial from :func:`_brake`, with the sign of the climb
    brake_m_s2 = min(params.max_acceleration_m_s2, params.max_vertical_m_s2)
    brake_m = 0.75 * climb_m_s * abs(climb_m_s) / brake_m_s2
    return (target.z - height_m - brake_m) * climb_m_s < 0.0


def _stop(start: TrajectorySetpoint, duration: float) -> Vec3:
    """Return the position [m] at which the brake polynomial of lowest degree comes to rest."""
    after_velocity = add_scaled(start.position_enu_m, duration / 2.0, start.velocity_enu_m_s)
    return add_scaled(after_velocity, duration * duration / 12.0, start.acceleration_enu_m_s2)


def _brake(start: TrajectorySetpoint, duration: float) -> _Quintic:
    """Return the brake polynomial of lowest degree from a motion to rest."""
    return _Quintic(
        begin_m=start.position_enu_m,
        velocity_m_s=start.velocity_enu_m_s,
        acceleration_m_s2=start.acceleration_enu_m_s2,
        end_m=_stop(start, duration),
        duration_s=duration,
    )


def _brake_duration_s(start: TrajectorySetpoint, params: TrajectoryParams) -> float:
    """Return the duration [s] of the shortest brake that keeps the bounds.

    If no brake keeps them, return the duration of the brake that exceeds them least.
    """
    scale_s = _time_to_rest_s(start.velocity_enu_m_s, params)
    for factor in _BRAKE_FACTORS:
        t = factor * scale_s
        if _excess(_brake(start, t), params, _FITS) <= _FITS:
            return t

    best_s = 0.0
    least_excess = math.inf
    for factor in _BRAKE_FACTORS:
        t = factor * scale_s
        excess = _excess(_brake(start, t), params, least_excess)
        if excess < least_excess:
            best_s = t
            least_excess = excess
    return best_s


def _direct_duration_s(
    guess: _Quintic, stop_m: Vec3, ordered_s: float, longest_s: float, params: TrajectoryParams
) -> float:
    """Return the duration [s] of the shortest quintic straight to the goal within the bounds.

    Return 0 if no such quintic is as short as ``longest_s``, or if it leads astray.

    Args:
        guess: the quintic with a first guess of its duration.
        stop_m: position at which a brake would come to rest.
        ordered_s: shortest duration.
        longest_s: longest duration.
        params: bounds.
    """
    for factor in _DIRECT_FACTORS:
        t = max(factor * guess.duration_s, ordered_s)
        if t > longest_s:
            return 0.0

        leg = _Quintic(
            begin_m=guess.begin_m,
            velocity_m_s=guess.velocity_m_s,
            acceleration_m_s2=guess.acceleration_m_s2,
            end_m=guess.end_m,
            duration_s=t,
        )
        if _excess(leg, params, _FITS) > _FITS:
            continue
        if _leads_astray(leg, stop_m, params):  # and a longer one farther
            return 0.0
        return t
    return 0.0


def _leads_astray(leg: _Quintic, stop_m: Vec3, params: TrajectoryParams) -> bool:
    """Return whether a quintic leads where neither its ends nor a brake at its start lead.

    Its heights are between those of its start, its goal and the stop of the brake. Horizontally, it
    passes its goal by no more than the brake, and is nowhere farther from the goal than its start
    or the stop.
    """
    room_m = _ASTRAY_SHARE * params.max_speed_m_s**2 / params.max_acceleration_m_s2
    lowest_m = min(leg.begin_m.z, leg.end_m.z, stop_m.z) - room_m
    highest_m = max(leg.begin_m.z, leg.end_m.z, stop_m.z) + room_m

    to_goal = subtract(leg.end_m, leg.begin_m)
    to_stop = subtract(stop_m, leg.begin_m)
    way_m = math.hypot(to_goal.x, to_goal.y)
    stop_from_goal_m = math.hypot(leg.end_m.x - stop_m.x, leg.end_m.y - stop_m.y)
    farthest_m = max(way_m, stop_from_goal_m) + room_m
    brake_past_m2 = to_goal.x * to_stop.x + to_goal.y * to_stop.y
    past_m2 = max(way_m * way_m, brake_past_m2) + room_m * way_m

    for k in range(_SAMPLES + 1):
        at = _position(leg, k / _SAMPLES)
        if not lowest_m <= at.z <= highest_m:
            return True

        along_m2 = to_goal.x * (at.x - leg.begin_m.x) + to_goal.y * (at.y - leg.begin_m.y)
        from_goal_m = math.hypot(at.x - leg.end_m.x, at.y - leg.end_m.y)
        if along_m2 > past_m2 or from_goal_m > farthest_m:
            return True
    return False
