"""Identifies the vehicles that flew in a recorded flight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from groundstation.identification.identification_report import IdentifiedVehicle, sets_values
from groundstation.identification.identify import identify
from groundstation.identification.logged_stretch import TooLittleFlown
from groundstation.identification.recorded_motion import logs_of
from groundstation.recording.reader import record_path
from onboard.config.file_reading import toml_values
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet


@dataclass(slots=True)
class IdentifiedFlight:
    """The identified vehicles of a record, and those that could not be identified."""

    vehicles: list[IdentifiedVehicle] = field(default_factory=list)
    # name of a vehicle that was not identified -> a sentence that says why
    refusals: dict[str, str] = field(default_factory=dict)


def identify_flight(folder: Path, fleet_path: str | None, name: str | None) -> IdentifiedFlight:
    """Identify all vehicles that flew in a record, or one of them.

    Args:
        folder: flight folder, or its MCAP file.
        fleet_path: fleet file; None for the one beside the record.
        name: name of the vehicle to identify; None for all.

    Raises:
        ConfigError: there is no record, no fleet file, or no such vehicle.
    """
    path = record_path(folder)
    fleet = load_fleet(fleet_path or path.parent / "fleet.toml", needs_folders=False)
    names = _names(fleet, name)
    own_tables = toml_values(fleet.text, fleet.path)["vehicles"]
    logs = logs_of(path, fleet, names)

    result = IdentifiedFlight()
    for vehicle_name in names:
        if vehicle_name in logs:
            try:
                identified = identify(logs[vehicle_name])
            except TooLittleFlown as error:
                result.refusals[vehicle_name] = str(error)
            else:
                result.vehicles.append(
                    IdentifiedVehicle(
                        vehicle=fleet.vehicles[vehicle_name],
                        identified=identified,
                        has_own_values=sets_values(own_tables[vehicle_name]),
                    )
                )
        elif name is not None or not logs:
            # A vehicle that did not fly is reported only if it was named, or if none flew.
            result.refusals[vehicle_name] = "it did not fly in this record."
    return result


def _names(fleet: FleetConfig, name: str | None) -> Sequence[str]:
    if name is None:
        return fleet.enabled_names
    if name not in fleet.vehicles:
        known = ", ".join(fleet.vehicles)
        raise ConfigError(f"'{name}' is no vehicle of fleet '{fleet.fleet.name}': {known}.")
    return (name,)
