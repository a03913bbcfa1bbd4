"""``covey simulate --map``: flies the map of the law, or goes on with it, and prints the cells."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from onboard.config.fleet import ConfigError
from onboard.plain_text import drawing
from sitl.monte_carlo.law_map import map_summary, run, unit_flights
from sitl.monte_carlo.law_map.cells import STAGES, Cell, Unit, cells
from sitl.monte_carlo.law_map.results_file import ResultsFile, digest


def fly_map(
    path: Path,
    *,
    selection: Sequence[str] = (),
    least_flights: int = 500,
    jobs: int = 1,
    scheduler: str | None = None,
    is_anew: bool = False,
) -> bool:
    """Fly what is missing of the map, and print it; return whether no cell has failed.

    Args:
        path: file of results.
        selection: cells, as for :func:`cells`.
        least_flights: in a cell that does not fail.
        jobs: processes.
        scheduler: address of a Dask scheduler in their place.
        is_anew: put a file that is there aside, and begin.
    Raises:
        ConfigError: nothing can be flown, for a reason in words.
    """
    selected = cells(selection)
    stages = _stages(least_flights, selected[0])

    with ResultsFile(path, unit_flights.version(), is_anew=is_anew) as file:
        try:
            run.run(selected, file, stages=stages, jobs=jobs, scheduler=scheduler)
        except KeyboardInterrupt:
            run.say(
                f"interrupted; {path} keeps what was flown, and the same command goes on from there"
            )
            raise
        _print(selected, file)
        return not any(run.has_failed(cell, file) for cell in selected)


def _stages(least_flights: int, cell: Cell) -> int:
    """Return how many stages have so many flights together.

    Raises:
        ConfigError: none, or more than all stages have.
    """
    if least_flights < 1:
        raise ConfigError(f"--flights is {least_flights}; it must be 1 or more.")

    flown = 0
    for stage in range(len(STAGES)):
        flown += Unit(cell, stage).flights
        if flown >= least_flights:
            return stage + 1
    raise ConfigError(
        f"--flights is {least_flights}; in a cell of the map up to {flown} are flown."
    )


def _print(selected: list[Cell], file: ResultsFile) -> None:
    """Print the selected cells as a table, and the digest of their rows."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"map of the law, version {file.version}")
    for index, column in enumerate(map_summary.COLUMNS):
        table.add_column(column, justify="left" if index < 2 else "right")
    for cell in selected:
        table.add_row(*map_summary.table_row(cell, file.rows))

    width = 140
    if sys.stdout.isatty():
        width = shutil.get_terminal_size().columns
    console = Console(file=drawing(sys.stdout), width=width)
    console.print(table)

    keys = {cell.key for cell in selected}
    rows = {key: row for key, row in file.rows.items() if key[0] in keys}
    console.print(f"digest {digest(rows)}")
