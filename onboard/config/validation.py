"""Checks of a whole fleet file: bounds, names, endpoints, doubles and spacing. A mistake raises ConfigError."""

from __future__ import annotations

import itertools
import math
import re
from typing import Any

from onboard.config import mocap as mocap_config
from onboard.config import obstacles
from onboard.config import sitl as sitl_profile
from onboard.config.fleet_config import FleetConfig, Vehicle, parking_distance_m
from onboard.config.law import LawConfig
from onboard.config.toml_reading import ConfigError, check_bound

_BOUNDS: dict[str, tuple[float, float]] = {
    "mass_kg": (0.02, 50.0),
    "hover_thrust_frac": (0.1, 0.9),
    "attitude_delay_s": (0.0, 0.5),
    "attitude_wn_rad_s": (1.0, 60.0),
    "attitude_zeta": (0.2, 2.0),
    "drag_1_s": (0.0, 5.0),
    "max_tilt_deg": (5.0, 45.0),
    "max_speed_m_s": (0.1, 10.0),
    "max_acceleration_m_s2": (0.1, 10.0),
    "system_id": (1, 255),
}
_AGENT_ENDPOINT = re.compile(r"tcp/(127\.\d+\.\d+\.\d+|localhost|\[::1\]|[A-Za-z0-9_.:\[\]-]+):(\d{1,5})")
_AUTOPILOT_ENDPOINT = re.compile(r"(udpin|udpout|serial)://.+")


def check_fleet(config: FleetConfig) -> None:
    """Check everything that concerns more than the type of a value.

    Args:
        config: a whole fleet file.
    Raises:
        ConfigError: the first mistake.
    """
    _check_fleet_section(config)
    _check_law(config)
    for vehicle in config.vehicles.values():
        _check_vehicle(config, vehicle)
    _check_doubles(config)
    for sentence in mocap_config.problems(config.mocap, {name: v.body for name, v in config.vehicles.items()}):
        raise ConfigError(f"{config.path}: {sentence}")
    _check_obstacles(config)
    _check_starts(config)
    _check_formations(config)


def _check_fleet_section(config: FleetConfig) -> None:
    path, fleet = config.path, config.fleet
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,40}", fleet.name):
        raise ConfigError(
            f"{path}: 'fleet.name' is {fleet.name!r}; it is part of the bus keys. Use 1 to 40 of A-Z a-z 0-9 _ -."
        )
    if not config.vehicles:
        raise ConfigError(f"{path}: 'vehicles' is empty. Add at least one [vehicles.NAME].")
    for key, low, high in (
        ("safety_distance_m", 0.1, 50.0),
        ("body_diameter_m", 0.02, fleet.safety_distance_m),
        ("battery_warning_pct", fleet.battery_land_pct, 100.0),
        ("battery_land_pct", 8.0, 100.0),
        ("direct_command_timeout_s", 0.05, 5.0),
        ("bus_lost_land_s", 0.5, 120.0),
    ):
        check_bound(path, f"fleet.{key}", getattr(fleet, key), low, high)
    for axis in ("x", "y", "z"):
        low, high = getattr(fleet.geofence_m, axis)
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ConfigError(
                f"{path}: 'fleet.geofence_m.{axis}' is [{low}, {high}]; give [low, high] with low < high."
            )


def _check_law(config: FleetConfig) -> None:
    path, law = config.path, config.law
    for key in LawConfig.__struct_fields__:
        value = getattr(law, key)
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            check_bound(path, f"law.{key}", value, 0.0 if "margin" in key or "gain" in key else 1e-3, 100.0)
    if law.name == "paper" and len(config.enabled_names) > 3 and not law.paper_force_ring:
        raise ConfigError(
            f"{path}: 'law.name' is 'paper' for {len(config.enabled_names)} vehicles. In the paper's ring each vehicle "
            "avoids only the next one, so with more than 3 some pairs do not avoid each other. Use law.name = 'covey', "
            "or set law.paper_force_ring = true to fly it all the same, in simulation."
        )


