"""A campaign of ``covey simulate``: each scenario is flown once with each seed.

The results are printed as a table or as JSON; traces and pictures are written on request.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterable, Sequence
from contextlib import redirect_stdout
from pathlib import Path

from groundstation.recording.output_file import refuse_other_file
from onboard.config.fleet import ConfigError, LawConfig
from onboard.plain_text import drawing
from onboard.rollout.first_compilation import compile_law
from sitl.monte_carlo import campaign_settings, flight_plans, process_chunks, results, worlds

_PICTURES = (".png", ".svg", ".pdf")
_TABLE_WIDTH = 135  # in a narrower terminal, the numbers are lines of text
_MAX_FAILURES = 10  # number of failed flights that are listed


def run(
    subjects: Sequence[flight_plans.Subject],
    seeds: range,
    setup: campaign_settings.Setup,
    *,
    jobs: int,
    is_json: bool,
    physics: str = worlds.DEFAULT,
    trace_folder: Path | None,
    picture: Path | None,
) -> list[results.FlightRecord]:
    """Fly every subject with every seed, print the results, and draw what was requested.

    Args:
        subjects: scenarios by name, or scenes.
        seeds: the seeds, each of which flies every subject.
        setup: the settings of all flights.
        jobs: number of processes.
        is_json: whether one JSON object per flight is printed instead of a table.
        physics: name of the physics, of :data:`sitl.monte_carlo.worlds.WORLDS`.
        trace_folder: folder for one .npz per flight; None keeps no traces.
        picture: a file for the picture of one flight, or a folder for many; None draws nothing.

    Raises:
        ConfigError: the settings do not allow the flights; nothing was flown.
    """
    worlds.world_of(physics)  # refuses an unknown name
    worlds.refuse_unused(physics, setup)
    for subject in subjects:
        _check_heights(subject, setup)
        # refuses a law that cannot be imported
        with redirect_stdout(sys.stderr):  # where an own law may print
            setup.fleet(flight_plans.vehicle_count(subject)).import_law()
    if picture is not None:
        _check_picture(picture, flights=len(subjects) * len(seeds))
    _refuse_other_files(subjects, seeds, trace_folder, picture)

    with tempfile.TemporaryDirectory() as scratch:
        folder = trace_folder
        if folder is None and picture is not None:
            folder = Path(scratch)  # a picture is drawn from a trace

        if folder is not None:
            _make(folder)
        if picture is not None and picture.suffix:
            _make(picture.parent)
        elif picture is not None:
            _make(picture)

        chunks = process_chunks.campaign(
            subjects, seeds, setup, jobs=jobs, physics=physics, trace_folder=folder
        )
        flights = len(subjects) * len(seeds)
        records = _fly(chunks, flights, seeds, setup, is_json=is_json)
        if picture is not None and folder is not None:
            _draw(folder, picture, records)
    return records


def _check_heights(subject: flight_plans.Subject, setup: campaign_settings.Setup) -> None:
    """Refuse a scenario with vehicles above each other if no vertical separation is set."""
    fleet = setup.fleet(flight_plans.vehicle_count(subject)).fleet
    if flight_plans.is_stacked(subject) and fleet.vertical_separation_m is None:
        raise ConfigError(
            f"'{subject}' begins with vehicles above each other, and nothing says how far apart in "
            "height they have to be. Add --set fleet.vertical_separation_m=1.2, or name a fleet "
            "file that has it."
        )


def _check_picture(picture: Path, *, flights: int) -> None:
    """Refuse one picture file for several flights, and unknown kinds of pictures."""
    if picture.suffix and flights > 1:
        raise ConfigError(
            f"--plot {picture}: one file takes one flight; name a folder for {flights}, or fly one "
            "seed, for instance --seeds 0:1."
        )
    if picture.suffix not in ("", *_PICTURES):
        raise ConfigError(
            f"--plot {picture}: this kind of picture is not drawn. Use {', '.join(_PICTURES)} "
            "or a folder."
        )


def _refuse_other_files(
    subjects: Sequence[flight_plans.Subject],
    seeds: range,
    trace_folder: Path | None,
    picture: Path | None,
) -> None:
    """Refuse to write traces and pictures over files that are none."""
    flights = [(flight_plans.name(subject), seed) for subject in subjects for seed in seeds]
    if trace_folder is not None:
        for scenario, seed in flights:
            path = results.trace_path(trace_folder, scenario, seed)
            refuse_other_file(path, results.is_trace, other="is no trace", option="--trace")

    if picture is not None:
        # Imported here, because without a picture no matplotlib is needed.
        from groundstation.figures.style import refuse_other_picture

        for scenario, seed in flights:
            refuse_other_picture(_picture_path(picture, scenario, seed), option="--plot")


def _picture_path(picture: Path, scenario: str, seed: int) -> Path:
    """Return the path of a flight's picture: the file ``picture``, or one in that folder."""
    if picture.suffix:
        return picture
    return picture / f"{scenario}-{seed}.png"


