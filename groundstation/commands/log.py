"""``covey log``: recorded flights listed, looked into, and written for other programs.

Examples:
  covey log list flights
  covey log info flights/first
  covey log export flights/first --foxglove
  covey log export flights/first --csv flown

Exit status: 0; 2 when there is no record, or the file cannot be written.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
from cyclopts import App, Parameter

from groundstation.commands.parameters import Folder
from groundstation.recording.catalogue import (
    channels,
    flight_folders,
    info_lines,
    list_line,
    summary,
)
from groundstation.recording.flown_paths import write_csvs
from onboard.config.fleet import ConfigError
from onboard.exit_status import EXIT_OK

app = App(name="log", help="Recorded flights: listed, looked into, written for other programs.")

_Flight = Annotated[Path, Parameter(name="DIR")]


@app.command(name="list")
def list_flights(folder: _Flight = Path("flights"), /, *, json: bool = False) -> int:
    """List the recorded flights in a folder, the newest first.

    Args:
        folder: folder of flight folders (default: flights)
        json: for programs
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder}: there is no such folder. Give one with flight folders in it.")

    found = []
    for one in flight_folders(folder):
        try:
            found.append(summary(one))
        except ConfigError as error:
            found.append({"folder": str(one), "refused": str(error)})
    if json:
        print(msgspec.json.format(msgspec.json.encode(found), indent=2).decode())
        return EXIT_OK

    for line in found:
        print(line["refused"] if "refused" in line else list_line(line))
    if not found:
        print(f"No recorded flight is in {folder}.")
    return EXIT_OK


@app.command
def info(flight: _Flight, /, *, json: bool = False) -> int:
    """Say what a record holds: length, vehicles, verdict, channels with their rates.

    Args:
        flight: flight folder, or its flight.mcap
        json: for programs
    """
    about = summary(flight)
    counts = channels(flight)
    if json:
        content = msgspec.json.encode({**about, "channels": counts})
        print(msgspec.json.format(content, indent=2).decode())
    else:
        print("\n".join(info_lines(about, counts)))
    return EXIT_OK


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
    try:
        if csv is not None:
            print("\n".join(str(path) for path in write_csvs(flight, csv)))
        if foxglove:
            # Imported here: only this needs the libraries of the extra `viewers`.
            from groundstation.viewers.viewer_record import write_viewer_record

            print(write_viewer_record(flight, out))
    except OSError as error:
        raise ConfigError(
            f"the file cannot be written: {error}. Give another place with --out."
        ) from None
    return EXIT_OK
