"""The height of a fleet's ground, and the least height of goals above it. Pure.

The fleet file says how high the ground is at the take-off spots; between them a slope is not known.

The floor of the geofence is not the ground. For vehicles that use PX4's height, the floor is a
metre below the ground, so that an error of the height does not breach the fence.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.config.fleet_config import FleetConfig, Vehicle

# Least height of goals and paths above the ground. With satellites, PX4's own height has a standard
# deviation of 0.28 m. So below half a metre, a vehicle may stand on the ground although its height
# says that it flies.
_MIN_BY_POSES_M = 0.2
_MIN_BY_PX4_M = 0.5

# Within this distance of a take-off spot, or a body's diameter if that is more, the ground is as
# high as the spot. A vehicle by satellites lands up to 0.6 m beside its spot.
_SPOT_RADIUS_M = 1.0


def lowest_ground_m(fleet: FleetConfig) -> float:
    """Return the height [m] of the lowest start; 0 if all starts are higher, as on tables."""
    lowest_m = 0.0
    for name in fleet.enabled_names:
        _, _, start_m = fleet.vehicles[name].start_enu_m
        lowest_m = min(lowest_m, start_m)
    return lowest_m


def highest_spot_m(fleet: FleetConfig) -> float:
    """Return the height [m] of the highest take-off spot."""
    return max(fleet.vehicles[name].start_enu_m[2] for name in fleet.enabled_names)


def is_level(fleet: FleetConfig) -> bool:
    """Return whether the ground is equally high everywhere by the fleet file."""
    lowest_m = lowest_ground_m(fleet)
    return all(fleet.vehicles[name].start_enu_m[2] == lowest_m for name in fleet.enabled_names)


def lowest_ground_in_fence_m(fleet: FleetConfig) -> float:
    """Return the height [m] of the lowest ground, or of the geofence's floor if that is higher."""
    low_m, _ = fleet.fleet.geofence_m.z
    return max(lowest_ground_m(fleet), low_m)


def ground_at_m(
    fleet: FleetConfig, x_m: NDArray[np.float64] | float, y_m: NDArray[np.float64] | float
) -> NDArray[np.float64]:
    """Return the height [m] of the ground under points: of the nearest take-off spot, or lowest.

    Args:
        fleet: the fleet file.
        x_m: coordinates of the points to the east.
        y_m: coordinates to the north, of the same shape.
    """
    heights_m = np.full(np.shape(x_m), lowest_ground_m(fleet))
    nearest_m = np.full(np.shape(x_m), max(fleet.fleet.body_diameter_m, _SPOT_RADIUS_M))
    for name in fleet.enabled_names:
        spot_x, spot_y, spot_m = fleet.vehicles[name].start_enu_m
        distances_m = np.hypot(x_m - spot_x, y_m - spot_y)
        is_higher = (distances_m == nearest_m) & (spot_m > heights_m)  # of spots above each other
        is_nearer = (distances_m < nearest_m) | is_higher
        heights_m = np.where(is_nearer, spot_m, heights_m)
        nearest_m = np.where(is_nearer, distances_m, nearest_m)
    return heights_m


def touchable_ground_at_m(
    fleet: FleetConfig, x_m: NDArray[np.float64] | float, y_m: NDArray[np.float64] | float
) -> NDArray[np.float64]:
    """Return the height [m] of what a body above points may touch, for the limits of goals.

    It is the ground, or the geofence's floor if that is higher. Within a body's diameter of a
    take-off spot it is at least as high as the spot, because the body may reach to its table.

    Args:
        fleet: the fleet file.
        x_m: coordinates of the points to the east.
        y_m: coordinates to the north, of the same shape.
    """
    low_m, _ = fleet.fleet.geofence_m.z
    heights_m = np.maximum(ground_at_m(fleet, x_m, y_m), low_m)
    for name in fleet.enabled_names:
        spot_x, spot_y, spot_m = fleet.vehicles[name].start_enu_m
        is_near = np.hypot(x_m - spot_x, y_m - spot_y) <= fleet.fleet.body_diameter_m
        heights_m = np.where(is_near, np.maximum(heights_m, spot_m), heights_m)
    return heights_m


def least_height_m(vehicle: Vehicle) -> float:
    """Return the least height [m] of a vehicle's goals above the ground."""
    if vehicle.mocap_required:
        return _MIN_BY_POSES_M
    return _MIN_BY_PX4_M
