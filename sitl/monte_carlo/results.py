"""The outputs of a campaign: flights as JSON lines, as a summary table, and as trace files."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.recording.output_file import written_beside
from onboard.confidence_intervals import upper_bound
from sitl.monte_carlo.batch_flight import Flown
from sitl.monte_carlo.campaign_settings import Setup

FlightRecord = dict[str, Any]  # one flight, as it is printed
_ZIP_HEADER_BYTES = 30  # of a member of an .npz, before its name


def record(flown: Flown, setup: Setup) -> FlightRecord:
    """Return one flight as the JSON object that is printed; a missing number is null."""
    outcome = flown.outcome
    plan = flown.plan
    values = {
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
    }
    if math.isfinite(outcome.contact_m_s):
        values["contact_m_s"] = _number(outcome.contact_m_s)
    if flown.law_refusal:
        values["law_refused"] = flown.law_refusal
    return values


def ratio(flown: Flown) -> float:
    """Return the makespan over the straight-line time; NaN if one of them is missing."""
    if not 0.0 < flown.straight_line_s < math.inf:
        return math.nan
    value = flown.outcome.makespan_s / flown.straight_line_s
    if not math.isfinite(value):
        return math.nan
    return value


def _number(value: float) -> float | None:
    if not math.isfinite(value):
        return None
    return round(value, 9) + 0.0  # -0.0 becomes 0.0


def line(values: FlightRecord) -> str:
    """Return a record as one line of JSON."""
    return json.dumps(values)


def is_flawless(values: FlightRecord) -> bool:
    """Return whether all arrived by their own law, kept the distance, and touched nothing."""
    is_clear = values["violation_s"] == 0.0 and not values["collision"]
    return bool(values["success"]) and is_clear and "law_refused" not in values


def write_trace(folder: Path, flown: Flown, setup: Setup) -> Path:
    """Write the flight's samples as ``<scenario>-<seed>.npz``; return the path of the file."""
    trace = flown.outcome.trace
    plan = flown.plan
    if trace is None:
        raise ValueError("this flight was flown without a trace")

    fleet = setup.fleet(plan.count)
    names = [*fleet.vehicles]
    if plan.intruder_m_s is not None:
        names[-1] = "intruder"

    obstacles = []
    for obstacle in plan.obstacles:
        obstacles.append([*obstacle.begin_enu_m, *obstacle.end_enu_m, obstacle.radius_m])

    path = trace_path(folder, plan.scenario, plan.seed)
    with written_beside(path) as part, part.open("wb") as stream:
        np.savez_compressed(
            stream,
            t_s=trace.t_s,  # the first one: is_trace looks for it
            position_enu_m=trace.position_enu_m,
            status=trace.status,
            active_neighbour=trace.active_neighbour,
            start_enu_m=plan.start_enu_m,
            goal_enu_m=plan.goal_enu_m,
            obstacles_m=np.array(obstacles),
            names=np.array(names),
            safety_distance_m=np.array(fleet.fleet.safety_distance_m),
            body_diameter_m=np.array(fleet.fleet.body_diameter_m),
            scenario=np.array(plan.scenario),
            seed=np.array(plan.seed),
            law=np.array(setup.law),
            success=np.array(flown.outcome.is_success),
        )
    return path


def trace_path(folder: Path, scenario: str, seed: int) -> Path:
    """Return the path of a flight's trace."""
    return folder / f"{scenario}-{seed}.npz"


def is_trace(begin: bytes) -> bool:
    """Return whether a file that begins with these bytes is a trace."""
    return begin.startswith(b"PK") and begin[_ZIP_HEADER_BYTES:].startswith(b"t_s.npy")


COLUMNS = (
    "scenario",
    "flights",
    "arrived",
    "violations",
    "95 % bound",
    "collisions",
    "worst m",
    "5th pct m",
    "ratio",
    "slew m/s^3",
    "max m/s",
    "relaxed %",
)


def summary(records: Sequence[FlightRecord]) -> list[list[str]]:
    """Return rows for :data:`COLUMNS`: one per scenario, and one for all if there are several."""
    by_scenario: dict[str, list[FlightRecord]] = {}
    for values in records:
        by_scenario.setdefault(values["scenario"], []).append(values)

    rows = [_table_row(name, own_records) for name, own_records in by_scenario.items()]
    if len(rows) > 1:
        rows.append(_table_row("all", records))
    return rows


def _table_row(name: str, records: Sequence[FlightRecord]) -> list[str]:
    """Return the row of COLUMNS that sums some flights up."""
    count = len(records)
    arrivals = sum(1 for values in records if values["success"])
    violations = sum(1 for values in records if values["violation_s"] > 0.0)
    collisions = sum(1 for values in records if values["collision"])

    worst = "-"
    fifth_percentile = "-"
    separations = _numbers(records, "min_separation_m")
    if separations:
        worst = f"{min(separations):.3f}"
        fifth_percentile = f"{np.percentile(separations, 5):.3f}"

    mean_ratio = "-"
    ratios = _numbers(records, "ratio")
    if ratios:
        mean_ratio = f"{np.mean(ratios):.3f}"

    return [
        name,
        str(count),
        str(arrivals),
        str(violations),
        f"<= {100.0 * upper_bound(violations, count):.1f} %",
        str(collisions),
        worst,
        fifth_percentile,
        mean_ratio,
        f"{_mean(records, 'slew_rms_m_s3'):.1f}",
        f"{max(values['max_speed_m_s'] for values in records):.2f}",
        f"{100.0 * _mean(records, 'relaxed_share'):.2f}",
    ]


def _numbers(records: Sequence[FlightRecord], key: str) -> list[float]:
    """Return the values of a key, skipping flights that have none."""
    return [values[key] for values in records if values[key] is not None]


def _mean(records: Sequence[FlightRecord], key: str) -> float:
    return float(np.mean([values[key] for values in records]))
