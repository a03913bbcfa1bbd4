"""``covey identify``: a vehicle's real values, from a short manoeuvre or from any recorded flight.

Examples:
  covey identify --fleet fleet.toml --vehicle mav0 --sitl
  covey identify flights/first
  covey identify flights/first --fleet fleet.toml --write

Exit status: 0 identified; 1 the flight failed or showed too little; 2 wrong input.
"""

from __future__ import annotations

import asyncio
import sys
import tomllib
from dataclasses import asdict
from json import dumps
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.fly import new_folder
from groundstation.commands.parameters import File, Folder
from groundstation.commands.shared.flight import MissionFlight, clock_say, open_folder, prepare
from groundstation.identification.flight_log import TooLittleFlown
from groundstation.identification.identify import identify as identify_log
from groundstation.identification.manoeuvre import BOX_M, manoeuvre, mission_text
from groundstation.identification.record import logs_of
from groundstation.identification.report import IdentifiedVehicle, page, rows, toml_of_types
from groundstation.processes.free_ports import in_another_folder, toml_text
from groundstation.recording.reader import record_path
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
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
    """Identify a vehicle's hover throttle, lag, drag and tilt error, and propose values for its
    type.

    Args:
        record_dir: folder of a recorded flight: nothing is flown
        fleet: fleet file (default for a record: the one in its folder)
        vehicle: the vehicle that flies; for a record, the one to identify (default: all)
        sitl: start the emulator and the agent too, on free ports
        headless: no console: progress in lines
        record: flight folder (default: flights/<time>)
        seed: seed of the manoeuvre, and of the emulator
        box: half its width
        json: a list with one object for each vehicle
        write: put the values into the fleet file of --fleet; its comments stay
    """
    if write and (fleet is None or not Path(fleet).is_file()):
        raise ConfigError(
            "--write needs --fleet FILE, a fleet file of yours, to put the values into."
        )
    target = Path(fleet) if write and fleet is not None else None
    if record_dir is not None:
        if sitl:
            raise ConfigError("--sitl flies; a recorded flight needs no flying. Give one of them.")
        return identify_from_record(record_dir, fleet, vehicle, json, target)
    if fleet is None or vehicle is None:
        raise ConfigError(
            "Give --fleet FILE and --vehicle NAME to fly, or the folder of a recorded flight."
        )
    if seed < 0:
        raise ConfigError(f"--seed is {seed}; it must be 0 or more.")
    if not box > 0.0:
        raise ConfigError(f"--box is {box}; it must be a width in metres above 0.")
    folder = (record or new_folder()).absolute()
    path = _prepare_files(
        fleet, vehicle, folder, half_m=box, seed=seed, is_simulated=sitl, is_headless=headless
    )
    settings = prepare(
        str(folder / "mission.py"),
        folder,
        fleet_path=str(path),
        law=None,
        is_simulated=sitl,
        has_free_ports=True,
        is_headless=headless,
        seed=seed,
    )
    say = clock_say() if not json else lambda line: print(line, file=sys.stderr, flush=True)
    status = asyncio.run(MissionFlight(settings, say=say).fly())
    if status != EXIT_OK:
        print(
            f"The manoeuvre was not flown to its end; what there is lies in {folder}.",
            file=sys.stderr,
        )
        return status
    return identify_from_record(folder, None, vehicle, json, target)


def _prepare_files(
    fleet_path: str,
    vehicle: str,
    folder: Path,
    *,
    half_m: float,
    seed: int,
    is_simulated: bool,
    is_headless: bool,
) -> Path:
    """Write the manoeuvre as a mission into the flight folder; returns the fleet file to fly with."""
    fleet = load_fleet(fleet_path)
    if vehicle not in fleet.enabled_names:
        raise ConfigError(
            f"'{vehicle}' is no enabled vehicle of '{fleet.fleet.name}': {', '.join(fleet.enabled_names)}."
        )
    path = folder / "fleet.toml" if is_simulated else Path(fleet_path).absolute()
    files = {
        "mission.py": mission_text(
            path, vehicle, manoeuvre(fleet, vehicle, half_m=half_m, seed=seed)
        )
    }
    if is_simulated:
        files["fleet.toml"] = one_alone(fleet, vehicle)
    open_folder(folder, files, is_headless=is_headless)
    return path


def one_alone(fleet: FleetConfig, name: str) -> str:
    """Return the fleet file with the others out of it."""
    data = in_another_folder(tomllib.loads(fleet.text), fleet)
    for other, table in data["vehicles"].items():
        table["enabled"] = other == name
    return toml_text(data, f"Made from {fleet.path}: only {name} takes part.")


def identify_from_record(
    folder: Path,
    fleet_path: str | None,
    name: str | None,
    is_json: bool,
    target: Path | None = None,
) -> int:
    """Identify everybody who flew in a record, or one of them, and say it; the exit status.

    Args:
        target: fleet file that gets the values.
    """
    path = record_path(folder)
    fleet = load_fleet(fleet_path or path.parent / "fleet.toml")
    names = fleet.enabled_names if name is None else (name,)
    if name is not None and name not in fleet.vehicles:
        raise ConfigError(
            f"'{name}' is no vehicle of fleet '{fleet.fleet.name}': {', '.join(fleet.vehicles)}."
        )
    logs, refusals = logs_of(path, fleet, names), dict[str, str]()
    flown: list[IdentifiedVehicle] = []
    for one in names:
        if one not in logs:
            if name is not None or not logs:
                refusals[one] = "it did not fly in this record."
            continue
        try:
            flown.append(IdentifiedVehicle(fleet.vehicles[one], identify_log(logs[one])))
        except TooLittleFlown as error:
            refusals[one] = str(error)
    for one, why in refusals.items():
        print(f"{one} was not identified: {why}", file=sys.stderr)
    if is_json:
        objects = [
            {"vehicle": each.vehicle.name, **asdict(each.identified), "rows": rows(each)}
            for each in flown
        ]
        print(dumps(objects, indent=2))
    elif flown:
        print(page(flown))
    if target is not None and flown:
        from groundstation.starter.fleet_edit import write_changes

        for text in toml_of_types(flown).values():
            write_changes(target, tomllib.loads(text))
        print(
            f"Written into {target}. Look at it with covey check {target}; every computer needs this file."
        )
    return EXIT_OK if flown else EXIT_FAILED
