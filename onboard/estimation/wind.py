"""Wind that a vehicle feels: from its lean, its motion and its drag.

A vehicle that leans by more than its acceleration explains is pushed. The Kalman filter has that
push: it is the part of its bias that attitude, throttle and the drag of the own motion do not
explain. Divided by the drag it is the velocity of the air. Its mean over some seconds is the wind,
and what is left are the gusts. Without a drag the wind is not known, but the gusts are, as an
acceleration.

Gusts are slower to be learned than they come: for the time of the lag and of the disturbance
observer they move the vehicle as nobody has commanded. Hence they are an error of the velocity that
the vehicle publishes, and widen the distance that all keep from it. Gusts come in groups: what two
calm seconds look like says little about the next one. So the distance goes by the strongest of
three: those of now, those of the last half minute, and those that belong to the wind of now.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.config.wind_limit import GUST_SHARE
from onboard.types import State
from onboard.vectors import ZERO_3, Vec3, add_scaled, subtract

MEAN_TIME_S = 2.0  # over which mean and gusts are taken
_LASTING_TIME_S = 30.0  # over which the gusts are taken that the distance to others goes by

_KNOWN_AFTER_S = 1.0  # of flight

# Gusts up to this are covered by the margin that always is there, and change nothing. In calm air
# the filter's bias wanders by 0.03 m/s^2.
COVERED_M_S2 = 0.15


class WindMemory(NamedTuple):
    """State of the estimate."""

    push_enu_m_s2: Vec3  # mean of what pushes the vehicle
    variance_m2_s4: float  # of the push about that mean, per horizontal axis
    lasting_variance_m2_s4: float  # mean of that variance over a longer time
    time_s: float  # for so long the vehicle has flown


def initial() -> WindMemory:
    """Return the memory of a vehicle that nothing pushes."""
    return WindMemory(
        push_enu_m_s2=ZERO_3, variance_m2_s4=0.0, lasting_variance_m2_s4=0.0, time_s=0.0
    )


def step(memory: WindMemory, bias_enu_m_s2: Vec3, dt_s: float, is_on_ground: bool) -> WindMemory:
    """Return the memory after a tick.

    Args:
        memory: of the last tick.
        bias_enu_m_s2: acceleration that attitude, throttle and drag do not explain, from the Kalman
            filter [m/s^2], ENU.
        dt_s: length of the tick.
        is_on_ground: whether the vehicle stands: the wind of an earlier flight is forgotten.
    """
    if is_on_ground:
        return initial()
    if not math.isfinite(bias_enu_m_s2.x + bias_enu_m_s2.y + bias_enu_m_s2.z):
        return memory

    # a plain mean at first
    time_s = memory.time_s + dt_s
    blend = dt_s / max(min(time_s, MEAN_TIME_S), dt_s, 1e-6)
    off = subtract(bias_enu_m_s2, memory.push_enu_m_s2)
    # once from the mean before and once from the mean after, so that a first sample is no gust
    square_m2_s4 = 0.5 * (1.0 - blend) * (off.x * off.x + off.y * off.y)
    variance_m2_s4 = memory.variance_m2_s4 + dt_s / MEAN_TIME_S * (
        square_m2_s4 - memory.variance_m2_s4
    )

    lasting_blend = dt_s / max(min(time_s, _LASTING_TIME_S), dt_s, 1e-6)
    lasting_variance_m2_s4 = memory.lasting_variance_m2_s4 + lasting_blend * (
        variance_m2_s4 - memory.lasting_variance_m2_s4
    )

    return WindMemory(
        push_enu_m_s2=add_scaled(memory.push_enu_m_s2, blend, off),
        variance_m2_s4=variance_m2_s4,
        lasting_variance_m2_s4=lasting_variance_m2_s4,
        time_s=time_s,
    )


def wind_enu_m_s(memory: WindMemory, drag_1_s: float) -> tuple[float, float]:
    """Return the mean velocity of the air, east and north [m/s]; NaN while it is not known.

    That is on the ground, in the first second of a flight, and always without a drag.

    Args:
        memory: of now.
        drag_1_s: of the vehicle; 0: not known.
    """
    if drag_1_s <= 0.0 or memory.time_s < _KNOWN_AFTER_S:
        return (math.nan, math.nan)
    push = memory.push_enu_m_s2
    return (push.x / drag_1_s, push.y / drag_1_s)


def gust_std_m_s2(memory: WindMemory) -> float:
    """Return the standard deviation of the gusts as an acceleration, per axis [m/s^2].

    Args:
        memory: of now.
    """
    return math.sqrt(memory.variance_m2_s4)


def strongest_gust_std_m_s2(memory: WindMemory) -> float:
    """Return the gusts to reckon with, as an acceleration, per axis [m/s^2].

    That is the largest standard deviation of now, of the last half minute, and of what belongs to
    the mean wind.

    Args:
        memory: of now.
    """
    now_m_s2 = gust_std_m_s2(memory)
    lasting_m_s2 = math.sqrt(memory.lasting_variance_m2_s4)
    expected_m_s2 = GUST_SHARE * math.hypot(memory.push_enu_m_s2.x, memory.push_enu_m_s2.y)
    return max(now_m_s2, lasting_m_s2, expected_m_s2)


def widened(state: State, memory: WindMemory, gust_time_s: float) -> State:
    """Return the estimate with the error of its velocity that gusts cause.

    Args:
        state: estimate of the Kalman filter.
        memory: of now.
        gust_time_s: for so long a gust moves the vehicle before it is leaned against.
    Properties: in calm air, and in gusts that the margin covers, the estimate stays as it is.
    """
    beyond_m_s2 = strongest_gust_std_m_s2(memory) - COVERED_M_S2
    if beyond_m_s2 <= 0.0:
        return state

    by_gusts_m_s = gust_time_s * beyond_m_s2
    velocity_std_m_s = math.sqrt(
        state.velocity_std_m_s * state.velocity_std_m_s + by_gusts_m_s * by_gusts_m_s
    )
    return State(
        position_enu_m=state.position_enu_m,
        velocity_enu_m_s=state.velocity_enu_m_s,
        acceleration_enu_m_s2=state.acceleration_enu_m_s2,
        yaw_rad=state.yaw_rad,
        age_s=state.age_s,
        position_std_m=state.position_std_m,
        velocity_std_m_s=velocity_std_m_s,
    )
