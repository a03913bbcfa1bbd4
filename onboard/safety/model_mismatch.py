"""Detects in flight that a vehicle's lag or hover throttle differs from its fleet file. Pure.

The disturbance observer has a model that applies the vehicle's own commands after the configured
lag. It gives the acceleration that the vehicle should have now. The acceleration computed from the
measured attitude is regressed on it:

    measured = gain (response - delay rate) + bias        for x and y, with a common gain and delay

Here ``response`` is the model's acceleration, ``rate`` its derivative, and ``delay`` says how much
slower than configured the vehicle responds. The equation is linear in the unknowns theta = (gain,
gain delay, bias_x, bias_y). They come from least squares over the last half minute.

In the code a is the response, r the rate and s the measured acceleration, each along x and y.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from onboard.arrays import Array
from onboard.avoidance.prediction import LAG_ERROR_S
from onboard.constants import GRAVITY_M_S2
from onboard.frames import Quaternion, body_up
from onboard.vectors import Vec3

_FORGET_S = 30.0  # time constant of the memory
_MIN_S = 8.0  # time of flight before any result
_ATTITUDE_AGE_S = 0.012  # mean age of PX4's attitude when it is used; it arrives at 50 to 100 Hz
_HOVER_SHARE = 0.12  # the hover throttle may differ from the file's by this share
_SURE_S = 0.008  # a difference of the lag counts up to this standard deviation
_CORRELATED_S = 0.5  # correlation time of the residuals
_MIN_GAIN = 0.3  # with a smaller gain, the commands do not explain the motion
_MIN_UP = 0.3  # a sample with a smaller vertical part of the body's up is left out
_LARGEST_CONDITION_NUMBER = 1e6  # above it, the commands varied too little for a result
_MIN_SQUARE = 1e-9  # avoids a division by zero, and the square root of a negative number


class LagDifference(NamedTuple):
    """How much more slowly a vehicle responds than its file says."""

    slower_s: float  # negative: it responds sooner than the file says
    std_s: float  # standard deviation of slower_s; infinite while it is not known


_UNKNOWN = LagDifference(0.0, math.inf)


class ResponseMemory(NamedTuple):
    """Sums of the regression over the past, with exponential forgetting."""

    normal: Array  # (4, 4), matrix of the normal equations
    right: Array  # (4,), right side of the normal equations
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
        memory: memory of the last tick.
        response_enu_m_s2: present acceleration of the observer's model; its horizontal part is
            used.
        rate_enu_m_s3: derivative of that acceleration.
        quaternion_wxyz: measured attitude, FLU to ENU.
        dt_s: time since the last call.
    Returns:
        The memory. It is unchanged if a number is not finite or the vehicle is upside down.
    """
    a_x, a_y, _ = response_enu_m_s2
    r_x, r_y, _ = rate_enu_m_s3
    up = body_up(quaternion_wxyz)
    is_finite = math.isfinite(a_x + a_y) and math.isfinite(r_x + r_y)
    is_upright = up.z > _MIN_UP
    if not (is_finite and is_upright):
        return memory

    # the measured acceleration is that of a thrust along the body's up axis that carries the weight
    s_x = GRAVITY_M_S2 * up.x / up.z
    s_y = GRAVITY_M_S2 * up.y / up.z

    # Each axis is a row of the regression: (a_x, -r_x, 1, 0) theta = s_x, and likewise for y. Add
    # the products of both rows with themselves and with s to the normal equations.
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
    """Return how much more slowly the vehicle responds than configured.

    Args:
        memory: memory of the flight so far.
    Returns:
        The difference of the lag. It is not known (infinite deviation) while there are too few
        samples, or while the commands vary too little.
    """
    if memory.time_s < _MIN_S:
        return _UNKNOWN

    # scaled to a unit diagonal, so that the condition number tells whether the commands varied
    scale = np.sqrt(np.maximum(np.diag(memory.normal), _MIN_SQUARE))
    scales = np.outer(scale, scale)
    normal = memory.normal / scales
    if np.linalg.cond(normal) > _LARGEST_CONDITION_NUMBER:
        return _UNKNOWN

    inverse = np.linalg.inv(normal) / scales
    theta = inverse @ memory.right
    gain, gain_delay, _, _ = theta
    if gain < _MIN_GAIN:
        return _UNKNOWN

    sample_count = memory.normal[2, 2]  # sum of the ones in the third column
    measurement_count = 2.0 * sample_count  # along x and y
    residuals = max(memory.energy - float(theta @ memory.right), _MIN_SQUARE)
    variance = residuals / measurement_count
    gain_delay_variance = variance * inverse[1, 1]

    # all samples within one correlation time carry the information of one sample
    correlated_count = max(1.0, _CORRELATED_S * sample_count / memory.time_s)
    return LagDifference(
        slower_s=float(gain_delay / gain) - _ATTITUDE_AGE_S,
        std_s=math.sqrt(correlated_count * gain_delay_variance) / gain,
    )


def differences(
    memory: ResponseMemory, lag_s: float, hover_frac: float, configured_hover_frac: float
) -> dict[str, str]:
    """Return what differs from the vehicle's file by more than the law tolerates.

    Args:
        memory: memory of the flight so far.
        lag_s: configured lag.
        hover_frac: hover throttle learned in flight.
        configured_hover_frac: hover throttle of the fleet file.
    Returns:
        code of each value that differs -> a sentence with the remedy.
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
    if memory.time_s >= _MIN_S and abs(hover_share - 1.0) > _HOVER_SHARE:
        sentences["hover-differs"] = (
            f"The vehicle hovers at {hover_frac:.2f} of its throttle, "
            f"the fleet file says {configured_hover_frac:.2f}. "
            "Check load, propellers and battery, or correct hover_thrust_frac."
        )
    return sentences
