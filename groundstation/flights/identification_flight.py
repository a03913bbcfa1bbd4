"""Writes the files of an identification flight, in which one vehicle alone flies a manoeuvre."""

from __future__ import annotations

import tomllib
from pathlib import Path

from groundstation.flights.flight_settings import open_folder
from groundstation.identification.manoeuvre import manoeuvre, mission_text
from groundstation.processes.free_ports import in_another_folder, toml_text
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet

_ALONE = "alone.toml"  # copy of the fleet file from which the flight makes its own, fleet.toml


def write_manoeuvre(
    fleet_path: str,
    vehicle: str,
    folder: Path,
    *,
    half_m: float,
    seed: int,
    is_simulated: bool,
    is_headless: bool,
) -> Path:
    """Write the manoeuvre as ``mission.py`` into the flight folder; return the fleet file to use.

    Args:
        fleet_path: the fleet file.
        vehicle: name of the vehicle that flies.
        folder: the flight folder, which is created.
        half_m: half the width of the box in which the manoeuvre stays.
        seed: seed of the manoeuvre.
        is_simulated: whether a copy of the fleet flies, in which the others are disabled.
        is_headless: whether the flight runs without the console.

    Raises:
        ConfigError: the vehicle is not enabled, or the folder cannot be used for a flight.
    """
    fleet = load_fleet(fleet_path)
    if vehicle not in fleet.enabled_names:
        enabled = ", ".join(fleet.enabled_names)
        raise ConfigError(f"'{vehicle}' is no enabled vehicle of '{fleet.fleet.name}': {enabled}.")

    flown_fleet_path = Path(fleet_path).absolute()
    if is_simulated:
        flown_fleet_path = folder / _ALONE

    steps = manoeuvre(fleet, vehicle, half_m=half_m, seed=seed)
    files = {"mission.py": mission_text(flown_fleet_path, vehicle, steps)}
    if is_simulated:
        files[_ALONE] = one_alone(fleet, vehicle)

    open_folder(folder, files, is_headless=is_headless)
    return flown_fleet_path


def one_alone(fleet: FleetConfig, name: str) -> str:
    """Return the text of a fleet file in which all vehicles but one are disabled."""
    data = in_another_folder(tomllib.loads(fleet.text), fleet)
    for other, table in data["vehicles"].items():
        table["enabled"] = other == name
    return toml_text(data, f"Made from {fleet.path}: only {name} takes part.")
