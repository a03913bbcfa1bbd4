"""``covey plot DIR``: the paper's Figs. 2 and 4-6 for a recorded flight, as PNG and SVG.

Example:
  covey plot flights/first

Exit status: 0 all was drawn that can be read, and a sentence says so if a record
was cut off or is damaged; 2 nothing can be drawn.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.notes import print_notes
from groundstation.commands.parameters import Folder
from onboard.config.fleet import ConfigError
from onboard.exit_status import EXIT_OK


def plot(folder: Annotated[Path, Parameter(name="DIR")], /, *, out: Folder | None = None) -> int:
    """Draw the figures of a recorded flight.

    Args:
        folder: flight folder, or its flight.mcap
        out: where to write (default: DIR/figures)
    """
    # Imported here: the help page needs no matplotlib.
    from groundstation.figures.record_figures import draw_record

    try:
        paths, notes = draw_record(folder, out)
    except OSError as error:
        raise ConfigError(
            f"the figures cannot be written: {error}. Give another place with --out."
        ) from None

    for path in paths:
        print(path)
    print_notes(folder, notes)
    return EXIT_OK
