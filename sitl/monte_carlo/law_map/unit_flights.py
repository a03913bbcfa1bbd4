"""Flies one unit of the map, and computes the version of the law from some reference flights."""

from __future__ import annotations

import hashlib
import statistics
from typing import Any

from sitl.monte_carlo import batch_flight, campaign_settings, process_chunks, results, scenarios
from sitl.monte_carlo.law_map.cells import STAGES, Cell, Unit, setup

MapRow = dict[str, Any]  # one line of the file of results
SCHEMA = 1
# scenario and error class of each reference flight of a version
_REFERENCE = (("swap8x", "mocap"), ("rand8", "mocap"), ("swap3x", "vision"))
_REFERENCE_CHANGES = ("delay_s=0.1", "loss_share=0.3")


def fly(unit: Unit) -> MapRow:
    """Fly all flights of a unit; return the row that sums them up."""
    records = _records(unit)
    nearest = min(records, key=lambda values: values["min_separation_m"])

    mean_ratio = None
    ratios = [values["ratio"] for values in records if values["ratio"] is not None]
    if ratios:
        mean_ratio = round(statistics.fmean(ratios), 4)

    # the median of the flights' greatest speeds
    speed_m_s = statistics.median(values["max_speed_m_s"] for values in records)

    return {
        "cell": unit.cell.key,
        "stage": unit.stage,
        "flights": len(records),
        "below": sum(1 for values in records if values["violation_s"] > 0.0),
        "collisions": sum(1 for values in records if values["collision"]),
        "arrived": sum(1 for values in records if values["success"]),
        "worst_m": nearest["min_separation_m"],
        "worst_flight": f"{nearest['scenario']} {nearest['seed']}",
        "speed_m_s": round(speed_m_s, 3),
        "ratio": mean_ratio,
        "digest": _digest(records),
    }


def _records(unit: Unit) -> list[results.FlightRecord]:
    """Fly a unit's scenarios with the seeds of its stage, many flights at once."""
    setups = {name: setup(unit.cell, name) for name in unit.cell.scenarios}
    plans = []
    for name, scenario_setup in setups.items():
        for seed in STAGES[unit.stage]:
            plans.append(scenarios.plan(name, seed, scale=scenario_setup.scale))

    # the setups differ only in the scale, which the plans contain already
    any_setup = setups[plans[0].scenario]
    size = max(1, process_chunks.CHUNK_VEHICLES // unit.cell.vehicles)
    records = []
    for first in range(0, len(plans), size):
        for flown in batch_flight.fly(plans[first : first + size], any_setup):
            records.append(results.record(flown, setups[flown.plan.scenario]))
    return records


def version() -> str:
    """Return the version of law, vehicles and processor: the digest of some reference flights.

    A change of the code that changes no digit of these flights keeps the version. Results of
    different versions are never added up.
    """
    cell = Cell(errors="mocap", vehicles=8, speed_m_s=1.0, delay_ms=200.0, loss_pct=30.0)
    setups = [repr(setup(cell, name)) for name in cell.scenarios]
    records: list[results.FlightRecord] = [{"schema": SCHEMA, "setups": setups}]

    for name, errors in _REFERENCE:
        reference = campaign_settings.setup_for(errors=errors, changes=_REFERENCE_CHANGES)
        for chunk in process_chunks.campaign([name], [0, 1], reference):
            records += chunk
    return _digest(records)


def _digest(records: list[results.FlightRecord]) -> str:
    lines = [results.line(values) for values in records]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:12]
