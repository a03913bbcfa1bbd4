"""Positions of a recorded flight at even times: by ground truth where there is one, else as the
vehicles knew them.
"""

from __future__ import annotations

import math
from pathlib import Path

from groundstation.recording.reader import Sample, is_number, is_vector, of_one_flight, read
from onboard.config.fleet import ConfigError
from onboard.frames import yaw_from_quaternion


def flown_paths(folder: Path, rate_hz: float) -> dict[str, list[str]]:
    """Return the lines ``t,x,y,z,yaw`` of each vehicle, in seconds, metres and degrees.

    Args:
        folder: flight folder, or the MCAP file itself.
        rate_hz: lines a second.

    Raises:
        ConfigError: there is no record.
    """
    samples: dict[str, dict[str, list[Sample]]] = {}
    for sample in read(folder, ("truth", "tick")):
        if is_vector(sample.values.get("position_enu_m"), 3):
            samples.setdefault(sample.name, {}).setdefault(sample.topic, []).append(sample)
    flown = {
        name: of_one_flight(topics.get("truth") or topics["tick"])
        for name, topics in sorted(samples.items())
    }
    begin_ns = min((one.stamp_ns for rows in flown.values() for one in rows), default=0)
    return {name: _lines(rows, begin_ns, round(1e9 / rate_hz)) for name, rows in flown.items()}


def write_csvs(folder: Path, out: Path, rate_hz: float = 10.0) -> list[Path]:
    """Write a CSV for each vehicle, which can be flown again as a path; returns the files.

    Raises:
        ConfigError: there is no record, or it has no positions.
    """
    flown = flown_paths(folder, rate_hz)
    if not flown:
        raise ConfigError(f"{folder}: the record has no positions.")
    out.mkdir(parents=True, exist_ok=True)
    for name, lines in flown.items():
        (out / f"{name}.csv").write_text(
            "t,x,y,z,yaw\n" + "\n".join(lines) + "\n", encoding="utf-8"
        )
    return [out / f"{name}.csv" for name in flown]


def _lines(rows: list[Sample], begin_ns: int, period_ns: int) -> list[str]:
    lines, due_ns = [], begin_ns
    for row in sorted(rows, key=lambda one: one.stamp_ns):
        if row.stamp_ns >= due_ns:
            due_ns = row.stamp_ns - (row.stamp_ns - begin_ns) % period_ns + period_ns
            x, y, z = row.values["position_enu_m"]
            lines.append(
                f"{(row.stamp_ns - begin_ns) * 1e-9:.3f},{x:.4f},{y:.4f},{z:.4f},{_yaw_deg(row):.1f}"
            )
    return lines


def _yaw_deg(row: Sample) -> float:
    quaternion, yaw_rad = row.values.get("quaternion_enu_flu_wxyz"), row.values.get("yaw_rad")
    if isinstance(quaternion, list) and is_vector(quaternion, 4):
        w, x, y, z = quaternion
        return math.degrees(yaw_from_quaternion((w, x, y, z)))
    return math.degrees(yaw_rad) if isinstance(yaw_rad, float) and is_number(yaw_rad) else 0.0
