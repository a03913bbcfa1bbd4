"""Own motion from the mocap itself, and the disturbance that the own commands do not explain.

Filter. Per axis [p, v, b] with p' = v, v' = a_in + b - c v: a_in is what attitude and throttle say (thrust behind the
motor lag, less gravity), c the linear drag, b a slowly wandering bias (thrust scale, tilt bias, wind). All axes share
one covariance, since their noise is alike. A mocap sample belongs to a time ``age`` ago. It is applied at that time
and re-propagated to now; the system being linear, that is one step: the innovation is taken against the position
remembered for that time, the row is H = [1 0 0] Phi(-age), and the remembered positions are corrected by the same
error. Samples may therefore come late, out of order or not at all.

Observer. A model of the own commands through the attitude lag predicts velocity; what is missing is the disturbance
s_b. Because the model starts from the commands (not from the measured attitude), a static error of the attitude loop
and a tilt bias are part of it. Command ``u - s_b + c V``. The command really sent enters, after all limits, so that
neither saturation nor the avoidance law charges it: that is the baseline's integral action.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onboard.frames import body_up
from onboard.types import GRAVITY_M_S2, Array, BoolArray, State


@dataclass(frozen=True, slots=True)
class EstimateParams:
    """Noise and limits; each a float or (...).

    position_noise_m: std of a mocap sample per axis. acceleration_noise: of the model, m/s^2 per sqrt(Hz).
    bias_noise: random walk of b, m/s^3 per sqrt(Hz). max_bias_m_s2. drag_1_s: c. motor_lag_s: throttle to thrust.
    jump_gate_m, jump_gate_sigma: a sample farther off than the larger of both is a jump and ignored. history: ticks.
    """

    position_noise_m: Array | float = 0.003
    acceleration_noise: Array | float = 0.03
    bias_noise: Array | float = 0.12
    max_bias_m_s2: Array | float = 3.0
    drag_1_s: Array | float = 0.0
    motor_lag_s: Array | float = 0.05
    jump_gate_m: Array | float = 0.30  # wide enough for a 0.2-s stall at speed, below half the distance of two bodies
    jump_gate_sigma: Array | float = 6.0
    history: int = 20


@dataclass(frozen=True, slots=True)
class EstimateMemory:
    """position, velocity, bias, acceleration (model with bias and drag) (..., 3), valid now.

    covariance (..., 6): pp, pv, pb, vv, vb, bb. ring_position_enu_m (..., N, 3): newest first, ring_age_s (N,) ages,
    inf where nothing is remembered. thrust_m_s2 (...): behind the motor lag. rejected_count (...): jumps in a row.
    last_age_s (...): age of the newest sample used, growing.
    """

    position_enu_m: Array
    velocity_enu_m_s: Array
    bias_enu_m_s2: Array
    acceleration_enu_m_s2: Array
    covariance: Array
    ring_position_enu_m: Array
    ring_age_s: Array
    thrust_m_s2: Array
    rejected_count: Array
    last_age_s: Array


def initial(position_enu_m: Array, *, params: EstimateParams) -> EstimateMemory:
    """At rest at a measured position (..., 3)."""
    position = np.array(position_enu_m, dtype=np.float64)
    shape = position.shape[:-1]
    covariance = np.zeros((*shape, 6))
    covariance[..., 0] = np.square(params.position_noise_m)
    covariance[..., 3] = 0.05**2
    covariance[..., 5] = 0.3**2
    still, zero = np.zeros_like(position), np.zeros(shape)
    ring = np.repeat(position[..., None, :], params.history, axis=-2)
    ages = np.full(params.history, np.inf)
    ages[0] = 0.0
    return EstimateMemory(position, still, still, still, covariance, ring, ages, zero, zero, zero)


def drive(
    memory: EstimateMemory,
    quaternion_wxyz: Array,
    thrust_frac: Array | float,
    hover_thrust_frac: Array | float,
    *,
    params: EstimateParams,
    dt_s: float,
    is_on_ground: BoolArray | bool = False,
) -> EstimateMemory:
    """Predict over ``dt_s`` from the attitude flown (..., 4) FLU to ENU and the throttle sent (...).

    The throttle passes the motor lag, the attitude does not: it is measured. On the ground the contact force carries
    what thrust does not: horizontal acceleration is zero and the vertical one not negative.
    """
    asked = np.asarray(thrust_frac, dtype=np.float64) / hover_thrust_frac * GRAVITY_M_S2
    blend = 1.0 - np.exp(-dt_s / np.maximum(params.motor_lag_s, 1e-6))
    thrust = memory.thrust_m_s2 + blend * (np.where(np.isfinite(asked), asked, memory.thrust_m_s2) - memory.thrust_m_s2)
    acceleration = thrust[..., None] * body_up(quaternion_wxyz)
    acceleration[..., 2] -= GRAVITY_M_S2
    if np.any(is_on_ground):
        ground = np.asarray(is_on_ground)
        lifted = np.maximum(acceleration[..., 2], 0.0)
        acceleration = np.where(ground[..., None], 0.0, acceleration)
        acceleration[..., 2] = np.where(ground, lifted, acceleration[..., 2])
    memory = replace(memory, thrust_m_s2=np.asarray(thrust))
    return predict(memory, acceleration, params=params, dt_s=dt_s)


def predict(
    memory: EstimateMemory,
    acceleration_input_enu_m_s2: Array,
    *,
    params: EstimateParams,
    dt_s: float,
) -> EstimateMemory:
    """The filter's motion over ``dt_s`` under an acceleration (..., 3) without drag and gravity; NaN counts as zero."""
    driven = acceleration_input_enu_m_s2
    if not np.isfinite(driven).all():
        driven = np.where(np.isfinite(driven), driven, 0.0)
    drag = np.asarray(params.drag_1_s, dtype=np.float64)[..., None]
    middle = memory.velocity_enu_m_s + (0.5 * dt_s) * (driven + memory.bias_enu_m_s2 - drag * memory.velocity_enu_m_s)
    acceleration = driven + memory.bias_enu_m_s2 - drag * middle
    velocity = memory.velocity_enu_m_s + dt_s * acceleration
    position = memory.position_enu_m + dt_s * middle
    ring = np.empty_like(memory.ring_position_enu_m)
    ring[..., 0, :] = position
    ring[..., 1:, :] = memory.ring_position_enu_m[..., :-1, :]
    ages = np.empty_like(memory.ring_age_s)
    ages[0] = 0.0
    ages[1:] = memory.ring_age_s[:-1] + dt_s
    return replace(
        memory,
        position_enu_m=position,
        velocity_enu_m_s=velocity,
        acceleration_enu_m_s2=acceleration,
        covariance=_grow(memory.covariance, params, dt_s),
        ring_position_enu_m=ring,
        ring_age_s=ages,
        last_age_s=memory.last_age_s + dt_s,
    )


