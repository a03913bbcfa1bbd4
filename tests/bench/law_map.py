"""``make bench-law-map ARGS="law-map.jsonl --out docs"``: the page, the picture and the summary of
a flown map.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from groundstation.figures.style import LIMIT, SOFT, new_figure, styled
from onboard.config.fleet import ConfigError
from sitl.monte_carlo.law_map import cells as law_map_cells
from sitl.monte_carlo.law_map import map_summary
from sitl.monte_carlo.law_map.cells import AXES, ERRORS, Cell
from sitl.monte_carlo.law_map.results_file import digest, parsed
from sitl.monte_carlo.law_map.unit_flights import MapRow

_SUMMARY = Path(__file__).parents[2] / "onboard" / "feasibility" / "law_map.toml"
_SHADES = {"holds": "#009E73", "failed": LIMIT, "screened": "#E69F00", "-": "#ffffff"}
_WORDS = {
    "holds": "holds: 504 flights, none below 0.80 m",
    "screened": "fewer flights, none below",
    "failed": "failed: some below",
    "-": "nothing flown",
}


def main(words: list[str]) -> int:
    """Write docs/law-map.md, its picture, and the summary that is part of the software."""
    parser = argparse.ArgumentParser(prog="make bench-law-map", description=__doc__)
    parser.add_argument("file", type=Path, help="results of covey simulate --map")
    parser.add_argument("--out", type=Path, required=True, help="folder of the page; docs")
    parser.add_argument(
        "--summary", type=Path, default=_SUMMARY, help="the summary that covey check reads"
    )
    options = parser.parse_args(words)
    try:
        head, rows = parsed(options.file.read_text(encoding="utf-8"), options.file)
    except OSError as error:
        raise ConfigError(f"{options.file}: cannot be read ({error.strerror}).") from None
    cells = law_map_cells.cells()
    figures = options.out / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    picture(cells, rows, figures / "law_map.png")
    (options.out / "law-map.md").write_text(page(cells, rows, head["version"]), encoding="utf-8")
    options.summary.write_text(
        map_summary.toml_summary(cells, rows, head["version"]), encoding="utf-8"
    )
    print(f"{options.out / 'law-map.md'}, {figures / 'law_map.png'}, {options.summary}")
    return 0


def page(cells: list[Cell], rows: dict[tuple[str, int], MapRow], version: str) -> str:
    """The page: how it was flown, what came of it, every cell."""
    verdicts = [map_summary.verdict(map_summary.map_cell(cell, rows)) for cell in cells]
    count = Counter[str](verdicts)
    some = next(
        cell
        for cell in cells
        if cell.delay_ms == 200 and cell.loss_pct == 30 and cell.vehicles == 8
    )
    table = [f"| {' | '.join(map_summary.COLUMNS)} |", "|---" * len(map_summary.COLUMNS) + "|"]
    table += [f"| {' | '.join(map_summary.table_row(cell, rows))} |" for cell in cells]
    return "\n".join(
        [
            "# The map: up to which delay, loss, speed and number the law holds",
            "",
            f"*{len(cells)} cells, each flown with the margin that `covey check` demands at its "
            "delay and loss: "
            f"{count['holds']} hold, {count['failed']} have failed, {count['screened']} have "
            "been screened only, "
            f"{count['-']} have not been flown.*",
            "",
            "![A square for each cell: delay to the right, loss upwards, a block for each number "
            "and speed]"
            "(figures/law_map.png)",
            "",
            _HOW.format(commands="\n".join(law_map_cells.commands(some))),
            "",
            "## Every cell",
            "",
            f"Law {version}, digest {digest(rows)}. 95 %: the share of flights below 0.80 m is "
            "under it, by Clopper "
            "and Pearson, one-sided. Worst: smallest distance between true centres. Arrived: "
            "flights in which all "
            "arrived in time. Ratio: time over straight-line time. Speed: the fastest vehicle's, "
            "in the middle flight. "
            "Margin: kept above 0.80 m.",
            "",
            *table,
            "",
        ]
    )


def picture(cells: Iterable[Cell], rows: dict[tuple[str, int], MapRow], path: Path) -> None:
    """A square for each cell, coloured by its verdict, with its smallest distance."""
    blocks = [(errors, count) for errors, counts in ERRORS.items() for count in counts]
    delays, losses, speeds = (AXES[axis] for axis in ("delay_ms", "loss_pct", "speed_m_s"))
    by_place = {(c.errors, c.vehicles, c.speed_m_s, c.delay_ms, c.loss_pct): c for c in cells}
    with styled():
        figure = new_figure(
            11.0, 8.0, "Where the law holds: smallest distance in metres, promised 0.80"
        )
        axes = figure.subplots(len(blocks), len(speeds), sharex=True, sharey=True)
        for line, (errors, count) in zip(axes, blocks, strict=True):
            for axis, speed in zip(line, speeds, strict=True):
                axis.set_title(f"{count} vehicles, {errors}, {speed:g} m/s", fontsize=9.5)
                for x, delay in enumerate(delays):
                    for y, loss in enumerate(losses):
                        cell = map_summary.map_cell(
                            by_place[errors, count, speed, delay, loss], rows
                        )
                        shade = _SHADES[map_summary.verdict(cell)]
                        axis.add_patch(_square(x, y, shade))
                        if cell.flights:
                            words = f"{cell.worst_m:.2f}" + (
                                f"\n{cell.below}/{cell.flights}" if cell.below else ""
                            )
                            ink = "black" if shade == _SHADES["screened"] else "white"
                            axis.text(
                                x, y, words, ha="center", va="center", fontsize=7.5, color=ink
                            )
                axis.set_xlim(-0.5, len(delays) - 0.5)
                axis.set_ylim(-0.5, len(losses) - 0.5)
                axis.set_xticks(range(len(delays)), [f"{delay:g}" for delay in delays])
                axis.set_yticks(range(len(losses)), [f"{loss:g}" for loss in losses])
                axis.grid(visible=False)
        axes[-1][1].set_xlabel("delay [ms]")
        figure.supylabel("lost [%]", fontsize=10)
        handles = [_square(0, 0, shade) for shade in _SHADES.values()]
        labels = [_WORDS[verdict] for verdict in _SHADES]
        figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=9)
        figure.savefig(path)


def _square(x: float, y: float, shade: str):
    from matplotlib.patches import Rectangle

    return Rectangle((x - 0.5, y - 0.5), 1.0, 1.0, facecolor=shade, edgecolor=SOFT, linewidth=0.5)


_HOW = """\
## How to read it

