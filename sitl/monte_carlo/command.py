"""``covey simulate``: the law over many perturbed flights on the emulator's physics."""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path

from onboard.config.fleet import ConfigError
from onboard.rollout import batch as rollout_batch
from sitl.monte_carlo import batch, results, scenarios, settings

EXIT_OK, EXIT_FAILED, EXIT_WRONG_INPUT, EXIT_INTERRUPTED = 0, 1, 2, 130
_PICTURES = (".png", ".svg", ".pdf")
_DESCRIPTION = (
    "Fly a scenario once per seed: the very control of the drone on the emulator's vehicles, with errors of the "
    "estimate, late and lost messages, gusts and vehicles that differ from their type. Same seed, same digits."
)


def main(argv: Sequence[str] | None = None) -> int:
    """The command; 0 when all flights succeed without violation, 1 otherwise, 2 for wrong input."""
    options = _parser().parse_args(argv)
    try:
        return _run(options)
    except ConfigError as error:
        print(f"covey: {error}", file=sys.stderr)
        return EXIT_WRONG_INPUT
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="covey simulate",
        description=_DESCRIPTION,
        epilog=f"Keys of --set: {', '.join(settings.keys(with_aliases=True))}. "
        "Exit status: 0 all flights succeed without violation, 1 otherwise, 2 wrong input.",
    )
    parser.add_argument("scenario", nargs="+", help=f"{scenarios.KNOWN}")
    parser.add_argument("--seeds", metavar="A:B", default="0:10", help="half-open range, or one seed (default 0:10)")
    parser.add_argument("--law", metavar="NAME", help=f"{', '.join(settings.LAWS)} (default covey)")
    parser.add_argument("--errors", metavar="CLASS", default="mocap", help=f"{', '.join(settings.ERRORS)}")
    parser.add_argument("--type", metavar="NAME[,NAME]", help="vehicle types, given in turn (default sih)")
    parser.add_argument(
        "--fleet", metavar="FILE", help="take types, law and distances from this fleet file (no obstacles, no fence)"
    )
    parser.add_argument("--scale", type=float, default=1.0, help="multiplies every spacing (default 1)")
    parser.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], help="change one value; repeatable")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes (default 1)")
    parser.add_argument("--json", action="store_true", help="one JSON object per flight on standard output")
    parser.add_argument("--trace", metavar="DIR", help="write one .npz per flight")
    parser.add_argument("--plot", metavar="FILE_OR_DIR", help="a picture (PNG, SVG, PDF) of a flight, or of each")
    return parser


def _run(options: argparse.Namespace) -> int:
    names = scenarios.expand(options.scenario)
    seeds = _seeds(options.seeds)
    if options.jobs < 1:
        raise ConfigError(f"--jobs is {options.jobs}; it must be 1 or more.")
    setup = settings.choose(
        law=options.law,
        types=options.type,
        fleet_path=options.fleet,
        errors=options.errors,
        scale=options.scale,
        changes=options.set,
    )
    for name in names:
        setup.fleet(scenarios.vehicle_count(name))
    picture = Path(options.plot) if options.plot else None
    if picture is not None and picture.suffix and len(names) * len(seeds) > 1:
        raise ConfigError(f"--plot {picture}: one file takes one flight; name a folder for {len(names) * len(seeds)}.")
    if picture is not None and picture.suffix not in ("", *_PICTURES):
        raise ConfigError(
            f"--plot {picture}: this kind of picture is not drawn. Use {', '.join(_PICTURES)} or a folder."
        )
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(options.trace or scratch) if options.trace or picture else None
        if folder is not None:
            _make(folder)
        if picture is not None:
            _make(picture.parent if picture.suffix else picture)
        records = _fly(names, seeds, setup, options, folder)
        if picture is not None and folder is not None:
            _draw(folder, picture, records)
    return EXIT_OK if all(results.is_flawless(values) for values in records) else EXIT_FAILED


def _warm_up() -> None:
    """Have the law compiled before the first flight, and say so where that is not done in a moment."""
    sentence = "covey: compiling the law for this machine; it is kept, and takes some ten seconds this time only"
    notice = threading.Timer(2.0, print, [sentence], {"file": sys.stderr})
    notice.start()
    rollout_batch.warm_up()
    notice.cancel()


def _fly(
    names: list[str], seeds: range, setup: settings.Setup, options: argparse.Namespace, folder: Path | None
) -> list[results.Record]:
    _warm_up()
    chunks = batch.campaign(names, seeds, setup, jobs=options.jobs, trace_folder=folder)
    records: list[results.Record] = []
    if options.json:
        for chunk in chunks:
            records += chunk
            for values in chunk:
                print(results.line(values), flush=True)
        return records
    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table

    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("flights", total=len(names) * len(seeds))
        for chunk in chunks:
            records += chunk
            progress.advance(task, len(chunk))
    title = f"law {setup.law}, type {','.join(setup.types)}, errors {setup.errors.name}"
    table = Table(title=f"{title}, seeds {seeds[0]}:{seeds[-1] + 1}")
    for place, column in enumerate(results.COLUMNS):
        table.add_column(column, justify="left" if place == 0 else "right")
    for row in results.summary(records):
        table.add_row(*row)
    console = Console(width=None if sys.stdout.isatty() else 140)
    console.print(table)
    failed = [values for values in records if not results.is_flawless(values)]
    for values in failed[:10]:
        why = values["reason"] or f"{values['violation_depth_m']:.3f} m too near for {values['violation_s']:.2f} s"
        console.print(f"{values['scenario']} seed {values['seed']}: {why}")
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


def _seeds(text: str) -> range:
    match = re.fullmatch(r"(\d{1,9})(?::(\d{1,9}))?", text)
    if not match:
        raise ConfigError(f"--seeds is '{text}'; write it as A:B with 0 <= A < B, or as one number.")
    first = int(match[1])
    last = int(match[2]) if match[2] else first + 1
    if last <= first:
        raise ConfigError(f"--seeds is '{text}', which holds no seed; write it as A:B with A < B (B is not flown).")
    return range(first, last)


def _make(folder: Path) -> None:
    """Make a folder, and try it, before minutes of flying whose results could not be kept."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ConfigError(f"{folder}: nothing can be written there ({error.strerror}). Name another folder.") from None


if __name__ == "__main__":
    sys.exit(main())
