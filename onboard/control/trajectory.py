"""Trajectories to a goal, without regard to obstacles: quintics with bounded speed and acceleration.

A leg is one quintic per axis from the present setpoint (position, velocity, acceleration, so the new leg continues the
old one) to rest at the goal. A quintic that starts with acceleration overshoots the bounds when it is made longer, so
there is a second form: brake to rest on the shortest polynomial that keeps the bounds, then a quintic from rest. The
shorter of the two that keeps the bounds is flown. From rest the bounds have the closed form used below:
peak speed 15/8 D/T, peak acceleration 10/sqrt(3) D/T^2.

Time: the setpoint published at time t refers to t + lead_s, the time at which a command given now acts; a leg that is
ordered now begins at the setpoint published now, and lead_s is taken off its duration, so that it ends when asked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from onboard.control import kernel_motion
from onboard.types import Array, Goal, IntArray, TrajectorySetpoint, light

_NO_SEQUENCE = np.iinfo(np.int64).min
_SPEED_FACTOR = 15.0 / 8.0
_ACCELERATION_FACTOR = 10.0 / math.sqrt(3.0)
_BRAKE_FACTORS = np.geomspace(0.35, 8.0, 32)
_DIRECT_FACTORS = np.geomspace(0.5, 4.0, 32)
_TIMES = np.linspace(0.0, 1.0, 41)


@dataclass(frozen=True, slots=True)
class GuidanceParams:
    """max_speed_m_s, max_acceleration_m_s2 (...): bounds of the setpoint's norm. lead_s (...): see the module."""

    max_speed_m_s: Array | float = 1.0
    max_acceleration_m_s2: Array | float = 1.5
    lead_s: Array | float = 0.0


@light
@dataclass(frozen=True, slots=True)
class GuidanceMemory:
    """The leg being flown: start -> via (at rest) -> goal, (..., 3) and (...).

    first_duration_s leads from the start's motion to rest at via, second_duration_s from via to the goal (0 when via is
    the goal). clock_rate: of the last tick, because the published velocity is what a new leg has to continue.
    """

    start_position_enu_m: Array
    start_velocity_enu_m_s: Array
    start_acceleration_enu_m_s2: Array
    via_position_enu_m: Array
    goal_position_enu_m: Array
    first_duration_s: Array
    second_duration_s: Array
    elapsed_s: Array
    clock_rate: Array
    sequence: IntArray

    @property
    def duration_s(self) -> Array:
        """Of the whole leg, (...)."""
        return np.asarray(self.first_duration_s + self.second_duration_s)


def initial(position_enu_m: Array) -> GuidanceMemory:
    """At rest at a position (..., 3), without a leg: the next goal is planned whatever it is."""
    position = np.array(position_enu_m, dtype=np.float64)
    shape = position.shape[:-1]
    zero, still = np.zeros(shape), np.zeros_like(position)
    return GuidanceMemory(
        position,
        still,
        still,
        position,
        position,
        zero,
        zero,
        zero,
        np.ones(shape),
        np.full(shape, _NO_SEQUENCE),
    )


def reset(memory: GuidanceMemory, position_enu_m: Array) -> GuidanceMemory:
    """Re-anchored at rest at a position (..., 3), for instance on the ground; rows not finite rest where they are."""
    position = np.asarray(position_enu_m, dtype=np.float64)
    finite = np.asarray(np.isfinite(position).all(axis=-1))
    return initial(np.where(finite[..., None], position, setpoint(memory).position_enu_m))


