"""Reads the folder of a lockstep flight: the files from which it was flown, and its digests.

``covey replay --what-if``, ``covey incident`` and ``sitl/lockstep/reflight.py`` fly it again.
"""

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
    origin: FlightOrigin  # fleet file, mission and settings
    digests: dict[str, str]  # second (as second_word writes it) -> digest of the state


def open_recorded(folder: Path) -> RecordedFlight:
    """Return a recorded flight that can be flown again.

    Args:
        folder: flight folder, or its MCAP file.

    Raises:
        ConfigError: the folder does not contain the settings, or it was not flown in lockstep.
    """
    if folder.is_file():
        folder = folder.parent
    settings = read_settings(folder)
    if not settings.is_lockstep:
        raise ConfigError(
            f"{folder}: this flight was simulated in real time, where no two flights are alike."
            " Only flights in lockstep can be flown again: record it with covey fly MISSION"
            " --lockstep."
        )
    suffix = Path(settings.mission_path).suffix
    if not suffix:
        suffix = ".toml"
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
    """Return the fleet of a fleet file's text.

    Args:
        text: text of the fleet file.
        path: path of the file, which messages name, and to which folders in it are relative.

    Raises:
        ConfigError: the file is wrong.
    """
    values = toml_values(text, str(path))
    return fleet_from_mapping(values, path=str(path), text=text)


def mission_of(flown: RecordedFlight, origin: FlightOrigin, fleet: FleetConfig) -> Mission:
    """Return the mission that is flown again.

    Args:
        flown: the recorded flight, whose folder contains a copy of its mission.
        origin: files and settings of the new flight, with changes.
        fleet: the fleet of the new flight.

    Raises:
        ConfigError: the mission is wrong, or does not fit this fleet.
    """
    path = origin.settings.mission_path
    if path.endswith(".py"):
        # Python code is loaded from a file. The copy in the folder will do, because a change cannot
        # alter a Python mission.
        copy = load_mission(flown.folder / "mission.py", fleet)
        mission = replace(copy, original_path=path)
    else:
        # A change may have altered the text. The path is the original one, because files that the
        # mission names are relative to it.
        values = toml_values(origin.mission_text, path)
        mission = mission_from_mapping(values, path=path, text=origin.mission_text, fleet=fleet)
    return replace(mission, arguments=origin.settings.arguments)


def write_digest(folder: Path, time_s: float, digest: str) -> None:
    """Append the digest of the state at a second of simulated time to a flight's folder.

    Raises:
        OSError: the file cannot be written.
    """
    with (folder / DIGESTS_NAME).open("a", encoding="utf-8") as file:
        file.write(f"{second_word(time_s)} {digest}\n")


def second_word(time_s: float) -> str:
    """Return a second in the form in which it is written beside its digest."""
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
