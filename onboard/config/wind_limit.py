"""How strong a wind a vehicle can stand: by its tilt, its thrust and its drag.

Wind pushes with drag times its velocity. Against that push a vehicle leans, and what it leans
against the wind is missing for its trajectory and for avoidance. Two thirds of the horizontal
acceleration may go against the wind; the disturbance observer learns no more than that.
"""

from __future__ import annotations

import math

from onboard.config.fleet_config import FleetConfig, Vehicle

GRAVITY_M_S2 = 9.80665

# of the horizontal acceleration; the rest stays for the trajectory and for the law
_WIND_SHARE = 2.0 / 3.0

# the observer of a vehicle that can lean little learns this much all the same: static errors of the
# attitude are a part of what it learns
_LEAST_PUSH_M_S2 = 1.5

# gusts that belong to a wind of this mean, as a share of it; their standard deviation per axis
GUST_SHARE = 0.15
_GUST_SIGMAS = 5.0 / 3.0  # nineteen of twenty gusts are weaker

# the wind with its gusts, as a share of its mean
GUSTY = 1.0 + _GUST_SIGMAS * GUST_SHARE

# full throttle, of which a little stays for the attitude
_MAX_THRUST_FRAC = 0.97


def tilt_acceleration_m_s2(vehicle: Vehicle) -> float:
    """Return the horizontal acceleration at the largest tilt, with the height kept [m/s^2].

    Args:
        vehicle: tilt and hover throttle count.
    """
    by_tilt = GRAVITY_M_S2 * math.tan(math.radians(vehicle.max_tilt_deg))
    full_lift = max(1.0, _MAX_THRUST_FRAC / vehicle.hover_thrust_frac)
    by_thrust = GRAVITY_M_S2 * math.sqrt(full_lift * full_lift - 1.0)
    return min(by_tilt, by_thrust)


def largest_push_m_s2(vehicle: Vehicle) -> float:
    """Return the largest disturbance that is learned and leaned against, per axis [m/s^2].

    Args:
        vehicle: tilt and hover throttle count.
    """
    return max(_LEAST_PUSH_M_S2, _WIND_SHARE * tilt_acceleration_m_s2(vehicle))


def wind_limit_m_s(fleet: FleetConfig, vehicle: Vehicle) -> float:
    """Return the mean wind in which a vehicle may fly [m/s]; NaN where nobody knows.

    It is the least of the fleet's and the vehicle's ``max_wind_m_s``. Where the vehicle has none,
    it follows from the drag: the push of this wind and of its gusts stays within
    :func:`largest_push_m_s2`.

    Args:
        fleet: whose ``max_wind_m_s`` holds for all its vehicles.
        vehicle: one of them.
    """
    limits_m_s = [
        limit_m_s
        for limit_m_s in (fleet.fleet.max_wind_m_s, vehicle.max_wind_m_s)
        if limit_m_s is not None
    ]

    # without a drag the wind is not measured, and a limit in m/s judges nothing
    if vehicle.drag_1_s <= 0.0:
        return math.nan

    if vehicle.max_wind_m_s is None:
        push_m_s2 = _WIND_SHARE * tilt_acceleration_m_s2(vehicle)
        limits_m_s.append(push_m_s2 / (vehicle.drag_1_s * GUSTY))
    return min(limits_m_s)
