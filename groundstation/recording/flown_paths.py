"""The flown path of each vehicle of a record, as CSV lines at an even rate.

A path is the ground truth if the record has it, or else the vehicle's own estimate. The CSV files
can be flown again as paths of a mission. Nothing is written for gaps of the record, so that such a
path leads straight across them; a sentence says so.
"""

from __future__ import annotations

import contextlib
import math
import re
from array import array
from pathlib import Path
from typing import NamedTuple

import numpy as np

from groundstation.recording.output_file import refuse_other_file, written_beside
from groundstation.recording.reader import (
    Sample,
    indexes_by_time,
    is_number,
    is_vector,
)
from groundstation.recording.recorded_flight import PATH_GAP_S
from groundstation.recording.timeline import Timeline
from onboard.arrays import Array, IntArray
from onboard.config.fleet import ConfigError
from onboard.frames import yaw_from_quaternion

_HEADER = "t,x,y,z,yaw"
# Form of a vehicle's name. A record may come from anybody, and each name becomes a file's name.
_NAME = re.compile(r"[A-Za-z0-9_-]{1,40}")


class FlownPath(NamedTuple):
    """One vehicle's path."""

    lines: list[str]  # t,x,y,z,yaw in seconds, metres and degrees
    gaps_s: list[tuple[float, float]]  # begin and end of each gap of the record, in seconds as t


def flown_paths(timeline: Timeline, rate_hz: float) -> dict[str, FlownPath]:
    """Return the path of each vehicle.

    Args:
        timeline: the record.
        rate_hz: rate of the lines.
    """
    paths: dict[str, dict[str, _Path]] = {}  # vehicle -> topic -> path
    for sample in timeline.samples(("truth", "tick")):
        if is_vector(sample.values.get("position_enu_m"), 3):
            paths.setdefault(sample.name, {}).setdefault(sample.topic, _Path()).add(sample)

    flown = {}
    for name, topics in sorted(paths.items()):
        topic = "truth" if "truth" in topics else "tick"
        flown[name] = topics[topic].by_time()

    begin_ns = min((int(stamps_ns[0]) for stamps_ns, _ in flown.values()), default=0)
    period_ns = round(1e9 / rate_hz)
    return {
        name: FlownPath(
            lines=_lines(stamps_ns, rows, begin_ns, period_ns),
            gaps_s=_gaps_s(stamps_ns, begin_ns),
        )
        for name, (stamps_ns, rows) in flown.items()
    }


class _Path:
    """Stamps, positions and yaw of one channel.

    A record of an hour has hundreds of thousands of messages, so nothing else of them is kept.
    """

    def __init__(self) -> None:
        self._stamps_ns = array("q")
        self._numbers = array("d")  # x, y, z [m] and yaw [deg] of each sample, one after another

    def add(self, sample: Sample) -> None:
        """Add a sample that has a position."""
        self._stamps_ns.append(sample.stamp_ns)
        self._numbers.extend(sample.values["position_enu_m"])
        self._numbers.append(_yaw_deg(sample))

    def by_time(self) -> tuple[IntArray, Array]:
        """Return the possible stamps (n,), rising, and x, y, z [m] and yaw [deg] (n, 4)."""
        stamps_ns = np.array(self._stamps_ns, np.int64)
        kept = indexes_by_time(stamps_ns)
        return stamps_ns[kept], np.reshape(self._numbers, (-1, 4))[kept]


