"""Own motion from the mocap itself.

Per axis [p, v, b] with p' = v, v' = a_in + b - c v: a_in is what attitude and throttle say (thrust behind the
motor lag, less gravity), c the linear drag, b a slowly wandering bias (thrust scale, tilt bias, wind). All axes share
one covariance, since their noise is alike. A mocap sample belongs to a time ``age`` ago. It is applied at that time
and re-propagated to now; the system being linear, that is one step: the innovation is taken against the position
remembered for that time, the row is H = [1 0 0] Phi(-age), and the remembered positions are corrected by the same
error. Samples may therefore come late, out of order or not at all.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass, replace

import numpy as np

from onboard.control import kernel_motion
from onboard.frames import body_up
from onboard.rollout import compiled
from onboard.types import GRAVITY_M_S2, Array, BoolArray, State, light


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


@light
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
    if memory.position_enu_m.ndim == 1:
        return _drive_one(memory, quaternion_wxyz, thrust_frac, hover_thrust_frac, params, dt_s, bool(is_on_ground))
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


def _drive_one(
    memory: EstimateMemory,
    quaternion_wxyz: Array,
    thrust_frac: Array | float,
    hover_thrust_frac: Array | float,
    params: EstimateParams,
    dt_s: float,
    is_on_ground: bool,
) -> EstimateMemory:
    """:func:`drive` for one vehicle, in floats."""
    w, x, y, z = quaternion_wxyz.tolist()
    thrust = float(memory.thrust_m_s2)
    asked = float(thrust_frac) / float(hover_thrust_frac) * GRAVITY_M_S2
    if math.isfinite(asked):
        thrust += (1.0 - math.exp(-dt_s / max(float(params.motor_lag_s), 1e-6))) * (asked - thrust)
    a_x, a_y = thrust * 2.0 * (x * z + w * y), thrust * 2.0 * (y * z - w * x)
    a_z = thrust * (1.0 - 2.0 * (x * x + y * y)) - GRAVITY_M_S2
    if is_on_ground:
        a_x, a_y, a_z = 0.0, 0.0, max(a_z, 0.0)
    return _predict_one(memory, (a_x, a_y, a_z), thrust, params, dt_s)


def _predict_one(
    memory: EstimateMemory, driven: tuple[float, float, float], thrust: float, params: EstimateParams, dt_s: float
) -> EstimateMemory:
    """:func:`predict` for one vehicle, in floats."""
    drag = float(params.drag_1_s)
    moved = []
    for p, v, b, a in zip(
        memory.position_enu_m.tolist(), memory.velocity_enu_m_s.tolist(), memory.bias_enu_m_s2.tolist(), driven,
        strict=True,
    ):  # fmt: skip
        a = a if math.isfinite(a) else 0.0
        middle = v + 0.5 * dt_s * (a + b - drag * v)
        acceleration = a + b - drag * middle
        moved.append((p + dt_s * middle, v + dt_s * acceleration, acceleration))
    position, velocity, acceleration = np.array(moved).T
    ring, ages = _shifted(memory, position, dt_s)
    noise_a, noise_b = float(params.acceleration_noise), float(params.bias_noise)
    covariance = kernel_motion.grown(
        memory.covariance.tolist(), 1.0 - drag * dt_s, dt_s, noise_a * noise_a, noise_b * noise_b
    )
    return EstimateMemory(
        position,
        velocity,
        memory.bias_enu_m_s2,
        acceleration,
        np.array(covariance),
        ring,
        ages,
        np.array(thrust),
        memory.rejected_count,
        np.array(float(memory.last_age_s) + dt_s),
    )


def _shifted(memory: EstimateMemory, position_enu_m: Array, dt_s: float) -> tuple[Array, Array]:
    """Remembered positions with a new one in front, and their ages."""
    ring, ages = np.empty_like(memory.ring_position_enu_m), np.empty_like(memory.ring_age_s)
    ring[..., 0, :] = position_enu_m
    ring[..., 1:, :] = memory.ring_position_enu_m[..., :-1, :]
    ages[0] = 0.0
    ages[1:] = memory.ring_age_s[:-1]
    ages[1:] += dt_s
    return ring, ages


def predict(
    memory: EstimateMemory,
    acceleration_input_enu_m_s2: Array,
    *,
    params: EstimateParams,
    dt_s: float,
) -> EstimateMemory:
    """The filter's motion over ``dt_s`` under an acceleration (..., 3) without drag and gravity; NaN counts as zero."""
    driven = acceleration_input_enu_m_s2
    if driven.ndim == 1:
        x, y, z = driven.tolist()
        return _predict_one(memory, (x, y, z), float(memory.thrust_m_s2), params, dt_s)
    if not np.isfinite(driven).all():
        driven = np.where(np.isfinite(driven), driven, 0.0)
    drag = np.asarray(params.drag_1_s, dtype=np.float64)[..., None]
    middle = memory.velocity_enu_m_s + (0.5 * dt_s) * (driven + memory.bias_enu_m_s2 - drag * memory.velocity_enu_m_s)
    acceleration = driven + memory.bias_enu_m_s2 - drag * middle
    velocity = memory.velocity_enu_m_s + dt_s * acceleration
    position = memory.position_enu_m + dt_s * middle
    ring, ages = _shifted(memory, position, dt_s)
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
    if memory.position_enu_m.ndim == 1:
        return _correct_one(memory, position_enu_m, max(float(age_s), 0.0), params) if bool(is_present) else memory
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
    if compiled.is_compiled(age.size) and compiled.uses_kernel(age.size):
        change = np.stack([d_p, d_v, d_b], axis=-2).reshape(-1, 3, 3)
        remembered_all = compiled.flat(memory.ring_position_enu_m, age.size, len(ages), 3)
        ring = compiled.moved_back_batch(remembered_all, ages[:, 0], change).reshape(memory.ring_position_enu_m.shape)
    else:
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


