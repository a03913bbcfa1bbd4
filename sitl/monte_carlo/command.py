"""A campaign of ``covey simulate``: scenarios flown once per seed; a table or JSON, traces and
pictures.
"""

from __future__ import annotations

import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path

from onboard.config.fleet import ConfigError
from onboard.plain_text import drawing
from onboard.rollout import batch as rollout_batch
from sitl.monte_carlo import batch, results, scenarios, settings

_PICTURES = (".png", ".svg", ".pdf")


def run(
    names: list[str],
    seeds: range,
    setup: settings.Setup,
    *,
    jobs: int,
    is_json: bool,
    trace_folder: Path | None,
    picture: Path | None,
) -> list[results.Record]:
    """Fly every scenario with every seed, print the results, and draw what was asked for.

    Args:
        names: scenarios.
        jobs: processes.
        is_json: one JSON object per flight on standard output instead of a table.
        trace_folder: where one .npz per flight is kept; None for nowhere.
        picture: a file for the picture of one flight, or a folder; None for no picture.
    Raises:
        ConfigError: nothing was flown, for a reason in words.
    """
    for name in names:
        fleet = setup.fleet(scenarios.vehicle_count(name)).fleet
        if scenarios.is_stacked(name) and fleet.vertical_separation_m is None:
            raise ConfigError(
                f"'{name}' begins with vehicles above each other, and nothing says how far apart in height they have "
                "to be. Add --set fleet.vertical_separation_m=1.2, or name a fleet file that has it."
            )
    if picture is not None and picture.suffix and len(names) * len(seeds) > 1:
        raise ConfigError(
            f"--plot {picture}: one file takes one flight; name a folder for {len(names) * len(seeds)}."
        )
    if picture is not None and picture.suffix not in ("", *_PICTURES):
        raise ConfigError(
            f"--plot {picture}: this kind of picture is not drawn. Use {', '.join(_PICTURES)} or a folder."
        )
    with tempfile.TemporaryDirectory() as scratch:
        folder = trace_folder or (Path(scratch) if picture else None)
        if folder is not None:
            _make(folder)
        if picture is not None:
            _make(picture.parent if picture.suffix else picture)
        records = _fly(names, seeds, setup, folder, jobs=jobs, is_json=is_json)
        if picture is not None and folder is not None:
            _draw(folder, picture, records)
    return records


def _warm_up() -> None:
    """Have the law compiled before the first flight, and say so where that is not done in a moment."""
    sentence = "covey: compiling the law for this machine; it is kept, and takes about half a minute this time only"
    notice = threading.Timer(2.0, print, [sentence], {"file": sys.stderr})
    notice.start()
    rollout_batch.warm_up()
    notice.cancel()


def _fly(
    names: list[str],
    seeds: range,
    setup: settings.Setup,
    folder: Path | None,
    *,
    jobs: int,
    is_json: bool,
) -> list[results.Record]:
    _warm_up()
    chunks = batch.campaign(names, seeds, setup, jobs=jobs, trace_folder=folder)
    records: list[results.Record] = []
    if is_json:
        for chunk in chunks:
            records += chunk
            for values in chunk:
                print(results.line(values), flush=True)
        return records
    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table

    with Progress(console=Console(file=drawing(sys.stderr)), transient=True) as progress:
        task = progress.add_task("flights", total=len(names) * len(seeds))
        for chunk in chunks:
            records += chunk
            progress.advance(task, len(chunk))
    title = f"law {setup.law}, type {','.join(setup.types)}, errors {setup.errors.name}"
    table = Table(title=f"{title}, seeds {seeds[0]}:{seeds[-1] + 1}")
    for index, column in enumerate(results.COLUMNS):
        table.add_column(column, justify="left" if index == 0 else "right")
    for row in results.summary(records):
        table.add_row(*row)
    console = Console(file=drawing(sys.stdout), width=None if sys.stdout.isatty() else 140)
    console.print(table)
    refused = [values for values in records if "law_refused" in values]
    if refused:
        console.print(
            f"In {len(refused)} of {len(records)} flights Covey's law took over, so they say little of {setup.law}. "
            f"In {refused[0]['scenario']} seed {refused[0]['seed']} it {refused[0]['law_refused']}."
        )
    failed = [values for values in records if not results.is_flawless(values)]
    for values in failed[:10]:
        reason = (
            values["reason"]
            or f"{values['violation_depth_m']:.3f} m too near for {values['violation_s']:.2f} s"
        )
        console.print(f"{values['scenario']} seed {values['seed']}: {reason}")
    if len(failed) > 10:
        console.print(f"... and {len(failed) - 10} more")
    return records


def _draw(folder: Path, picture: Path, records: Sequence[results.Record]) -> None:
    from sitl.monte_carlo import plot

    is_file = bool(picture.suffix)
    for values in records:
        name = f"{values['scenario']}-{values['seed']}"
        path = picture if is_file else picture / f"{name}.png"
        plot.draw(folder / f"{name}.npz", path)


def _make(folder: Path) -> None:
    """Make a folder, and try it, before minutes of flying whose results could not be kept."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ConfigError(
            f"{folder}: nothing can be written there ({error.strerror}). Name another folder."
        ) from None
