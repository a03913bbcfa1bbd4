"""The results of the suite: a line for each scene or law, with exact intervals."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence

import numpy as np

from onboard.confidence_intervals import exact_interval
from sitl.monte_carlo.open_benchmark.suite import SuiteRow, flights_of
from sitl.monte_carlo.results import FlightRecord

COLUMNS = (
    "flights",
    "flawless",
    "below 0.80 m (95 %)",
    "collisions",
    "arrived",
    "worst m",
    "ratio",
    "slew m/s^3",
    "energy",
    "us a step",
)


def table_row(rows: Sequence[SuiteRow]) -> list[str]:
    """Return the texts of :data:`COLUMNS` for the flights of some rows, at least one.

    Each row holds several flights of a law in a scene, and the time that the law took in them.
    Flawless: all arrived, none came too close and nothing was touched. Ratio and energy are means
    over the flights in which all arrived.
    """
    flights = flights_of(rows)
    count = len(flights)
    below = sum(flight["violation_s"] > 0.0 for flight in flights)
    arrived = [flight for flight in flights if flight["success"]]
    flawless = sum(is_flawless(flight) for flight in flights)
    ratios = [flight["ratio"] for flight in arrived if flight["ratio"] is not None]
    energies = [
        flight["energy_hover_s"] / flight["straight_line_s"]
        for flight in arrived
        if flight["straight_line_s"]
    ]
    slew_m_s3 = math.sqrt(statistics.fmean(flight["slew_rms_m_s3"] ** 2 for flight in flights))

    busy_s = sum(row["busy_s"] for row in rows)
    calls = sum(row["calls"] for row in rows)
    cost = "-"
    if calls:
        cost = f"{1e6 * busy_s / calls:.0f}"

    return [
        str(count),
        f"{100.0 * flawless / count:.0f} %",
        share(below, count),
        str(sum(flight["collision"] for flight in flights)),
        f"{100.0 * len(arrived) / count:.0f} %",
        f"{min(flight['min_separation_m'] for flight in flights):.3f}",
        _mean(ratios),
        f"{slew_m_s3:.0f}",
        _mean(energies),
        cost,
    ]


def is_flawless(flight: FlightRecord) -> bool:
    """Return whether all arrived, none came too close, and nothing was touched."""
    is_clear = flight["violation_s"] == 0.0 and not flight["collision"]
    return bool(flight["success"]) and is_clear


def share(events: int, count: int) -> str:
    """Return a share with its exact interval, in per cent."""
    interval = exact_interval(events, count)
    return (
        f"{events} = {100.0 * events / count:.0f} % "
        f"({100.0 * interval.low:.0f} to {100.0 * interval.high:.0f})"
    )


def _mean(values: Sequence[float]) -> str:
    if not values:
        return "-"
    return f"{np.mean(values):.2f}"
