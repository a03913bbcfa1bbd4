"""``make bench-law``: Covey's law beside other methods, and beside itself without each of its
ideas.

Everybody flies the same seeded scenarios through the same pipeline and vehicles
(``contestants.py``). Three jobs: the comparison, ``--ablation``, and ``--tune``, which tries every
method's own grid and says which values are best.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import re
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from onboard.config.fleet import ConfigError
from sitl.monte_carlo import campaign_settings
from sitl.monte_carlo.campaign_settings import SimulatedErrors
from sitl.monte_carlo.law_map.cells import Cell as MapCell
from sitl.monte_carlo.law_map.cells import changes
from sitl.monte_carlo.law_map.results_file import ResultsFile, ResultsKind
from sitl.monte_carlo.law_map.unit_flights import version
from tests.bench.peers import arena, explain, pages, pictures
from tests.bench.peers.ablation import VARIANTS
from tests.bench.peers.contestants import (
    PEERS,
    RING_GRID,
    Contestant,
    combinations,
    named,
    peer,
    ring,
)
from tests.bench.peers.methods import METHODS
from tests.bench.peers.report import Outcome, Summary, summary, table

SEEDS = (1000, 1050)
ABLATION_SEEDS = (1000, 1020)
TUNING_SEEDS = (0, 4)
QUICK_SEEDS = (0, 2)
DELAY_SEEDS = (1000, 1010)
QUICK = ("form3", "swap4")
_PART = 10  # flights of a cell that is kept by itself
# a mixed fleet shows what an idea is worth; the others fly type sih
TYPES = {"ablation": "sih,ardrone"}
COMPARISON = ("form3", "swap4x", "swap8x", "rand4")
ABLATION = ("swap8x",)
TUNING = ("form3", "swap8x", "rand8")


@dataclass(frozen=True, slots=True)
class Cell:
    """One contestant, by group and key so that a worker can look it up, in one scenario."""

    group: str
    key: str
    values: tuple[tuple[str, float], ...]
    scenario: str
    seeds: tuple[int, int]
    errors: str
    delay_s: float = SimulatedErrors().delay_s  # age of a message when it arrives

    def contestant(self) -> Contestant:
        """Contestant of this cell."""
        if self.group == "tune":
            values = dict(self.values)
            return ring(values) if self.key == "ring" else peer(METHODS[self.key], values)
        return VARIANTS[self.key] if self.group == "ablation" else named(self.key)


def fly(cell: Cell) -> tuple[Cell, arena.Flights]:
    """All flights of a cell, in this process."""
    contestant = cell.contestant()
    sets = (
        (*contestant.sets, *_late(cell))
        if cell.delay_s != SimulatedErrors().delay_s
        else contestant.sets
    )
    late = replace(contestant, sets=sets)
    return cell, arena.fly(
        late, cell.scenario, range(*cell.seeds), errors=cell.errors, types=TYPES.get(cell.group)
    )


def _late(cell: Cell) -> tuple[str, ...]:
    """Return what a fleet with such messages sets: the delay, and margin and range as ``covey
    check`` demands them.
    """
    place = MapCell(
        errors=cell.errors,
        vehicles=arena.size(cell.scenario),
        speed_m_s=1.0,
        delay_ms=round(1e3 * cell.delay_s, 6),
        loss_pct=0.0,
    )
    return f"delay_s={cell.delay_s}", *(
        change for change in changes(place) if change.startswith("law.")
    )


_KEPT = ResultsKind(
    head="law_bench",
    command="make bench-law",
    option="--keep",
    numbers=(),
    others=("outcomes", "cost"),
)


def fly_all(
    cells: Sequence[Cell], jobs: int, keep: Path | None = None
) -> list[tuple[Cell, arena.Flights]]:
    """The cells in their order, the big ones first, on ``jobs`` processes or in this one, with a
    line of progress.

    With a file to ``keep`` them in, each is written there when it has been flown, and those that it
    has are not flown again. It is of one version of the law, the methods and the processor.
    """
    if keep is None:
        found = dict(_flown(cells, jobs))
        return [(cell, found[cell]) for cell in cells]
    law = campaign_settings.setup_for(law="tests.bench.peers.laws:orca").fleet(2).own_law
    methods = "" if law is None else law.source_hash  # of all files of this folder
    with ResultsFile(keep, f"bench {version()} {methods}", kind=_KEPT) as file:
        missing = [cell for cell in cells if (repr(cell), 0) not in file.rows]
        for cell, flown in _flown(missing, jobs):
            outcomes = [asdict(outcome) for outcome in flown.outcomes]
            file.add(
                {
                    "cell": repr(cell),
                    "stage": 0,
                    "outcomes": outcomes,
                    "cost": [flown.busy_s, flown.calls],
                }
            )
        rows = [file.rows[repr(cell), 0] for cell in cells]
    kept = [
        arena.Flights(tuple(Outcome(**one) for one in row["outcomes"]), *row["cost"])
        for row in rows
    ]
    return list(zip(cells, kept, strict=True))


def _flown(cells: Sequence[Cell], jobs: int) -> Iterator[tuple[Cell, arena.Flights]]:
    order = [
        cells[k] for k in sorted(range(len(cells)), key=lambda k: -arena.size(cells[k].scenario))
    ]
    if jobs == 1:
        yield from _counted(map(fly, order), len(cells))
        return
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        yield from _counted(pool.imap_unordered(fly, order), len(cells))


def _counted(
    results: Iterable[tuple[Cell, arena.Flights]], count: int
) -> Iterator[tuple[Cell, arena.Flights]]:
    begun = time.monotonic()
    for done, result in enumerate(results, 1):
        print(
            f"\r{done}/{count} cells, {time.monotonic() - begun:.0f} s",
            end="",
            file=sys.stderr,
            flush=True,
        )
        yield result
    print(file=sys.stderr)


def gathered(
    results: Sequence[tuple[Cell, arena.Flights]],
) -> dict[tuple[str, str], tuple[list[Outcome], Summary]]:
    """Outcomes and summary of each contestant, over all its scenarios; the key is its key and its
    values.
    """
    rows: dict[tuple[str, str], list[arena.Flights]] = {}
    for cell, flights in results:
        rows.setdefault(
            (cell.key, ", ".join(f"{name} {value:g}" for name, value in cell.values)), []
        ).append(flights)
    out = {}
    for key, parts in rows.items():
        outcomes = [outcome for part in parts for outcome in part.outcomes]
        cost = 1e6 * sum(part.busy_s for part in parts) / max(1, sum(part.calls for part in parts))
        out[key] = (outcomes, summary(outcomes, cost))
    return out


def compare(options: argparse.Namespace, group: str, contestants: Mapping[str, Contestant]) -> int:
    """The comparison or the ablation: table, figures, page."""
    scenarios: Sequence[str] = COMPARISON
    seeds = SEEDS
    if options.quick:
        scenarios = QUICK
        seeds = QUICK_SEEDS
    elif group == "ablation":
        scenarios = ABLATION
        seeds = ABLATION_SEEDS
    if options.mix:
        scenarios = arena.MIX
    if options.seeds:
        seeds = options.seeds

    cells = [
        Cell(group=group, key=key, values=(), scenario=scenario, seeds=part, errors=options.errors)
        for key in contestants
        for scenario in scenarios
        for part in _parts(seeds)
    ]
    rows = gathered(fly_all(cells, options.jobs, options.keep))
    outcomes = {contestants[key].title: flights for (key, _), (flights, _) in rows.items()}
    summaries = {contestants[key].title: figures for (key, _), (_, figures) in rows.items()}
    print(table(summaries, "law" if group == "ablation" else "method"))

    if options.out is None:
        return 0
    folder = Path(options.out)
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    run = pages.Run(_command(options), seeds, scenarios, options.errors)
    if group == "ablation":
        pictures.comparison(
            summaries, folder / "figures/law_ablation.png", "Covey's law without one of its ideas"
        )
        page = pages.ablation(run, summaries, contestants)
        section = "ablation"
    else:
        pictures.comparison(
            summaries, folder / "figures/law_bench.png", "Same vehicle, errors, baseline and margin"
        )
        pictures.distances(
            outcomes, folder / "figures/law_flights.png", "Every flight: smallest distance and time"
        )
        figure_of = "swap2x" if options.quick else "swap8x"
        traces = {
            title: arena.trace(contestants[key], figure_of, 0)[1]
            for key, title in _titles(contestants).items()
        }
        pictures.paths(
            traces,
            folder / "figures/law_paths.png",
            f"{arena.size(figure_of)} vehicles change places across a circle",
        )
        page = pages.comparison(run, summaries, outcomes)
        section = "methods"
    pages.write_section(folder / pages.MEASURED, section, page)
    print(f"written: {folder / pages.MEASURED}, {section}")
    return 0


def by_delay(options: argparse.Namespace, contestants: Mapping[str, Contestant]) -> int:
    """Every method at every delay of the messages: table and page."""
    scenarios = QUICK if options.quick else COMPARISON
    seeds = options.seeds or (QUICK_SEEDS if options.quick else DELAY_SEEDS)
    cells = [
        Cell(
            group="peers",
            key=key,
            values=(),
            scenario=scenario,
            seeds=part,
            errors=options.errors,
            delay_s=delay_s,
        )
        for delay_s in options.delays
        for key in contestants
        for scenario in scenarios
        for part in _parts(seeds)
    ]
    results = fly_all(cells, options.jobs, options.keep)
    rows: dict[str, list[Summary]] = {}
    for delay_s in options.delays:
        for (key, _), (_, figures) in gathered(
            [one for one in results if one[0].delay_s == delay_s]
        ).items():
            rows.setdefault(contestants[key].title, []).append(figures)
    run = pages.Run(_command(options), seeds, scenarios, options.errors)
    page = pages.by_delay(run, options.delays, rows)
    print(page)
    if options.out is not None:
        folder = Path(options.out)
        (folder / "figures").mkdir(parents=True, exist_ok=True)
        pictures.by_delay(
            options.delays, rows, folder / "figures/law_delay.png", "Messages that come late"
        )
        pages.write_section(folder / pages.MEASURED, "delay", page)
    return 0


def _parts(seeds: tuple[int, int]) -> list[tuple[int, int]]:
    """Return the seeds in pieces that are flown and kept one by one."""
    return [(first, min(first + _PART, seeds[1])) for first in range(*seeds, _PART)]


def _titles(contestants: Mapping[str, Contestant]) -> dict[str, str]:
    return {key: contestant.title for key, contestant in contestants.items()}


def tune(options: argparse.Namespace) -> int:
    """All combinations of each method's grid; the best by violations, then success, then ratio."""
    scenarios = QUICK if options.quick else TUNING
    seeds = options.seeds or (QUICK_SEEDS if options.quick else TUNING_SEEDS)
    grids = {name: method.grid for name, method in METHODS.items()} | {"ring": RING_GRID}
    cells = [
        Cell(
            group="tune",
            key=name,
            values=tuple(values.items()),
            scenario=scenario,
            seeds=seeds,
            errors=options.errors,
        )
        for name, grid in grids.items()
        for values in combinations(grid)
        for scenario in scenarios
    ]
    rows = gathered(fly_all(cells, options.jobs))
    lines = {
        f"{PEERS[key].title}: {values}": figures for (key, values), (_, figures) in rows.items()
    }
    print(table(lines))
    best = {
        name: min(
            (figures.order, values) for (key, values), (_, figures) in rows.items() if key == name
        )[1]
        for name in grids
    }
    for name, values in best.items():
        print(f"best for {PEERS[name].title}: {values}")
    if options.out is not None:
        run = pages.Run(_command(options), seeds, scenarios, options.errors)
        best_titles = {PEERS[name].title: values for name, values in best.items()}
        page = pages.tuning(run, lines, best_titles)
        pages.write_section(Path(options.out) / pages.MEASURED, "tuning", page)
    return 0