def _grow(covariance: Array, params: EstimateParams, dt_s: float) -> Array:
    """Phi P Phi' + Q with Phi = [[1, T, T^2/2], [0, 1 - c T, T], [0, 0, 1]]."""
    pp, pv, pb, vv, vb, bb = (covariance[..., i] for i in range(6))
    t, t2 = dt_s, 0.5 * dt_s * dt_s
    keep = 1.0 - params.drag_1_s * dt_s
    qa, qb = np.square(params.acceleration_noise), np.square(params.bias_noise)
    # rows of Phi P first, then times Phi'
    a_p, a_v, a_b = pp + t * pv + t2 * pb, pv + t * vv + t2 * vb, pb + t * vb + t2 * bb
    b_v, b_b = keep * vv + t * vb, keep * vb + t * bb
    out = np.empty_like(covariance)
    out[..., 0] = a_p + t * a_v + t2 * a_b + qa * t**3 / 3.0
    out[..., 1] = keep * a_v + t * a_b + qa * t2
    out[..., 2] = a_b
    out[..., 3] = keep * b_v + t * b_b + qa * t
    out[..., 4] = b_b
    out[..., 5] = bb + qb * t
    return out


def correct(
    memory: EstimateMemory,
    position_enu_m: Array,
    age_s: Array | float,
    *,
    params: EstimateParams,
    is_present: BoolArray | bool = True,
) -> EstimateMemory:
    """Apply a mocap sample (..., 3) that was taken ``age_s`` (...) ago; see the module.

    Samples that are not finite, negative in age beyond rounding, or older than the memory are ignored; a jump is
    ignored and counted in ``rejected_count``, which the next good sample sets back to 0. Deciding to believe a body
    that stays elsewhere (start again with ``initial``) is the caller's business.

    Args:
        is_present: (...) rows of the batch that have a sample at all.
    """
    age = np.maximum(np.asarray(age_s, dtype=np.float64), 0.0)
    remembered, is_known = _remembered(memory, age)
    innovation = position_enu_m - remembered
    finite = np.isfinite(innovation).all(axis=-1) & is_known & is_present
    innovation = np.where(finite[..., None], innovation, 0.0)
    pp, pv, pb, vv, vb, bb = (memory.covariance[..., i] for i in range(6))
    # first row of Phi(-age): p(t - age) = p - age v + age^2/2 (v' terms)
    age = np.where(finite, age, 0.0)
    half = 0.5 * age * age
    h_v, h_b = -age - half * params.drag_1_s, half
    g_p, g_v, g_b = (
        pp + h_v * pv + h_b * pb,
        pv + h_v * vv + h_b * vb,
        pb + h_v * vb + h_b * bb,
    )
    spread = np.maximum(g_p + h_v * g_v + h_b * g_b, 0.0) + np.square(params.position_noise_m)
    gate = np.maximum(np.square(params.jump_gate_m), np.square(params.jump_gate_sigma) * spread)
    x, y, z = innovation[..., 0], innovation[..., 1], innovation[..., 2]
    near = x * x + y * y + z * z <= gate
    used = finite & near
    weight = np.where(used, 1.0 / spread, 0.0)
    k_p, k_v, k_b = weight * g_p, weight * g_v, weight * g_b
    d_p, d_v, d_b = (
        k_p[..., None] * innovation,
        k_v[..., None] * innovation,
        k_b[..., None] * innovation,
    )
    covariance = np.empty_like(memory.covariance)
    covariance[..., 0] = pp - k_p * g_p
    covariance[..., 1] = pv - k_p * g_v
    covariance[..., 2] = pb - k_p * g_b
    covariance[..., 3] = vv - k_v * g_v
    covariance[..., 4] = vb - k_v * g_b
    covariance[..., 5] = bb - k_b * g_b
    covariance[..., (0, 3, 5)] = np.maximum(covariance[..., (0, 3, 5)], 1e-12)
    ages = np.where(np.isfinite(memory.ring_age_s), memory.ring_age_s, 0.0)[:, None]
    ring = memory.ring_position_enu_m + d_p[..., None, :] - ages * d_v[..., None, :]
    ring += (0.5 * ages * ages) * d_b[..., None, :]
    bound = np.asarray(params.max_bias_m_s2, dtype=np.float64)[..., None]
    return replace(
        memory,
        position_enu_m=memory.position_enu_m + d_p,
        velocity_enu_m_s=memory.velocity_enu_m_s + d_v,
        bias_enu_m_s2=np.minimum(np.maximum(memory.bias_enu_m_s2 + d_b, -bound), bound),
        acceleration_enu_m_s2=memory.acceleration_enu_m_s2 + d_b,
        covariance=covariance,
        ring_position_enu_m=ring,
        rejected_count=np.where(used, 0.0, memory.rejected_count + (finite & ~near)),
        last_age_s=np.where(used, np.minimum(memory.last_age_s, age), memory.last_age_s),
    )


