"""What came of the map: a cell's verdict, the table for people, and the summary that ``covey
check`` reads.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Literal

from onboard.estimation.accuracies import ACCURACIES
from onboard.feasibility.law_map import SCHEMA, MapCell, values_of
from onboard.feasibility.pair_checks import effective_margin_m
from sitl.monte_carlo.law_map.cells import AXES, ERRORS, STAGES, Cell, changes
from sitl.monte_carlo.law_map.flights import Row
from sitl.monte_carlo.results import upper_bound
from sitl.monte_carlo.settings import setup_for

Verdict = Literal["holds", "failed", "screened", "-"]
COLUMNS = (
    "cell",
    "verdict",
    "flights",
    "below 0.80 m",
    "95 %",
    "worst m",
    "arrived",
    "ratio",
    "speed m/s",
    "margin m",
)
Rows = Mapping[tuple[str, int], Row]


def map_cell(cell: Cell, rows: Rows) -> MapCell:
    """Return a cell with the sums of its stages; without flights if there are none."""
    flown = stages(cell, rows)
    fleet = setup_for(errors=cell.errors, changes=changes(cell)).fleet(cell.vehicles)
    return MapCell(
        cell.errors,
        cell.vehicles,
        cell.speed_m_s,
        round(1e-3 * cell.delay_ms, 6),
        round(1e-2 * cell.loss_pct, 6),
        round(effective_margin_m(fleet, ACCURACIES[cell.errors]), 4),
        sum(row["flights"] for row in flown),
        sum(row["below"] for row in flown),
        sum(row["arrived"] for row in flown),
        min((round(row["worst_m"], 3) for row in flown), default=0.0),
    )


def stages(cell: Cell, rows: Rows) -> list[Row]:
    """Return the rows of a cell, in the order of its stages."""
    return [rows[cell.key, stage] for stage in range(len(STAGES)) if (cell.key, stage) in rows]


def verdict(cell: MapCell) -> Verdict:
    """Return whether a cell holds, has failed, or was only screened."""
    if not cell.flights:
        return "-"
    return "failed" if cell.has_failed else "holds" if cell.is_promised else "screened"


def table_row(cell: Cell, rows: Rows) -> list[str]:
    """Return a cell as words for :data:`COLUMNS`."""
    flown, summed = stages(cell, rows), map_cell(cell, rows)
    if not flown:
        return [cell.key, "-", "0", *["-"] * (len(COLUMNS) - 3)]
    ratios = [(row["ratio"], row["flights"]) for row in flown if row["ratio"] is not None]
    ratio = sum(ratio * count for ratio, count in ratios) / max(
        sum(count for _, count in ratios), 1
    )
    return [
        cell.key,
        verdict(summed),
        str(summed.flights),
        str(summed.below),
        f"< {100.0 * upper_bound(summed.below, summed.flights):.2g} %",
        f"{summed.worst_m:.3f}",
        str(summed.arrived),
        f"{ratio:.2f}",
        f"{max(row['speed_m_s'] for row in flown):.2f}",
        f"{summed.margin_m:.2f}",
    ]


def toml_summary(cells: Iterable[Cell], rows: Rows, version: str) -> str:
    """Return the summary that is part of the software: cells without flights are left out."""
    fleets = {name: setup_for(errors=name).fleet(3) for name in ERRORS}
    some = next(iter(fleets.values()))
    lines = [
        "# The map of the law in short: covey check and preflight look fleets up in it. Written by",
        '# make bench-law-map ARGS="FILE --write", from the results of covey simulate --map; docs/law-map.md shows it.',
        f"schema = {SCHEMA}",
        f'version = "{version}"  # of the law: the digest of a few flights',
        f"# {', '.join(MapCell._fields)}",
        "cells = [",
        *(
            f"  {json.dumps(list(summed))},"
            for summed in (map_cell(cell, rows) for cell in cells)
            if summed.flights
        ),
        "]",
        "",
        "[flown]",
        f"safety_distance_m = {some.fleet.safety_distance_m}",
        f"lag_s = {max(vehicle.lag_s for vehicle in some.vehicles.values()):.3f}",
    ]
    for name, fleet in fleets.items():
        lines += [
            "",
            f"[law.{name}]",
            *(f"{key} = {json.dumps(value)}" for key, value in values_of(fleet).items()),
        ]
    return "\n".join(lines) + "\n"


def axis_words(name: str) -> str:
    """Return the values of an axis in words."""
    return ", ".join(f"{value:g}" for value in AXES[name])
