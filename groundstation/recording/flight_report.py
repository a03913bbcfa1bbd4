"""Evaluation of a record: separation by ground truth, and the timing of the agents' loops."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from groundstation.fleet.state import Separation
from groundstation.recording.reader import Sample, is_vector, of_one_flight, read
from onboard.config.pair_separation import separations_m

MAX_GAP_S = 0.25
PERIOD_NOMINAL_MS = 20.0


class LoopTiming(msgspec.Struct, frozen=True):
    """Periods of one agent's control loop; nominal 20 ms."""

    period_p50_ms: float
    period_p99_ms: float
    period_max_ms: float
    ticks: int


@dataclass(frozen=True, slots=True)
class TrueMotion:
    """True motion of one vehicle."""

    stamp_ns: NDArray[np.int64]  # (n,)
    position_enu_m: NDArray[np.float64]  # (n, 3)
    is_on_ground: NDArray[np.bool_]  # (n,)
    is_collided: bool  # at any time


@dataclass(frozen=True, slots=True)
class FlightReport:
    """Figures of one flight."""

    smallest: Separation | None  # by truth while one of the two flew; None without truth
    pairs: dict[str, Separation]  # the same of each pair
    collided: tuple[str, ...]
    loops: dict[str, LoopTiming]
    begin_ns: int  # first stamp of truth
    duration_s: float


def report(folder: Path, height_share: float = 0.0) -> FlightReport:
    """Evaluate a record.

    Args:
        folder: flight folder.
        height_share: what a metre of height counts in a separation, ``FleetSection.height_share``.

    Returns:
        Its figures.

    Raises:
        ConfigError: there is no record.
    """
    truths: dict[str, list[Sample]] = defaultdict(list)
    periods_ms: dict[str, list[float]] = defaultdict(list)
    for sample in read(folder, ("truth", "tick")):
        values = sample.values
        if sample.topic == "tick":
            period_s = values.get("period_s")
            if isinstance(period_s, float) and 0.0 < period_s < math.inf:
                periods_ms[sample.name].append(1e3 * period_s)
        elif is_vector(values.get("position_enu_m"), 3):
            truths[sample.name].append(sample)
    tracks = {
        name: track([_row(one) for one in of_one_flight(samples)])
        for name, samples in truths.items()
    }
    pairs = separations(tracks, height_share)
    stamps = [value.stamp_ns for value in tracks.values()]
    begin_ns = min((int(value[0]) for value in stamps), default=0)
    end_ns = max((int(value[-1]) for value in stamps), default=0)
    return FlightReport(
        smallest=min(pairs.values(), key=lambda pair: pair.distance_m, default=None),
        pairs=pairs,
        collided=tuple(sorted(name for name, value in tracks.items() if value.is_collided)),
        loops={name: loop_timing(values) for name, values in sorted(periods_ms.items())},
        begin_ns=begin_ns,
        duration_s=(end_ns - begin_ns) * 1e-9,
    )


def _row(truth: Sample) -> tuple[int, list[float], bool, bool]:
    values = truth.values
    is_on_ground, is_collided = bool(values.get("is_on_ground")), bool(values.get("is_collided"))
    return truth.stamp_ns, values["position_enu_m"], is_on_ground, is_collided


def track(rows: list[tuple[int, list[float], bool, bool]]) -> TrueMotion:
    """Sort rows (stamp, position, on ground, collided) of one vehicle by stamp, each stamp once."""
    stamps, first = np.unique(np.array([row[0] for row in rows], dtype=np.int64), return_index=True)
    return TrueMotion(
        stamps,
        np.array([rows[index][1] for index in first], dtype=np.float64).reshape(-1, 3),
        np.array([rows[index][2] for index in first], dtype=np.bool_),
        any(row[3] for row in rows),
    )


def separations(tracks: dict[str, TrueMotion], height_share: float = 0.0) -> dict[str, Separation]:
    """Find the smallest separation of each pair while at least one of the two flies.

    The distance is evaluated at both vehicles' stamps. Between samples positions are interpolated;
    gaps longer than MAX_GAP_S are left out.

    Args:
        tracks: true motion of each vehicle.
        height_share: what a metre of height counts.

    Returns:
        Smallest separations by "FIRST-SECOND".
    """
    closest = {}
    for one, two in itertools.combinations(sorted(tracks), 2):
        first, second = tracks[one], tracks[two]
        stamps = np.union1d(first.stamp_ns, second.stamp_ns)
        stamps = stamps[
            (stamps >= max(first.stamp_ns[0], second.stamp_ns[0]))
            & (stamps <= min(first.stamp_ns[-1], second.stamp_ns[-1]))
        ]
        is_valid = _covered(first, stamps) & _covered(second, stamps)
        is_flying = ~(_on_ground(first, stamps) & _on_ground(second, stamps))
        stamps = stamps[is_valid & is_flying]
        if stamps.size:
            distance_m = separations_m(_at(first, stamps) - _at(second, stamps), height_share)
            index = int(np.argmin(distance_m))
            smallest_m, stamp_ns = float(distance_m[index]), int(stamps[index])
            closest[f"{one}-{two}"] = Separation(one, two, smallest_m, stamp_ns, is_truth=True)
    return closest


def loop_timing(periods_ms: list[float]) -> LoopTiming:
    """Return percentiles of the periods of one loop."""
    values = np.array(periods_ms)
    if not values.size:
        return LoopTiming(math.nan, math.nan, math.nan, 0)
    p50, p99 = np.percentile(values, [50, 99])
    return LoopTiming(
        round(float(p50), 3), round(float(p99), 3), round(float(values.max()), 3), int(values.size)
    )


def _at(value: TrueMotion, stamps: NDArray[np.int64]) -> NDArray[np.float64]:
    origin = value.stamp_ns[0]  # int64 nanoseconds do not fit into a double; differences do
    times, known = (
        (stamps - origin).astype(np.float64),
        (value.stamp_ns - origin).astype(np.float64),
    )
    return np.stack(
        [np.interp(times, known, value.position_enu_m[:, axis]) for axis in (0, 1, 2)], axis=-1
    )


def _on_ground(value: TrueMotion, stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    index = np.clip(np.searchsorted(value.stamp_ns, stamps, side="right") - 1, 0, None)
    return np.asarray(value.is_on_ground[index])


def _covered(value: TrueMotion, stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    before = np.clip(np.searchsorted(value.stamp_ns, stamps, side="right") - 1, 0, None)
    after = np.clip(
        np.searchsorted(value.stamp_ns, stamps, side="left"), None, value.stamp_ns.size - 1
    )
    return np.asarray(value.stamp_ns[after] - value.stamp_ns[before] <= MAX_GAP_S * 1e9)
