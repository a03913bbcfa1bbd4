"""The ground of a fleet, and how low above it vehicles may be sent. Pure.

The floor of the geofence is no ground: where heights are PX4's own it lies a metre below it, so
that an error of the height breaches nothing.
"""

from __future__ import annotations

from onboard.config.fleet_config import FleetConfig, Vehicle

# Goals and paths keep so far above the ground. PX4's own height errs by 0.28 m in standard
# deviation with satellites: below half a metre a vehicle may stand while it reads that it flies.
_LEAST_BY_POSES_M = 0.2
_LEAST_BY_PX4_M = 0.5


def ground_m(fleet: FleetConfig) -> float:
    """Return the height of the lowest ground that the fleet file knows [m].

    It is that of the lowest start, or 0 where all start higher: on tables, for instance.
    """
    starts_m = [fleet.vehicles[name].start_enu_m[2] for name in fleet.enabled_names]
    return min(0.0, *starts_m)


def floor_m(fleet: FleetConfig) -> float:
    """Return the height [m] of the ground or of the geofence's floor, whichever is higher."""
    return max(ground_m(fleet), fleet.fleet.geofence_m.z[0])


def least_height_m(vehicle: Vehicle) -> float:
    """Return how far above the ground a vehicle's goals have to be [m]."""
    if vehicle.mocap_required:
        return _LEAST_BY_POSES_M
    return _LEAST_BY_PX4_M
