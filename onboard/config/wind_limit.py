"""The strongest wind in which a vehicle may fly, from its tilt, its thrust and its drag.

Wind accelerates a vehicle by drag times wind velocity. The vehicle tilts against the wind, which
leaves less tilt for its trajectory and for avoidance. At most two thirds of the horizontal
acceleration may be used against the wind; this also bounds the disturbance observer.
"""

from __future__ import annotations

import math

from onboard.config.fleet_config import FleetConfig, Vehicle
from onboard.constants import GRAVITY_M_S2, MAX_PLANNED_THRUST_FRAC

# share of the horizontal acceleration for the wind; the rest stays for the trajectory and the law
_WIND_SHARE = 2.0 / 3.0

# least bound of the disturbance observer, for a vehicle with little tilt, because the observer also
# learns static attitude errors
_MIN_PUSH_M_S2 = 1.5

# standard deviation of usual gusts per axis, as a share of the mean wind
GUST_SHARE = 0.15
_GUST_SIGMAS = 5.0 / 3.0  # 19 of 20 gusts are weaker

# wind with its gusts, as a multiple of the mean wind
GUSTY = 1.0 + _GUST_SIGMAS * GUST_SHARE


def tilt_acceleration_m_s2(vehicle: Vehicle) -> float:
    """Return the horizontal acceleration at the largest tilt, with the height kept [m/s^2].

    Args:
        vehicle: the vehicle; its largest tilt and its hover throttle are used.
    """
    by_tilt = GRAVITY_M_S2 * math.tan(math.radians(vehicle.max_tilt_deg))
    full_lift = max(1.0, MAX_PLANNED_THRUST_FRAC / vehicle.hover_thrust_frac)
    by_thrust = GRAVITY_M_S2 * math.sqrt(full_lift * full_lift - 1.0)
    return min(by_tilt, by_thrust)


def largest_push_m_s2(vehicle: Vehicle) -> float:
    """Return the largest disturbance that the vehicle learns and compensates, per axis [m/s^2].

    Args:
        vehicle: the vehicle; its largest tilt and its hover throttle are used.
    """
    return max(_MIN_PUSH_M_S2, _WIND_SHARE * tilt_acceleration_m_s2(vehicle))


def wind_limit_m_s(fleet: FleetConfig, vehicle: Vehicle) -> float:
    """Return the mean wind in which a vehicle may fly [m/s]; NaN if it has no known drag.

    The limit is the smaller of the fleet's and the vehicle's ``max_wind_m_s``. If the vehicle has
    none, its limit follows from the drag: the push of the wind with its gusts must not exceed the
    share _WIND_SHARE of the horizontal acceleration.

    Args:
        fleet: the fleet; its ``max_wind_m_s`` holds for all its vehicles.
        vehicle: one of its vehicles.
    """
    # without a known drag the wind cannot be measured, so a limit in m/s is useless
    if vehicle.drag_1_s <= 0.0:
        return math.nan

    limit_m_s = vehicle.max_wind_m_s
    if limit_m_s is None:
        push_m_s2 = _WIND_SHARE * tilt_acceleration_m_s2(vehicle)
        limit_m_s = push_m_s2 / (vehicle.drag_1_s * GUSTY)
    if fleet.fleet.max_wind_m_s is not None:
        limit_m_s = min(limit_m_s, fleet.fleet.max_wind_m_s)
    return limit_m_s
