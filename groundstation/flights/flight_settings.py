"""Prepares a flight before anything starts: checks its files and ports, and creates its folder.

All input errors are found here. When :func:`prepare` returns, nothing has been started yet, and the
flight folder contains exactly the files that will be flown.
"""

from __future__ import annotations

import contextlib
import datetime
import sys
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from msgspec.structs import replace

from groundstation.flights.simulation_settings import SimulationSettings, write_settings
from groundstation.mission_files.loading import load_mission, with_fleet
from groundstation.mission_files.mission import Mission
from groundstation.mission_files.mission_findings import refuse_unflyable
from groundstation.mission_files.wall_time import WallTime
from groundstation.missions.python_check import check_python
from groundstation.processes.free_ports import (
    busy_ports,
    in_another_folder,
    is_local,
    toml_text,
    with_free_ports,
)
from groundstation.recording.writer import RECORD_NAME
from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping

_CALM = SimulationSettings()


@dataclass(frozen=True, slots=True)
class FlightSettings:
    """The settings of a flight that has been checked and can start."""

    mission: Mission
    folder: Path  # folder for the record, the logs and the verdict
    is_simulated: bool  # whether the flight starts emulator and agents itself
    is_headless: bool  # whether it runs without the console
    simulation: SimulationSettings  # settings of a simulated flight
    at: WallTime | None = None  # start of the mission; None: when the vehicles are ready


def prepare(
    mission: Mission | str,
    folder: Path,
    *,
    fleet_path: str | None,
    law: str | None,
    is_simulated: bool,
    has_free_ports: bool,
    is_headless: bool,
    simulation: SimulationSettings = _CALM,
    needs_ports: bool = True,
    arguments: Mapping[str, str] = MappingProxyType({}),
    at: WallTime | None = None,
) -> FlightSettings:
    """Check a flight before anything starts, and write the files that are flown into its folder.

    Args:
        mission: the loaded mission, or its path.
        folder: the flight folder, which is created.
        fleet_path: fleet file instead of the mission's.
        law: avoidance law instead of the fleet file's; for simulated flights only.
        is_simulated: whether the flight starts emulator and agents itself.
        has_free_ports: whether a simulated fleet gets ports that no other program uses.
        is_headless: whether the flight runs without the console.
        simulation: seed, weather, faults and orders of a simulated flight.
        needs_ports: whether the flight uses sockets; a lockstep flight does not.
        arguments: arguments of a Python mission, as texts.
        at: start of the mission; None: when the vehicles are ready.

    Raises:
        ConfigError: a file or a combination of options is wrong, a port is in use, there is no
            terminal, or the folder cannot be used.
    """
    refuse_law_of_real_flight(law, is_simulated=is_simulated)

    if isinstance(mission, str):
        mission = load_mission(mission, fleet_path)
    if arguments and not mission.is_python:
        raise ConfigError(f"{mission.path}: only Python missions have arguments. Leave --arg out.")
    mission = replace(mission, arguments=arguments)

    if mission.is_python:
        check_python(mission)  # so that an error in it is found before anything starts

    if is_simulated:
        fleet = simulated_fleet(
            mission.fleet, folder, law=law, has_free_ports=has_free_ports, needs_ports=needs_ports
        )
        mission = with_fleet(mission, fleet)

    refuse_unflyable(mission, is_simulated)

    mission_name = f"mission{Path(mission.path).suffix}"
    files = {"fleet.toml": mission.fleet.text, mission_name: mission.text}
    open_folder(folder, files, is_headless=is_headless)
    if is_simulated:
        simulation = replace(
            simulation,
            mission_path=str(Path(mission.path).absolute()),
            arguments=dict(arguments),
        )
        write_settings(folder, simulation)

    return FlightSettings(
        mission=mission,
        folder=folder,
        is_simulated=is_simulated,
        is_headless=is_headless,
        simulation=simulation,
        at=at,
    )


def refuse_law_of_real_flight(law: str | None, *, is_simulated: bool) -> None:
    """Refuse --law for a real flight, whose agents fly the law of their own fleet file.

    Raises:
        ConfigError: a law is given for a flight that is not simulated.
    """
    if law is not None and not is_simulated:
        raise ConfigError(
            "--law is for simulated flights: agents that run already fly the law of their fleet"
            " file."
        )


@contextlib.contextmanager
def flight_folder(record: Path | None) -> Iterator[Path]:
    """Give the folder of a new flight: a named one, or a new one that no other flight gets.

    A new one that is empty at the end is removed: the flight was refused.

    Args:
        record: the folder of --record; None creates one in ``flights``, named after the time.

    Raises:
        ConfigError: the new folder cannot be created.
    """
    if record is not None:
        yield record
        return

    named = Path("flights") / datetime.datetime.now().strftime("%Y%m%d-%H%M%S")
    try:
        folder = create_folder(named).absolute()
    except OSError as error:
        raise _unwritable(named, error) from None
    try:
        yield folder
    finally:
        with contextlib.suppress(OSError):  # it is not empty
            folder.rmdir()
            folder.parent.rmdir()