def _correct_one(memory: EstimateMemory, position_enu_m: Array, age_s: float, params: EstimateParams) -> EstimateMemory:
    """:func:`correct` for one vehicle, in floats."""
    ages = memory.ring_age_s.tolist()
    last = sum(map(math.isfinite, ages)) - 1
    if not age_s <= ages[last] + 1e-9:
        return memory
    older = min(max(bisect.bisect_left(ages, age_s, 0, last + 1), 1), last)
    at = memory.ring_position_enu_m[0].tolist()
    if last > 0:
        share = min(max((age_s - ages[older - 1]) / max(ages[older] - ages[older - 1], 1e-9), 0.0), 1.0)
        newer_old = zip(*memory.ring_position_enu_m[older - 1 : older + 1].tolist(), strict=True)
        at = [new + share * (old - new) for new, old in newer_old]
    innovation = [seen - there for seen, there in zip(position_enu_m.tolist(), at, strict=True)]
    if not all(map(math.isfinite, innovation)):
        return memory
    used, k_p, k_v, k_b, covariance = kernel_motion.corrected(
        memory.covariance.tolist(),
        innovation,
        age_s,
        float(params.drag_1_s),
        float(params.position_noise_m),
        float(params.jump_gate_m),
        float(params.jump_gate_sigma),
    )
    if not used:
        return replace(memory, rejected_count=np.asarray(memory.rejected_count + 1.0))
    change = np.array([k_p, k_v, k_b])[:, None] * np.array(innovation)
    since = np.where(np.isfinite(memory.ring_age_s), memory.ring_age_s, 0.0)
    weights = np.array([np.ones_like(since), -since, 0.5 * since * since])
    bound = float(params.max_bias_m_s2)
    bias = [
        min(max(b + d, -bound), bound) for b, d in zip(memory.bias_enu_m_s2.tolist(), change[2].tolist(), strict=True)
    ]
    return EstimateMemory(
        memory.position_enu_m + change[0],
        memory.velocity_enu_m_s + change[1],
        np.array(bias),
        memory.acceleration_enu_m_s2 + change[2],
        np.array(covariance),
        memory.ring_position_enu_m + weights.T @ change,
        memory.ring_age_s,
        memory.thrust_m_s2,
        np.zeros(()),
        np.array(min(float(memory.last_age_s), age_s)),
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
    if not shape:
        pp, _, _, vv, _, _ = memory.covariance.tolist()
        return State(
            memory.position_enu_m,
            memory.velocity_enu_m_s,
            memory.acceleration_enu_m_s2,
            np.array(float(yaw_rad)),
            np.zeros(()),
            np.array(math.sqrt(pp)),
            np.array(math.sqrt(vv)),
        )
    return State(
        memory.position_enu_m,
        memory.velocity_enu_m_s,
        memory.acceleration_enu_m_s2,
        np.broadcast_to(np.asarray(yaw_rad, dtype=np.float64), shape),
        np.zeros(shape),
        np.sqrt(memory.covariance[..., 0]),
        np.sqrt(memory.covariance[..., 3]),
    )
