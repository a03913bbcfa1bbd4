"""The results of the map: the verdict of each cell, a table for people, and a TOML summary.

The summary is part of the software: ``covey check`` and preflight look fleets up in it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Literal

from onboard.confidence_intervals import upper_bound
from onboard.estimation.accuracies import ACCURACIES
from onboard.feasibility.law_map import SCHEMA, MapCell, values_of
from onboard.feasibility.pair_checks import effective_margin_m
from sitl.monte_carlo.campaign_settings import setup_for
from sitl.monte_carlo.law_map.cells import AXES, ERRORS, STAGES, Cell, changes
from sitl.monte_carlo.law_map.unit_flights import MapRow

# "screened": flown without a failure, but too few flights for a promise; "-": not flown
CellVerdict = Literal["holds", "failed", "screened", "-"]
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
MapRows = Mapping[tuple[str, int], MapRow]  # (key of the cell, stage) -> row


def map_cell(cell: Cell, rows: MapRows) -> MapCell:
    """Return a cell with the sums of its stages; a cell without stages has 0 flights."""
    flown = stages(cell, rows)
    fleet = setup_for(errors=cell.errors, changes=changes(cell)).fleet(cell.vehicles)
    margin_m = effective_margin_m(fleet, ACCURACIES[cell.errors])

    return MapCell(
        errors=cell.errors,
        vehicles=cell.vehicles,
        speed_m_s=cell.speed_m_s,
        delay_s=round(1e-3 * cell.delay_ms, 6),
        loss_frac=round(1e-2 * cell.loss_pct, 6),
        margin_m=round(margin_m, 4),
        flights=sum(row["flights"] for row in flown),
        below=sum(row["below"] for row in flown),
        arrived=sum(row["arrived"] for row in flown),
        worst_m=min((round(row["worst_m"], 3) for row in flown), default=0.0),
    )


def stages(cell: Cell, rows: MapRows) -> list[MapRow]:
    """Return the rows of a cell, in the order of its stages."""
    return [rows[cell.key, stage] for stage in range(len(STAGES)) if (cell.key, stage) in rows]


def verdict(cell: MapCell) -> CellVerdict:
    """Return the verdict of a cell."""
    if not cell.flights:
        return "-"
    if cell.has_failed:
        return "failed"
    if cell.is_promised:
        return "holds"
    return "screened"


def table_row(cell: Cell, rows: MapRows) -> list[str]:
    """Return a cell as words for :data:`COLUMNS`."""
    flown = stages(cell, rows)
    if not flown:
        return [cell.key, "-", "0", *["-"] * (len(COLUMNS) - 3)]

    summed = map_cell(cell, rows)
    below_share = upper_bound(summed.below, summed.flights)
    fastest_m_s = max(row["speed_m_s"] for row in flown)
    return [
        cell.key,
        verdict(summed),
        str(summed.flights),
        str(summed.below),
        f"< {100.0 * below_share:.2g} %",
        f"{summed.worst_m:.3f}",
        str(summed.arrived),
        f"{_mean_ratio(flown):.2f}",
        f"{fastest_m_s:.2f}",
        f"{summed.margin_m:.2f}",
    ]


def _mean_ratio(flown: list[MapRow]) -> float:
    """Return the mean ratio of makespan to straight-line time over all flights; 0 without any.

    Each stage has the mean ratio of its flights, and is weighted by their number.
    """
    measured = [row for row in flown if row["ratio"] is not None]
    weighted: float = sum(row["ratio"] * row["flights"] for row in measured)
    flights: int = sum(row["flights"] for row in measured)
    return weighted / max(flights, 1)


def toml_summary(cells: Iterable[Cell], rows: MapRows, version: str) -> str:
    """Return the summary as TOML; cells without flights are left out."""
    # 3 stands for any number of vehicles, because nothing written here depends on it
    fleets = {name: setup_for(errors=name).fleet(3) for name in ERRORS}
    first_fleet = next(iter(fleets.values()))
    lag_s = max(vehicle.lag_s for vehicle in first_fleet.vehicles.values())

    lines = [
        "# The map of the law in short: covey check and preflight look fleets up in it. Written by",
        '# make bench-law-map ARGS="FILE --write", from the results of covey simulate --map; '
        "docs/law-map.md shows it.",
        f"schema = {SCHEMA}",
        f'version = "{version}"  # of the law: the digest of a few flights',
        f"# {', '.join(MapCell._fields)}",
        "cells = [",
    ]
    for cell in cells:
        summed = map_cell(cell, rows)
        if summed.flights:
            lines.append(f"  {json.dumps(list(summed))},")
    lines += [
        "]",
        "",
        "[flown]",
        f"safety_distance_m = {first_fleet.fleet.safety_distance_m}",
        f"lag_s = {lag_s:.3f}",
    ]

    for name, fleet in fleets.items():
        lines += ["", f"[law.{name}]"]
        for key, value in values_of(fleet).items():
            lines.append(f"{key} = {json.dumps(value)}")
    return "\n".join(lines) + "\n"


def axis_words(name: str) -> str:
    """Return the values of an axis in words."""
    return ", ".join(f"{value:g}" for value in AXES[name])