def _command(options: argparse.Namespace) -> str:
    words = [f"--{name}" for name in ("ablation", "tune", "quick", "mix") if getattr(options, name)]
    words += [f"--seeds {options.seeds[0]}:{options.seeds[1]}"] if options.seeds else []
    words += [f"--law {name}" for name in options.law]
    words += (
        [f"--delays {','.join(f'{delay_s:g}' for delay_s in options.delays)}"]
        if options.delays
        else []
    )
    words += [f"--errors {options.errors}"] if options.errors != "mocap" else []
    words += ["--out docs"]
    return f'make bench-law ARGS="{" ".join(words)}"'


def _seeds(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+):(\d+)", text)
    if not match or int(match[1]) >= int(match[2]):
        raise ConfigError(
            f"--seeds is '{text}'; write it as FIRST:END, for instance 200:206, with END above "
            "FIRST."
        )
    return int(match[1]), int(match[2])


def _delays(text: str) -> list[float]:
    try:
        delays_s = [float(word) for word in text.split(",")]
    except ValueError:
        delays_s = []
    if not delays_s or not all(0.0 <= delay_s <= 2.0 for delay_s in delays_s):
        raise ConfigError(
            f"--delays is '{text}'; write seconds from 0 to 2 with commas, for instance "
            "0.02,0.1,0.3."
        )
    return list(dict.fromkeys(delays_s))


