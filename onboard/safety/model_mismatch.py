"""Detects in flight a vehicle that responds otherwise than its file says: lag, static gain, tilt
bias, hover throttle. Pure.

The disturbance observer has a model of the own commands after the configured lag: the acceleration
that the vehicle should have by now. The measured attitude is regressed on that model,

    measured = gain (response - late rate) + bias        for x and y, with one gain and one late,

where ``response`` is the model's acceleration, ``rate`` its derivative and ``late`` the time by
which the vehicle is slower than configured. The equation is linear in the unknowns theta = (gain,
gain late, bias_x, bias_y), so these come from least squares over the last half minute. Ten samples
a second are enough. ``covey identify`` measures the same more accurately.

In the code a is the response, r the rate and s what was measured, each along x and y.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from onboard.arrays import Array
from onboard.avoidance.prediction import LAG_ERROR_S
from onboard.frames import Quaternion, body_up
from onboard.types import GRAVITY_M_S2
from onboard.vectors import Vec3

_FORGET_S = 30.0  # time constant of the memory
_LEAST_S = 8.0  # of flight, before anything is said
_ATTITUDE_AGE_S = 0.012  # of PX4's attitude when it is used: it comes at 50-100 Hz over a link
_HOVER_SHARE = 0.12  # by which the hover throttle may differ from the file's
_SURE_S = 0.008  # largest standard deviation with which a difference of the lag counts
_CORRELATED_S = 0.5  # correlation time of the residuals
_LEAST_GAIN = 0.3  # below it the commands do not explain the motion
_LEAST_UP = 0.3  # vertical part of the body's up, below which a sample is left out
_LARGEST_CONDITION_NUMBER = 1e6


class LagDifference(NamedTuple):
    """By how much a vehicle responds more slowly than its file says."""

    slower_s: float  # negative: it is quicker
    std_s: float  # standard deviation of that; infinite while it is not known


_UNKNOWN = LagDifference(0.0, math.inf)


class ResponseMemory(NamedTuple):
    """Sums of the regression over the past, forgotten exponentially."""

    normal: Array  # (4, 4), the normal equations' matrix
    right: Array  # (4,), their right side
    energy: float  # sum of the squared measurements
    time_s: float


def initial() -> ResponseMemory:
    """Return the memory before the first sample."""
    return ResponseMemory(np.zeros((4, 4)), np.zeros(4), 0.0, 0.0)


def update(
    memory: ResponseMemory,
    response_enu_m_s2: Vec3,
    rate_enu_m_s3: Vec3,
    quaternion_wxyz: Quaternion,
    dt_s: float,
) -> ResponseMemory:
    """Return the memory after one sample in free flight.

    Args:
        memory: of the last tick.
        response_enu_m_s2: acceleration that the model of the commands has now; only its horizontal
            part is used.
        rate_enu_m_s3: its derivative.
        quaternion_wxyz: measured attitude, FLU to ENU.
        dt_s: since the last call.
    Returns:
        the memory; unchanged where something is not finite or the vehicle is upside down.
    """
    a_x, a_y, _ = response_enu_m_s2
    r_x, r_y, _ = rate_enu_m_s3
    up = body_up(quaternion_wxyz)
    is_finite = math.isfinite(a_x + a_y) and math.isfinite(r_x + r_y)
    is_upright = up.z > _LEAST_UP
    if not (is_finite and is_upright):
        return memory

    # measured: horizontal acceleration of a thrust along the body's up that carries the weight
    s_x = GRAVITY_M_S2 * up.x / up.z
    s_y = GRAVITY_M_S2 * up.y / up.z

    # Each axis is a row of the regression: (a_x, -r_x, 1, 0) theta = s_x, and likewise for y. Both
    # rows are added to the normal equations: their products with themselves, and with s.
    mixed = -(a_x * r_x + a_y * r_y)
    normal = np.array(
        (
            (a_x * a_x + a_y * a_y, mixed, a_x, a_y),
            (mixed, r_x * r_x + r_y * r_y, -r_x, -r_y),
            (a_x, -r_x, 1.0, 0.0),
            (a_y, -r_y, 0.0, 1.0),
        )
    )
    right = np.array((a_x * s_x + a_y * s_y, -(r_x * s_x + r_y * s_y), s_x, s_y))

    keep = math.exp(-dt_s / _FORGET_S)
    return ResponseMemory(
        normal=keep * memory.normal + normal,
        right=keep * memory.right + right,
        energy=keep * memory.energy + s_x * s_x + s_y * s_y,
        time_s=keep * memory.time_s + dt_s,
    )


def lag_difference(memory: ResponseMemory) -> LagDifference:
    """Return by how much the vehicle is slower than configured, and how sure that is.

    Args:
        memory: of the flight so far.
    Returns:
        the difference of the lag; not known while there are too few samples, or commands too poor.
    """
    if memory.time_s < _LEAST_S:
        return _UNKNOWN

    # scaled to a unit diagonal, so that the condition number says whether the commands were rich
    scale = np.sqrt(np.maximum(np.diag(memory.normal), 1e-9))
    scales = np.outer(scale, scale)
    normal = memory.normal / scales
    if np.linalg.cond(normal) > _LARGEST_CONDITION_NUMBER:
        return _UNKNOWN

    inverse = np.linalg.inv(normal) / scales
    theta = inverse @ memory.right
    gain = theta[0]
    gain_late = theta[1]
    if gain < _LEAST_GAIN:
        return _UNKNOWN

    # each sample has two measurements: normal[2, 2] and normal[3, 3] both count the samples
    sample_count = memory.normal[2, 2]
    measurement_count = sample_count + memory.normal[3, 3]
    variance = max(memory.energy - float(theta @ memory.right), 1e-9) / measurement_count

    # samples within the correlation time say the same: so many of them count as one
    alike_count = max(1.0, _CORRELATED_S * sample_count / memory.time_s)
    return LagDifference(
        slower_s=float(gain_late / gain) - _ATTITUDE_AGE_S,
        std_s=math.sqrt(alike_count * variance * inverse[1, 1]) / gain,
    )


def differences(
    memory: ResponseMemory, lag_s: float, hover_frac: float, configured_hover_frac: float
) -> dict[str, str]:
    """Return what differs from the vehicle's file by more than the law tolerates.

    Args:
        memory: of the flight so far.
        lag_s: configured lag.
        hover_frac: hover throttle learned in flight.
        configured_hover_frac: hover throttle of the fleet file.
    Returns:
        code -> sentence with the remedy, for everything that differs.
    """
    sentences: dict[str, str] = {}

    slower_s, std_s = lag_difference(memory)
    if std_s < _SURE_S and abs(slower_s) - 2.0 * std_s > LAG_ERROR_S:
        direction = "later" if slower_s > 0.0 else "earlier"
        sentences["lag-differs"] = (
            f"The attitude responds {1e3 * abs(slower_s):.0f} ms {direction} than the fleet "
            f"file's lag of {lag_s:.2f} s, so the safety distance is not certain. "
            "Land, and run covey identify."
        )

    hover_share = hover_frac / configured_hover_frac
    if memory.time_s >= _LEAST_S and abs(hover_share - 1.0) > _HOVER_SHARE:
        sentences["hover-differs"] = (
            f"The vehicle hovers at {hover_frac:.2f} of its throttle, "
            f"the fleet file says {configured_hover_frac:.2f}. "
            "Check load, propellers and battery, or correct hover_thrust_frac."
        )
    return sentences