def _remembered(memory: EstimateMemory, age_s: Array) -> tuple[Array, BoolArray]:
    """The position (..., 3) estimated for ``age_s`` (...) ago, linear between ticks, and whether it is remembered."""
    ages, ring = memory.ring_age_s, memory.ring_position_enu_m
    last = int(np.isfinite(ages).sum()) - 1
    known = np.asarray(age_s <= ages[last] + 1e-9)
    if last == 0:
        return ring[..., 0, :], known
    older = np.minimum(np.maximum(np.searchsorted(ages[: last + 1], age_s), 1), last)
    step_s = np.maximum(ages[older] - ages[older - 1], 1e-9)
    share = np.minimum(np.maximum((age_s - ages[older - 1]) / step_s, 0.0), 1.0)
    if age_s.ndim == 0:
        before, after = ring[..., int(older) - 1, :], ring[..., int(older), :]
    else:
        before = np.take_along_axis(ring, (older - 1)[..., None, None], axis=-2)[..., 0, :]
        after = np.take_along_axis(ring, older[..., None, None], axis=-2)[..., 0, :]
    return before + share[..., None] * (after - before), known


def state(memory: EstimateMemory, yaw_rad: Array | float = 0.0) -> State:
    """The estimate as the pipeline takes it: propagated to now (age 0), yaw (...) from the mocap, accuracy per axis."""
    shape = memory.position_enu_m.shape[:-1]
    return State(
        memory.position_enu_m,
        memory.velocity_enu_m_s,
        memory.acceleration_enu_m_s2,
        np.broadcast_to(np.asarray(yaw_rad, dtype=np.float64), shape),
        np.zeros(shape),
        np.sqrt(memory.covariance[..., 0]),
        np.sqrt(memory.covariance[..., 3]),
    )


@dataclass(frozen=True, slots=True)
class ObserverParams:
    """Disturbance observer; each a float or (...).

    bandwidth_rad_s: both poles. delay_s, wn_rad_s, zeta: horizontal response to commands. vertical_lag_s: first order.
    drag_1_s. max_disturbance_m_s2: bound per axis. history: ticks of commands kept, longer than the delay.
    """

    bandwidth_rad_s: Array | float = 4.0
    delay_s: float = 0.04
    wn_rad_s: Array | float = 11.0
    zeta: Array | float = 0.6
    vertical_lag_s: Array | float = 0.06
    drag_1_s: Array | float = 0.0
    max_disturbance_m_s2: Array | float = 1.5
    history: int = 8


