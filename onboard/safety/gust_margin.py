"""The margin that two vehicles keep in gusts, on top of the safety distance. Pure.

A gust moves a vehicle before the vehicle compensates it. This counts as an error of the published
velocity, and the law's margin grows with the errors of both vehicles.
"""

from __future__ import annotations

import math

from onboard.avoidance.pairs import margin_2
from onboard.avoidance.params import VehicleLimits, params_of
from onboard.config.law import LawConfig
from onboard.estimation import kalman
from onboard.estimation.wind import counted_gust_m_s2


def gust_margin_m(gust_m_s2: float, lag_s: float, law: LawConfig) -> float:
    """Return the margin [m] of two vehicles in gusts. It is at least the margin in calm air.

    Args:
        gust_m_s2: standard deviation of the gusts per axis, as an acceleration.
        lag_s: lag of both vehicles, from a command to its acceleration.
        law: the fleet's ``[law]``; its margin and its kappa gains are used.
    """
    velocity_std_m_s = kalman.gust_time_s(lag_s) * counted_gust_m_s2(gust_m_s2)
    spacing = params_of(law, VehicleLimits(lag_s=lag_s)).spacing
    both_m2 = 2.0 * margin_2(0.0, velocity_std_m_s, spacing)  # squares of both vehicles' margins
    return max(spacing.margin_m, spacing.margin_floor_m + math.sqrt(both_m2))
