"""``covey plot DIR``: the paper's Figs. 2 and 4-6 for a recorded flight, as PNG and SVG.

Example:
  covey plot flights/first

Exit status: 0 all was drawn; 2 nothing can be drawn, or the record breaks off
(then the figures show the recorded part).
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.parameters import Folder
from onboard.config.fleet import ConfigError
from onboard.exit_status import EXIT_OK, EXIT_WRONG_INPUT


def plot(folder: Annotated[Path, Parameter(name="DIR")], /, *, out: Folder | None = None) -> int:
    """Draw the figures of a recorded flight.

    Args:
        folder: flight folder, or its flight.mcap
        out: where to write (default: DIR/figures)
    """
    # Imported here: the help page needs no matplotlib.
    from groundstation.figures.record_figures import draw_record

    try:
        paths, is_whole = draw_record(folder, out)
    except OSError as error:
        raise ConfigError(
            f"the figures cannot be written: {error}. Give another place with --out."
        ) from None

    for path in paths:
        print(path)
    if is_whole:
        return EXIT_OK

    print(
        f"covey: {folder}: the record breaks off before its end, for instance because the"
        " recording process was killed. The figures show what it has.",
        file=sys.stderr,
    )
    return EXIT_WRONG_INPUT