@dataclass(frozen=True, slots=True)
class ObserverMemory:
    """velocity and disturbance of the observer, response and its rate of the lag model (..., 3).

    commands_enu_m_s2 (..., N, 3): newest first, without gravity.
    """

    velocity_enu_m_s: Array
    disturbance_enu_m_s2: Array
    response_enu_m_s2: Array
    response_rate_enu_m_s3: Array
    commands_enu_m_s2: Array


def observer_initial(velocity_enu_m_s: Array, *, params: ObserverParams) -> ObserverMemory:
    """No disturbance known, moving at (..., 3), commands so far zero."""
    velocity = np.array(velocity_enu_m_s, dtype=np.float64)
    still = np.zeros_like(velocity)
    commands = np.zeros((*velocity.shape[:-1], params.history, 3))
    return ObserverMemory(velocity, still, still, still, commands)


def observe(
    memory: ObserverMemory,
    velocity_enu_m_s: Array,
    command_enu_m_s2: Array,
    *,
    params: ObserverParams,
    dt_s: float,
    is_frozen: BoolArray | bool = False,
) -> ObserverMemory:
    """One tick of x' = a_model - c v + s_b + 2 w (v - x), s_b' = w^2 (v - x).

    Args:
        velocity_enu_m_s: (..., 3) estimated now.
        command_enu_m_s2: (..., 3) acceleration commanded since the last tick, after every limit, without gravity
            (horizontal: what the attitude asks for; vertical: throttle less gravity).
        is_frozen: (...) keeps s_b (on the ground, at lift-off) while the model follows.
    Returns:
        memory; ``disturbance_enu_m_s2`` is s_b: what acts beside the commands and the drag.
    """
    command = command_enu_m_s2
    if not (np.isfinite(command).all() and np.isfinite(velocity_enu_m_s).all()):
        command = np.where(np.isfinite(command), command, memory.commands_enu_m_s2[..., 0, :])
        velocity_enu_m_s = np.where(np.isfinite(velocity_enu_m_s), velocity_enu_m_s, memory.velocity_enu_m_s)
    commands = np.empty_like(memory.commands_enu_m_s2)
    commands[..., 0, :] = command
    commands[..., 1:, :] = memory.commands_enu_m_s2[..., :-1, :]
    ticks = min(params.delay_s / dt_s, commands.shape[-2] - 1.000001)
    whole = int(ticks)
    delayed = commands[..., whole, :] + (ticks - whole) * (commands[..., whole + 1, :] - commands[..., whole, :])
    # second order by the implicit midpoint rule: stable for every tick length
    wn = np.asarray(params.wn_rad_s, dtype=np.float64)[..., None]
    zeta = np.asarray(params.zeta, dtype=np.float64)[..., None]
    half = 0.5 * dt_s
    push = wn * wn * (delayed - memory.response_enu_m_s2)
    rate = (memory.response_rate_enu_m_s3 + half * push) / (1.0 + 2.0 * half * zeta * wn + half * half * wn * wn)
    response = memory.response_enu_m_s2 + dt_s * rate
    rate = 2.0 * rate - memory.response_rate_enu_m_s3
    blend = 1.0 - np.exp(-dt_s / np.asarray(params.vertical_lag_s, dtype=np.float64))
    response[..., 2] = memory.response_enu_m_s2[..., 2] + blend * (command[..., 2] - memory.response_enu_m_s2[..., 2])
    rate[..., 2] = 0.0
    acting = 0.5 * (response + memory.response_enu_m_s2)
    width = np.asarray(params.bandwidth_rad_s, dtype=np.float64)[..., None]
    drag = np.asarray(params.drag_1_s, dtype=np.float64)[..., None]
    forecast = memory.velocity_enu_m_s + dt_s * (acting - drag * velocity_enu_m_s + memory.disturbance_enu_m_s2)
    miss = velocity_enu_m_s - forecast
    decay = np.exp(-width * dt_s)
    # gains that put both discrete poles on exp(-w T)
    velocity = forecast + (1.0 - decay * decay) * miss
    disturbance = memory.disturbance_enu_m_s2 + ((1.0 - decay) ** 2 / dt_s) * miss
    bound = np.asarray(params.max_disturbance_m_s2, dtype=np.float64)[..., None]
    disturbance = np.minimum(np.maximum(disturbance, -bound), bound)
    if np.any(is_frozen):
        frozen = np.asarray(is_frozen)[..., None]
        disturbance = np.where(frozen, memory.disturbance_enu_m_s2, disturbance)
        velocity = np.where(frozen, velocity_enu_m_s, velocity)
    return ObserverMemory(velocity, disturbance, response, rate, commands)
