"""``covey report DIR``: a recorded flight as one page that opens offline and plays.

Examples:
  covey report flights/first
  covey report flights/first --compare flights/second

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
from groundstation.report.flight_page import write_page
from onboard.config.fleet import ConfigError
from onboard.exit_status import EXIT_OK

_MB = 1e6


def report(
    folder: Annotated[Path, Parameter(name="DIR")],
    /,
    *,
    compare: Annotated[Path | None, Parameter(metavar="DIR")] = None,
    fleet: File | None = None,
    out: Annotated[Path | None, Parameter(metavar="FILE")] = None,
) -> int:
    """Write a recorded flight as one page for a browser.

    Args:
        folder: flight folder, or its flight.mcap
        compare: another flight of the same vehicles, shown as ghosts beside this one
        fleet: fleet file, where none lies beside the record
        out: where to write (default: DIR/report.html)
    """
    try:
        written = write_page(folder, out, fleet_path=fleet, compared=compare)
    except OSError as error:
        raise ConfigError(
            f"the page cannot be written: {error}. Give another place with --out."
        ) from None

    for note in written.notes:
        print(note)
    print(f"{written.path} ({written.size / _MB:.1f} MB): open it in a browser.")
    return EXIT_OK
