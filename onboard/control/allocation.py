"""From the thrust vector to the setpoint that PX4 takes: an attitude quaternion and a throttle.

The quaternion is built exactly from thrust direction and yaw.
DEVIATION D1: the paper's (2) gives the angles of R = Rx(roll) Ry(pitch), whereas PX4 composes Euler
angles as ZYX; read that way (2) errs by 0.4 m/s^2 at 30 deg of combined tilt (a test shows it).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.types import GRAVITY_M_S2, AttitudeSetpoint, Thrust
from onboard.vectors import Vec3, is_finite, length

MAX_THRUST_FRAC = 0.98


class AllocationParams(NamedTuple):
    """Limits of the setpoints that are sent."""

    max_tilt_rad: float  # between thrust and the vertical
    # throttle of the level answer to unusable input: the configured hover throttle
    fallback_hover_thrust_frac: float
    min_thrust_frac: float = 0.08  # keeps the propellers turning, so that attitude stays controlled
    max_thrust_frac: float = MAX_THRUST_FRAC


def is_usable(thrust: Thrust, yaw_rad: float, hover_thrust_frac: float) -> bool:
    """Whether all inputs of ``allocate`` are finite and the hover throttle is positive; else it
    levels out.
    """
    is_number = (
        is_finite(thrust.thrust_enu_m_s2)
        and math.isfinite(yaw_rad)
        and math.isfinite(hover_thrust_frac)
    )
    return is_number and hover_thrust_frac > 0.0


def limit(thrust: Thrust, hover_thrust_frac: float, params: AllocationParams) -> Thrust:
    """Return the nearest thrust within the limits, height first.

    The vertical component is kept as far as the throttle reaches, then the horizontal one is
    shortened (its direction kept) to what tilt limit and remaining throttle allow: F_h <= min(F_z
    tan(max_tilt), sqrt(F_max^2 - F_z^2)).

    Args:
        thrust: F/m [m/s^2], ENU, finite.
        hover_thrust_frac: throttle that carries the weight [-]; throttle is linear in thrust.
        params: limits.
    Properties: idempotent; yaw-rotation-equivariant; keeps height before tracking.
    """
    x, y, z = thrust.thrust_enu_m_s2
    unit = GRAVITY_M_S2 / hover_thrust_frac
    largest = params.max_thrust_frac * unit
    up = min(max(z, params.min_thrust_frac * unit), largest)
    room = min(up * math.tan(params.max_tilt_rad), math.sqrt(largest * largest - up * up))
    scale = min(1.0, room / max(math.sqrt(x * x + y * y), 1e-12))
    return Thrust(Vec3(scale * x, scale * y, up))


def allocate(
    thrust: Thrust, yaw_rad: float, hover_thrust_frac: float, params: AllocationParams
) -> AttitudeSetpoint:
    """Return the attitude and throttle whose thrust is the given vector, exactly, within the
    limits.

    With b = F/|F| turned into the yaw frame, the attitude is Rz(yaw) Ry(pitch) Rx(roll) with pitch
    = atan2(b_x, b_z) and roll = asin(-b_y): its third column is b and its heading is yaw. Half
    angles come from square roots. thrust_frac = |F|/g * hover_thrust_frac. Unusable input gives
    level at the hover throttle (see ``is_usable``).

    Implements: the inverse of eq. (2), see DEVIATION D1.

    Args:
        thrust: F/m [m/s^2], ENU.
        yaw_rad: heading to hold, counterclockwise from east.
        hover_thrust_frac: throttle that carries the weight [-].
        params: limits.
    Returns:
        quaternion_wxyz FLU to ENU with w >= 0, thrust_frac in [0, 1].
    Properties: body z axis equals F/|F|; heading equals yaw; yaw-rotation-equivariant.
    """
    wanted, yaw, hover = thrust, yaw_rad, hover_thrust_frac
    if not is_usable(thrust, yaw_rad, hover_thrust_frac):
        wanted = Thrust(Vec3(0.0, 0.0, GRAVITY_M_S2))
        yaw = yaw_rad if math.isfinite(yaw_rad) else 0.0
        is_known = math.isfinite(hover_thrust_frac) and hover_thrust_frac > 0.0
        hover = hover_thrust_frac if is_known else params.fallback_hover_thrust_frac
    force = limit(wanted, hover, params).thrust_enu_m_s2
    size = length(force)
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    forward = (cos_yaw * force.x + sin_yaw * force.y) / size
    left = (cos_yaw * force.y - sin_yaw * force.x) / size
    up = force.z / size
    cos_roll = math.sqrt(forward * forward + up * up)
    cr, sr = _half(cos_roll, -left)
    cp, sp = _half(up / cos_roll, forward / cos_roll)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    w = cy * cp * cr + sy * sp * sr
    sign = -1.0 if w < 0.0 else 1.0
    quaternion = (
        sign * w,
        sign * (cy * cp * sr - sy * sp * cr),
        sign * (cy * sp * cr + sy * cp * sr),
        sign * (sy * cp * cr - cy * sp * sr),
    )
    return AttitudeSetpoint(quaternion, size / GRAVITY_M_S2 * hover)


def _half(cosine: float, sine: float) -> tuple[float, float]:
    """Return cosine and sine of half an angle in (-pi/2, pi/2) from those of the angle; exact at
    small angles too.
    """
    half_cosine = math.sqrt(0.5 * (1.0 + cosine))
    return half_cosine, sine / (2.0 * half_cosine)