def main(argv: Sequence[str]) -> int:
    """Entry of ``make bench-law``; exit status 0 when everything has flown, whatever came out."""
    parser = argparse.ArgumentParser(
        prog="make bench-law",
        description="Covey's law beside other methods, or (--ablation) without each of its ideas.",
    )
    parser.add_argument(
        "--seeds", metavar="A:B", help="seeds of each scenario (1000:1050; with --delays 1000:1010)"
    )
    parser.add_argument(
        "--out", metavar="DIR", help="write the page and its figures here (docs is where ours are)"
    )
    parser.add_argument(
        "--errors", default="mocap", help="accuracy of the estimate (default mocap)"
    )
    parser.add_argument(
        "--ablation", action="store_true", help="Covey's law with one idea taken away at a time"
    )
    parser.add_argument(
        "--tune",
        action="store_true",
        help="every method's own values, each combination of its grid",
    )
    parser.add_argument(
        "--explain", action="store_true", help="only the pictures that explain the law"
    )
    parser.add_argument(
        "--quick", action="store_true", help="three small scenarios and two seeds: under a minute"
    )
    parser.add_argument(
        "--mix",
        action="store_true",
        help="the twelve scenarios of the campaigns, up to 32 vehicles",
    )
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count() or 1, help="processes (default: one per core)"
    )
    parser.add_argument(
        "--law", action="append", default=[], metavar="NAME", help="a law of your own beside them"
    )
    parser.add_argument(
        "--delays", metavar="S,S", help="every method with messages that are so old, instead"
    )
    parser.add_argument(
        "--keep", type=Path, metavar="FILE", help="keep each cell there, and go on from it"
    )
    options = parser.parse_args(argv)
    options.seeds = _seeds(options.seeds) if options.seeds else None
    if options.jobs < 1:
        raise ConfigError(f"--jobs is {options.jobs}; it must be 1 or more.")
    options.delays = _delays(options.delays) if options.delays else []
    if options.keep is not None and (options.tune or options.explain):
        raise ConfigError(
            "--keep is for flights beside other methods, with --delays or without, and for "
            "--ablation."
        )
    contestants = PEERS | {name: named(name) for name in options.law}
    if options.delays:
        return by_delay(options, contestants)
    if options.explain:
        folder = Path(options.out or "docs") / "figures"
        folder.mkdir(parents=True, exist_ok=True)
        print("\n".join(map(str, explain.draw(folder))))
        return 0
    if options.tune:
        return tune(options)
    if options.ablation:
        return compare(options, "ablation", VARIANTS)
    return compare(options, "peers", contestants)
