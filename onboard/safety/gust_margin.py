"""The margin that two vehicles keep in gusts, on top of the safety distance. Pure.

A gust moves a vehicle before the vehicle compensates it. This counts as an error of the published
velocity, and the law's margin grows with the errors of both vehicles.
"""

from __future__ import annotations

import math

from onboard.avoidance.pairs import margin_2
from onboard.avoidance.params import VehicleLimits, params_of
from onboard.config.fleet_config import Vehicle
from onboard.config.law import LawConfig
from onboard.estimation import kalman
from onboard.estimation.accuracies import ACCURACIES
from onboard.estimation.wind import counted_gust_m_s2


def gust_margin_m(gust_m_s2: float, vehicle: Vehicle, law: LawConfig) -> float:
    """Return the margin [m] of two such vehicles in gusts. It is at least the margin in calm air.

    Args:
        gust_m_s2: standard deviation of the gusts per axis, as an acceleration.
        vehicle: either of both; its lag and the errors of PX4's own position are used. Those of
            poses are so small that the margin in calm air covers them.
        law: the fleet's ``[law]``; its margin and its kappa gains are used.
    """
    position_std_m = 0.0
    velocity_std_m_s = kalman.gust_time_s(vehicle.lag_s) * counted_gust_m_s2(gust_m_s2)
    if not vehicle.mocap_required:
        accuracy = ACCURACIES[vehicle.px4_position]
        position_std_m = accuracy.position_std_m
        velocity_std_m_s = math.hypot(velocity_std_m_s, accuracy.velocity_std_m_s)

    spacing = params_of(law, VehicleLimits(lag_s=vehicle.lag_s)).spacing
    # squares of both vehicles' margins
    both_m2 = 2.0 * margin_2(position_std_m, velocity_std_m_s, spacing)
    return max(spacing.margin_m, spacing.margin_floor_m + math.sqrt(both_m2))
