"""``covey identify``: a vehicle's real values, from a short manoeuvre or from any recorded flight.

Examples:
  covey identify --fleet fleet.toml --vehicle mav0 --sitl
  covey identify flights/first
  covey identify flights/first --fleet fleet.toml --write

Exit status: 0 identified; 1 the flight failed or showed too little; 2 wrong
input.
"""

from __future__ import annotations

import asyncio
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import asdict
from json import dumps
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.parameters import File, Folder, refuse_wrong_seed
from groundstation.flights.flight_settings import FlightSettings, flight_folder, prepare
from groundstation.flights.identification_flight import write_manoeuvre
from groundstation.flights.mission_flight import MissionFlight, clock_say
from groundstation.flights.simulation_settings import SimulationSettings
from groundstation.identification.identification_report import (
    IdentifiedVehicle,
    page,
    rows,
    tomls,
    unknown_parameters,
)
from groundstation.identification.identified_flight import identify_flight
from groundstation.identification.manoeuvre import BOX_M
from onboard.config.fleet import ConfigError
from onboard.exit_status import EXIT_FAILED, EXIT_OK


def identify(
    record_dir: Annotated[Path | None, Parameter(name="RECORD")] = None,
    /,
    *,
    fleet: File | None = None,
    vehicle: Annotated[str | None, Parameter(metavar="NAME")] = None,
    sitl: bool = False,
    headless: bool = False,
    record: Folder | None = None,
    seed: int = 0,
    box: Annotated[float, Parameter(metavar="METRES")] = BOX_M,
    json: bool = False,
    write: bool = False,
) -> int:
    """Identify a vehicle's hover throttle, lag, drag and tilt error; propose values for its type.

    Args:
        record_dir: folder of a recorded flight; then nothing is flown
        fleet: fleet file (default for a record: the one in its folder)
        vehicle: the vehicle that flies; for a record, the one to identify (default: all)
        sitl: start the emulator and the agent too, on free ports
        headless: no console: progress in lines
        record: flight folder (default: flights/<time>)
        seed: seed of the manoeuvre, and of the emulator
        box: half the width of the box in which the manoeuvre is flown
        json: a list with one object for each vehicle
        write: put the values into the fleet file of --fleet; its comments stay
    """
    target = None
    if write:
        if fleet is None or not Path(fleet).is_file():
            raise ConfigError(
                "--write needs --fleet FILE, a fleet file of yours, to put the values into."
            )
        target = Path(fleet)

    if record_dir is not None:
        if sitl:
            raise ConfigError("--sitl flies; a recorded flight needs no flying. Give one of them.")
        return _identify_record(record_dir, fleet, vehicle, target, is_json=json)

    if fleet is None or vehicle is None:
        raise ConfigError(
            "Give --fleet FILE and --vehicle NAME to fly, or the folder of a recorded flight."
        )
    refuse_wrong_seed(seed)
    if not box > 0.0:
        raise ConfigError(f"--box is {box}; half the width of the box must be more than 0 m.")

    with flight_folder(record) as folder:
        return _fly_and_identify(
            fleet,
            vehicle,
            folder.absolute(),
            target,
            half_m=box,
            seed=seed,
            is_simulated=sitl,
            is_headless=headless,
            is_json=json,
        )


def _fly_and_identify(
    fleet: str,
    vehicle: str,
    folder: Path,
    target: Path | None,
    *,
    half_m: float,
    seed: int,
    is_simulated: bool,
    is_headless: bool,
    is_json: bool,
) -> int:
    """Fly the manoeuvre, identify the vehicle by its record; return the exit status."""
    # This also writes mission.py into the folder.
    fleet_path = write_manoeuvre(
        fleet,
        vehicle,
        folder,
        half_m=half_m,
        seed=seed,
        is_simulated=is_simulated,
        is_headless=is_headless,
    )
    settings = prepare(
        str(folder / "mission.py"),
        folder,
        fleet_path=str(fleet_path),
        law=None,
        is_simulated=is_simulated,
        has_free_ports=True,
        is_headless=is_headless,
        simulation=SimulationSettings(seed=seed),
    )
    status = _fly(settings, is_json=is_json)
    if status != EXIT_OK:
        print(
            f"The manoeuvre was not flown to its end; what there is lies in {folder}.",
            file=sys.stderr,
        )
        return status
    return _identify_record(folder, None, vehicle, target, is_json=is_json)


def _fly(settings: FlightSettings, *, is_json: bool) -> int:
    """Fly the manoeuvre; return the exit status."""
    say = clock_say()
    if is_json:
        say = _say_beside_objects
    return asyncio.run(MissionFlight(settings, say=say).fly())


def _say_beside_objects(line: str) -> None:
    """Print a line to standard error, because JSON objects go to standard output."""
    print(line, file=sys.stderr, flush=True)


def _identify_record(
    folder: Path,
    fleet_path: str | None,
    name: str | None,
    target: Path | None,
    *,
    is_json: bool,
) -> int:
    """Identify the vehicles of a record and print them; return the exit status.

    Args:
        folder: flight folder.
        fleet_path: fleet file; None for the one beside the record.
        name: name of the vehicle to identify; None for all.
        target: fleet file into which the values are written; None writes none.
        is_json: whether JSON objects are printed instead of a page.
    """
    result = identify_flight(folder, fleet_path, name)

    for vehicle_name, reason in result.refusals.items():
        print(f"{vehicle_name} was not identified: {reason}", file=sys.stderr)
    if is_json:
        print(dumps([_as_mapping(vehicle) for vehicle in result.vehicles], indent=2))
    elif result.vehicles:
        print(page(result.vehicles))

    if not result.vehicles:
        return EXIT_FAILED
    if target is None:
        return EXIT_OK

    unknown = [
        f"{name} of {vehicle.vehicle.name}"
        for vehicle in result.vehicles
        for name in unknown_parameters(vehicle)
    ]
    if unknown:
        print(
            f"Nothing is written into {target}: the flight shows too little of"
            f" {', '.join(unknown)}. Fly longer, or put values into the file by hand.",
            file=sys.stderr,
        )
        return EXIT_FAILED
    _write(target, result.vehicles)
    return EXIT_OK


def _as_mapping(result: IdentifiedVehicle) -> dict[str, object]:
    return {"vehicle": result.vehicle.name, **asdict(result.identified), "rows": rows(result)}


def _write(target: Path, vehicles: Sequence[IdentifiedVehicle]) -> None:
    """Put the identified values into a fleet file."""
    # Imported here: only --write needs tomlkit.
    from groundstation.starter.fleet_edit import write_changes

    for text in tomls(vehicles):
        write_changes(target, tomllib.loads(text))
    print(
        f"Written into {target}. Look at it with covey check {target};"
        " every computer needs this file."
    )
