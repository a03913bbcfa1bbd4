"""When a vehicle counts as there or at rest, and where it can come to rest. Pure."""

from __future__ import annotations

import math

import numpy as np

from onboard.config.fleet import FleetConfig, Vec3, Vehicle
from onboard.flight.types import FlightView

_ARRIVED_M, _ARRIVED_M_S = 0.12, 0.10
# PX4's own estimate in hover: .08-.18 m and .12-.19 m/s std per axis measured: stillness shows no better
_ARRIVED_PX4_M, _ARRIVED_PX4_M_S = 0.6, 0.6
_REST_SHARE = 1.5
_INSIDE_M = 0.05


def is_there(view: FlightView, goal_enu_m: Vec3, vehicle: Vehicle) -> bool:
    """Whether it is at its goal and slow, as well as its source of positions can tell."""
    has_mocap = vehicle.mocap_required
    near_m, slow_m_s = (_ARRIVED_M, _ARRIVED_M_S) if has_mocap else (_ARRIVED_PX4_M, _ARRIVED_PX4_M_S)
    return math.dist(goal_enu_m, view.position_enu_m) < near_m and math.hypot(*view.velocity_enu_m_s) < slow_m_s


def is_at_rest(view: FlightView, vehicle: Vehicle) -> bool:
    """Whether it is as slow as a vehicle that holds."""
    slow_m_s = _ARRIVED_M_S if vehicle.mocap_required else _ARRIVED_PX4_M_S
    return math.hypot(*view.velocity_enu_m_s) < _REST_SHARE * slow_m_s


def stop_point(view: FlightView, vehicle: Vehicle, fleet: FleetConfig) -> Vec3:
    """Where it comes to rest as soon as its lag and its acceleration allow, inside the fence."""
    p, v = np.asarray(view.position_enu_m), np.asarray(view.velocity_enu_m_s)
    way = p + v * (vehicle.lag_s + float(np.linalg.norm(v)) / vehicle.max_acceleration_m_s2)
    fence = fleet.fleet.geofence_m
    low, high = np.array([fence.x[0], fence.y[0], fence.z[0]]), np.array([fence.x[1], fence.y[1], fence.z[1]])
    x, y, z = np.clip(way, low + _INSIDE_M, high - _INSIDE_M).tolist()
    return x, y, z


def place(view: FlightView) -> str:
    """Where it is, in words."""
    x, y, z = view.position_enu_m
    return f"({x:.2f}, {y:.2f}, {z:.2f}) m"
