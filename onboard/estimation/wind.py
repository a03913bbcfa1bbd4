"""Estimates the wind at a vehicle from its tilt, motion and drag.

Wind pushes a vehicle, and the vehicle tilts against the wind. The push is the Kalman filter's bias:
the acceleration that attitude, throttle and the drag of the vehicle's motion do not explain. The
push divided by the drag is the velocity of the air. Its mean over some seconds is the wind, and the
deviations from the mean are the gusts. If the drag is unknown, the gusts are known only as an
acceleration.

A gust moves the vehicle before the control compensates it. Therefore gusts are added to the
published velocity error, which makes all other vehicles keep a larger distance. Two calm seconds do
not predict the next gust. So the largest of three standard deviations is used: of the present
gusts, of the last half minute, and of the usual gusts in the present mean wind. Early in a flight
the first two are raised, because only a few gusts have been observed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.config.wind_limit import GUST_SHARE
from onboard.types import State
from onboard.vectors import ZERO_3, Vec3, add_scaled, subtract

MEAN_TIME_S = 2.0  # averaging time of the mean wind and of the present gusts
_LASTING_TIME_S = 30.0  # averaging time of the gusts of the last half minute

# A few seconds contain only a few gusts, and the mean over them follows these gusts. So gusts that
# the usual margin does not cover are expected to have a larger variance than observed: larger by
# this time divided by the time of flight.
_FEW_GUSTS_S = 4.0

_KNOWN_AFTER_S = 1.0  # the wind is known after this time of flight

# the usual margin covers gusts up to this standard deviation
COVERED_M_S2 = 0.15

# The usual margin does not cover strong gusts together with the other errors. The floor of the
# margin for errors (onboard/avoidance/params.py) covers a part of them.
_STRONG_M_S2 = 0.2
_BY_FLOOR_M_S2 = 0.05


class WindMemory(NamedTuple):
    """State of the estimate."""

    push_enu_m_s2: Vec3  # mean push
    variance_m2_s4: float  # present variance of the push about its mean, per horizontal axis
    lasting_variance_m2_s4: float  # mean of this variance over the last half minute
    time_s: float  # time of flight


def initial() -> WindMemory:
    """Return the memory of a vehicle without any push."""
    return WindMemory(
        push_enu_m_s2=ZERO_3, variance_m2_s4=0.0, lasting_variance_m2_s4=0.0, time_s=0.0
    )


def step(memory: WindMemory, bias_enu_m_s2: Vec3, dt_s: float, is_on_ground: bool) -> WindMemory:
    """Return the memory after a tick.

    Args:
        memory: memory of the last tick.
        bias_enu_m_s2: acceleration that attitude, throttle and drag do not explain, from the Kalman
            filter [m/s^2], ENU.
        dt_s: length of the tick.
        is_on_ground: whether the vehicle stands on the ground. The memory is then reset.
    """
    if is_on_ground:
        return initial()
    if not math.isfinite(bias_enu_m_s2.x + bias_enu_m_s2.y + bias_enu_m_s2.z):
        return memory

    # the push is averaged over all ticks until MEAN_TIME_S of flight, and low-passed afterwards
    time_s = memory.time_s + dt_s
    blend = dt_s / max(min(time_s, MEAN_TIME_S), dt_s, 1e-6)
    off = subtract(bias_enu_m_s2, memory.push_enu_m_s2)

    # Square of the deviation per axis, as in Welford's running variance: the deviation from the
    # mean before this tick times the deviation from the mean after it. It is 0 for the first
    # sample, which therefore does not count as a gust.
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
    """Return the mean velocity of the air, east and north [m/s].

    NaN on the ground, in the first second of a flight, and for an unknown drag.

    Args:
        memory: present memory.
        drag_1_s: drag of the vehicle; 0: not known.
    """
    if drag_1_s <= 0.0 or memory.time_s < _KNOWN_AFTER_S:
        return (math.nan, math.nan)
    push = memory.push_enu_m_s2
    return (push.x / drag_1_s, push.y / drag_1_s)


def gust_std_m_s2(memory: WindMemory) -> float:
    """Return the standard deviation of the present gusts as an acceleration, per axis [m/s^2].

    Args:
        memory: present memory.
    """
    return math.sqrt(memory.variance_m2_s4)


def strongest_gust_std_m_s2(memory: WindMemory) -> float:
    """Return the standard deviation of the gusts to expect, per axis [m/s^2].

    The largest of three is returned: of the present gusts, of the last half minute, and of the
    usual gusts in the mean wind. Early in a flight the first two are raised.

    Args:
        memory: present memory.
    """
    now_m_s2 = gust_std_m_s2(memory)
    lasting_m_s2 = math.sqrt(memory.lasting_variance_m2_s4)
    usual_m_s2 = GUST_SHARE * math.hypot(memory.push_enu_m_s2.x, memory.push_enu_m_s2.y)

    observed_m_s2 = max(now_m_s2, lasting_m_s2)
    if observed_m_s2 > COVERED_M_S2:
        observed_m_s2 *= math.sqrt(1.0 + _FEW_GUSTS_S / max(memory.time_s, 1e-6))
    return max(observed_m_s2, usual_m_s2)


def counted_gust_m_s2(gust_m_s2: float) -> float:
    """Return the part of the gusts that counts as an error of the velocity [m/s^2].

    Args:
        gust_m_s2: standard deviation of the gusts to expect, per axis.
    """
    if gust_m_s2 > _STRONG_M_S2:
        return gust_m_s2 - _BY_FLOOR_M_S2
    return max(0.0, gust_m_s2 - COVERED_M_S2)


def widened(state: State, memory: WindMemory, gust_time_s: float) -> State:
    """Return the estimate with gusts added to its velocity error.

    Args:
        state: estimate of the Kalman filter.
        memory: present memory.
        gust_time_s: how long a gust moves the vehicle before it is compensated.
    Properties: in calm air, and in gusts that the margin covers, the estimate is unchanged.
    """
    counted_m_s2 = counted_gust_m_s2(strongest_gust_std_m_s2(memory))
    if counted_m_s2 <= 0.0:
        return state

    by_gusts_m_s = gust_time_s * counted_m_s2
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
