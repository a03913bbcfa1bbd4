"""Converts the thrust vector to PX4's setpoint: an attitude quaternion and a throttle.

The quaternion follows exactly from the thrust's direction and the yaw. DEVIATION D1: the paper's
(2) gives the angles of R = Rx(roll) Ry(pitch), but PX4 composes Euler angles as ZYX. Used as ZYX
angles, (2) errs by 0.4 m/s^2 at 30 deg of combined tilt, as a test shows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.constants import GRAVITY_M_S2
from onboard.types import AttitudeSetpoint, Thrust
from onboard.vectors import Vec3, is_finite, length

MAX_THRUST_FRAC = 0.98  # largest throttle that is sent


class AllocationParams(NamedTuple):
    """Limits of the setpoints that are sent."""

    max_tilt_rad: float  # largest angle between thrust and the vertical
    # configured hover throttle, for a level setpoint if the estimated one cannot be used
    fallback_hover_thrust_frac: float
    # smallest throttle: the propellers keep turning, so that the attitude stays controlled
    min_thrust_frac: float = 0.08
    max_thrust_frac: float = MAX_THRUST_FRAC


def tilted_less(params: AllocationParams, max_tilt_rad: float) -> AllocationParams:
    """Return the limits with a tilt that is at most the given one.

    Args:
        params: limits.
        max_tilt_rad: largest angle between thrust and the vertical.
    """
    return AllocationParams(
        max_tilt_rad=min(params.max_tilt_rad, max_tilt_rad),
        fallback_hover_thrust_frac=params.fallback_hover_thrust_frac,
        min_thrust_frac=params.min_thrust_frac,
        max_thrust_frac=params.max_thrust_frac,
    )


def is_usable(thrust: Thrust, yaw_rad: float, hover_thrust_frac: float) -> bool:
    """Whether ``allocate`` can use its inputs: all are finite, and the hover throttle is
    positive.
    """
    return (
        is_finite(thrust.thrust_enu_m_s2)
        and math.isfinite(yaw_rad)
        and math.isfinite(hover_thrust_frac)
        and hover_thrust_frac > 0.0
    )


def limit(thrust: Thrust, hover_thrust_frac: float, params: AllocationParams) -> Thrust:
    """Return the thrust within the limits; the vertical component has priority.

    The vertical component is kept as far as the throttle reaches. Then the horizontal component is
    shortened, but not turned, to what the tilt limit and the remaining throttle allow: F_h <=
    min(F_z tan(max_tilt), sqrt(F_max^2 - F_z^2)).

    Args:
        thrust: F/m [m/s^2], ENU, finite.
        hover_thrust_frac: throttle that carries the weight [-]; throttle is linear in thrust.
        params: limits.
    Properties: idempotent; yaw-rotation-equivariant; keeping the height has priority over tracking.
    """
    x, y, z = thrust.thrust_enu_m_s2
    full_m_s2 = GRAVITY_M_S2 / hover_thrust_frac  # thrust at full throttle
    largest_m_s2 = params.max_thrust_frac * full_m_s2

    up = min(max(z, params.min_thrust_frac * full_m_s2), largest_m_s2)
    by_tilt = up * math.tan(params.max_tilt_rad)
    by_throttle = math.sqrt(largest_m_s2 * largest_m_s2 - up * up)

    horizontal_limit = min(by_tilt, by_throttle)
    # 1e-12 avoids a division by zero
    scale = min(1.0, horizontal_limit / max(math.sqrt(x * x + y * y), 1e-12))
    return Thrust(Vec3(scale * x, scale * y, up))


def allocate(
    thrust: Thrust, yaw_rad: float, hover_thrust_frac: float, params: AllocationParams
) -> AttitudeSetpoint:
    """Return the attitude and throttle whose thrust is exactly the given vector, within limits.

    With b = F/|F| turned into the yaw frame, the attitude is Rz(yaw) Ry(pitch) Rx(roll) with pitch
    = atan2(b_x, b_z) and roll = asin(-b_y). Its third column is b, and its heading is yaw. The
    throttle is |F|/g * hover_thrust_frac. Unusable input (see ``is_usable``) gives a level attitude
    at the hover throttle.

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
    required = thrust
    yaw = yaw_rad
    hover_frac = hover_thrust_frac
    if not is_usable(thrust, yaw_rad, hover_thrust_frac):
        required = Thrust(Vec3(0.0, 0.0, GRAVITY_M_S2))
        if not math.isfinite(yaw_rad):
            yaw = 0.0
        if not (math.isfinite(hover_thrust_frac) and hover_thrust_frac > 0.0):
            hover_frac = params.fallback_hover_thrust_frac

    # b in the yaw frame
    force = limit(required, hover_frac, params).thrust_enu_m_s2
    size = length(force)
    cos_yaw = math.cos(yaw)
    sin_yaw = math.sin(yaw)
    forward = (cos_yaw * force.x + sin_yaw * force.y) / size
    left = (cos_yaw * force.y - sin_yaw * force.x) / size
    up = force.z / size

    # cosine of the roll angle itself, not of half of it; positive, because `limit` keeps up > 0
    cos_roll = math.sqrt(forward * forward + up * up)

    # The quaternion is made of c and s: cosine and sine of half of roll, pitch and yaw.
    c_roll, s_roll = _half(cos_roll, -left)
    c_pitch, s_pitch = _half(up / cos_roll, forward / cos_roll)
    c_yaw = math.cos(0.5 * yaw)
    s_yaw = math.sin(0.5 * yaw)

    w = c_yaw * c_pitch * c_roll + s_yaw * s_pitch * s_roll
    x = c_yaw * c_pitch * s_roll - s_yaw * s_pitch * c_roll
    y = c_yaw * s_pitch * c_roll + s_yaw * c_pitch * s_roll
    z = s_yaw * c_pitch * c_roll - c_yaw * s_pitch * s_roll

    # A quaternion and its negative are the same attitude. The one with w >= 0 is sent.
    sign = -1.0 if w < 0.0 else 1.0
    quaternion = (sign * w, sign * x, sign * y, sign * z)
    return AttitudeSetpoint(quaternion, size / GRAVITY_M_S2 * hover_frac)


def _half(cosine: float, sine: float) -> tuple[float, float]:
    """Return cosine and sine of half an angle in (-pi/2, pi/2), from those of the angle.

    The half-angle formula with a square root is exact at small angles too.
    """
    half_cosine = math.sqrt(0.5 * (1.0 + cosine))
    half_sine = sine / (2.0 * half_cosine)
    return half_cosine, half_sine
