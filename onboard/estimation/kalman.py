"""Kalman filter of a vehicle's motion from mocap samples, the flown attitude and the sent throttle.

Per axis the state is [p, v, b]: position, velocity and bias, with p' = v and v' = a + b - c v. Here
a is the acceleration that attitude and throttle give (thrust after the motor lag, minus gravity),
and c is the linear drag. The bias b changes slowly: thrust scale, tilt bias, wind. All axes share
one covariance P, because they have the same noise. Phi(t) is the transition matrix over a time t.

A mocap sample was measured ``age`` seconds ago. The system is linear, so the sample corrects the
present state in one step. The innovation is the sample minus the position at that time, and the
measurement row is H = [1 0 0] Phi(-age). Samples may therefore come late, out of order or not at
all. A past position is found by integrating backwards from the present estimate, along the
accelerations of the last ticks. So a correction of the present state also corrects the past.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.constants import GRAVITY_M_S2
from onboard.frames import Quaternion, body_up
from onboard.types import State
from onboard.vectors import (
    ZERO_3,
    Vec3,
    add,
    add_scaled,
    bounded,
    finite_or,
    is_finite,
    scaled,
    subtract,
)

HISTORY_TICKS = 28  # a sample older than this many ticks is ignored
_MIN_VARIANCE = 1e-12  # rounding must not make a variance negative
_LEARNED_S = 0.125  # half of the disturbance observer's time constant, which is 1/bandwidth_rad_s
_MIN_BIAS_M_S2 = 3.0  # smallest bound of the bias; static errors need it

# standard deviations at the start, when the vehicle stands still
_START_VELOCITY_M_S = 0.05
_START_BIAS_M_S2 = 0.3

# At a lift-off, wind pushes a vehicle as soon as the ground no longer holds it. Above this share of
# the weight the ground may let go, and the bias has at least this standard deviation.
_LETTING_GO_SHARE = 0.8
_LIFTOFF_BIAS_M_S2 = 1.0

# standard deviations of an estimate whose samples turned out to have wrong stamps
_DOUBT_M = 1.0
_DOUBT_M_S = 1.0
_DOUBT_M_S2 = 1.0

_AGE_ROUNDING_S = 1e-9  # because of rounding, an age may exceed the remembered time by this


class KalmanParams(NamedTuple):
    """Noise and limits of the filter."""

    position_noise_m: float = 0.003  # standard deviation of a mocap sample per axis
    acceleration_noise: float = 0.03  # noise of the model [m/s^2 per sqrt(Hz)]
    bias_noise: float = 0.12  # random walk of the bias [m/s^3 per sqrt(Hz)]
    max_bias_m_s2: float = _MIN_BIAS_M_S2  # bound of each axis
    drag_1_s: float = 0.0  # c
    gust_time_s: float = 0.25  # how long a gust moves the vehicle before it is compensated
    motor_lag_s: float = 0.05  # time constant from throttle to thrust

    # A sample is a jump if its innovation is larger than both gates. The gates are wide enough for
    # a gap of 0.2 s at full speed, and smaller than half the distance between two bodies.
    jump_gate_m: float = 0.30
    jump_gate_sigma: float = 6.0


class Covariance(NamedTuple):
    """Covariance of position (p), velocity (v) and bias (b) of one axis."""

    pp: float
    pv: float
    pb: float
    vv: float
    vb: float
    bb: float


class PastTick(NamedTuple):
    """One past tick."""

    duration_s: float  # 0: no tick yet
    acceleration_enu_m_s2: Vec3  # without the bias, so that the present bias can be added


class KalmanMemory(NamedTuple):
    """State of the filter, valid now."""

    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    bias_enu_m_s2: Vec3
    acceleration_enu_m_s2: Vec3  # acceleration of the model, with bias and drag
    covariance: Covariance  # the same for each axis
    past: tuple[PastTick, ...]  # the last HISTORY_TICKS ticks, newest first
    thrust_m_s2: float  # collective thrust per mass, after the motor lag

    rejected_count: int  # number of jumps in a row
    last_age_s: float  # current age of the newest sample used


_NO_PAST = (PastTick(0.0, ZERO_3),) * HISTORY_TICKS


def gust_time_s(lag_s: float) -> float:
    """Return the time for which a gust moves a vehicle before it is compensated [s].

    Args:
        lag_s: lag from a command to its acceleration.
    """
    return lag_s + _LEARNED_S


def largest_bias_m_s2(largest_push_m_s2: float) -> float:
    """Return the bound of the bias per axis [m/s^2].

    The bound is twice the largest push that the vehicle can compensate, so that the filter can
    recognise a stronger wind.

    Args:
        largest_push_m_s2: largest push that the vehicle can compensate, per axis.
    """
    return max(_MIN_BIAS_M_S2, 2.0 * largest_push_m_s2)


def initial(position_enu_m: Vec3, params: KalmanParams) -> KalmanMemory:
    """Return the memory of a vehicle at rest at a measured position.

    Args:
        position_enu_m: measured position [m], ENU.
        params: noise and limits.
    """
    covariance = Covariance(
        pp=params.position_noise_m * params.position_noise_m,
        pv=0.0,
        pb=0.0,
        vv=_START_VELOCITY_M_S * _START_VELOCITY_M_S,
        vb=0.0,
        bb=_START_BIAS_M_S2 * _START_BIAS_M_S2,
    )
    return KalmanMemory(
        position_enu_m=position_enu_m,
        velocity_enu_m_s=ZERO_3,
        bias_enu_m_s2=ZERO_3,
        acceleration_enu_m_s2=ZERO_3,
        covariance=covariance,
        past=_NO_PAST,
        thrust_m_s2=0.0,
        rejected_count=0,
        last_age_s=0.0,
    )


def doubted(memory: KalmanMemory) -> KalmanMemory:
    """Return the same estimate with a variance so large that the next samples replace it.

    Args:
        memory: memory from samples that turned out to have wrong stamps.
    """
    covariance = Covariance(
        pp=_DOUBT_M * _DOUBT_M,
        pv=0.0,
        pb=0.0,
        vv=_DOUBT_M_S * _DOUBT_M_S,
        vb=0.0,
        bb=_DOUBT_M_S2 * _DOUBT_M_S2,
    )
    return memory._replace(covariance=covariance)


def drive(
    memory: KalmanMemory,
    quaternion_wxyz: Quaternion,
    thrust_frac: float,
    hover_thrust_frac: float,
    params: KalmanParams,
    dt_s: float,
    is_on_ground: bool,
) -> KalmanMemory:
    """Return the memory after ``dt_s`` under the flown attitude and the sent throttle.

    Only the throttle passes through a lag, because the attitude is measured. On the ground, contact
    forces keep the horizontal acceleration zero and the vertical acceleration non-negative. They
    also hide the push of the wind, so at a lift-off the bias is less certain.

    Args:
        memory: memory of the last tick.
        quaternion_wxyz: flown attitude, FLU to ENU.
        thrust_frac: sent throttle [-]. If it is not finite, the motors keep their thrust.
        hover_thrust_frac: throttle that carries the weight [-].
        params: noise and limits.
        dt_s: length of the tick.
        is_on_ground: whether the vehicle stands on the ground.
    """
    thrust = memory.thrust_m_s2
    commanded = thrust_frac / hover_thrust_frac * GRAVITY_M_S2
    if math.isfinite(commanded):
        blend = 1.0 - math.exp(-dt_s / max(params.motor_lag_s, 1e-6))
        thrust += blend * (commanded - thrust)

    up = body_up(quaternion_wxyz)
    driven = Vec3(thrust * up.x, thrust * up.y, thrust * up.z - GRAVITY_M_S2)
    if is_on_ground:
        driven = Vec3(0.0, 0.0, max(driven.z, 0.0))

    least_bias_std_m_s2 = 0.0
    if is_on_ground and thrust > _LETTING_GO_SHARE * GRAVITY_M_S2:
        least_bias_std_m_s2 = _LIFTOFF_BIAS_M_S2
    return _moved(memory, driven, thrust, params, dt_s, least_bias_std_m_s2)


def driven_enu_m_s2(memory: KalmanMemory, params: KalmanParams) -> Vec3:
    """Return the acceleration that attitude and throttle gave in the last tick [m/s^2], ENU.

    It contains neither drag nor bias.
    """
    return add_scaled(
        memory.past[0].acceleration_enu_m_s2, params.drag_1_s, memory.velocity_enu_m_s
    )


def predict(
    memory: KalmanMemory, acceleration_enu_m_s2: Vec3, params: KalmanParams, dt_s: float
) -> KalmanMemory:
    """Return the memory after ``dt_s`` under a given acceleration.

    Args:
        memory: memory of the last tick.
        acceleration_enu_m_s2: acceleration without drag and bias [m/s^2], ENU. A component that is
            not finite counts as zero.
        params: noise and limits.
        dt_s: length of the tick.
    """
    return _moved(memory, acceleration_enu_m_s2, memory.thrust_m_s2, params, dt_s, 0.0)


def _moved(
    memory: KalmanMemory,
    driven: Vec3,
    thrust_m_s2: float,
    params: KalmanParams,
    dt_s: float,
    least_bias_std_m_s2: float,
) -> KalmanMemory:
    """Return the memory after one tick, integrated by the midpoint rule.

    ``driven`` is the acceleration without drag and bias. The bias has at least the given standard
    deviation afterwards.
    """
    pushed = add(finite_or(driven, ZERO_3), memory.bias_enu_m_s2)  # with the bias

    before = memory.velocity_enu_m_s
    middle = add_scaled(before, 0.5 * dt_s, add_scaled(pushed, -params.drag_1_s, before))
    acceleration = add_scaled(pushed, -params.drag_1_s, middle)

    tick = PastTick(dt_s, subtract(acceleration, memory.bias_enu_m_s2))
    return KalmanMemory(
        position_enu_m=add_scaled(memory.position_enu_m, dt_s, middle),
        velocity_enu_m_s=add_scaled(before, dt_s, acceleration),
        bias_enu_m_s2=memory.bias_enu_m_s2,
        acceleration_enu_m_s2=acceleration,
        covariance=_grown(memory.covariance, params, dt_s, least_bias_std_m_s2),
        past=(tick,) + memory.past[:-1],  # noqa: RUF005  numba compiles no unpacking
        thrust_m_s2=thrust_m_s2,
        rejected_count=memory.rejected_count,
        last_age_s=memory.last_age_s + dt_s,
    )


def _grown(
    covariance: Covariance, params: KalmanParams, dt_s: float, least_bias_std_m_s2: float
) -> Covariance:
    """Return the covariance one tick T later: Phi P Phi' + Q, with at least the given bias's.

    Phi = [[1, T, T^2/2], [0, 1 - c T, T], [0, 0, 1]].
    """
    pp, pv, pb, vv, vb, bb = covariance
    t = dt_s
    half = 0.5 * dt_s * dt_s
    keep = 1.0 - params.drag_1_s * dt_s  # share of the velocity that the drag leaves
    q_a = params.acceleration_noise * params.acceleration_noise
    q_b = params.bias_noise * params.bias_noise

    # A = Phi P: a_* is the row of the position, b_* the row of the velocity
    a_p = pp + t * pv + half * pb
    a_v = pv + t * vv + half * vb
    a_b = pb + t * vb + half * bb
    b_v = keep * vv + t * vb
    b_b = keep * vb + t * bb

    # A Phi' + Q
    return Covariance(
        pp=a_p + t * a_v + half * a_b + q_a * (t * t * t) / 3.0,
        pv=keep * a_v + t * a_b + q_a * half,
        pb=a_b,
        vv=keep * b_v + t * b_b + q_a * t,
        vb=b_b,
        bb=max(bb + q_b * t, least_bias_std_m_s2 * least_bias_std_m_s2),
    )


def correct(
    memory: KalmanMemory, position_enu_m: Vec3, age_s: float, params: KalmanParams
) -> KalmanMemory:
    """Return the memory corrected by a mocap sample.

    A sample is ignored if it is not finite, or older than the remembered ticks. A jump is ignored
    and counted in ``rejected_count``, which the next used sample resets to 0. After many jumps in a
    row, the caller may restart the filter with ``initial``.

    Args:
        memory: memory of the last tick.
        position_enu_m: measured position [m], ENU.
        age_s: time since the sample was taken; a negative age counts as 0.
        params: noise and limits.
    Properties: a late sample has the same effect as a punctual one; the order of two samples does
    not matter.
    """
    age = max(age_s, 0.0)
    if not (remembers(memory, age) and is_finite(position_enu_m)):
        return memory

    # first row of Phi(-age): p(t - age) = p + h_v v + h_b b
    half = 0.5 * age * age
    h_v = -age - half * params.drag_1_s
    h_b = half

    # g = P H', and the variance H P H' + R of the innovation
    pp, pv, pb, vv, vb, bb = memory.covariance
    g_p = pp + h_v * pv + h_b * pb
    g_v = pv + h_v * vv + h_b * vb
    g_b = pb + h_v * vb + h_b * bb
    noise_m2 = params.position_noise_m * params.position_noise_m
    variance_m2 = max(g_p + h_v * g_v + h_b * g_b, 0.0) + noise_m2

    innovation = subtract(position_enu_m, position_at(memory, age))
    if _is_jump(innovation, variance_m2, params):
        return _rejected(memory)

    # With the gain k = P H' / (H P H' + R), the state becomes x + k innovation, and the covariance
    # P - k g'.
    k_p = g_p / variance_m2
    k_v = g_v / variance_m2
    k_b = g_b / variance_m2
    bias = add_scaled(memory.bias_enu_m_s2, k_b, innovation)
    covariance = Covariance(
        pp=max(pp - k_p * g_p, _MIN_VARIANCE),
        pv=pv - k_p * g_v,
        pb=pb - k_p * g_b,
        vv=max(vv - k_v * g_v, _MIN_VARIANCE),
        vb=vb - k_v * g_b,
        bb=max(bb - k_b * g_b, _MIN_VARIANCE),
    )
    return KalmanMemory(
        position_enu_m=add_scaled(memory.position_enu_m, k_p, innovation),
        velocity_enu_m_s=add_scaled(memory.velocity_enu_m_s, k_v, innovation),
        bias_enu_m_s2=bounded(bias, params.max_bias_m_s2),
        acceleration_enu_m_s2=add_scaled(memory.acceleration_enu_m_s2, k_b, innovation),
        covariance=covariance,
        past=memory.past,
        thrust_m_s2=memory.thrust_m_s2,
        rejected_count=0,
        last_age_s=min(memory.last_age_s, age),
    )


def _is_jump(innovation_m: Vec3, variance_m2: float, params: KalmanParams) -> bool:
    """Whether the innovation of a sample is larger than both gates."""
    gate_m2 = max(
        params.jump_gate_m * params.jump_gate_m,
        params.jump_gate_sigma * params.jump_gate_sigma * variance_m2,
    )
    i = innovation_m
    return i.x * i.x + i.y * i.y + i.z * i.z > gate_m2


def _rejected(memory: KalmanMemory) -> KalmanMemory:
    """Return the memory with one more jump counted."""
    return KalmanMemory(
        position_enu_m=memory.position_enu_m,
        velocity_enu_m_s=memory.velocity_enu_m_s,
        bias_enu_m_s2=memory.bias_enu_m_s2,
        acceleration_enu_m_s2=memory.acceleration_enu_m_s2,
        covariance=memory.covariance,
        past=memory.past,
        thrust_m_s2=memory.thrust_m_s2,
        rejected_count=memory.rejected_count + 1,
        last_age_s=memory.last_age_s,
    )


def remembers(memory: KalmanMemory, age_s: float) -> bool:
    """Whether the remembered ticks cover the last ``age_s`` seconds; False for NaN."""
    left_s = age_s - _AGE_ROUNDING_S
    for tick in memory.past:
        if left_s <= 0.0:
            return True
        if tick.duration_s <= 0.0:
            return False
        left_s -= tick.duration_s
    return left_s <= 0.0


def position_at(memory: KalmanMemory, age_s: float) -> Vec3:
    """Return the position ``age_s`` ago [m], ENU, according to the present estimate.

    Between two ticks the position is interpolated linearly.
    """
    position = memory.position_enu_m
    velocity = memory.velocity_enu_m_s
    left_s = age_s
    for tick in memory.past:
        t = tick.duration_s
        if left_s <= 0.0 or t <= 0.0:
            break

        # go back over the whole tick; the velocity in its middle is v - t/2 a
        acceleration = add(tick.acceleration_enu_m_s2, memory.bias_enu_m_s2)
        middle = add_scaled(velocity, -0.5 * t, acceleration)
        whole_step = scaled(-t, middle)

        position = add_scaled(position, min(left_s / t, 1.0), whole_step)
        velocity = add_scaled(velocity, -t, acceleration)
        left_s -= t
    return position


def state(
    memory: KalmanMemory, yaw_rad: float, least_position_std_m: float, least_velocity_std_m_s: float
) -> State:
    """Return the present estimate for the control pipeline, with its accuracy per axis.

    Args:
        memory: memory of this tick.
        yaw_rad: heading, counterclockwise from east.
        least_position_std_m: slow error of the positions, which the filter cannot see [m]; 0 for a
            mocap.
        least_velocity_std_m_s: slow error of the velocity [m/s].
    """
    position_std_m = math.sqrt(memory.covariance.pp)
    velocity_std_m_s = math.sqrt(memory.covariance.vv)
    return State(
        position_enu_m=memory.position_enu_m,
        velocity_enu_m_s=memory.velocity_enu_m_s,
        acceleration_enu_m_s2=memory.acceleration_enu_m_s2,
        yaw_rad=yaw_rad,
        age_s=0.0,
        position_std_m=max(position_std_m, least_position_std_m),
        velocity_std_m_s=max(velocity_std_m_s, least_velocity_std_m_s),
    )
