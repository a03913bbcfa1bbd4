"""Baseline: backstepping along the trajectory, as if the vehicle were alone.

The paper leaves the baseline's gains to a source that is not public ([18]); this is our own derivation. For one
vehicle p'' = a with the setpoint (p_s, v_s, a_s), the tracking error e = p_s - p and its radial clamp s(e) (s(e) = e
inside the radius r, r e/|e| outside; s is the gradient of the convex Huber function H(e)):

    v_ref = v_s + k1 s(e)                       first step: what velocity would bring e to rest
    z     = v - v_ref                           so e' = v_s - v = -k1 s(e) - z
    W     = c H(e) + |z|^2 / 2                  Lyapunov function
    W'    = c s.e' + z.(a - a_s - k1 s'(e) e')
    a     = a_s + k1 s'(e) (v_s - v) + c s(e) - k2 z        second step
    W'    = -c k1 |s(e)|^2 - k2 |z|^2           negative definite for k1, k2, c > 0

The term k1 s'(v_s - v) is the derivative of the first step's reference and c s(e) is the cross term that cancels
-c s.z; dropping either leaves W' indefinite. Inside the clamp this is a linear loop s^2 + (k1 + k2) s + (k1 k2 + c).
The clamp makes the answer to a far setpoint a bounded velocity k1 r instead of full tilt towards and away.

Integral action: none here. A free integrator winds up whenever the avoidance law holds the vehicle back. Static errors
(tilt bias, weak attitude gain, wind) are seen by the disturbance observer instead (disturbance.py), which knows what
was really commanded, so that holding back does not charge it. The state given here is the one predicted over the
attitude lag, which is why gains of 1.5 and 4 1/s are stable with 0.15 s of lag as well as with 0.27 s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onboard.control import kernel_motion
from onboard.frames import vector
from onboard.types import GRAVITY_M_S2, Array, Thrust, TrajectorySetpoint


@dataclass(frozen=True, slots=True)
class BacksteppingParams:
    """Gains and bounds; each a float or (...).

    position_gain_1_s: k1; a position error decays with it. velocity_gain_1_s: k2; bounded by the attitude loop's
    bandwidth (k1 + k2 below half of wn). coupling_1_s2: c. max_position_error_m: r, so the vehicle returns to its
    setpoint with at most k1 r. max_acceleration_m_s2: horizontal, at most g tan(max_tilt).
    max_vertical_acceleration_m_s2: up and down, below g.
    """

    position_gain_1_s: Array | float = 1.5
    velocity_gain_1_s: Array | float = 4.0
    coupling_1_s2: Array | float = 0.5
    max_position_error_m: Array | float = 0.8
    max_acceleration_m_s2: Array | float = 4.0
    max_vertical_acceleration_m_s2: Array | float = 2.5


def step(
    position_enu_m: Array,
    velocity_enu_m_s: Array,
    setpoint: TrajectorySetpoint,
    *,
    params: BacksteppingParams,
) -> Thrust:
    """Thrust that tracks the setpoint; see the module's derivation.

    Args:
        position_enu_m, velocity_enu_m_s: (..., 3), predicted to the time at which the thrust acts.
        setpoint: for that same time, (..., 3) each.
    Returns:
        F/m (..., 3) [m/s^2] ENU with gravity included: hover is (0, 0, g). Bounded as the params say.
    Properties: yaw-rotation- and translation-equivariant; homogeneous in length; zero error gives a_s + g.
    """
    if position_enu_m.ndim == 1:
        return _step_one(position_enu_m, velocity_enu_m_s, setpoint, params)
    k1, k2, c = params.position_gain_1_s, params.velocity_gain_1_s, params.coupling_1_s2
    error = setpoint.position_enu_m - position_enu_m
    slip = setpoint.velocity_enu_m_s - velocity_enu_m_s
    feed = setpoint.acceleration_enu_m_s2
    ex, ey, ez = error[..., 0], error[..., 1], error[..., 2]
    dx, dy, dz = slip[..., 0], slip[..., 1], slip[..., 2]
    # The clamp is horizontal and vertical apart: a far setpoint in the plane must not weaken the hold of height.
    radius = params.max_position_error_m
    far = np.sqrt(ex * ex + ey * ey)
    ratio = np.minimum(1.0, radius / np.maximum(far, 1e-12))
    outside = ratio < 1.0
    # s'(e) = I inside; outside r/|e| (I - e e^T/|e|^2): only the turning of e moves a clamped reference
    radial = np.where(outside, (ex * dx + ey * dy) / np.maximum(far * far, 1e-12), 0.0)
    turn_x, turn_y = ratio * (dx - radial * ex), ratio * (dy - radial * ey)
    sx, sy = ratio * ex, ratio * ey
    sz = np.minimum(np.maximum(ez, -radius), radius)
    turn_z = np.where(sz == ez, dz, 0.0)
    spring = k1 * k2 + c
    ax = feed[..., 0] + k1 * turn_x + k2 * dx + spring * sx
    ay = feed[..., 1] + k1 * turn_y + k2 * dy + spring * sy
    az = feed[..., 2] + k1 * turn_z + k2 * dz + spring * sz
    size = np.sqrt(ax * ax + ay * ay)
    scale = np.minimum(1.0, params.max_acceleration_m_s2 / np.maximum(size, 1e-12))
    az_bound = params.max_vertical_acceleration_m_s2
    return Thrust(
        vector(
            scale * ax,
            scale * ay,
            np.minimum(np.maximum(az, -az_bound), az_bound) + GRAVITY_M_S2,
        )
    )


def _step_one(
    position_enu_m: Array, velocity_enu_m_s: Array, setpoint: TrajectorySetpoint, params: BacksteppingParams
) -> Thrust:
    """:func:`step` for one vehicle, in floats."""
    p_x, p_y, p_z = position_enu_m.tolist()
    v_x, v_y, v_z = velocity_enu_m_s.tolist()
    s_x, s_y, s_z = setpoint.position_enu_m.tolist()
    r_x, r_y, r_z = setpoint.velocity_enu_m_s.tolist()
    x, y, z = kernel_motion.baseline(
        (s_x - p_x, s_y - p_y, s_z - p_z),
        (r_x - v_x, r_y - v_y, r_z - v_z),
        setpoint.acceleration_enu_m_s2.tolist(),
        (float(params.position_gain_1_s), float(params.velocity_gain_1_s), float(params.coupling_1_s2)),
        float(params.max_position_error_m),
        (float(params.max_acceleration_m_s2), float(params.max_vertical_acceleration_m_s2)),
    )
    return Thrust(np.array((x, y, z + GRAVITY_M_S2)))
