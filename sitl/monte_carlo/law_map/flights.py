"""Flies one unit of the map, and tells one version of the law from another by how it flies."""

from __future__ import annotations

import hashlib
import statistics
from typing import Any

from sitl.monte_carlo import batch, flight, results, scenarios, settings
from sitl.monte_carlo.law_map.cells import STAGES, Cell, Unit, setup

Row = dict[str, Any]  # one line of the file of results
SCHEMA = 1
_REFERENCE = (("swap8x", "mocap"), ("rand8", "mocap"), ("swap3x", "vision"))
_REFERENCE_CHANGES = ("delay_s=0.1", "loss_share=0.3")


def fly(unit: Unit) -> Row:
    """Fly all flights of a unit; the line that is kept of them."""
    setups = {name: setup(unit.cell, name) for name in unit.cell.scenarios}
    plans = [
        scenarios.plan(name, seed, scale=own.scale)
        for name, own in setups.items()
        for seed in STAGES[unit.stage]
    ]
    size = max(1, batch.CHUNK_VEHICLES // unit.cell.vehicles)
    flown = [
        outcome
        for first in range(0, len(plans), size)
        # alike but for the scale
        for outcome in flight.fly(plans[first : first + size], setups[plans[0].scenario])
    ]
    records = [results.record(one, setups[one.plan.scenario]) for one in flown]
    nearest = min(records, key=lambda values: values["min_separation_m"])
    return {
        "cell": unit.cell.key,
        "stage": unit.stage,
        "flights": len(records),
        "below": sum(values["violation_s"] > 0.0 for values in records),
        "collisions": sum(values["collision"] for values in records),
        "arrived": sum(values["success"] for values in records),
        "worst_m": nearest["min_separation_m"],
        "worst_flight": f"{nearest['scenario']} {nearest['seed']}",
        # reached on the way: of the fastest vehicle, in the middle flight
        "speed_m_s": round(statistics.median(values["max_speed_m_s"] for values in records), 3),
        "ratio": round(
            statistics.fmean(values["ratio"] for values in records if values["ratio"] is not None),
            4,
        )
        if any(values["ratio"] is not None for values in records)
        else None,
        "digest": _digest(records),
    }


def version() -> str:
    """Return a name of the law, the vehicles and the processor that fly here: the digest of a few
    flights.

    A change that alters no digit is no other version. Numbers of two versions are never added up.
    """
    records = [
        values
        for name, errors in _REFERENCE
        for chunk in batch.campaign(
            [name], [0, 1], settings.setup_for(errors=errors, changes=_REFERENCE_CHANGES)
        )
        for values in chunk
    ]
    cell = Cell("mocap", 8, 1.0, 200.0, 30.0)
    return _digest(
        [
            {"schema": SCHEMA, "setups": [repr(setup(cell, name)) for name in cell.scenarios]},
            *records,
        ]
    )


def _digest(records: list[results.FlightRecord]) -> str:
    return hashlib.sha256(
        "\n".join(results.line(values) for values in records).encode()
    ).hexdigest()[:12]
