"""``covey log``: recorded flights listed, looked into, and written for other programs.

Examples:
  covey log list flights
  covey log info flights/first
  covey log info flights/first/px4/mav0-2026-11-26_05_21_29.ulg
  covey log export flights/first --foxglove
  covey log export flights/first --csv flown
  covey log fetch flights/first

Exit status: 0; 2 when there is no record, or the file cannot be written. Exit
status of fetch: 0 all logs are here; 1 none; 10 nobody answered; 50 some.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import msgspec
from cyclopts import App, Parameter

from groundstation.commands.notes import print_notes
from groundstation.commands.parameters import File, Folder, Names
from groundstation.recording.flown_paths import write_csvs
from groundstation.recording.record_list import (
    contents,
    flight_folders,
    info_lines,
    list_line,
    summary,
)
from onboard.config.fleet import ConfigError, load_fleet
from onboard.exit_status import EXIT_OK

app = App(name="log", help="Recorded flights: listed, looked into, written for other programs.")

_Flight = Annotated[Path, Parameter(name="DIR")]


@app.command(name="list")
def list_flights(folder: _Flight = Path("flights"), /, *, json: bool = False) -> int:
    """List the recorded flights in a folder, the newest first.

    Args:
        folder: folder of flight folders
        json: JSON instead of lines
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder}: there is no such folder. Give one with flight folders in it.")

    summaries = []
    for flight_folder in flight_folders(folder):
        try:
            summaries.append(summary(flight_folder))
        except ConfigError as error:
            summaries.append({"folder": str(flight_folder), "refused": str(error)})
    if json:
        print(msgspec.json.format(msgspec.json.encode(summaries), indent=2).decode())
        return EXIT_OK

    for record in summaries:
        print(record["refused"] if "refused" in record else list_line(record))
    if not summaries:
        print(f"No recorded flight is in {folder}.")
    return EXIT_OK


@app.command
def info(flight: _Flight, /, *, json: bool = False) -> int:
    """Say what a record, or a log of PX4, holds: length, vehicles, verdict, rates, warnings.

    Args:
        flight: flight folder, its flight.mcap, or a log of PX4 (.ulg)
        json: JSON instead of lines
    """
    # Imported here: only this command needs the reader of PX4's logs.
    from groundstation.px4_logs import flight_logs, log_summary, px4_log

    if flight.suffix == flight_logs.SUFFIX:
        log = px4_log.read_log(flight)
        _print(log_summary.as_mapping(log), log_summary.lines(log), is_json=json)
        return EXIT_OK

    about = contents(flight)
    px4_logs = flight_logs.logs_of_folder(flight)
    content = {**about, "px4": log_summary.fleet_mapping(px4_logs)}
    lines = [*info_lines(about), *log_summary.fleet_lines(px4_logs)]
    _print(content, lines, is_json=json)
    return EXIT_OK


def _print(content: dict[str, Any], lines: list[str], *, is_json: bool) -> None:
    """Print values for programs, or lines for people."""
    if is_json:
        print(msgspec.json.format(msgspec.json.encode(content), indent=2).decode())
    else:
        print("\n".join(lines))


@app.command
def export(
    flight: _Flight,
    /,
    *,
    foxglove: bool = False,
    csv: Folder | None = None,
    out: Annotated[Path | None, Parameter(metavar="FILE")] = None,
) -> int:
    """Write a record for other programs.

    Args:
        flight: flight folder, or its flight.mcap
        foxglove: one MCAP file with scene, frames, log and attachments, for Foxglove, Lichtblick
            and Rerun; more: docs/viewers.md
        csv: t,x,y,z,yaw of each vehicle into this folder
        out: with --foxglove: file to write (default: DIR/flight.foxglove.mcap)
    """
    if not foxglove and csv is None:
        raise ConfigError("nothing to write: give --foxglove, --csv DIR or both.")
    all_notes: list[str] = []
    try:
        if csv is not None:
            paths, notes = write_csvs(flight, csv)
            print("\n".join(str(path) for path in paths))
            all_notes += notes
        if foxglove:
            # Imported here: only --foxglove needs the libraries of the extra `viewers`.
            from groundstation.viewers.viewer_record import write_viewer_record

            path, notes = write_viewer_record(flight, out)
            print(path)
            all_notes += notes
    except OSError as error:
        raise ConfigError(
            f"the file cannot be written: {error}. Give another place with --csv or --out."
        ) from None
    print_notes(flight, all_notes)
    return EXIT_OK


@app.command
def fetch(
    flight: _Flight,
    /,
    *,
    fleet: File | None = None,
    vehicles: Names | None = None,
    exclude: Names | None = None,
    newest: int = 1,
    json: bool = False,
) -> int:
    """Fetch PX4's own logs (ULog) of disarmed vehicles into DIR/px4, from all vehicles at the same
    time.

    Args:
        flight: flight folder, or any other folder
        fleet: fleet file (default: DIR/fleet.toml)
        vehicles: only these: names or indices, a,b or 0-2 (default all)
        exclude: all but these
        newest: number of logs of each vehicle, the newest first
        json: one object instead of the list
    """
    # Imported here: only this command needs the libraries of MAVLink.
    from groundstation.px4 import log_fetch
    from groundstation.px4.agent_log_link import agent_log_links
    from groundstation.px4.fetch_progress import FetchProgress
    from groundstation.px4.parameter_sets import as_mapping, as_text, exit_status
    from groundstation.px4.vehicle_links import opened, selected_vehicles
    from groundstation.px4_logs.flight_logs import FOLDER
    from onboard.security.mavlink_key import mavlink_keys

    if newest < 1:
        raise ConfigError(f"--newest is {newest}; it must be 1 or more.")
    if flight.is_file():
        flight = flight.parent
    if fleet is None and not (flight / "fleet.toml").is_file():
        raise ConfigError(f"{flight}: there is no fleet.toml in it. Give one with --fleet FILE.")

    config = load_fleet(fleet or flight / "fleet.toml")
    chosen = selected_vehicles(config, vehicles, exclude)
    progress = FetchProgress(sys.stderr)
    keys = mavlink_keys(config, [vehicle.name for vehicle in chosen])
    with opened(chosen, keys) as vehicle_links:
        unreached = [reached.vehicle for reached in vehicle_links if reached.link is None]
        with agent_log_links(config, unreached) as through_agents:
            reports = log_fetch.fetch(
                vehicle_links,
                through_agents,
                flight / FOLDER,
                newest=newest,
                progress=progress.show,
            )
    progress.end()

    if json:
        content = msgspec.json.encode(as_mapping(reports))
        print(msgspec.json.format(content, indent=2).decode())
    else:
        print(as_text(reports))
    return exit_status(reports)
