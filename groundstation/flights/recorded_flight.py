"""A simulated flight as its folder has it: what it was flown from, and the digests of its state."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from groundstation.flights.changes import FlightOrigin
from groundstation.flights.simulation_settings import read_settings
from groundstation.mission_files.loading import load_mission, mission_from_mapping
from groundstation.mission_files.mission import Mission
from onboard.config.file_reading import (
    FLEET_FILE,
    MISSION_FILE,
    SIMULATION_FILE,
    read_text,
    toml_values,
)
from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping

DIGESTS_NAME = "digests.txt"
FLEET_NAME = "fleet.toml"


class RecordedFlight(NamedTuple):
    """A flight that was flown in lockstep."""

    folder: Path
    origin: FlightOrigin  # fleet file and settings
    digests: dict[str, str]  # of the state: second as it is written -> digest


def open_recorded(folder: Path) -> RecordedFlight:
    """Return a recorded flight that can be flown again.

    Raises:
        ConfigError: its folder does not say how it was flown, or it was not flown in lockstep.
    """
    settings = read_settings(folder)
    if not settings.is_lockstep:
        raise ConfigError(
            f"{folder}: this flight was simulated in real time, where no two flights are alike."
            " Only flights in lockstep can be flown again: add --lockstep."
        )
    suffix = Path(settings.mission_path).suffix or ".toml"
    origin = FlightOrigin(
        fleet_text=read_text(folder / FLEET_NAME, FLEET_FILE),
        mission_text=read_text(folder / f"mission{suffix}", MISSION_FILE),
        settings=settings,
    )
    return RecordedFlight(
        folder=folder,
        origin=origin,
        digests=_digests(folder),
    )


def fleet_of(text: str, path: Path) -> FleetConfig:
    """Return the fleet of a file's text.

    Args:
        text: of the fleet file.
        path: of the file, which refusals name; folders in it are relative to its place.

    Raises:
        ConfigError: the file is wrong.
    """
    values = toml_values(text, str(path))
    return fleet_from_mapping(values, path=str(path), text=text)


def mission_of(flown: RecordedFlight, origin: FlightOrigin, fleet: FleetConfig) -> Mission:
    """Return the mission of an origin.

    Files that it names are read where the recorded flight has read them.

    Args:
        flown: the recorded flight, whose folder has a copy of its mission.
        origin: of the flight that is flown again.
        fleet: of that origin.

    Raises:
        ConfigError: the mission is wrong, or does not fit this fleet.
    """
    path = origin.settings.mission_path
    if path.endswith(".py"):
        mission = load_mission(flown.folder / "mission.py", fleet)
    else:
        values = toml_values(origin.mission_text, path)
        mission = mission_from_mapping(values, path=path, text=origin.mission_text, fleet=fleet)
    return replace(mission, arguments=origin.settings.arguments)


def write_digest(folder: Path, time_s: float, digest: str) -> None:
    """Add a digest of the state at a second of simulated time to a flight's folder.

    Raises:
        OSError: the disk refuses.
    """
    with (folder / DIGESTS_NAME).open("a", encoding="utf-8") as file:
        file.write(f"{second_word(time_s)} {digest}\n")


def second_word(time_s: float) -> str:
    """Return a second as it stands beside its digest."""
    return f"{time_s:.3f}"


def _digests(folder: Path) -> dict[str, str]:
    path = folder / DIGESTS_NAME
    if not path.is_file():
        return {}
    digests = {}
    for line in read_text(path, SIMULATION_FILE).splitlines():
        second, _, digest = line.partition(" ")
        digests[second] = digest
    return digests
