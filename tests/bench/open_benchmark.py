"""``make bench-open ARGS="FILE --write"``: the leaderboard of the open benchmark from kept results.

The flights come from ``covey simulate --suite open --law NAME --keep FILE``, once for each law.
Several files of the same version are added up, so that several machines can fly. ``--pictures``
draws the scenes.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.figures.style import SOFT, colour, new_figure, styled
from onboard.config.file_reading import RESULTS_FILE, read_text
from onboard.config.fleet import ConfigError
from sitl.monte_carlo import worlds
from sitl.monte_carlo.law_map.results_file import digest, parsed
from sitl.monte_carlo.open_benchmark import scene_plans, suite, suite_summary
from tests.bench.peers.pages import insert

DOCS = Path(__file__).parents[2] / "docs"
PAGE = "open-benchmark.md"
_HEADS = ("law", "scenes", *suite_summary.COLUMNS)

Rows = Sequence[suite.SuiteRow]


def main(words: Sequence[str]) -> int:
    """Entry of ``make bench-open``."""
    parser = argparse.ArgumentParser(prog="make bench-open", description=__doc__)
    parser.add_argument("files", type=Path, nargs="+", help="results that --suite open has kept")
    parser.add_argument("--write", action="store_true", help=f"write them into docs/{PAGE}")
    parser.add_argument("--pictures", action="store_true", help="draw the scenes anew")
    parser.add_argument("--out", type=Path, default=DOCS, help="folder of the page; docs")
    options = parser.parse_args(words)

    version, rows = _read(options.files)
    text = leaderboard(list(rows.values()), version, digest(rows))
    print(text)
    if options.write:
        insert(options.out / PAGE, "leaderboard", text)
    if options.pictures:
        draw_scenes(options.out / "figures" / "open_scenes.png")
    return 0


def _read(files: Sequence[Path]) -> tuple[str, dict[tuple[str, int], suite.SuiteRow]]:
    """Return the version and the rows of all files.

    Raises:
        ConfigError: a file is no file of the suite, or two are of different versions.
    """
    versions = []
    rows: dict[tuple[str, int], suite.SuiteRow] = {}
    for file in files:
        head, own_rows = parsed(read_text(file, RESULTS_FILE), file, suite.KIND)
        versions.append(head["version"])
        rows.update(own_rows)

    if len(set(versions)) > 1:
        raise ConfigError(
            f"the files are of different versions ({', '.join(versions)}), which are not added up. "
            "Fly them anew with one."
        )
    return versions[0], rows


def leaderboard(rows: Rows, version: str, results_digest: str) -> str:
    """Return both tables: a line for each law, and its flawless flights in each scene.

    A law whose source was edited between its flights has a line for each source.
    """
    sources = {(row["law"], suite.source_hash(row)) for row in rows}
    source_counts = Counter(law for law, _ in sources)
    named_rows = []
    for row in rows:
        name = _contestant(row, has_sources=source_counts[row["law"]] > 1)
        named_rows.append({**row, "contestant": name})
    rows = named_rows
    by_law = _by(rows, "contestant")
    scenes = sorted({row["scene"] for row in rows})
    order = sorted(by_law, key=lambda law: _rank(by_law[law], len(scenes)))

    lines = [f"| {' | '.join(_HEADS)} |", "|---" * len(_HEADS) + "|"]
    for law in order:
        count = len({row["scene"] for row in by_law[law]})
        lines.append(f"| {law} | {count} | {' | '.join(suite_summary.table_row(by_law[law]))} |")

    lines += ["", "Flawless flights by scene:", ""]
    lines += [f"| law | {' | '.join(scenes)} |", "|---" * (len(scenes) + 1) + "|"]
    for law in order:
        own = _by(by_law[law], "scene")
        cells = [_flawless(own.get(scene, ())) for scene in scenes]
        lines.append(f"| {law} | {' | '.join(cells)} |")

    lines += ["", f"Version of law and vehicles {version}; digest of the results {results_digest}."]
    return "\n".join(lines)


def _contestant(row: suite.SuiteRow, *, has_sources: bool) -> str:
    """Return the name of a line: the law, and its physics if that is another one.

    Args:
        row: a row of that law.
        has_sources: whether the law has flown with several sources, whose hash then is named.
    """
    name = f"`{row['law']}`"
    if has_sources:
        name += f" of source {suite.source_hash(row)}"
    physics = row.get("physics", worlds.DEFAULT)
    if physics != worlds.DEFAULT:
        name += f" on {physics}"
    return name


def _by(rows: Rows, key: str) -> dict[str, list[suite.SuiteRow]]:
    groups: dict[str, list[suite.SuiteRow]] = {}
    for row in rows:
        groups.setdefault(row[key], []).append(row)
    return groups


def _rank(rows: Rows, scenes: int) -> tuple[bool, float, float]:
    """Return the sorting key of a law: flawless flights, then too near ones.

    Laws that have not flown all scenes come last, because scenes differ in how hard they are.
    """
    flights = suite.flights_of(rows)
    flawless = sum(suite_summary.is_flawless(flight) for flight in flights)
    below = sum(flight["violation_s"] > 0.0 for flight in flights)
    is_partial = len({row["scene"] for row in rows}) < scenes
    return is_partial, -flawless / len(flights), below / len(flights)


def _flawless(rows: Rows) -> str:
    flights = suite.flights_of(rows)
    if not flights:
        return "-"
    flawless = sum(suite_summary.is_flawless(flight) for flight in flights)
    return f"{flawless}/{len(flights)}"


def draw_scenes(path: Path) -> None:
    """Draw starts, straight lines, obstacles and intruder of each scene, with the first seed."""
    scenes = suite.scenes()
    columns = 5
    count = -(-len(scenes) // columns)
    with styled():
        figure = new_figure(
            width_in=12.0, height_in=2.5 * count, title="The scenes of the open benchmark"
        )
        for index, scene in enumerate(scenes):
            axes = figure.add_subplot(count, columns, index + 1)
            axes.set_title(scene.name, fontsize=9)
            axes.set_aspect("equal")
            axes.set_xticks([])
            axes.set_yticks([])
            _draw_scene(axes, scene)
        figure.savefig(path, dpi=80)


def _draw_scene(axes: Any, scene: Any) -> None:
    plan = scene_plans.plan(scene, 1000)
    for obstacle in plan.obstacles:
        begin, end = np.array(obstacle.begin_enu_m), np.array(obstacle.end_enu_m)
        for share in np.linspace(0.0, 1.0, 25):
            middle = begin + share * (end - begin)
            axes.add_patch(_disc(middle, obstacle.radius_m, "#555555"))

    stops = np.concatenate([plan.start_enu_m[None], plan.goals_enu_m])  # (1 + G, N, 3)
    for vehicle in range(plan.count):
        x_m, y_m, _ = stops[:, vehicle].T
        is_blind = vehicle in plan.blind
        is_intruder = plan.intruder_m_s is not None and vehicle == plan.count - 1
        has_other_law = plan.other_law is not None and vehicle in plan.other_law.vehicles
        tint = SOFT if has_other_law else colour(0)
        if is_blind or is_intruder:
            tint = "#D55E00"
        axes.plot(x_m, y_m, color=tint, linewidth=0.7, alpha=0.6)
        axes.add_patch(_disc(plan.start_enu_m[vehicle, :2], 0.25, tint))
    axes.autoscale_view()


def _disc(middle: Any, radius_m: float, tint: str) -> Any:
    from matplotlib.patches import Circle

    return Circle((float(middle[0]), float(middle[1])), radius_m, color=tint, linewidth=0)
