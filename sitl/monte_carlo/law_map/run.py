"""Flies the units of the map: which of them are missing, and how far the map has come.

A stage of a cell is flown only if the one before it has not failed.
"""

from __future__ import annotations

import time
from collections.abc import Iterable

from sitl.monte_carlo.executors import Row, Say, fly_missing, say
from sitl.monte_carlo.law_map import unit_flights
from sitl.monte_carlo.law_map.cells import STAGES, Cell, Unit
from sitl.monte_carlo.law_map.results_file import ResultsFile

_SAY_EVERY_S = 5.0


def has_failed(cell: Cell, file: ResultsFile) -> bool:
    """Return whether vehicles have come too close to each other in any stage of a cell."""
    for stage in range(len(STAGES)):
        row = file.rows.get((cell.key, stage))
        if row is not None and row["below"]:  # number of flights below the safety distance
            return True
    return False


def missing(cells: Iterable[Cell], stages: int, file: ResultsFile) -> list[Unit]:
    """Return the units that are still to be flown, in the order in which they are flown.

    The screening of all cells comes first, then the further stages cell by cell. Nothing more is
    flown in a cell that has failed.
    """
    screenings = []
    further = []
    for cell in cells:
        if has_failed(cell, file):
            continue
        for stage in range(stages):
            if (cell.key, stage) in file.rows:
                continue
            if stage == 0:
                screenings.append(Unit(cell, stage))
            else:
                further.append(Unit(cell, stage))
    return screenings + further


def run(
    cells: list[Cell],
    file: ResultsFile,
    *,
    stages: int,
    jobs: int = 1,
    scheduler: str | None = None,
    tell: Say = say,
) -> None:
    """Fly the missing units of the map, and write the result of each when it is done.

    Args:
        cells: cells of the map.
        file: file of results.
        stages: number of stages to fly, from the first on.
        jobs: number of processes on this machine.
        scheduler: address of a Dask scheduler, whose workers fly instead of these processes.
        tell: called with each sentence of progress.

    Raises:
        ConfigError: the scheduler does not answer, or the package for it is missing.
    """
    progress = _MapProgress(cells, stages, file, tell)

    def keep(row: Row) -> None:
        file.add(row)
        progress.tell()

    fly_missing(
        lambda: missing(cells, stages, file),
        unit_flights.fly,
        keep,
        jobs=jobs,
        scheduler=scheduler,
        tell=tell,
    )
    progress.tell(is_last=True)


class _MapProgress:
    """Reports now and then how much of the map is flown, and how much time is left."""

    def __init__(self, cells: list[Cell], stages: int, file: ResultsFile, tell: Say) -> None:
        self._cells = cells
        self._stages = stages
        self._file = file
        self._tell = tell
        self._began_s = time.monotonic()
        self._last_said_s = self._began_s
        self._work_at_first = self._work_left()

    def _work_left(self) -> float:
        """Return the work (flights times weight) that is left if no further cell fails."""
        units = missing(self._cells, self._stages, self._file)
        return sum(unit.flights * unit.cell.weight for unit in units)

    def tell(self, *, is_last: bool = False) -> None:
        """Report the progress, unless the last report is less than some seconds old."""
        now_s = time.monotonic()
        if not is_last and now_s - self._last_said_s < _SAY_EVERY_S:
            return
        self._last_said_s = now_s

        rows = self._file.rows
        flown = sum(row["flights"] for row in rows.values())

        last_stage = self._stages - 1
        failed = 0
        held = 0  # cells that have been flown to the last stage, and did not fail in any
        for cell in self._cells:
            if has_failed(cell, self._file):
                failed += 1
            elif (cell.key, last_stage) in rows:
                held += 1

        work_left = self._work_left()
        work_done = self._work_at_first - work_left
        left_s = 0.0
        if work_done > 0.0:
            left_s = (now_s - self._began_s) * work_left / work_done

        sentence = (
            f"law map: {held + failed} of {len(self._cells)} cells done ({failed} failed), "
            f"{flown} flights"
        )
        if work_left:
            sentence += f", at most {left_s / 60.0:.0f} min left"
        self._tell(sentence)
