"""Makes an emulator of vehicles of a fleet file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec.structs import asdict

from onboard.config.fleet import FleetConfig, Vehicle
from sitl.emulator.emulator import Emulator, Environment, VehicleSpec
from sitl.physics.earth import ZURICH, EarthPoint
from sitl.physics.scatter import one_of_type
from sitl.physics.vehicle import VehicleProfile
from sitl.px4.parameters import DEFAULTS
from sitl.px4.versions import VERSIONS

_HOVER_S = 300.0  # hover time of a battery without a value in the fleet file


def profile_of(vehicle: Vehicle) -> VehicleProfile:
    """Return the emulator's profile of a vehicle of the fleet file."""
    params = {**DEFAULTS[vehicle.px4_version], **vehicle.px4_params}
    return VehicleProfile(
        attitude_p_1_s=(float(params.get("MC_ROLL_P", 0.0)), float(params.get("MC_PITCH_P", 0.0))),
        setpoint_filter_rad_s=float(params.get("MC_REF_W_N", 0.0)),
        mass_kg=vehicle.mass_kg,
        hover_thrust_frac=vehicle.hover_thrust_frac,
        attitude_delay_s=vehicle.attitude_delay_s,
        attitude_wn_rad_s=vehicle.attitude_wn_rad_s,
        attitude_zeta=vehicle.attitude_zeta,
        drag_1_s=vehicle.drag_1_s,
        **asdict(vehicle.sitl),
    )


def emulator_of(
    fleet: FleetConfig,
    vehicles: Sequence[Vehicle],
    *,
    seed: int,
    environment: Environment | None = None,
    px4: str | None = None,
) -> Emulator:
    """Return the emulator of some vehicles of a fleet file.

    Args:
        fleet: the fleet file.
        vehicles: vehicles to emulate.
        seed: seed of all random numbers.
        environment: wind, downwash and errors.
        px4: version of PX4 of all vehicles; None: the version of each in the fleet file.
    """
    if environment is None:
        environment = Environment()

    specs: list[VehicleSpec] = []
    for vehicle in vehicles:
        profile = one_of_type(
            profile_of(vehicle), seed=seed, index=vehicle.index, scale=environment.vehicle_scatter
        )
        hover_time_s = _HOVER_S
        least_charge_pct = None
        if vehicle.hover_time_s is not None:
            hover_time_s = vehicle.hover_time_s
            least_charge_pct = 0.0  # who says how long a battery lasts wants to see its end
        spec = VehicleSpec(
            name=vehicle.name,
            system_id=vehicle.system_id,
            profile=profile,
            start_enu_m=vehicle.start_enu_m,
            px4=VERSIONS[px4 or vehicle.px4_version],
            hover_time_s=hover_time_s,
            least_charge_pct=least_charge_pct,
            has_camera=vehicle.flies_by_vision,
        )
        specs.append(spec)

    # The spots of vehicles that are not emulated tell the ground too.
    spots_enu_m = np.array([fleet.vehicles[name].start_enu_m for name in fleet.enabled_names])
    return Emulator(
        specs,
        body_diameter_m=fleet.fleet.body_diameter_m,
        environment=environment,
        origin=_earth_point(fleet),
        spots_enu_m=spots_enu_m,
        seed=seed,
    )


def _earth_point(fleet: FleetConfig) -> EarthPoint:
    """Return the origin of a fleet; a fleet without one gets the origin of PX4's own simulator."""
    origin = fleet.fleet.origin
    if isinstance(origin, str):
        return ZURICH
    return EarthPoint(
        latitude_deg=origin.latitude_deg,
        longitude_deg=origin.longitude_deg,
        altitude_m=origin.altitude_m,
    )
