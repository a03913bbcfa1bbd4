"""``covey simulate --suite open``: judges a law over all scenes, or continues such a run."""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from onboard.plain_text import drawing
from sitl.monte_carlo import worlds
from sitl.monte_carlo.executors import fly_missing, say
from sitl.monte_carlo.law_map.results_file import ResultsFile
from sitl.monte_carlo.law_map.unit_flights import version
from sitl.monte_carlo.open_benchmark import suite, suite_summary

_SAY_EVERY_S = 10.0


def judge(
    law: str,
    seeds: range,
    *,
    physics: str = worlds.DEFAULT,
    jobs: int = 1,
    scheduler: str | None = None,
    keep: Path | None = None,
    is_anew: bool = False,
) -> bool:
    """Fly the missing flights of a law, and print them by scene; return whether all are flawless.

    Args:
        law: name of the law, as ``--law`` takes it.
        seeds: the seeds that fly each scene.
        physics: name of the physics, of :data:`sitl.monte_carlo.worlds.WORLDS`.
        jobs: number of processes.
        scheduler: address of a Dask scheduler that is used instead of processes.
        keep: file of results, from which the same command continues; None keeps none.
        is_anew: whether an existing file is put aside, so that the benchmark begins anew.

    Raises:
        ConfigError: the law cannot be imported, or the file cannot be continued.
    """
    work = suite.units(law, seeds, physics)
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "open-benchmark.jsonl"
        if keep is not None:
            path = keep
        with ResultsFile(path, version(), kind=suite.KIND, is_anew=is_anew) as file:
            try:
                _fly(work, file, jobs=jobs, scheduler=scheduler)
            except KeyboardInterrupt:
                if keep is not None:
                    say(f"interrupted; {keep} keeps what was flown, and the same command goes on")
                raise
            rows = [file.rows[unit.cell, 0] for unit in work]

    _print(f"open benchmark, law {law}, physics {physics}", seeds, rows)
    return all(suite_summary.is_flawless(flight) for flight in suite.flights_of(rows))


def _fly(
    work: Sequence[suite.Unit], file: ResultsFile, *, jobs: int, scheduler: str | None
) -> None:
    """Fly the units that the file lacks."""

    def missing() -> list[suite.Unit]:
        return [unit for unit in work if (unit.cell, 0) not in file.rows]

    begun_s = time.monotonic()
    last_said_s = begun_s
    missing_at_first = len(missing())

    def keep(row: suite.SuiteRow) -> None:
        nonlocal last_said_s
        file.add(row)

        now_s = time.monotonic()
        left = len(missing())
        if now_s - last_said_s < _SAY_EVERY_S and left:
            return
        last_said_s = now_s
        flown_now = missing_at_first - left  # at least the unit of this row
        left_min = (now_s - begun_s) * left / flown_now / 60.0
        say(
            f"open benchmark: {len(work) - left} of {len(work)} units flown, "
            f"about {left_min:.0f} min left"
        )

    fly_missing(missing, suite.fly, keep, jobs=jobs, scheduler=scheduler, has_own_law=True)


def _print(title: str, seeds: range, rows: Sequence[suite.SuiteRow]) -> None:
    """Print a line for each scene, and one for all."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{title}, seeds {seeds[0]}:{seeds[-1] + 1}")
    table.add_column("scene")
    for column in suite_summary.COLUMNS:
        table.add_column(column, justify="right")

    for scene in dict.fromkeys(row["scene"] for row in rows):
        own_rows = [row for row in rows if row["scene"] == scene]
        table.add_row(scene, *suite_summary.table_row(own_rows))
    table.add_row("all", *suite_summary.table_row(rows))

    width = 140
    if sys.stdout.isatty():
        width = shutil.get_terminal_size().columns
    console = Console(file=drawing(sys.stdout), width=width)
    console.print(table)

    reasons = [flight["reason"] for flight in suite.flights_of(rows) if flight["reason"]]
    refusals = [reason for reason in reasons if reason.startswith("law ")]
    if refusals:
        console.print(f"In {len(refusals)} flights the law was refused. The first: {refusals[0]}.")
