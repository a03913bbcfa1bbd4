"""``make bench-law``: Covey's law beside other methods, and beside itself without each of its ideas.

Everybody flies the same seeded scenarios through the same pipeline and vehicles (``contestants.py``). Three jobs: the
comparison, ``--ablation``, and ``--tune``, which tries every method's own grid and says which values are best.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import re
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from onboard.config.fleet import ConfigError
from tests.bench.peers import arena, explain, pages, pictures
from tests.bench.peers.ablation import VARIANTS
from tests.bench.peers.contestants import PEERS, RING_GRID, Contestant, combinations, peer, ring
from tests.bench.peers.methods import METHODS
from tests.bench.peers.report import Outcome, Summary, summary, table

SEEDS, ABLATION_SEEDS, TUNING_SEEDS, QUICK_SEEDS = (200, 206), (200, 208), (0, 4), (0, 2)
QUICK = ("form3", "swap4")
TYPES = {"ablation": "sih,ardrone"}  # a mixed fleet shows what an idea is worth; the others fly type sih
COMPARISON = ("form3", "swap8x", "swap16", "rand16")
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

    def contestant(self) -> Contestant:
        """Contestant of this cell."""
        if self.group == "tune":
            values = dict(self.values)
            return ring(values) if self.key == "ring" else peer(METHODS[self.key], values)
        return (VARIANTS if self.group == "ablation" else PEERS)[self.key]


def fly(cell: Cell) -> tuple[Cell, arena.Flights]:
    """All flights of a cell, in this process."""
    return cell, arena.fly(
        cell.contestant(), cell.scenario, range(*cell.seeds), errors=cell.errors, types=TYPES.get(cell.group)
    )


def fly_all(cells: Sequence[Cell], jobs: int) -> list[tuple[Cell, arena.Flights]]:
    """The cells in their order, the big ones first, on ``jobs`` processes or in this one, with a line of progress."""
    order = [cells[k] for k in sorted(range(len(cells)), key=lambda k: -arena.size(cells[k].scenario))]
    if jobs == 1:
        found = dict(_counted(map(fly, order), len(cells)))
    else:
        with multiprocessing.get_context("spawn").Pool(jobs) as pool:
            found = dict(_counted(pool.imap_unordered(fly, order), len(cells)))
    return [(cell, found[cell]) for cell in cells]


def _counted(results: Iterable[tuple[Cell, arena.Flights]], count: int) -> Iterator[tuple[Cell, arena.Flights]]:
    begun = time.monotonic()
    for done, result in enumerate(results, 1):
        print(f"\r{done}/{count} cells, {time.monotonic() - begun:.0f} s", end="", file=sys.stderr, flush=True)
        yield result
    print(file=sys.stderr)


def gathered(results: Sequence[tuple[Cell, arena.Flights]]) -> dict[tuple[str, str], tuple[list[Outcome], Summary]]:
    """Outcomes and summary of each contestant, over all its scenarios; the key is its key and its values."""
    rows: dict[tuple[str, str], list[arena.Flights]] = {}
    for cell, flights in results:
        rows.setdefault((cell.key, ", ".join(f"{name} {value:g}" for name, value in cell.values)), []).append(flights)
    out = {}
    for key, parts in rows.items():
        outcomes = [outcome for part in parts for outcome in part.outcomes]
        cost = 1e6 * sum(part.busy_s for part in parts) / max(1, sum(part.calls for part in parts))
        out[key] = (outcomes, summary(outcomes, cost))
    return out


def compare(options: argparse.Namespace, group: str, contestants: Mapping[str, Contestant]) -> int:
    """The comparison or the ablation: table, figures, page."""
    scenarios: Sequence[str] = QUICK if options.quick else ABLATION if group == "ablation" else COMPARISON
    scenarios = arena.MIX if options.mix else scenarios
    usual = QUICK_SEEDS if options.quick else ABLATION_SEEDS if group == "ablation" else SEEDS
    seeds = options.seeds or usual
    cells = [Cell(group, key, (), scenario, seeds, options.errors) for key in contestants for scenario in scenarios]
    rows = gathered(fly_all(cells, options.jobs))
    outcomes = {contestants[key].title: flights for (key, _), (flights, _) in rows.items()}
    summaries = {contestants[key].title: figures for (key, _), (_, figures) in rows.items()}
    print(table(summaries, "law" if group == "ablation" else "method"))
    if options.out is None:
        return 0
    folder = Path(options.out)
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    run = pages.Run(_command(options), seeds, scenarios, options.errors)
    if group == "ablation":
        pictures.comparison(summaries, folder / "figures/law_ablation.png", "Covey's law without one of its ideas")
        page = pages.ablation(run, summaries, contestants)
        pages.insert(folder / "law.md", "ablation", f"{run.sentence()}\n\n{pages.worth(summaries, contestants)}")
        name = "law-ablation.md"
    else:
        pictures.comparison(summaries, folder / "figures/law_bench.png", "Same vehicle, errors, baseline and margin")
        pictures.distances(outcomes, folder / "figures/law_flights.png", "Every flight: smallest distance and time")
        figure_of = "swap2x" if options.quick else "swap8x"
        traces = {title: arena.trace(contestants[key], figure_of, 0)[1] for key, title in _titles(contestants).items()}
        pictures.paths(
            traces, folder / "figures/law_paths.png", f"{arena.size(figure_of)} vehicles change places across a circle"
        )
        page = pages.comparison(run, summaries, outcomes)
        pages.insert(folder / "law.md", "comparison", f"{run.sentence()}\n\n{table(summaries)}")
        name = "law-bench.md"
    (folder / name).write_text(page, encoding="utf-8")
    print(f"written: {folder / name}")
    return 0


def _titles(contestants: Mapping[str, Contestant]) -> dict[str, str]:
    return {key: contestant.title for key, contestant in contestants.items()}


def tune(options: argparse.Namespace) -> int:
    """Every combination of every method's grid; the best by violations, then success, then ratio."""
    scenarios = QUICK if options.quick else TUNING
    seeds = options.seeds or (QUICK_SEEDS if options.quick else TUNING_SEEDS)
    grids = {name: method.grid for name, method in METHODS.items() if method.grid} | {"ring": RING_GRID}
    cells = [
        Cell("tune", name, tuple(values.items()), scenario, seeds, options.errors)
        for name, grid in grids.items()
        for values in combinations(grid)
        for scenario in scenarios
    ]
    rows = gathered(fly_all(cells, options.jobs))
    lines = {f"{PEERS[key].title}: {values}": figures for (key, values), (_, figures) in rows.items()}
    print(table(lines))
    best = {
        name: min((figures.order, values) for (key, values), (_, figures) in rows.items() if key == name)[1]
        for name in grids
    }
    for name, values in best.items():
        print(f"best for {PEERS[name].title}: {values}")
    if options.out is not None:
        run = pages.Run(_command(options), seeds, scenarios, options.errors)
        best_titles = {PEERS[name].title: values for name, values in best.items()}
        (Path(options.out) / "law-tuning.md").write_text(pages.tuning(run, lines, best_titles), encoding="utf-8")
    return 0


