"""The time that vehicles need to come down, for time limits of landings. Pure."""

from __future__ import annotations

from groundstation.fleet.state import FleetState, VehicleView
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.control.climb_duration import climb_duration_s


def descent_s(vehicle: Vehicle, view: VehicleView) -> float:
    """Return the time of a landing from the position that a vehicle in the air has reported last.

    Args:
        vehicle: entry of the vehicle in the fleet file.
        view: the vehicle as it is known.

    Returns:
        Time [s], without braking and disarming; 0 for a vehicle that does not fly, or whose
        position is not known.
    """
    telemetry = view.telemetry
    if telemetry is None or not view.is_airborne or not telemetry.is_position_valid:
        return 0.0

    height_m = telemetry.position_enu_m[2] - vehicle.start_enu_m[2]
    return climb_duration_s(height_m, vehicle.max_speed_m_s)


def longest_descent_s(fleet: FleetConfig, state: FleetState) -> float:
    """Return the time that the landing of all vehicles takes if they land side by side.

    Args:
        fleet: the fleet file.
        state: state of the fleet now.

    Returns:
        Time [s]; 0 if no vehicle flies.
    """
    times_s = [descent_s(fleet.vehicles[name], view) for name, view in state.vehicles.items()]
    return max(times_s, default=0.0)
