"""The filter of ``estimate.py`` for one vehicle, in plain floats: numpy costs ten times as much for three numbers.

Same equations, same order; a test holds the two together over random flights. The agent flies this one; simulations
over many flights at once fly the other.

A late sample moves what is remembered of the way since then, by a square polynomial of the age. Instead of moving every
remembered position, the polynomials are added up: a position is stored without the sum at its time, and read with the
sum as it is now.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from onboard.estimation.kalman import EstimateParams
from onboard.types import GRAVITY_M_S2, State

Vec3 = tuple[float, float, float]
Vec4 = tuple[float, float, float, float]
Six = tuple[float, float, float, float, float, float]
_STILL: Vec3 = (0.0, 0.0, 0.0)
_NO_BEND = (_STILL, _STILL, _STILL)
_FAR_BEND_M = 10.0


class OneMemory(NamedTuple):
    """As :class:`onboard.estimation.kalman.EstimateMemory`, without a batch axis.

    covariance: pp, pv, pb, vv, vb, bb. ring: time [s] and stored position (x, y, z) [m] of each tick, newest first.
    bend: what is added to a stored position of age a: bend[0] + a bend[1] + a^2 bend[2]. time_s: since the start.
    """

    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    bias_enu_m_s2: Vec3
    acceleration_enu_m_s2: Vec3
    covariance: Six
    ring: tuple[tuple[float, float, float, float], ...]
    bend: tuple[Vec3, Vec3, Vec3]
    time_s: float
    thrust_m_s2: float
    rejected_count: int
    last_age_s: float

    def remembered(self) -> tuple[list[Vec3], list[float]]:
        """Positions of the last ticks and their ages, newest first."""
        ages = [self.time_s - entry[0] for entry in self.ring]
        return [_bent(entry, self.bend, age) for entry, age in zip(self.ring, ages, strict=True)], ages


def initial(position_enu_m: Vec3, *, params: EstimateParams) -> OneMemory:
    """At rest at a measured position."""
    noise = float(params.position_noise_m)
    covariance = (noise * noise, 0.0, 0.0, 0.05**2, 0.0, 0.3**2)
    ring = ((0.0, *position_enu_m),)
    return OneMemory(position_enu_m, _STILL, _STILL, _STILL, covariance, ring, _NO_BEND, 0.0, 0.0, 0, 0.0)


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
    (px, py, pz), (vx, vy, vz), bias, _, covariance, ring, bend, time_s, thrust, rejected, last_age_s = memory
    asked = thrust_frac / hover_thrust_frac * GRAVITY_M_S2
    if math.isfinite(asked):
        thrust += (1.0 - math.exp(-dt_s / max(float(params.motor_lag_s), 1e-6))) * (asked - thrust)
    w, x, y, z = quaternion_wxyz
    ax, ay = thrust * (2.0 * (x * z + w * y)), thrust * (2.0 * (y * z - w * x))
    az = thrust * (1.0 - 2.0 * (x * x + y * y)) - GRAVITY_M_S2
    if is_on_ground:
        ax, ay, az = 0.0, 0.0, max(az, 0.0)
    drag, half = float(params.drag_1_s), 0.5 * dt_s
    bx, by, bz = bias
    ax, ay, az = _finite(ax) + bx, _finite(ay) + by, _finite(az) + bz
    mx, my, mz = vx + half * (ax - drag * vx), vy + half * (ay - drag * vy), vz + half * (az - drag * vz)
    ax, ay, az = ax - drag * mx, ay - drag * my, az - drag * mz
    px, py, pz = px + dt_s * mx, py + dt_s * my, pz + dt_s * mz
    time_s += dt_s
    # everything remembered is older by dt_s now
    (cx, cy, cz), (dx, dy, dz), (ex, ey, ez) = bend
    cx, cy, cz = cx - dt_s * (dx - dt_s * ex), cy - dt_s * (dy - dt_s * ey), cz - dt_s * (dz - dt_s * ez)
    twice = 2.0 * dt_s
    return OneMemory(
        (px, py, pz),
        (vx + dt_s * ax, vy + dt_s * ay, vz + dt_s * az),
        bias,
        (ax, ay, az),
        _grown(covariance, params, dt_s),
        ((time_s, px - cx, py - cy, pz - cz), *ring[: params.history - 1]),
        ((cx, cy, cz), (dx - twice * ex, dy - twice * ey, dz - twice * ez), (ex, ey, ez)),
        time_s,
        thrust,
        rejected,
        last_age_s + dt_s,
    )


def _finite(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def _grown(covariance: Six, params: EstimateParams, dt_s: float) -> Six:
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
    known = _remembered(memory, age)
    if known is None or not all(map(math.isfinite, position_enu_m)):
        return memory
    x, y, z = position_enu_m[0] - known[0], position_enu_m[1] - known[1], position_enu_m[2] - known[2]
    pp, pv, pb, vv, vb, bb = memory.covariance
    half = 0.5 * age * age
    h_v, h_b = -age - half * float(params.drag_1_s), half
    g_p, g_v, g_b = pp + h_v * pv + h_b * pb, pv + h_v * vv + h_b * vb, pb + h_v * vb + h_b * bb
    spread = max(g_p + h_v * g_v + h_b * g_b, 0.0) + float(params.position_noise_m) ** 2
    gate = max(float(params.jump_gate_m) ** 2, float(params.jump_gate_sigma) ** 2 * spread)
    if x * x + y * y + z * z > gate:
        return memory._replace(rejected_count=memory.rejected_count + 1)
    k_p, k_v, k_b = g_p / spread, g_v / spread, g_b / spread
    (px, py, pz), (vx, vy, vz), (bx, by, bz), (ax, ay, az), _, ring, bend, time_s, thrust, _, last_age_s = memory
    # a sample moves what is ``age`` old by k_p - age k_v + age^2 k_b / 2
    (cx, cy, cz), (dx, dy, dz), (ex, ey, ez) = bend
    curve, bound = 0.5 * k_b, float(params.max_bias_m_s2)
    bend = (
        (cx + k_p * x, cy + k_p * y, cz + k_p * z),
        (dx - k_v * x, dy - k_v * y, dz - k_v * z),
        (ex + curve * x, ey + curve * y, ez + curve * z),
    )
    bias = bx + k_b * x, by + k_b * y, bz + k_b * z
    if not (-bound <= min(bias) and max(bias) <= bound):
        bias = _clipped(bias[0], bound), _clipped(bias[1], bound), _clipped(bias[2], bound)
    if max(map(abs, bend[0])) > _FAR_BEND_M:  # before the sums grow beyond what their difference can be seen in
        ring = tuple((entry[0], *_bent(entry, bend, time_s - entry[0])) for entry in ring)
        bend = _NO_BEND
    return OneMemory(
        (px + k_p * x, py + k_p * y, pz + k_p * z),
        (vx + k_v * x, vy + k_v * y, vz + k_v * z),
        bias,
        (ax + k_b * x, ay + k_b * y, az + k_b * z),
        (
            max(pp - k_p * g_p, 1e-12),
            pv - k_p * g_v,
            pb - k_p * g_b,
            max(vv - k_v * g_v, 1e-12),
            vb - k_v * g_b,
            max(bb - k_b * g_b, 1e-12),
        ),
        ring,
        bend,
        time_s,
        thrust,
        0,
        min(last_age_s, age),
    )


def _clipped(value: float, bound: float) -> float:
    return min(max(value, -bound), bound)


def _bent(entry: tuple[float, float, float, float], bend: tuple[Vec3, Vec3, Vec3], age_s: float) -> Vec3:
    _, x, y, z = entry
    (cx, cy, cz), (dx, dy, dz), (ex, ey, ez) = bend
    return (
        x + cx + age_s * (dx + age_s * ex),
        y + cy + age_s * (dy + age_s * ey),
        z + cz + age_s * (dz + age_s * ez),
    )


def _remembered(memory: OneMemory, age_s: float) -> Vec3 | None:
    """The position estimated for ``age_s`` ago, linear between ticks; None when that is not remembered."""
    ring, bend, time_s = memory.ring, memory.bend, memory.time_s
    if age_s > time_s - ring[-1][0] + 1e-9:
        return None
    newer = older = ring[0]
    for older in ring[1:]:
        if time_s - older[0] >= age_s:
            break
        newer = older
    if newer is older:
        newer = ring[-2] if len(ring) > 1 else older
    newer_s, older_s = time_s - newer[0], time_s - older[0]
    share = min(max((age_s - newer_s) / max(older_s - newer_s, 1e-9), 0.0), 1.0)
    x, y, z = _bent(newer, bend, newer_s)
    u, v, w = _bent(older, bend, older_s)
    return x + share * (u - x), y + share * (v - y), z + share * (w - z)


def state(
    memory: OneMemory, yaw_rad: float = 0.0, *, least_position_std_m: float = 0.0, least_velocity_std_m_s: float = 0.0
) -> State:
    """The estimate as the pipeline takes it: propagated to now (age 0), with its accuracy per axis.

    least_...: what the samples are wrong by for longer than the filter remembers, so that it cannot know.
    """
    return State(
        np.array(memory.position_enu_m),
        np.array(memory.velocity_enu_m_s),
        np.array(memory.acceleration_enu_m_s2),
        np.array(yaw_rad),
        np.zeros(()),
        np.array(max(math.sqrt(memory.covariance[0]), least_position_std_m)),
        np.array(max(math.sqrt(memory.covariance[3]), least_velocity_std_m_s)),
    )
