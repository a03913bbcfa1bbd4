"""The height of a fleet's ground, and the least height of goals above it. Pure.

The floor of the geofence is not the ground. For vehicles that use PX4's height, the floor is a
metre below the ground, so that an error of the height does not breach the fence.
"""

from __future__ import annotations

from onboard.config.fleet_config import FleetConfig, Vehicle

# Least height of goals and paths above the ground. With satellites, PX4's own height has a standard
# deviation of 0.28 m. So below half a metre, a vehicle may stand on the ground although its height
# says that it flies.
_MIN_BY_POSES_M = 0.2
_MIN_BY_PX4_M = 0.5


def ground_m(fleet: FleetConfig) -> float:
    """Return the height [m] of the lowest start; 0 if all starts are higher, as on tables."""
    lowest_m = 0.0
    for name in fleet.enabled_names:
        _, _, start_m = fleet.vehicles[name].start_enu_m
        lowest_m = min(lowest_m, start_m)
    return lowest_m


def floor_m(fleet: FleetConfig) -> float:
    """Return the height [m] of the ground or of the geofence's floor, whichever is higher."""
    low_m, _ = fleet.fleet.geofence_m.z
    return max(ground_m(fleet), low_m)


def least_height_m(vehicle: Vehicle) -> float:
    """Return the least height [m] of a vehicle's goals above the ground."""
    if vehicle.mocap_required:
        return _MIN_BY_POSES_M
    return _MIN_BY_PX4_M