* A cell **holds** when 504 flights of it stayed above 0.80 m: with 95 % confidence fewer than 0.6 % come below. It
  has **failed** when one flight came below; it was flown no further. What was **screened** has too few flights for a
  promise.
* Flown are `swapNx`, `swapN` and `randN` (scenarios of `covey simulate`), seeds from 1000 on, vehicles of the type
  `sih` (lag 0.15 s). Lengths are scaled so that a vehicle alone flies at 90 % of its top speed or more for two
  seconds.
* Margin, range and largest tilt are those that `covey check` demands for the cell's delay, loss and speed. The fleet
  declares both (`[radio] expected_delay_s`, `expected_loss_frac`), so that a state that is late for that reason is
  believed and carried on: without that nobody is believed after 0.25 s, and at 300 ms eight vehicles came below 0.80
  m in 20 of 21 flights.
* `covey check` and preflight look a fleet up here: refused where a cell that is no harder has failed, a warning where
  no cell that is at least as hard holds with the fleet's margin and values of the law, with the nearest cell that
  does. On the ground preflight measures the delay and the loss, and says when they are worse than declared.

## Flown by

```
covey simulate --map --jobs 2                               # about an hour; interrupted, it goes on
make bench-law-map ARGS="law-map.jsonl --out docs"          # this page, its picture, and what covey check reads
# one cell alone, 8 vehicles, 200 ms, 30 %:
{commands}
```

`--scheduler ADDRESS` flies it on a Dask cluster (extra `cluster`, there and here). The digest is the
same on one kind of processor with one set of libraries, however often it was interrupted and wherever it was flown; a
file of another version of the law is refused. A piece that was lost with its process or its scheduler is flown again,
and none counts twice."""  # noqa: E501  lines of a page