def write_csvs(folder: Path, out: Path, rate_hz: float = 10.0) -> tuple[list[Path], list[str]]:
    """Write a CSV file for each vehicle.

    A vehicle whose name could lead out of the folder is left out.

    Args:
        folder: flight folder, or the MCAP file itself.
        out: folder of the CSV files.
        rate_hz: rate of the lines.

    Returns:
        Paths of the files, and sentences about what is damaged or missing in the record, and about
        other CSVs in the folder.

    Raises:
        ConfigError: there is no record, or it has no positions; or a file of such a name is there
            that has other columns.
        OSError: a file cannot be written.
    """
    with contextlib.closing(Timeline(folder)) as timeline:
        paths_by_name = flown_paths(timeline, rate_hz)
        notes = timeline.damage
    flown = {name: path for name, path in paths_by_name.items() if _NAME.fullmatch(name)}
    if not flown:
        raise ConfigError(f"{folder}: the record has no positions.")

    out.mkdir(parents=True, exist_ok=True)
    paths = {name: out / f"{name}.csv" for name in flown}
    for path in paths.values():
        refuse_other_file(path, _is_path, other=f"has other columns than {_HEADER}", option="--csv")
    for name, path in paths.items():
        with written_beside(path) as part:
            part.write_text("\n".join([_HEADER, *flown[name].lines]) + "\n", encoding="utf-8")

    for path, own in zip(paths.values(), flown.values(), strict=True):
        if own.gaps_s:
            notes.append(_gap_note(path.name, own.gaps_s))
    others = set(out.glob("*.csv")) - set(paths.values())
    if others:
        notes.append(
            f"{out} also has CSVs that are not of this flight, for instance {min(others).name}."
            " Delete them, or give another folder with --csv."
        )
    return list(paths.values()), notes


def _is_path(begin: bytes) -> bool:
    """Return whether a file that begins with these bytes has the columns of a flown path."""
    first_line, _, _ = begin.partition(b"\n")
    return first_line.rstrip() == _HEADER.encode()


def _gaps_s(stamps_ns: IntArray, begin_ns: int) -> list[tuple[float, float]]:
    """Return begin and end of each gap between stamps (n,), in seconds after ``begin_ns``."""
    befores = np.flatnonzero(np.diff(stamps_ns) > PATH_GAP_S * 1e9)
    times_s = (stamps_ns - begin_ns) * 1e-9
    return [(float(times_s[before]), float(times_s[before + 1])) for before in befores]


def _gap_note(file: str, gaps_s: list[tuple[float, float]]) -> str:
    """Return a sentence about the gaps of a path."""
    begin_s, end_s = max(gaps_s, key=lambda gap_s: gap_s[1] - gap_s[0])
    others = ""
    if len(gaps_s) > 1:
        others = f" ({len(gaps_s)} gaps in all)"
    return (
        f"The record has no positions for {file} from {begin_s:.1f} s to {end_s:.1f} s{others}."
        " Flown from this file, the path leads straight across."
    )


def _lines(stamps_ns: IntArray, rows: Array, begin_ns: int, period_ns: int) -> list[str]:
    """Return one line for each period: its first row.

    Args:
        stamps_ns: stamps (n,), rising.
        rows: x, y, z [m] and yaw [deg] (n, 4).
        begin_ns: stamp at which the first period begins.
        period_ns: length of a period.
    """
    periods = (stamps_ns - begin_ns) // period_ns
    _, firsts = np.unique(periods, return_index=True)

    lines = []
    for since_begin_ns, row in zip(stamps_ns[firsts] - begin_ns, rows[firsts], strict=True):
        x, y, z, yaw_deg = row
        time_s = since_begin_ns * 1e-9
        lines.append(f"{time_s:.3f},{x:.4f},{y:.4f},{z:.4f},{yaw_deg:.1f}")
    return lines


def _yaw_deg(sample: Sample) -> float:
    quaternion = sample.values.get("quaternion_enu_flu_wxyz")
    if isinstance(quaternion, list) and is_vector(quaternion, 4):
        w, x, y, z = map(float, quaternion)
        return math.degrees(yaw_from_quaternion((w, x, y, z)))

    yaw_rad = sample.values.get("yaw_rad")
    if isinstance(yaw_rad, float) and is_number(yaw_rad):
        return math.degrees(yaw_rad)
    return 0.0