def step(
    memory: GuidanceMemory,
    goal: Goal,
    *,
    params: GuidanceParams,
    dt_s: float,
    clock_rate: Array | float = 1.0,
) -> tuple[GuidanceMemory, TrajectorySetpoint]:
    """One tick along the leg; a new ``goal.sequence`` plans anew from the present setpoint.

    Args:
        goal: position (..., 3), duration (...) [s] (0 = as fast as the bounds allow, never faster than they allow),
            sequence (...). Rows that are not finite are ignored: the old leg goes on.
        clock_rate: (...) in [0, 1], slows the trajectory's clock while the law holds the vehicle back (anti-windup);
            velocity scales with it and acceleration with its square. Change it smoothly.
    Returns:
        memory and the setpoint (..., 3) each.
    Properties: continuous in position, velocity and acceleration at a clock rate of 1; from rest the bounds hold
        exactly; rotation- and translation-equivariant; homogeneous in length and time; ends at rest on the goal.
    """
    memory = planned(memory, goal, params=params)
    if memory.elapsed_s.ndim == 0:
        pace = float(clock_rate)
        pace = min(max(pace, 0.0), 1.0) if math.isfinite(pace) else 1.0
        whole = float(memory.first_duration_s) + float(memory.second_duration_s)
        elapsed = np.array(min(float(memory.elapsed_s) + pace * dt_s, whole))
        memory = replace(memory, elapsed_s=elapsed, clock_rate=np.array(pace))
        return memory, setpoint(memory)
    rate = np.minimum(np.maximum(np.asarray(clock_rate, dtype=np.float64), 0.0), 1.0)
    rate = np.broadcast_to(np.where(np.isfinite(rate), rate, 1.0), memory.elapsed_s.shape)
    total = memory.first_duration_s + memory.second_duration_s
    memory = replace(
        memory,
        elapsed_s=np.minimum(memory.elapsed_s + rate * dt_s, total),
        clock_rate=rate,
    )
    return memory, setpoint(memory)


def planned(memory: GuidanceMemory, goal: Goal, *, params: GuidanceParams) -> GuidanceMemory:
    """The legs after a look at the goals: rows with a new, finite one begin a leg from their present setpoint."""
    fresh = np.asarray(goal.sequence != memory.sequence)
    if fresh.any() if fresh.ndim else fresh:
        usable = fresh & np.isfinite(goal.position_enu_m).all(axis=-1) & np.isfinite(goal.duration_s)
        if usable.any():
            return _replan(memory, goal, np.asarray(usable), params)
    return memory


def setpoint(memory: GuidanceMemory) -> TrajectorySetpoint:
    """The setpoint at the leg's present time, (..., 3) each."""
    if memory.elapsed_s.ndim == 0:
        return _setpoint_one(memory)
    second = memory.elapsed_s >= memory.first_duration_s
    second3 = second[..., None]
    begin = np.where(second3, memory.via_position_enu_m, memory.start_position_enu_m)
    end = np.where(second3, memory.goal_position_enu_m, memory.via_position_enu_m)
    speed = np.where(second3, 0.0, memory.start_velocity_enu_m_s)
    push = np.where(second3, 0.0, memory.start_acceleration_enu_m_s2)
    duration = np.where(second, memory.second_duration_s, memory.first_duration_s)
    elapsed = memory.elapsed_s - np.where(second, memory.first_duration_s, 0.0)
    duration = np.where(duration > 0.0, duration, 1.0)  # a leg without duration goes nowhere: any value will do
    tau = np.minimum(elapsed / duration, 1.0)
    position, velocity, acceleration = _quintic(begin, speed, push, end, duration[..., None], tau[..., None])
    rate = memory.clock_rate[..., None]
    return TrajectorySetpoint(position, rate * velocity, rate * rate * acceleration)


def _setpoint_one(memory: GuidanceMemory) -> TrajectorySetpoint:
    """:func:`setpoint` for one vehicle, in floats."""
    elapsed, first = float(memory.elapsed_s), float(memory.first_duration_s)
    if elapsed >= first:
        begin, end = memory.via_position_enu_m.tolist(), memory.goal_position_enu_m.tolist()
        speed, push = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        duration, elapsed = float(memory.second_duration_s), elapsed - first
    else:
        begin, end = memory.start_position_enu_m.tolist(), memory.via_position_enu_m.tolist()
        speed, push = memory.start_velocity_enu_m_s.tolist(), memory.start_acceleration_enu_m_s2.tolist()
        duration = first
    duration = duration if duration > 0.0 else 1.0
    tau, rate = min(elapsed / duration, 1.0), float(memory.clock_rate)
    position, velocity, acceleration = np.array(kernel_motion.quintic(begin, speed, push, end, duration, tau, rate))
    return TrajectorySetpoint(position, velocity, acceleration)


