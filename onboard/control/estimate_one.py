"""The filter of ``estimate.py`` for one vehicle, in plain floats: numpy costs ten times as much for three numbers.

Same equations, same order; a test holds the two together over random flights. The agent flies this one; simulations
over many flights at once fly the other.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass

import numpy as np

from onboard.control.estimate import EstimateParams
from onboard.types import GRAVITY_M_S2, Array, State

Vec3 = tuple[float, float, float]
Vec4 = tuple[float, float, float, float]
_STILL: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class OneMemory:
    """As :class:`onboard.control.estimate.EstimateMemory`, without a batch axis.

    covariance: pp, pv, pb, vv, vb, bb. ring_position_enu_m (N, 3): newest first, of which the first ``len(ring_age_s)``
    are remembered; ring_age_s grows.
    """

    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    bias_enu_m_s2: Vec3
    acceleration_enu_m_s2: Vec3
    covariance: tuple[float, float, float, float, float, float]
    ring_position_enu_m: Array
    ring_age_s: list[float]
    thrust_m_s2: float
    rejected_count: int
    last_age_s: float


def initial(position_enu_m: Vec3, *, params: EstimateParams) -> OneMemory:
    """At rest at a measured position."""
    noise = float(params.position_noise_m)
    ring = np.repeat(np.array([position_enu_m], dtype=np.float64), params.history, axis=0)
    covariance = (noise * noise, 0.0, 0.0, 0.05**2, 0.0, 0.3**2)
    return OneMemory(position_enu_m, _STILL, _STILL, _STILL, covariance, ring, [0.0], 0.0, 0, 0.0)


def drive(
    memory: OneMemory,
    quaternion_wxyz: Vec4,
    thrust_frac: float,
    hover_thrust_frac: float,
    *,
    params: EstimateParams,
    dt_s: float,
    is_on_ground: bool = False,
) -> OneMemory:
    """Predict over ``dt_s`` from the attitude flown and the throttle sent."""
    asked = thrust_frac / hover_thrust_frac * GRAVITY_M_S2
    blend = 1.0 - math.exp(-dt_s / max(float(params.motor_lag_s), 1e-6))
    thrust = memory.thrust_m_s2 + blend * (asked - memory.thrust_m_s2) if math.isfinite(asked) else memory.thrust_m_s2
    w, x, y, z = quaternion_wxyz
    up = (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))
    driven = [thrust * up[0], thrust * up[1], thrust * up[2] - GRAVITY_M_S2]
    if is_on_ground:
        driven = [0.0, 0.0, max(driven[2], 0.0)]
    drag, half = float(params.drag_1_s), 0.5 * dt_s
    position, velocity, acceleration = [], [], []
    for a, p, v, b in zip(driven, memory.position_enu_m, memory.velocity_enu_m_s, memory.bias_enu_m_s2, strict=True):
        a = a if math.isfinite(a) else 0.0
        middle = v + half * (a + b - drag * v)
        total = a + b - drag * middle
        acceleration.append(total)
        velocity.append(v + dt_s * total)
        position.append(p + dt_s * middle)
    ring = np.empty_like(memory.ring_position_enu_m)
    ring[0] = position
    ring[1:] = memory.ring_position_enu_m[:-1]
    ages = [0.0, *[age + dt_s for age in memory.ring_age_s[: len(ring) - 1]]]
    return OneMemory(
        (position[0], position[1], position[2]),
        (velocity[0], velocity[1], velocity[2]),
        memory.bias_enu_m_s2,
        (acceleration[0], acceleration[1], acceleration[2]),
        _grown(memory.covariance, params, dt_s),
        ring,
        ages,
        thrust,
        memory.rejected_count,
        memory.last_age_s + dt_s,
    )


def _grown(
    covariance: tuple[float, float, float, float, float, float], params: EstimateParams, dt_s: float
) -> tuple[float, float, float, float, float, float]:
    pp, pv, pb, vv, vb, bb = covariance
    t, t2 = dt_s, 0.5 * dt_s * dt_s
    keep = 1.0 - float(params.drag_1_s) * dt_s
    qa, qb = float(params.acceleration_noise) ** 2, float(params.bias_noise) ** 2
    a_p, a_v, a_b = pp + t * pv + t2 * pb, pv + t * vv + t2 * vb, pb + t * vb + t2 * bb
    b_v, b_b = keep * vv + t * vb, keep * vb + t * bb
    return (
        a_p + t * a_v + t2 * a_b + qa * t**3 / 3.0,
        keep * a_v + t * a_b + qa * t2,
        a_b,
        keep * b_v + t * b_b + qa * t,
        b_b,
        bb + qb * t,
    )


def correct(memory: OneMemory, position_enu_m: Vec3, age_s: float, *, params: EstimateParams) -> OneMemory:
    """Apply a sample taken ``age_s`` ago; what the memory does not reach is ignored, jumps are ignored and counted."""
    age = max(age_s, 0.0)
    remembered = _remembered(memory, age)
    if remembered is None or not all(map(math.isfinite, position_enu_m)):
        return memory
    innovation = [measured - known for measured, known in zip(position_enu_m, remembered, strict=True)]
    pp, pv, pb, vv, vb, bb = memory.covariance
    half = 0.5 * age * age
    h_v, h_b = -age - half * float(params.drag_1_s), half
    g_p, g_v, g_b = pp + h_v * pv + h_b * pb, pv + h_v * vv + h_b * vb, pb + h_v * vb + h_b * bb
    spread = max(g_p + h_v * g_v + h_b * g_b, 0.0) + float(params.position_noise_m) ** 2
    gate = max(float(params.jump_gate_m) ** 2, float(params.jump_gate_sigma) ** 2 * spread)
    if sum(value * value for value in innovation) > gate:
        return _counted(memory)
    k_p, k_v, k_b = g_p / spread, g_v / spread, g_b / spread
    x, y, z = innovation
    back, bend = -k_v, 0.5 * k_b  # a sample moves what is ``age`` old by k_p - age k_v + age^2 k_b / 2
    gains = np.array(((k_p * x, k_p * y, k_p * z), (back * x, back * y, back * z), (bend * x, bend * y, bend * z)))
    shares = np.ones((len(memory.ring_position_enu_m), 3))
    ages = shares[:, 1]
    ages[: len(memory.ring_age_s)], ages[len(memory.ring_age_s) :] = memory.ring_age_s, 0.0
    np.multiply(ages, ages, out=shares[:, 2])
    bound = float(params.max_bias_m_s2)
    bias = [min(max(b + k_b * miss, -bound), bound) for b, miss in zip(memory.bias_enu_m_s2, innovation, strict=True)]
    return OneMemory(
        _moved(memory.position_enu_m, k_p, innovation),
        _moved(memory.velocity_enu_m_s, k_v, innovation),
        (bias[0], bias[1], bias[2]),
        _moved(memory.acceleration_enu_m_s2, k_b, innovation),
        (
            max(pp - k_p * g_p, 1e-12),
            pv - k_p * g_v,
            pb - k_p * g_b,
            max(vv - k_v * g_v, 1e-12),
            vb - k_v * g_b,
            max(bb - k_b * g_b, 1e-12),
        ),
        memory.ring_position_enu_m + shares @ gains,
        memory.ring_age_s,
        memory.thrust_m_s2,
        0,
        min(memory.last_age_s, age),
    )


def _moved(vector: Vec3, gain: float, innovation: list[float]) -> Vec3:
    return vector[0] + gain * innovation[0], vector[1] + gain * innovation[1], vector[2] + gain * innovation[2]


def _counted(memory: OneMemory) -> OneMemory:
    return OneMemory(
        memory.position_enu_m,
        memory.velocity_enu_m_s,
        memory.bias_enu_m_s2,
        memory.acceleration_enu_m_s2,
        memory.covariance,
        memory.ring_position_enu_m,
        memory.ring_age_s,
        memory.thrust_m_s2,
        memory.rejected_count + 1,
        memory.last_age_s,
    )


def _remembered(memory: OneMemory, age_s: float) -> list[float] | None:
    """The position estimated for ``age_s`` ago, linear between ticks; None when that is not remembered."""
    ages, ring = memory.ring_age_s, memory.ring_position_enu_m
    last = len(ages) - 1
    if age_s > ages[last] + 1e-9:
        return None
    if last == 0:
        found: list[float] = ring[0].tolist()
        return found
    older = min(max(bisect_left(ages, age_s), 1), last)
    share = min(max((age_s - ages[older - 1]) / max(ages[older] - ages[older - 1], 1e-9), 0.0), 1.0)
    before, after = ring[older - 1 : older + 1].tolist()
    return [b + share * (a - b) for b, a in zip(before, after, strict=True)]


def state(memory: OneMemory, yaw_rad: float = 0.0) -> State:
    """The estimate as the pipeline takes it: propagated to now (age 0), with its accuracy per axis."""
    return State(
        np.array(memory.position_enu_m),
        np.array(memory.velocity_enu_m_s),
        np.array(memory.acceleration_enu_m_s2),
        np.array(yaw_rad),
        np.zeros(()),
        np.array(math.sqrt(memory.covariance[0])),
        np.array(math.sqrt(memory.covariance[3])),
    )