def _check_vehicle(config: FleetConfig, vehicle: Vehicle) -> None:
    path, name = config.path, vehicle.name
    for key, (low, high) in _BOUNDS.items():
        check_bound(path, f"vehicles.{name}.{key}", getattr(vehicle, key), low, high)
    for key, (low, high) in sitl_profile.BOUNDS.items():
        value = getattr(vehicle.sitl, key)
        for number in value if isinstance(value, tuple) else (value,):
            check_bound(path, f"vehicles.{name}.sitl.{key}", number, low, high)
    if not _AGENT_ENDPOINT.fullmatch(vehicle.agent):
        raise ConfigError(f"{path}: 'vehicles.{name}.agent' is {vehicle.agent!r}; write it as tcp/127.0.0.1:7460.")
    if not _AUTOPILOT_ENDPOINT.fullmatch(vehicle.autopilot):
        raise ConfigError(
            f"{path}: 'vehicles.{name}.autopilot' is {vehicle.autopilot!r}; write it as udpin://127.0.0.1:14540."
        )
    if not all(math.isfinite(value) for value in vehicle.start_enu_m):
        raise ConfigError(f"{path}: 'vehicles.{name}.start_enu_m' must be three finite numbers in metres.")
    if not config.fleet.geofence_m.contains(vehicle.start_enu_m):
        raise ConfigError(
            f"{path}: 'vehicles.{name}.start_enu_m' {list(vehicle.start_enu_m)} lies outside fleet.geofence_m. "
            "Move the start or widen the fence."
        )


def _check_doubles(config: FleetConfig) -> None:
    owners: dict[tuple[str, Any], str] = {}
    for name, vehicle in config.vehicles.items():
        for key in ("system_id", "agent", "autopilot", "direct", "mocap_body"):
            value = getattr(vehicle, key)
            if value is None:
                continue
            other = owners.setdefault((key, value), name)
            if other != name:
                raise ConfigError(
                    f"{config.path}: 'vehicles.{name}.{key}' is {value!r}, which 'vehicles.{other}.{key}' has too. "
                    "Give each vehicle its own."
                )


def _check_obstacles(config: FleetConfig) -> None:
    clearance_m = 0.5 * config.fleet.body_diameter_m + config.law.obstacle_margin_m
    starts = {name: vehicle.start_enu_m for name, vehicle in config.vehicles.items()}
    for sentence in obstacles.problems(config.obstacles, starts, clearance_m):
        raise ConfigError(f"{config.path}: {sentence}")


def _check_starts(config: FleetConfig) -> None:
    path, fleet = config.path, config.fleet
    for first, second in itertools.combinations(config.enabled_names, 2):
        spacing = math.dist(config.vehicles[first].start_enu_m[:2], config.vehicles[second].start_enu_m[:2])
        if spacing < fleet.safety_distance_m:
            raise ConfigError(
                f"{path}: 'vehicles.{first}.start_enu_m' and 'vehicles.{second}.start_enu_m' are {spacing:.2f} m "
                f"apart; at least fleet.safety_distance_m = {fleet.safety_distance_m:.2f} m is needed. Move them apart."
            )


def _check_formations(config: FleetConfig) -> None:
    path, parking = config.path, parking_distance_m(config)
    for formation, slots in config.formations.items():
        for name in slots:
            if name not in config.vehicles:
                raise ConfigError(
                    f"{path}: 'formations.{formation}.{name}' names no vehicle of this fleet "
                    f"({', '.join(config.vehicles)}). Correct the name."
                )
        for first, second in itertools.combinations(slots, 2):
            spacing = math.dist(slots[first][:2], slots[second][:2])
            if spacing < parking:
                raise ConfigError(
                    f"{path}: slots 'formations.{formation}.{first}' and '.{second}' are {spacing:.2f} m apart; the "
                    f"law '{config.law.name}' can park vehicles at {parking:.2f} m or more. Spread the slots."
                )