def is_finished(memory: GuidanceMemory) -> Array:
    """Whether the setpoint rests on the goal, (...)."""
    return np.asarray(memory.elapsed_s >= memory.duration_s)


def shortest_duration_s(distance_m: Array | float, params: GuidanceParams) -> Array:
    """Duration of a leg from rest to rest over a distance (...) at the bounds, (...)."""
    distance = np.asarray(distance_m, dtype=np.float64)
    by_speed = _SPEED_FACTOR * distance / params.max_speed_m_s
    by_acceleration = np.sqrt(_ACCELERATION_FACTOR * distance / params.max_acceleration_m_s2)
    return np.asarray(np.maximum(by_speed, by_acceleration))


def _quintic(
    begin: Array,
    velocity: Array,
    acceleration: Array,
    end: Array,
    duration: Array,
    tau: Array,
) -> tuple[Array, Array, Array]:
    """Quintic from (begin, velocity, acceleration) to (end, 0, 0) over ``duration``, at tau = t/duration in [0, 1].

    Position, velocity, acceleration, broadcast over all arguments. Seen from the end, with r = 1 - tau, the three
    polynomials of displacement, initial velocity and initial acceleration have short forms.
    """
    r = 1.0 - tau
    r2, r3, t2 = r * r, r * r * r, tau * tau
    way = end - begin
    gone = t2 * tau * (10.0 - 15.0 * tau + 6.0 * t2)
    position = begin + way * gone + duration * velocity * (tau * r3 * (1.0 + 3.0 * tau))
    position = position + duration * duration * acceleration * (0.5 * t2 * r3)
    rate = way / duration * (30.0 * t2 * r2) + velocity * (r2 * (1.0 + 2.0 * tau - 15.0 * t2))
    rate = rate + duration * acceleration * (0.5 * tau * r2 * (2.0 - 5.0 * tau))
    bend = way / (duration * duration) * (60.0 * tau * r * (1.0 - 2.0 * tau))
    bend = (
        bend
        + velocity / duration * (tau * r * (60.0 * tau - 36.0))
        + acceleration * (r * (1.0 - 8.0 * tau + 10.0 * t2))
    )
    return position, rate, bend


def _excess(
    p: Array,
    v: Array,
    a: Array,
    end: Array,
    duration: Array,
    params: tuple[Array, Array],
) -> Array:
    """Largest of speed/bound and acceleration/bound over the quintic; leading axes (M, C), vectors (M, C, 3)."""
    _, rate, bend = _quintic(
        p[:, :, None],
        v[:, :, None],
        a[:, :, None],
        end[:, :, None],
        duration[:, :, None, None],
        _TIMES[:, None],
    )
    speed = np.sqrt((rate * rate).sum(axis=-1)).max(axis=-1)
    force = np.sqrt((bend * bend).sum(axis=-1)).max(axis=-1)
    return np.asarray(np.maximum(speed / params[0], force / params[1]))