def _make(folder: Path) -> None:
    """Create a folder, and check before the flights that files can be written there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ConfigError(
            f"{folder}: nothing can be written there ({error.strerror}). Name another folder."
        ) from None


def _fly(
    chunks: Iterable[list[results.FlightRecord]],
    flights: int,
    seeds: range,
    setup: campaign_settings.Setup,
    *,
    is_json: bool,
) -> list[results.FlightRecord]:
    """Fly all flights and print them; return their records."""
    compile_law(has_own_law=LawConfig(name=setup.law).is_own)
    if is_json:
        return _print_lines(chunks)

    records = _collect(chunks, flights=flights)
    _print_table(records, seeds, setup)
    return records


def _print_lines(chunks: Iterable[list[results.FlightRecord]]) -> list[results.FlightRecord]:
    """Print each flight as JSON as soon as its chunk is ready; return all of them."""
    records = []
    for chunk in chunks:
        records += chunk
        for values in chunk:
            print(results.line(values), flush=True)
    return records


def _collect(
    chunks: Iterable[list[results.FlightRecord]], *, flights: int
) -> list[results.FlightRecord]:
    """Return the records of all flights; a bar on standard error shows the progress."""
    from rich.console import Console
    from rich.progress import Progress

    records = []
    with Progress(console=Console(file=drawing(sys.stderr)), transient=True) as progress:
        task = progress.add_task("flights", total=flights)
        for chunk in chunks:
            records += chunk
            progress.advance(task, len(chunk))
    return records


def _print_table(
    records: Sequence[results.FlightRecord], seeds: range, setup: campaign_settings.Setup
) -> None:
    """Print the summary of all flights, and which of them failed."""
    from rich.console import Console
    from rich.table import Table

    flown_by = f"law {setup.law}, type {','.join(setup.types)}, errors {setup.errors.name}"
    table = Table(title=f"{flown_by}, seeds {seeds[0]}:{seeds[-1] + 1}")
    scenario_column, *number_columns = results.COLUMNS
    table.add_column(scenario_column)
    for column in number_columns:
        table.add_column(column, justify="right")
    for row in results.summary(records):
        table.add_row(*row)

    width = None  # the terminal's
    if not sys.stdout.isatty():
        width = 140  # a file or a pipe has no width
    console = Console(file=drawing(sys.stdout), width=width)
    if console.width >= _TABLE_WIDTH:
        console.print(table)
    else:
        console.print(f"{table.title}:")
        for scenario, *numbers in results.summary(records):
            named = zip(number_columns, numbers, strict=True)
            console.print(f"{scenario}: {', '.join(' '.join(pair) for pair in named)}")

    refused = [values for values in records if "law_refused" in values]
    if refused:
        first = refused[0]
        console.print(
            f"In {len(refused)} of {len(records)} flights Covey's law took over, so they say "
            f"little of {setup.law}. "
            f"In {first['scenario']} seed {first['seed']} {first['law_refused']}."
        )

    failed = [values for values in records if not results.is_flawless(values)]
    for values in failed[:_MAX_FAILURES]:
        console.print(f"{values['scenario']} seed {values['seed']}: {_reason(values)}")
    if len(failed) > _MAX_FAILURES:
        console.print(f"... and {len(failed) - _MAX_FAILURES} more")


def _reason(values: results.FlightRecord) -> str:
    """Return why a flight was not flawless."""
    if values["reason"]:
        reason = str(values["reason"])
    elif values["violation_s"] > 0.0:
        depth_m = values["violation_depth_m"]
        reason = f"{depth_m:.3f} m too near for {values['violation_s']:.2f} s"
    elif values["collision"]:
        reason = "a body touched an obstacle or another body"
    else:
        reason = f"Covey's law took over: {values['law_refused']}"

    if "contact_m_s" in values:
        reason += f", touched with {values['contact_m_s']:.2f} m/s"
    return reason


def _draw(folder: Path, picture: Path, records: Sequence[results.FlightRecord]) -> None:
    """Draw each flight from its trace: into the file ``picture``, or into a folder of that name."""
    from sitl.monte_carlo import plot

    for values in records:
        scenario, seed = values["scenario"], values["seed"]
        trace = results.trace_path(folder, scenario, seed)
        plot.draw(trace, _picture_path(picture, scenario, seed))
