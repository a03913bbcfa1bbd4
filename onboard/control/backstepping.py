"""Baseline: the thrust that tracks the trajectory by backstepping, as if the vehicle were alone.

The paper takes the baseline's gains from a source that is not public ([18]), so this is our own
derivation. The vehicle obeys p'' = a, and the setpoint is (p_s, v_s, a_s). The tracking error is
e = p_s - p. Its radial clamp is s(e) = e inside the radius r, and s(e) = r e/|e| outside. The clamp
s is the gradient of the convex Huber function H(e). Then:

    v_ref = v_s + k1 s(e)                       first step: the velocity that brings e to rest
    z     = v - v_ref                           so e' = v_s - v = -k1 s(e) - z
    W     = c H(e) + |z|^2 / 2                  Lyapunov function
    W'    = c s.e' + z.(a - a_s - k1 s'(e) e')
    a     = a_s + k1 s'(e) (v_s - v) + c s(e) - k2 z        second step
    W'    = -c k1 |s(e)|^2 - k2 |z|^2           negative definite for k1, k2, c > 0

The term k1 s'(v_s - v) is the derivative of the first step's reference, and c s(e) is the cross
term that cancels -c s.z. Without either of them W' is indefinite. Inside the clamp this is a linear
loop with the polynomial s^2 + (k1 + k2) s + (k1 k2 + c). For a distant setpoint, the clamp bounds
the velocity to k1 r. Without it, the vehicle would tilt fully, first towards the setpoint and then
away.

There is no integral action here, because a free integrator winds up while the avoidance law holds
the vehicle back. The disturbance observer (estimation/disturbance_observer.py) compensates static
errors: tilt bias, weak attitude gain and wind. The state given here is predicted over the attitude
lag.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.constants import GRAVITY_M_S2
from onboard.types import Thrust, TrajectorySetpoint
from onboard.vectors import Vec3, subtract


class BacksteppingParams(NamedTuple):
    """Gains and bounds of the baseline."""

    position_gain_1_s: float = 1.5  # k1: rate at which a position error decays
    velocity_gain_1_s: float = 4.0  # k2; k1 + k2 stay below half of the attitude loop's wn
    coupling_1_s2: float = 0.5  # c
    # r: the vehicle returns to its setpoint with at most k1 r, horizontally and vertically
    max_position_error_m: float = 0.8
    max_height_error_m: float = 0.8
    max_acceleration_m_s2: float = 4.0  # horizontal, at most g tan(max_tilt)
    max_vertical_acceleration_m_s2: float = 2.5  # up and down, below g


def step(
    position_enu_m: Vec3,
    velocity_enu_m_s: Vec3,
    setpoint: TrajectorySetpoint,
    params: BacksteppingParams,
) -> Thrust:
    """Return the thrust that tracks the setpoint. The module docstring derives it.

    Args:
        position_enu_m: position predicted to the time at which the thrust acts [m], ENU.
        velocity_enu_m_s: velocity at the same time [m/s], ENU.
        setpoint: setpoint for the same time.
        params: gains and bounds.
    Returns:
        F/m [m/s^2], ENU, with gravity included: hover is (0, 0, g). ``params`` bound it.
    Properties: equivariant under translations and rotations about the vertical; gravity aside,
    homogeneous if the bounds are scaled with the state and the setpoint; without an error it is
    a_s + g, if the bounds allow a_s.
    """
    k1 = params.position_gain_1_s
    k2 = params.velocity_gain_1_s
    spring = k1 * k2 + params.coupling_1_s2  # factor of s(e): c, and k1 k2 from the term -k2 z

    e = subtract(setpoint.position_enu_m, position_enu_m)
    d = subtract(setpoint.velocity_enu_m_s, velocity_enu_m_s)  # e'
    feed = setpoint.acceleration_enu_m_s2

    # Horizontal and vertical errors are clamped separately, so that a horizontally distant setpoint
    # does not weaken the height control. Horizontally s(e) = ratio e and s'(e) d = ratio (d -
    # radial e).
    radius = params.max_position_error_m
    squared_error_m2 = e.x * e.x + e.y * e.y
    if squared_error_m2 > radius * radius:
        # s'(e) = r/|e| (I - e e^T/|e|^2): a clamped reference moves only where e turns
        ratio = radius / max(math.sqrt(squared_error_m2), 1e-12)
        radial = (e.x * d.x + e.y * d.y) / max(squared_error_m2, 1e-12)
    else:
        # s'(e) = I
        ratio = 1.0
        radial = 0.0

    s_z = min(max(e.z, -params.max_height_error_m), params.max_height_error_m)
    is_clamped = s_z != e.z
    rate_z = 0.0 if is_clamped else d.z  # s'(e) d

    a_x = feed.x + k1 * (ratio * (d.x - radial * e.x)) + k2 * d.x + spring * (ratio * e.x)
    a_y = feed.y + k1 * (ratio * (d.y - radial * e.y)) + k2 * d.y + spring * (ratio * e.y)
    a_z = feed.z + k1 * rate_z + k2 * d.z + spring * s_z

    scale = min(1.0, params.max_acceleration_m_s2 / max(math.sqrt(a_x * a_x + a_y * a_y), 1e-12))
    highest = params.max_vertical_acceleration_m_s2
    a_z = min(max(a_z, -highest), highest)
    return Thrust(Vec3(scale * a_x, scale * a_y, a_z + GRAVITY_M_S2))
