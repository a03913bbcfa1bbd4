"""Estimate, prediction, guidance, baseline and allocation of one vehicle, in plain floats; see kernels.py.

Each function is its namesake's formula in estimate.py, prediction.py, guidance.py, backstepping.py or allocation.py for
one vehicle: there is the derivation, here are the floats. Vectors are tuples of three.
"""

from __future__ import annotations

import math
from typing import Any

Vec3 = tuple[float, float, float]
Vec6 = tuple[float, float, float, float, float, float]
_GRAVITY_M_S2 = 9.80665


def grown(covariance: Any, keep: float, t: float, q_a: float, q_b: float) -> Vec6:
    """Covariance over a tick; estimate._grow."""
    pp, pv, pb, vv, vb, bb = covariance
    t_2 = 0.5 * t * t
    a_p, a_v, a_b = pp + t * pv + t_2 * pb, pv + t * vv + t_2 * vb, pb + t * vb + t_2 * bb
    b_v, b_b = keep * vv + t * vb, keep * vb + t * bb
    return (
        a_p + t * a_v + t_2 * a_b + q_a * (t * t * t) / 3.0,
        keep * a_v + t * a_b + q_a * t_2,
        a_b,
        keep * b_v + t * b_b + q_a * t,
        b_b,
        bb + q_b * t,
    )


def corrected(
    covariance: Any, innovation: Any, age: float, drag: float, noise: float, gate_m: float, gate_sigma: float
) -> tuple[int, float, float, float, Vec6]:
    """What a sample ``age`` old teaches: 0 far, 1 used; gains of position, velocity, bias; covariance.

    The gains are 0 when it is not used; see estimate.correct.
    """
    pp, pv, pb, vv, vb, bb = covariance
    x, y, z = innovation
    half = 0.5 * age * age
    h_v, h_b = -age - half * drag, half
    g_p, g_v, g_b = pp + h_v * pv + h_b * pb, pv + h_v * vv + h_b * vb, pb + h_v * vb + h_b * bb
    spread = max(g_p + h_v * g_v + h_b * g_b, 0.0) + noise * noise
    near = x * x + y * y + z * z <= max(gate_m * gate_m, gate_sigma * gate_sigma * spread)
    weight = 1.0 / spread if near else 0.0
    k_p, k_v, k_b = weight * g_p, weight * g_v, weight * g_b
    after = (
        max(pp - k_p * g_p, 1e-12),
        pv - k_p * g_v,
        pb - k_p * g_b,
        max(vv - k_v * g_v, 1e-12),
        vb - k_v * g_b,
        max(bb - k_b * g_b, 1e-12),
    )
    return 1 if near else 0, k_p, k_v, k_b, after


def predicted(
    accelerations: Any, durations: Any, position: Any, velocity: Any, window: float, window_z: float, rest_z: float
) -> tuple[Vec3, Vec3]:
    """Own state over the own lag, the vertical axis over its own; prediction.predict_own, oist.predict.

    accelerations: all components of the commands, one after the other.
    """
    p_x, p_y, p_z = position[0] + window * velocity[0], position[1] + window * velocity[1], position[2]
    v_x, v_y, v_z = velocity[0], velocity[1], velocity[2]
    p_z = p_z + window_z * v_z
    left, longest = 0.0, max(window, window_z)
    for k in range(len(durations)):
        if left >= longest:
            break
        inside = min(max(window - left, 0.0), durations[k])
        weight = inside * (left + 0.5 * inside)
        v_x, p_x = v_x + inside * accelerations[3 * k], p_x + weight * accelerations[3 * k]
        v_y, p_y = v_y + inside * accelerations[3 * k + 1], p_y + weight * accelerations[3 * k + 1]
        inside = min(max(window_z - left, 0.0), durations[k])
        weight = inside * (left + 0.5 * inside)
        v_z, p_z = v_z + inside * accelerations[3 * k + 2], p_z + weight * accelerations[3 * k + 2]
        left += durations[k]
    return (p_x, p_y, p_z + rest_z * v_z), (v_x, v_y, v_z)


def quintic(
    begin: Any, velocity: Any, acceleration: Any, end: Any, duration: float, tau: float, rate: float
) -> tuple[Vec3, Vec3, Vec3]:
    """Position, velocity and acceleration along a leg, the clock going at ``rate``; guidance._quintic."""
    r = 1.0 - tau
    r_2, t_2 = r * r, tau * tau
    r_3 = r_2 * r
    p_w, p_v, p_a = t_2 * tau * (10.0 - 15.0 * tau + 6.0 * t_2), tau * r_3 * (1.0 + 3.0 * tau), 0.5 * t_2 * r_3
    v_w, v_v = 30.0 * t_2 * r_2, r_2 * (1.0 + 2.0 * tau - 15.0 * t_2)
    v_a = 0.5 * tau * r_2 * (2.0 - 5.0 * tau)
    a_w, a_v = 60.0 * tau * r * (1.0 - 2.0 * tau), tau * r * (60.0 * tau - 36.0)
    a_a = r * (1.0 - 8.0 * tau + 10.0 * t_2)
    t, t_t, rate_2 = duration, duration * duration, rate * rate
    b_x, b_y, b_z = begin
    s_x, s_y, s_z = velocity
    f_x, f_y, f_z = acceleration
    w_x, w_y, w_z = end[0] - b_x, end[1] - b_y, end[2] - b_z
    return (
        (
            b_x + w_x * p_w + t * s_x * p_v + t_t * f_x * p_a,
            b_y + w_y * p_w + t * s_y * p_v + t_t * f_y * p_a,
            b_z + w_z * p_w + t * s_z * p_v + t_t * f_z * p_a,
        ),
        (
            rate * (w_x / t * v_w + s_x * v_v + t * f_x * v_a),
            rate * (w_y / t * v_w + s_y * v_v + t * f_y * v_a),
            rate * (w_z / t * v_w + s_z * v_v + t * f_z * v_a),
        ),
        (
            rate_2 * (w_x / t_t * a_w + s_x / t * a_v + f_x * a_a),
            rate_2 * (w_y / t_t * a_w + s_y / t * a_v + f_y * a_a),
            rate_2 * (w_z / t_t * a_w + s_z / t * a_v + f_z * a_a),
        ),
    )


