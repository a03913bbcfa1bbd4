"""``covey simulate --map``: flies the map of the law, or continues it, and prints its cells."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from onboard.config.fleet import ConfigError
from onboard.plain_text import drawing
from sitl.monte_carlo.executors import say
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
    """Fly the missing flights of the map, and print it; return whether no cell has failed.

    Args:
        path: the file of results.
        selection: restricted axes, as for :func:`cells`.
        least_flights: minimum number of flights in each cell; a failed cell gets no more.
        jobs: number of processes.
        scheduler: address of a Dask scheduler that is used instead of processes.
        is_anew: whether an existing file is put aside and a new map begun.

    Raises:
        ConfigError: the flights are impossible with these settings.
    """
    selected = cells(selection)
    stages = _stages(least_flights, selected[0])

    with ResultsFile(path, unit_flights.version(), is_anew=is_anew) as file:
        try:
            run.run(selected, file, stages=stages, jobs=jobs, scheduler=scheduler)
        except KeyboardInterrupt:
            say(
                f"interrupted; {path} keeps what was flown, and the same command goes on from there"
            )
            raise
        _print(selected, file)
        return not any(run.has_failed(cell, file) for cell in selected)


def _stages(least_flights: int, cell: Cell) -> int:
    """Return how many of the first stages are needed for a number of flights in a cell.

    Args:
        least_flights: that number.
        cell: any cell; all of them have the same stages.

    Raises:
        ConfigError: the number is below 1, or all stages together have fewer flights.
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
    cell_column, verdict_column, *number_columns = map_summary.COLUMNS
    table.add_column(cell_column)
    table.add_column(verdict_column)
    for column in number_columns:
        table.add_column(column, justify="right")
    for cell in selected:
        table.add_row(*map_summary.table_row(cell, file.rows))

    width = 140
    if sys.stdout.isatty():
        width = shutil.get_terminal_size().columns
    console = Console(file=drawing(sys.stdout), width=width)
    console.print(table)

    keys = {cell.key for cell in selected}
    rows = {
        (cell_key, stage): row for (cell_key, stage), row in file.rows.items() if cell_key in keys
    }
    console.print(f"digest {digest(rows)}")
