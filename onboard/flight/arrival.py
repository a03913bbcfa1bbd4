"""Whether a vehicle has arrived or rests, and where it can come to rest. Pure."""

from __future__ import annotations

import math

from onboard.config.fleet import FleetConfig, Vehicle
from onboard.config.flight_space import flight_space_of
from onboard.flight.types import FlightView
from onboard.tuples import Xyz

_ARRIVED_M = 0.12
_ARRIVED_M_S = 0.10

# For vehicles without a mocap. PX4's own estimate in hover has .08-.18 m and .12-.19 m/s std per
# axis (measured), so stillness shows no better than this.
_ARRIVED_PX4_M = 0.6
_ARRIVED_PX4_M_S = 0.6

# Gusts move a vehicle that has arrived. For each m/s^2 of them its position and speed may be so far
# off.
_CALM_M_S2 = 0.10
_GUST_S2 = 0.25
_GUST_S = 0.6

_TURNED_RAD = math.radians(10.0)
_REST_SHARE = 1.5  # of the speed that counts as arrived
_INSIDE_M = 0.05  # between a stop point and the fence

# A climb or a descent is not braked along a leg: the baseline ends it at once.
_VERTICAL_BRAKE_S = 0.15


def moved_by_gusts(gust_m_s2: float) -> tuple[float, float]:
    """Return by how much gusts move a vehicle that rests, more than calm air does.

    Args:
        gust_m_s2: standard deviation of the gusts, per axis.
    Returns:
        Distance [m] and speed [m/s].
    """
    beyond_m_s2 = max(0.0, gust_m_s2 - _CALM_M_S2)
    return _GUST_S2 * beyond_m_s2, _GUST_S * beyond_m_s2


def is_at(view: FlightView, goal_enu_m: Xyz, vehicle: Vehicle) -> bool:
    """Return whether the vehicle is at its goal and slow, as far as its positions can show it.

    Gusts widen both.
    """
    moved_m, _ = moved_by_gusts(view.gust_m_s2)
    if not math.dist(goal_enu_m, view.position_enu_m) < _near_m(vehicle) + moved_m:
        return False
    return math.hypot(*view.velocity_enu_m_s) < _slow_m_s(view, vehicle)


def is_near(view: FlightView, goal_enu_m: Xyz, vehicle: Vehicle) -> bool:
    """Return whether the vehicle is as near to its goal as a vehicle that rests in calm air."""
    return math.dist(goal_enu_m, view.position_enu_m) < _near_m(vehicle)


def has_turned(view: FlightView, yaw_rad: float) -> bool:
    """Return whether the vehicle has a heading, as far as both are known."""
    away_rad = math.remainder(view.yaw_rad - yaw_rad, 2.0 * math.pi)
    return not abs(away_rad) > _TURNED_RAD  # a heading that is not known is NaN, and is no reason


def is_at_rest(view: FlightView, vehicle: Vehicle) -> bool:
    """Return whether the vehicle is as slow as one that holds."""
    return math.hypot(*view.velocity_enu_m_s) < _REST_SHARE * _slow_m_s(view, vehicle)


def stop_point(view: FlightView, vehicle: Vehicle, fleet: FleetConfig) -> Xyz:
    """Return the point [m, ENU] inside the fence where the vehicle comes to rest.

    It flies on for its lag, and for as long as its acceleration needs to stop it at the mean speed.
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


def _slow_m_s(view: FlightView, vehicle: Vehicle) -> float:
    slow_m_s = _ARRIVED_M_S if vehicle.mocap_required else _ARRIVED_PX4_M_S
    _, moved_m_s = moved_by_gusts(view.gust_m_s2)
    return slow_m_s + moved_m_s