def create_folder(named: Path) -> Path:
    """Create a folder that nobody else gets, with a number behind its name if that is taken.

    Args:
        named: the folder, whose parents are created, too.

    Returns:
        The folder, for instance ``named`` or ``named-2``.

    Raises:
        OSError: it cannot be created.
    """
    named.parent.mkdir(parents=True, exist_ok=True)
    folder = named
    number = 1
    while not _is_created(folder):
        number += 1
        folder = named.with_name(f"{named.name}-{number}")
    return folder


def _is_created(folder: Path) -> bool:
    """Create a folder; return False if there is a file or folder of this name already."""
    try:
        folder.mkdir()
    except FileExistsError:
        return False
    return True


def refuse_flown_folder(folder: Path) -> None:
    """Refuse the folder of another flight.

    Raises:
        ConfigError: the folder contains a record.
    """
    if (folder / RECORD_NAME).exists():
        raise ConfigError(
            f"{folder}: this folder holds a flight already. Choose another with --record."
        )


def open_folder(folder: Path, files: Mapping[str, str], *, is_headless: bool) -> None:
    """Create the folder of a new flight with the files from which it is flown.

    Args:
        folder: the flight folder.
        files: name of a file -> its text.
        is_headless: whether the flight runs without the console.

    Raises:
        ConfigError: there is no terminal for the console, the folder contains another flight or
            other files of these names, or it cannot be written.
    """
    if not is_headless and not sys.stdout.isatty():
        raise ConfigError("The console needs a terminal, and this output is none. Add --headless.")

    refuse_flown_folder(folder)
    write_files(folder, files)


def write_files(folder: Path, files: Mapping[str, str]) -> None:
    """Create a folder with these files.

    Args:
        folder: the folder.
        files: name of a file -> its text.

    Raises:
        ConfigError: the folder or a file cannot be written, or it would replace another file.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _refuse_other_files(folder, files)
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise _unwritable(folder, error) from None


def _unwritable(folder: Path, error: OSError) -> ConfigError:
    return ConfigError(
        f"{folder}: cannot be written ({error.strerror}). Choose another with --record."
    )


def _refuse_other_files(folder: Path, files: Mapping[str, str]) -> None:
    """Refuse a folder in which somebody's own files have the names of the flight's files.

    Args:
        folder: the flight folder.
        files: name of a file -> the text that it would get.

    Raises:
        ConfigError: a file of one of these names has another text.
    """
    for name, text in files.items():
        path = folder / name
        if path.is_file() and path.read_bytes() != text.encode("utf-8"):
            raise ConfigError(
                f"{path} is there already, and the flight would overwrite it. "
                "Choose another folder with --record."
            )


def simulated_fleet(
    fleet: FleetConfig, folder: Path, *, law: str | None, has_free_ports: bool, needs_ports: bool
) -> FleetConfig:
    """Return the fleet of a simulated flight, with this law, and on ports of this machine.

    Args:
        fleet: the fleet file.
        folder: the flight folder.
        law: avoidance law instead of the fleet file's.
        has_free_ports: whether it gets ports that no other program uses.
        needs_ports: whether the flight uses sockets; a lockstep flight does not.

    Raises:
        ConfigError: ports are in use, or the law cannot be imported.
    """
    fleet.with_law(law, named_by="--law").import_law()

    # this computer cannot listen at endpoints of other computers
    is_elsewhere = needs_ports and not is_local(fleet)
    flown = _fleet_of_flight(fleet, folder, law, has_free_ports=has_free_ports or is_elsewhere)
    if needs_ports:
        _refuse_busy_ports(flown)

    # Until now refusals name the user's file: of a flight that is refused there is no copy.
    return replace(flown, path=str(folder / "fleet.toml"))


def _refuse_busy_ports(fleet: FleetConfig) -> None:
    """Refuse a fleet whose ports other programs use.

    Raises:
        ConfigError: ports are in use.
    """
    busy = busy_ports(fleet)
    if busy:
        more = ""
        if len(busy) > 1:
            more = f" {len(busy)} ports are taken."
        raise ConfigError(
            f"{fleet.path}: {busy[0]}{more} Stop another emulator or fleet that runs here, change"
            " the endpoints, or fly with covey demo, which picks free ones."
        )


def _fleet_of_flight(
    fleet: FleetConfig, folder: Path, law: str | None, *, has_free_ports: bool
) -> FleetConfig:
    """Return the fleet of the copy that is written into the flight folder.

    Its path is still that of the fleet file.
    """
    data = tomllib.loads(fleet.text)

    for vehicle in data["vehicles"].values():
        vehicle.pop("emulated", None)  # in a simulated flight all are emulated
    if law is not None:
        data["law"] = {**data.get("law", {}), "name": law}

    data = in_another_folder(data, fleet)
    if has_free_ports:
        data = with_free_ports(data, fleet)

    path = f"{folder}/fleet.toml"
    comment = f"Made from {fleet.path} for this flight; attach with: covey tui --fleet {path}"
    return fleet_from_mapping(data, path=fleet.path, text=toml_text(data, comment))
