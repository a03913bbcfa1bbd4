"""Margin that vehicles keep in gusts, above the safety distance. Pure.

Gusts move a vehicle before it leans against them. That is an error of the velocity that it
publishes, and the law's margin grows with it, on both sides.
"""

from __future__ import annotations

import math

from onboard.avoidance.pairs import margin_2
from onboard.avoidance.params import VehicleLimits, params_of
from onboard.config.law import LawConfig
from onboard.estimation import kalman
from onboard.estimation.wind import COVERED_M_S2


def gust_margin_m(gust_m_s2: float, lag_s: float, law: LawConfig) -> float:
    """Return the margin of two vehicles in gusts.

    Args:
        gust_m_s2: standard deviation per axis, as an acceleration.
        lag_s: of both vehicles, from a command to its acceleration.
        law: its margin and kappas.
    Returns:
        margin [m], at least the one without gusts.
    """
    beyond_m_s2 = max(0.0, gust_m_s2 - COVERED_M_S2)
    velocity_std_m_s = kalman.gust_time_s(lag_s) * beyond_m_s2
    spacing = params_of(law, VehicleLimits(lag_s=lag_s)).spacing
    both_m2 = 2.0 * margin_2(0.0, velocity_std_m_s, spacing)
    return max(spacing.margin_m, spacing.margin_floor_m + math.sqrt(both_m2))
