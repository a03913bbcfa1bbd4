"""Decides whether a vehicle has arrived or is at rest, and where it can come to rest. Pure."""

from __future__ import annotations

import math

from onboard.config.fleet import FleetConfig, Vehicle
from onboard.config.flight_space import flight_space_of
from onboard.flight.types import FlightView
from onboard.tuples import Xyz

# a vehicle has arrived if it is this near to its goal and this slow
_ARRIVED_M = 0.12
_ARRIVED_M_S = 0.10

# The same for vehicles without a mocap. In hover, PX4's own estimate has a measured standard
# deviation of 0.08 to 0.18 m and 0.12 to 0.19 m/s per axis.
_ARRIVED_PX4_M = 0.6
_ARRIVED_PX4_M_S = 0.6

# Gusts move a vehicle that has arrived. For each m/s^2 of gusts beyond calm air, its position is
# off by _GUST_S2 metres and its speed by _GUST_S m/s, and it stays within _AROUND_S2 metres.
_CALM_M_S2 = 0.10
_GUST_S2 = 0.25
_GUST_S = 0.6
_AROUND_S2 = 1.0

_TURNED_RAD = math.radians(10.0)  # a turn is complete within this difference of heading
_REST_FACTOR = 1.5  # largest speed at rest, divided by the largest speed at arrival
_INSIDE_M = 0.05  # least distance of a stop point from the fence

# the baseline ends a climb or a descent within this time
_VERTICAL_BRAKE_S = 0.15


def moved_by_gusts(gust_m_s2: float) -> tuple[float, float]:
    """Return how much gusts move a vehicle at rest, beyond its motion in calm air.

    Args:
        gust_m_s2: standard deviation of the gusts, per axis.
    Returns:
        Distance [m] and speed [m/s].
    """
    beyond_m_s2 = max(0.0, gust_m_s2 - _CALM_M_S2)
    return _GUST_S2 * beyond_m_s2, _GUST_S * beyond_m_s2


def is_at(view: FlightView, goal_enu_m: Xyz, vehicle: Vehicle) -> bool:
    """Return whether the vehicle is near its goal and slow, or in gusts stays around its goal.

    Gusts move a hovering vehicle back and forth at up to half a metre per second. So in gusts only
    the distance counts, and the vehicle has arrived if it stays within it.

    Gusts measured over the last seconds are often only half as strong as the true ones, so the
    expected gusts are used.
    """
    beyond_m_s2 = view.expected_gust_m_s2 - _CALM_M_S2
    if beyond_m_s2 <= 0.0:
        return is_near_and_slow(view, goal_enu_m, vehicle)

    around_m = _near_m(vehicle) + _AROUND_S2 * beyond_m_s2
    return math.dist(goal_enu_m, view.position_enu_m) < around_m


def is_near_and_slow(view: FlightView, goal_enu_m: Xyz, vehicle: Vehicle) -> bool:
    """Return whether the vehicle is as near to its goal as in calm air, and slow considering the
    gusts.

    Both limits depend on the accuracy of its positions.
    """
    _, moved_m_s = moved_by_gusts(view.expected_gust_m_s2)
    is_near = math.dist(goal_enu_m, view.position_enu_m) < _near_m(vehicle)
    is_slow = math.hypot(*view.velocity_enu_m_s) < _slow_m_s(vehicle) + moved_m_s
    return is_near and is_slow


def has_turned(view: FlightView, yaw_rad: float) -> bool:
    """Return whether the vehicle has turned to a heading; True if one heading is not known."""
    away_rad = math.remainder(view.yaw_rad - yaw_rad, 2.0 * math.pi)
    if math.isnan(away_rad):
        return True
    return abs(away_rad) <= _TURNED_RAD


def is_at_rest(view: FlightView, vehicle: Vehicle) -> bool:
    """Return whether the vehicle is slow enough to count as holding."""
    _, moved_m_s = moved_by_gusts(view.gust_m_s2)
    slow_m_s = _slow_m_s(vehicle) + moved_m_s
    return math.hypot(*view.velocity_enu_m_s) < _REST_FACTOR * slow_m_s


def stop_point(view: FlightView, vehicle: Vehicle, fleet: FleetConfig) -> Xyz:
    """Return the point [m, ENU] inside the fence where the vehicle comes to rest.

    The vehicle flies on for the time of its lag. Then it brakes, on average at half of its largest
    deceleration.
    """
    speed_m_s = math.hypot(*view.velocity_enu_m_s)
    brake_s = vehicle.lag_s + speed_m_s / vehicle.max_acceleration_m_s2

    x, y, z = view.position_enu_m
    vx, vy, vz = view.velocity_enu_m_s
    stop_enu_m = (x + vx * brake_s, y + vy * brake_s, z + vz * _VERTICAL_BRAKE_S)
    return flight_space_of(fleet).nearest_inside(stop_enu_m, _INSIDE_M)


def position_text(view: FlightView) -> str:
    """Return the position in words."""
    x, y, z = view.position_enu_m
    return f"({x:.2f}, {y:.2f}, {z:.2f}) m"


def _near_m(vehicle: Vehicle) -> float:
    return _ARRIVED_M if vehicle.mocap_required else _ARRIVED_PX4_M


def _slow_m_s(vehicle: Vehicle) -> float:
    return _ARRIVED_M_S if vehicle.mocap_required else _ARRIVED_PX4_M_S
