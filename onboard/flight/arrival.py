"""Predicates of arrival and rest, and the point where a vehicle can come to rest. Pure."""

from __future__ import annotations

import math

from onboard.config.fleet import FleetConfig, Vec3, Vehicle
from onboard.flight.types import FlightView

_ARRIVED_M, _ARRIVED_M_S = 0.12, 0.10
# PX4's own estimate in hover: .08-.18 m and .12-.19 m/s std per axis measured: stillness shows no
# better
_ARRIVED_PX4_M, _ARRIVED_PX4_M_S = 0.6, 0.6
_TURNED_RAD = math.radians(10.0)
_REST_SHARE = 1.5
_INSIDE_M = 0.05
# a climb or a descent is not braked along a leg: the baseline ends it at once
_VERTICAL_BRAKE_S = 0.15


def is_at(view: FlightView, goal_enu_m: Vec3, vehicle: Vehicle) -> bool:
    """Whether the vehicle is at its goal and slow, as well as its source of positions can tell."""
    has_mocap = vehicle.mocap_required
    near_m, slow_m_s = (
        (_ARRIVED_M, _ARRIVED_M_S) if has_mocap else (_ARRIVED_PX4_M, _ARRIVED_PX4_M_S)
    )
    return (
        math.dist(goal_enu_m, view.position_enu_m) < near_m
        and math.hypot(*view.velocity_enu_m_s) < slow_m_s
    )


def has_turned(view: FlightView, yaw_rad: float) -> bool:
    """Whether the vehicle has a heading, as far as both are known."""
    away_rad = math.remainder(view.yaw_rad - yaw_rad, 2.0 * math.pi)
    return not abs(away_rad) > _TURNED_RAD


def is_at_rest(view: FlightView, vehicle: Vehicle) -> bool:
    """Whether the vehicle is as slow as one that holds."""
    slow_m_s = _ARRIVED_M_S if vehicle.mocap_required else _ARRIVED_PX4_M_S
    return math.hypot(*view.velocity_enu_m_s) < _REST_SHARE * slow_m_s


def stop_point(view: FlightView, vehicle: Vehicle, fleet: FleetConfig) -> Vec3:
    """Return the point [m, ENU] inside the fence where the vehicle comes to rest, given its lag and
    acceleration.
    """
    brake_s = vehicle.lag_s + math.hypot(*view.velocity_enu_m_s) / vehicle.max_acceleration_m_s2
    x, y, z = (
        position_m + speed_m_s * time_s
        for position_m, speed_m_s, time_s in zip(
            view.position_enu_m,
            view.velocity_enu_m_s,
            (brake_s, brake_s, _VERTICAL_BRAKE_S),
            strict=True,
        )
    )
    return fleet.fleet.geofence_m.nearest_inside((x, y, z), _INSIDE_M)


def position_text(view: FlightView) -> str:
    """Return the position in words."""
    x, y, z = view.position_enu_m
    return f"({x:.2f}, {y:.2f}, {z:.2f}) m"
