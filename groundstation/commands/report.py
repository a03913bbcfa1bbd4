"""``covey report DIR``: a recorded flight as one page that opens offline and plays.

Examples:
  covey report flights/first
  covey report flights/first --compare flights/second
  covey report flights/first --rehearse

The page is DIR/report.html. Any browser with WebGL2 opens it, without a network:
the flight in three dimensions with a time line, the verdict, distances with the
promise, thrust before and after the law, wind, battery, loop and bus, events
and orders. report.html#t=12.5&pair=mav0-mav3 opens a pair at a second.

Exit status: 0; 2 when there is no record to open, or the page cannot be written.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.parameters import File
from groundstation.flights.flight_settings import prepare
from groundstation.flights.simulation_settings import SimulationSettings
from groundstation.recording.writer import RECORD_NAME
from groundstation.report.flight_page import write_page
from onboard.config.fleet import ConfigError
from onboard.exit_status import EXIT_OK

_MB = 1e6


def report(
    folder: Annotated[Path, Parameter(name="DIR")],
    /,
    *,
    compare: Annotated[Path | None, Parameter(metavar="DIR")] = None,
    rehearse: bool = False,
    fleet: File | None = None,
    out: Annotated[Path | None, Parameter(metavar="FILE")] = None,
    tiles: Annotated[Path | None, Parameter(metavar="DIR")] = None,
) -> int:
    """Write a recorded flight as one page for a browser.

    Args:
        folder: flight folder, or its flight.mcap
        compare: another flight of the same vehicles, shown as ghosts beside this one
        rehearse: fly the mission of the folder in lockstep first, into DIR/rehearsal, and show
            that flight as ghosts; this runs the code of a Python mission and of the fleet's own law
        fleet: fleet file, if there is none beside the record
        out: where to write (default: DIR/report.html)
        tiles: folder with pictures of the ground, {z}/{x}/{y}.png, which become a part of the page
    """
    if rehearse:
        if compare is not None:
            raise ConfigError("--rehearse and --compare both show ghosts. Give one of them.")
        compare = _rehearsal(folder.parent if folder.is_file() else folder)

    try:
        written = write_page(folder, out, fleet_path=fleet, compared=compare, tiles=tiles)
    except OSError as error:
        raise ConfigError(
            f"the page cannot be written: {error}. Give another place with --out."
        ) from None

    for note in written.notes:
        print(note)
    print(f"{written.path} ({written.size / _MB:.1f} MB): open it in a browser.")
    return EXIT_OK


def _rehearsal(folder: Path) -> Path:
    """Return the folder of the rehearsal in lockstep, which is flown unless it is there already."""
    rehearsal = folder / "rehearsal"
    if (rehearsal / RECORD_NAME).is_file():
        return rehearsal

    missions = [folder / name for name in ("mission.toml", "mission.py")]
    mission = next((path for path in missions if path.is_file()), None)
    if mission is None:
        raise ConfigError(
            f"{folder}: there is no mission file in it to rehearse. Show another flight with"
            " --compare DIR."
        )

    # Imported here: only a rehearsal needs the simulation.
    from sitl.lockstep.command import fly_mission

    settings = prepare(
        str(mission),
        rehearsal.absolute(),
        fleet_path=str(folder / "fleet.toml"),
        law=None,
        is_simulated=True,
        has_free_ports=False,
        is_headless=True,
        simulation=SimulationSettings(is_lockstep=True),
        needs_ports=False,
    )
    fly_mission(settings.mission, settings.folder, settings.simulation)
    return rehearsal