def _command(options: argparse.Namespace) -> str:
    words = [f"--{name}" for name in ("ablation", "tune", "quick", "mix") if getattr(options, name)]
    words += [f"--seeds {options.seeds[0]}:{options.seeds[1]}"] if options.seeds else []
    words += [f"--errors {options.errors}"] if options.errors != "mocap" else []
    words += ["--out docs"]
    return f'make bench-law ARGS="{" ".join(words)}"'


def _seeds(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+):(\d+)", text)
    if not match or int(match[1]) >= int(match[2]):
        raise ConfigError(f"--seeds is '{text}'; write it as FIRST:END, for instance 200:206, with END above FIRST.")
    return int(match[1]), int(match[2])


def main(argv: Sequence[str]) -> int:
    """Entry of ``make bench-law``; exit status 0 when everything has flown, whatever came out."""
    parser = argparse.ArgumentParser(
        prog="make bench-law",
        description="Covey's law beside other methods, or (--ablation) without each of its ideas.",
    )
    parser.add_argument("--seeds", metavar="A:B", help="seeds of each scenario (default 200:206)")
    parser.add_argument("--out", metavar="DIR", help="write the page and its figures here (docs is where ours are)")
    parser.add_argument("--errors", default="mocap", help="accuracy of the estimate (default mocap)")
    parser.add_argument("--ablation", action="store_true", help="Covey's law with one idea taken away at a time")
    parser.add_argument("--tune", action="store_true", help="every method's own values, each combination of its grid")
    parser.add_argument("--explain", action="store_true", help="only the pictures that explain the law")
    parser.add_argument("--quick", action="store_true", help="three small scenarios and two seeds: under a minute")
    parser.add_argument("--mix", action="store_true", help="the twelve scenarios of the campaigns, up to 32 vehicles")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes (default: one per core)")
    options = parser.parse_args(argv)
    options.seeds = _seeds(options.seeds) if options.seeds else None
    if options.jobs < 1:
        raise ConfigError(f"--jobs is {options.jobs}; it must be 1 or more.")
    if options.explain:
        folder = Path(options.out or "docs") / "figures"
        folder.mkdir(parents=True, exist_ok=True)
        print("\n".join(map(str, explain.draw(folder))))
        return 0
    if options.tune:
        return tune(options)
    if options.ablation:
        return compare(options, "ablation", VARIANTS)
    return compare(options, "peers", PEERS)
