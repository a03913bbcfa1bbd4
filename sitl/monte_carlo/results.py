"""Flights as JSON lines, as a summary table, and as trace files."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sitl.monte_carlo.flight import Flown
from sitl.monte_carlo.settings import Setup

Record = dict[str, Any]


def record(flown: Flown, setup: Setup) -> Record:
    """One flight as the JSON object that is printed; null where there is no number."""
    outcome, plan = flown.outcome, flown.plan
    refused = {"law_refused": flown.law_refusal} if flown.law_refusal else {}
    return {
        "scenario": plan.scenario,
        "seed": plan.seed,
        "law": setup.law,
        "errors": setup.errors.name,
        "type": ",".join(setup.types),
        "scale": setup.scale,
        "vehicles": plan.count,
        "success": outcome.is_success,
        "reason": outcome.reason,
        "min_separation_m": _number(outcome.min_separation_m),
        "violation_s": _number(outcome.violation_s),
        "violation_depth_m": _number(outcome.violation_depth_m),
        "collision": outcome.is_collision,
        "makespan_s": _number(outcome.makespan_s),
        "straight_line_s": _number(flown.straight_line_s),
        "ratio": _number(ratio(flown)),
        "duration_s": _number(outcome.duration_s),
        "relaxed_share": _number(outcome.relaxed_share),
        "slew_rms_m_s3": _number(outcome.slew_rms_m_s3),
        "max_speed_m_s": _number(outcome.max_speed_m_s),
        "intervention_m_s2": _number(outcome.intervention_m_s2),
        "path_ratio": _number(outcome.path_ratio),
        "min_clearance_m": _number(outcome.min_clearance_m),
        **refused,
    }


def ratio(flown: Flown) -> float:
    """Makespan over straight-line time; NaN when there is none."""
    value = (
        flown.outcome.makespan_s / flown.straight_line_s
        if flown.straight_line_s > 0.0
        else math.nan
    )
    return value if math.isfinite(value) else math.nan


def _number(value: float) -> float | None:
    return round(value, 9) + 0.0 if math.isfinite(value) else None


def line(values: Record) -> str:
    """A record as one line of JSON."""
    return json.dumps(values)


def is_flawless(values: Record) -> bool:
    """Whether all arrived in time and nobody came too near."""
    return bool(values["success"]) and values["violation_s"] == 0.0


def write_trace(folder: Path, flown: Flown, setup: Setup) -> Path:
    """The flight's samples as ``<scenario>-<seed>.npz``; arrays as in the README of this folder."""
    trace, plan = flown.outcome.trace, flown.plan
    if trace is None:
        raise ValueError("this flight was flown without a trace")
    fleet = setup.fleet(plan.count)
    path = folder / f"{plan.scenario}-{plan.seed}.npz"
    names = [*fleet.vehicles]
    if plan.intruder_m_s is not None:
        names[-1] = "intruder"
    np.savez_compressed(
        path,
        t_s=trace.t_s,
        position_enu_m=trace.position_enu_m,
        status=trace.status,
        active_neighbour=trace.active_neighbour,
        start_enu_m=plan.start_enu_m,
        goal_enu_m=plan.goal_enu_m,
        obstacles_m=np.array(
            [[*one.begin_enu_m, *one.end_enu_m, one.radius_m] for one in plan.obstacles]
        ),
        names=np.array(names),
        safety_distance_m=np.array(fleet.fleet.safety_distance_m),
        body_diameter_m=np.array(fleet.fleet.body_diameter_m),
        scenario=np.array(plan.scenario),
        seed=np.array(plan.seed),
        law=np.array(setup.law),
        success=np.array(flown.outcome.is_success),
    )
    return path


COLUMNS = (
    *(
        "scenario",
        "flights",
        "success",
        "violations",
        "below 95 %",
        "collisions",
        "worst m",
        "5th pct m",
        "ratio",
    ),
    *("slew m/s^3", "max m/s", "relaxed %"),
)


def summary(records: Sequence[Record]) -> list[list[str]]:
    """Rows for :data:`COLUMNS`, one per scenario and one for all if there are several."""
    names = list(dict.fromkeys(values["scenario"] for values in records))
    rows = [
        _row(name, [values for values in records if values["scenario"] == name]) for name in names
    ]
    return rows if len(rows) < 2 else [*rows, _row("all", records)]


def _row(name: str, records: Sequence[Record]) -> list[str]:
    count = len(records)
    violations = sum(values["violation_s"] > 0.0 for values in records)
    separations = [
        values["min_separation_m"] for values in records if values["min_separation_m"] is not None
    ]
    ratios = [values["ratio"] for values in records if values["ratio"] is not None]
    return [
        name,
        str(count),
        str(sum(bool(values["success"]) for values in records)),
        str(violations),
        f"{100.0 * upper_bound(violations, count):.1f} %",
        str(sum(bool(values["collision"]) for values in records)),
        f"{min(separations):.3f}" if separations else "-",
        f"{np.percentile(separations, 5):.3f}" if separations else "-",
        f"{np.mean(ratios):.3f}" if ratios else "-",
        f"{_mean(records, 'slew_rms_m_s3'):.1f}",
        f"{max(values['max_speed_m_s'] for values in records):.2f}",
        f"{100.0 * _mean(records, 'relaxed_share'):.2f}",
    ]


def _mean(records: Sequence[Record], key: str) -> float:
    return float(np.mean([values[key] for values in records]))


def upper_bound(events: int, count: int) -> float:
    """The share that the true rate of events stays below with 95 % confidence (Clopper-Pearson,
    one-sided).

    For no event it is 1 - 0.05^(1/n), nearly 3/n.
    """
    if events >= count:
        return 1.0
    low, high = events / count, 1.0
    for _ in range(60):
        rate = 0.5 * (low + high)
        term, chance = (1.0 - rate) ** count, 0.0
        for k in range(events + 1):
            chance += term
            term *= (count - k) / (k + 1) * rate / max(1.0 - rate, 1e-300)
        low, high = (rate, high) if chance > 0.05 else (low, rate)
    return high
