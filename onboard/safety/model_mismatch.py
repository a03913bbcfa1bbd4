"""Detects in flight a vehicle that responds otherwise than its file says: lag, static gain, tilt
bias, hover throttle.

The disturbance observer has a model of the own commands after the configured lag. The measured
attitude is regressed on that model: measured = gain (response - late rate) + bias, per axis, with
``late`` the time by which the vehicle is slower than configured. The method is recursive least
squares with a memory of half a minute; ten samples a second are enough. ``covey identify`` measures
the same more accurately.
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

_FORGET_S = 30.0
_LEAST_S = 8.0
_ATTITUDE_AGE_S = 0.012  # PX4's attitude at 50-100 Hz over a link, when it is used
_HOVER_SHARE = 0.12
_SURE_S = 0.008  # largest standard deviation of the lag's error with which it is believed
_CORRELATED_S = 0.5  # correlation time of the residuals


class ResponseMemory(NamedTuple):
    """Sums of the regression over the past, forgotten exponentially."""

    normal: Array  # (4, 4)
    right: Array  # (4,)
    energy: float  # of the measurement
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
    """Take one sample in free flight.

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
    if not (math.isfinite(a_x + a_y) and math.isfinite(r_x + r_y) and up.z > 0.3):
        return memory
    s_x, s_y = GRAVITY_M_S2 * up.x / up.z, GRAVITY_M_S2 * up.y / up.z
    keep = math.exp(-dt_s / _FORGET_S)
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
    return ResponseMemory(
        keep * memory.normal + normal,
        keep * memory.right + right,
        keep * memory.energy + s_x * s_x + s_y * s_y,
        keep * memory.time_s + dt_s,
    )


def late_s(memory: ResponseMemory) -> tuple[float, float]:
    """Estimate by how much the vehicle is slower than configured.

    Args:
        memory: of the flight so far.
    Returns:
        the difference of the lag [s] and its standard deviation [s]; (0, inf) while there are too
        few samples.
    """
    if memory.time_s < _LEAST_S:
        return 0.0, math.inf
    scale = np.sqrt(np.maximum(np.diag(memory.normal), 1e-9))
    normal = memory.normal / np.outer(scale, scale)
    if np.linalg.cond(normal) > 1e6:
        return 0.0, math.inf
    inverse = np.linalg.inv(normal) / np.outer(scale, scale)
    gain, lag, *_ = theta = inverse @ memory.right
    if gain < 0.3:
        return 0.0, math.inf
    count = memory.normal[2, 2] + memory.normal[3, 3]
    variance = max(memory.energy - float(theta @ memory.right), 1e-9) / count
    alike = max(1.0, _CORRELATED_S * memory.normal[2, 2] / memory.time_s)  # correlated samples
    std = math.sqrt(alike * variance * inverse[1, 1]) / gain
    return float(lag / gain) - _ATTITUDE_AGE_S, std


def differences(
    memory: ResponseMemory, lag_s: float, hover_frac: float, configured_hover_frac: float
) -> dict[str, str]:
    """Compare the vehicle with its file.

    Args:
        memory: of the flight so far.
        lag_s: configured lag.
        hover_frac: hover throttle learned in flight.
        configured_hover_frac: hover throttle of the fleet file.
    Returns:
        code -> sentence with the remedy, for everything that differs by more than the law
        tolerates.
    """
    sentences: dict[str, str] = {}
    late, std = late_s(memory)
    if std < _SURE_S and abs(late) - 2.0 * std > LAG_ERROR_S:
        sentences["lag-differs"] = (
            f"The attitude responds {1e3 * abs(late):.0f} ms {'later' if late > 0.0 else 'earlier'} than the fleet "
            f"file's lag of {lag_s:.2f} s, so the safety distance is not certain. Land, and run covey identify."
        )
    if memory.time_s >= _LEAST_S and abs(hover_frac / configured_hover_frac - 1.0) > _HOVER_SHARE:
        sentences["hover-differs"] = (
            f"The vehicle hovers at {hover_frac:.2f} of its throttle, the fleet file says {configured_hover_frac:.2f}. "
            "Check load, propellers and battery, or correct hover_thrust_frac."
        )
    return sentences