def _replan(memory: GuidanceMemory, goal: Goal, rows: Array, params: GuidanceParams) -> GuidanceMemory:
    """The memory with new legs in ``rows`` (...) from the present setpoint; the other rows untouched."""
    shape = memory.elapsed_s.shape
    index = np.flatnonzero(rows)
    now = setpoint(memory)

    def pick(values: Array | float) -> Array:
        return np.broadcast_to(np.asarray(values, dtype=np.float64), shape).reshape(-1)[index]

    def pick3(values: Array) -> Array:
        return np.broadcast_to(values, (*shape, 3)).reshape(-1, 3)[index]

    p, v, a = (
        pick3(now.position_enu_m),
        pick3(now.velocity_enu_m_s),
        pick3(now.acceleration_enu_m_s2),
    )
    target = pick3(goal.position_enu_m)
    top, push = pick(params.max_speed_m_s), pick(params.max_acceleration_m_s2)
    asked = np.maximum(
        pick(goal.duration_s) - np.where(pick(goal.duration_s) > 0.0, pick(params.lead_s), 0.0),
        0.0,
    )
    bounds = GuidanceParams(top, push)
    speed, force = np.sqrt((v * v).sum(-1)), np.sqrt((a * a).sum(-1))
    at_rest = (speed <= 1e-9 * top) & (force <= 1e-9 * push)

    # brake first, then from rest; from rest the brake is void
    # the floor keeps the jerk of a change of mind at low speed moderate
    scale = np.maximum(speed, 0.8 * top) / push
    brake = scale[:, None] * _BRAKE_FACTORS
    stop = p[:, None] + brake[..., None] * (v[:, None] / 2.0) + (brake * brake)[..., None] * (a[:, None] / 12.0)
    limits = (top[:, None], push[:, None])
    first = np.ones_like(brake)
    excess = _excess(
        p[:, None] * first[..., None],
        v[:, None] * first[..., None],
        a[:, None] * first[..., None],
        stop,
        brake,
        limits,
    )
    fits = excess <= 1.0 + 1e-9
    choice = np.where(fits.any(-1), fits.argmax(-1), excess.argmin(-1))
    row = np.arange(index.size)
    t1 = np.where(at_rest, 0.0, brake[row, choice])
    via = np.where(at_rest[:, None], p, stop[row, choice])
    t2 = np.maximum(shortest_duration_s(np.sqrt(((target - via) ** 2).sum(-1)), bounds), asked - t1)
    t2 = np.where(np.abs(target - via).max(-1) > 0.0, np.maximum(t2, 0.0), 0.0)

    # one quintic straight to the goal, when one within the bounds is not longer
    guess = np.maximum(
        shortest_duration_s(np.sqrt(((target - p) ** 2).sum(-1)), bounds),
        scale,
    )
    direct = np.maximum(guess[:, None] * _DIRECT_FACTORS, asked[:, None])
    ends = target[:, None] * np.ones_like(direct)[..., None]
    excess = _excess(
        p[:, None] * np.ones_like(ends),
        v[:, None] * np.ones_like(ends),
        a[:, None] * np.ones_like(ends),
        ends,
        direct,
        limits,
    )
    fits = excess <= 1.0 + 1e-9
    straight = direct[row, fits.argmax(-1)]
    use = fits.any(-1) & ~at_rest & (straight <= np.maximum(t1 + t2, asked))
    t1, t2 = np.where(use, straight, t1), np.where(use, 0.0, t2)
    via = np.where(use[:, None], target, via)

    def put(old: Array, new: Array) -> Array:
        out = np.array(old, dtype=np.float64).reshape(-1)
        out[index] = new
        return out.reshape(shape)

    def put3(old: Array, new: Array) -> Array:
        out = np.array(np.broadcast_to(old, (*shape, 3)), dtype=np.float64).reshape(-1, 3)
        out[index] = new
        return out.reshape(*shape, 3)

    return GuidanceMemory(
        put3(memory.start_position_enu_m, p),
        put3(memory.start_velocity_enu_m_s, v),
        put3(memory.start_acceleration_enu_m_s2, a),
        put3(memory.via_position_enu_m, via),
        put3(memory.goal_position_enu_m, target),
        put(memory.first_duration_s, t1),
        put(memory.second_duration_s, t2),
        put(memory.elapsed_s, np.zeros(index.size)),
        memory.clock_rate,
        np.where(rows, goal.sequence, memory.sequence),
    )