def responded(
    velocity: float,
    forecast: tuple[float, float, float, float],
    command: float,
    model: tuple[float, float],
    gains: tuple[float, float, float, float],
    t: float,
) -> tuple[float, float, float, float]:
    """One horizontal axis of disturbance.observe: its velocity, disturbance, response and rate.

    Args:
        forecast: the same four of the last tick. model: wn, zeta. gains: of velocity and disturbance, drag, bound.
    """
    seen, disturbance, response, rate = forecast
    wn, zeta = model
    half = 0.5 * t
    middle = (rate + half * (wn * wn * (command - response))) / (1.0 + 2.0 * half * zeta * wn + half * half * wn * wn)
    after = response + t * middle
    seen, disturbance = observed(velocity, seen, disturbance, 0.5 * (after + response), gains, t)
    return seen, disturbance, after, 2.0 * middle - rate


def observed(
    velocity: float, seen: float, disturbance: float, acting: float, gains: tuple[float, float, float, float], t: float
) -> tuple[float, float]:
    """Velocity and disturbance of one axis of the observer; disturbance.observe."""
    gain_v, gain_d, drag, bound = gains
    forecast = seen + t * (acting - drag * velocity + disturbance)
    miss = velocity - forecast
    return forecast + gain_v * miss, min(max(disturbance + gain_d * miss, -bound), bound)


def baseline(
    error: Vec3, slip: Vec3, feed: Vec3, gains: tuple[float, float, float], radius: float, bounds: tuple[float, float]
) -> Vec3:
    """Acceleration that tracks the setpoint; backstepping.step.

    Args:
        gains: k1, k2, c. bounds: horizontal and vertical acceleration.
    """
    k_1, k_2, c = gains
    e_x, e_y, e_z = error
    d_x, d_y, d_z = slip
    far_2 = e_x * e_x + e_y * e_y
    ratio, radial = 1.0, 0.0
    if far_2 > radius * radius:
        ratio, radial = radius / max(math.sqrt(far_2), 1e-12), (e_x * d_x + e_y * d_y) / max(far_2, 1e-12)
    s_z = min(max(e_z, -radius), radius)
    spring = k_1 * k_2 + c
    a_x = feed[0] + k_1 * (ratio * (d_x - radial * e_x)) + k_2 * d_x + spring * (ratio * e_x)
    a_y = feed[1] + k_1 * (ratio * (d_y - radial * e_y)) + k_2 * d_y + spring * (ratio * e_y)
    a_z = feed[2] + k_1 * (d_z if s_z == e_z else 0.0) + k_2 * d_z + spring * s_z
    largest, highest = bounds
    scale = min(1.0, largest / max(math.sqrt(a_x * a_x + a_y * a_y), 1e-12))
    return scale * a_x, scale * a_y, min(max(a_z, -highest), highest)


def limited(f: Any, hover: float, tan_tilt: float, low_frac: float, high_frac: float) -> Vec3:
    """The nearest thrust that the vehicle may be asked for, height first; allocation.limit."""
    x, y, z = f
    unit = _GRAVITY_M_S2 / hover
    largest = high_frac * unit
    up = min(max(z, low_frac * unit), largest)
    room = min(up * tan_tilt, math.sqrt(largest * largest - up * up))
    scale = min(1.0, room / max(math.sqrt(x * x + y * y), 1e-12))
    return scale * x, scale * y, up


def attitude(f: Vec3, yaw: float, hover: float) -> tuple[float, float, float, float, float]:
    """Quaternion (w >= 0) and throttle whose thrust is ``f``; allocation.allocate."""
    x, y, z = f
    length = math.sqrt(x * x + y * y + z * z)
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    forward, left, up = (cos_yaw * x + sin_yaw * y) / length, (cos_yaw * y - sin_yaw * x) / length, z / length
    cos_roll = math.sqrt(forward * forward + up * up)
    c_r = math.sqrt(0.5 * (1.0 + cos_roll))
    s_r = -left / (2.0 * c_r)
    c_p = math.sqrt(0.5 * (1.0 + up / cos_roll))
    s_p = forward / cos_roll / (2.0 * c_p)
    c_y, s_y = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    w = c_y * c_p * c_r + s_y * s_p * s_r
    sign = -1.0 if w < 0.0 else 1.0
    return (
        sign * w,
        sign * (c_y * c_p * s_r - s_y * s_p * c_r),
        sign * (c_y * s_p * c_r + s_y * c_p * s_r),
        sign * (s_y * c_p * c_r - c_y * s_p * s_r),
        length / _GRAVITY_M_S2 * hover,
    )
