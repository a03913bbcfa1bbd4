"""From the thrust vector to what PX4 takes: an attitude quaternion and a throttle.

The quaternion is built exactly from thrust direction and yaw. The paper's (2) is kept as a documented reference only:
DEVIATION D1: (2) are the angles of R = Rx(roll) Ry(pitch), whereas PX4 composes Euler angles as ZYX; read that way
(2) errs by 0.4 m/s^2 at 30 deg of combined tilt (a test shows it).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from onboard.control import kernel_motion
from onboard.frames import vector
from onboard.types import GRAVITY_M_S2, Array, AttitudeSetpoint, BoolArray, Thrust


@dataclass(frozen=True, slots=True)
class AllocationParams:
    """Limits of what is sent.

    max_tilt_rad (...): between thrust and the vertical. min/max_thrust_frac (...): of the throttle. The minimum keeps
    the propellers turning so that attitude stays controlled. fallback_hover_thrust_frac (...): throttle of the level
    answer to unusable input, the configured hover throttle.
    """

    max_tilt_rad: Array | float
    min_thrust_frac: Array | float = 0.08
    max_thrust_frac: Array | float = 0.98
    fallback_hover_thrust_frac: Array | float = 0.5


def is_usable(thrust: Thrust, yaw_rad: Array, hover_thrust_frac: Array) -> BoolArray:
    """Whether everything needed is finite and the hover throttle positive, (...); otherwise allocate levels out."""
    f = thrust.thrust_enu_m_s2
    finite = np.isfinite(f[..., 0]) & np.isfinite(f[..., 1]) & np.isfinite(f[..., 2])
    hover = np.asarray(hover_thrust_frac)
    return np.asarray(finite & np.isfinite(yaw_rad) & np.isfinite(hover) & (hover > 0.0))


def limit(thrust: Thrust, hover_thrust_frac: Array, *, params: AllocationParams) -> Thrust:
    """The nearest thrust that the vehicle may be asked for, height first.

    The vertical component is kept as far as the throttle reaches, then the horizontal one is shortened (its direction
    kept) to what tilt limit and remaining throttle allow: F_h <= min(F_z tan(max_tilt), sqrt(F_max^2 - F_z^2)).

    Args:
        thrust: F/m (..., 3) [m/s^2] ENU, finite.
        hover_thrust_frac: (...) throttle that carries the weight; throttle is linear in thrust.
    Properties: idempotent; yaw-rotation-equivariant; keeps height before tracking.
    """
    f = thrust.thrust_enu_m_s2
    if f.ndim == 1:
        return Thrust(np.array(_limited_one(f, hover_thrust_frac, params)))
    x, y, z = f[..., 0], f[..., 1], f[..., 2]
    unit_m_s2 = GRAVITY_M_S2 / hover_thrust_frac
    largest_m_s2 = params.max_thrust_frac * unit_m_s2
    vertical = np.minimum(np.maximum(z, params.min_thrust_frac * unit_m_s2), largest_m_s2)
    room = np.minimum(vertical * np.tan(params.max_tilt_rad), np.sqrt(largest_m_s2**2 - vertical**2))
    horizontal = np.sqrt(x * x + y * y)
    scale = np.minimum(1.0, room / np.maximum(horizontal, 1e-12))
    return Thrust(vector(scale * x, scale * y, vertical))


def allocate(
    thrust: Thrust,
    yaw_rad: Array,
    hover_thrust_frac: Array,
    *,
    params: AllocationParams,
) -> AttitudeSetpoint:
    """Attitude and throttle whose thrust is the given vector, exactly, within the limits.

    With b = F/|F| turned into the yaw frame, the attitude is Rz(yaw) Ry(pitch) Rx(roll) with pitch = atan2(b_x, b_z)
    and roll = asin(-b_y): its third column is b and its heading is yaw. Half angles come from square roots.
    thrust_frac = |F|/g * hover_thrust_frac. Unusable input gives level at the hover throttle (see ``is_usable``).

    Args:
        thrust: F/m (..., 3) [m/s^2] ENU. yaw_rad: (...) heading to hold. hover_thrust_frac: (...).
    Returns:
        quaternion_wxyz (..., 4) FLU to ENU with w >= 0, thrust_frac (...) in [0, 1].
    Properties: body z axis equals F/|F|; heading equals yaw; yaw-rotation-equivariant.
    """
    f, yaw, hover = (
        thrust.thrust_enu_m_s2,
        np.asarray(yaw_rad, dtype=np.float64),
        np.asarray(hover_thrust_frac),
    )
    if f.ndim == 1 and all(map(math.isfinite, (*f.tolist(), float(yaw), float(hover)))) and float(hover) > 0.0:
        wanted = _limited_one(f, hover, params)
        *quaternion, throttle = kernel_motion.attitude(wanted, float(yaw), float(hover))
        return AttitudeSetpoint(np.array(quaternion), np.array(throttle))
    usable = is_usable(thrust, yaw, hover)
    if not np.all(usable):
        fallback = np.asarray(params.fallback_hover_thrust_frac, dtype=np.float64)
        yaw = np.where(np.isfinite(yaw), yaw, 0.0)
        hover = np.where(np.isfinite(hover) & (hover > 0.0), hover, fallback)
        f = np.where(usable[..., None], f, (0.0, 0.0, GRAVITY_M_S2))
    f = limit(Thrust(f), hover, params=params).thrust_enu_m_s2
    x, y, z = f[..., 0], f[..., 1], f[..., 2]
    length = np.sqrt(x * x + y * y + z * z)
    cos_yaw, sin_yaw = np.cos(yaw), np.sin(yaw)
    forward, left, up = (
        (cos_yaw * x + sin_yaw * y) / length,
        (cos_yaw * y - sin_yaw * x) / length,
        z / length,
    )
    cos_roll = np.sqrt(forward * forward + up * up)
    cr, sr = _half(cos_roll, -left)
    cp, sp = _half(up / cos_roll, forward / cos_roll)
    cy, sy = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    q = np.empty((*np.shape(length), 4))
    q[..., 0] = cy * cp * cr + sy * sp * sr
    q[..., 1] = cy * cp * sr - sy * sp * cr
    q[..., 2] = cy * sp * cr + sy * cp * sr
    q[..., 3] = sy * cp * cr - cy * sp * sr
    q *= np.where(q[..., 0] < 0.0, -1.0, 1.0)[..., None]
    return AttitudeSetpoint(q, np.asarray(length / GRAVITY_M_S2 * hover, dtype=np.float64))


def _limited_one(f: Array, hover_thrust_frac: Array, params: AllocationParams) -> tuple[float, float, float]:
    """:func:`limit` for one vehicle, in floats."""
    tan_tilt = math.tan(float(params.max_tilt_rad))
    bounds = float(params.min_thrust_frac), float(params.max_thrust_frac)
    return kernel_motion.limited(f.tolist(), float(hover_thrust_frac), tan_tilt, *bounds)


def _half(cosine: Array, sine: Array) -> tuple[Array, Array]:
    """Cosine and sine of half an angle in (-pi/2, pi/2) from those of the angle; exact at small angles too."""
    half_cosine = np.sqrt(0.5 * (1.0 + cosine))
    return half_cosine, sine / (2.0 * half_cosine)


def euler_from_thrust_paper(thrust: Array) -> tuple[Array, Array, Array]:
    """Implements: eq. (2), the reference. Roll, pitch and thrust in the paper's axes.

    Args:
        thrust: (..., 3) in x forward, y RIGHT, z up; from ENU/FLU at yaw 0 negate y. Any unit.
    Returns:
        roll_rad, pitch_rad (right-handed about x forward and y right), and |F|, (...) each.
    """
    x, y, z = thrust[..., 0], thrust[..., 1], thrust[..., 2]
    roll = np.arctan2(y, z)
    pitch = np.arctan2(-x, np.sqrt(y * y + z * z))
    return (
        np.asarray(roll),
        np.asarray(pitch),
        np.asarray(np.sqrt(x * x + y * y + z * z)),
    )


def tilt_rad(attitude: AttitudeSetpoint) -> Array:
    """Angle between body z and up, (...)."""
    q = attitude.quaternion_wxyz
    return np.asarray(
        2.0 * np.arcsin(np.minimum(1.0, np.sqrt(q[..., 1] ** 2 + q[..., 2] ** 2))),
        dtype=np.float64,
    )


def params_from_degrees(max_tilt_deg: float, hover_thrust_frac: float) -> AllocationParams:
    """Limits for a vehicle as its configuration gives them."""
    return AllocationParams(
        max_tilt_rad=math.radians(max_tilt_deg),
        fallback_hover_thrust_frac=hover_thrust_frac,
    )
