"""Evaluation of a record: separations by ground truth, distances to persons, timing of the loops.

The verdict of a mission is computed from these figures.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from groundstation.fleet.state import Separation
from groundstation.recording.reader import Sample, is_vector, of_one_flight
from groundstation.recording.timeline import Timeline
from onboard.config.pair_separation import separations_m
from onboard.config.people import Person, body_of

MAX_GAP_S = 0.25  # no distance is evaluated in a longer gap between two samples of truth
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
    is_collided: bool  # whether it collided at any time


class PersonDistance(msgspec.Struct, frozen=True):
    """The smallest distance of a vehicle to the circle of a person."""

    vehicle: str
    person: str
    distance_m: float  # horizontal, to the circle; negative inside it
    stamp_ns: int


@dataclass(frozen=True, slots=True)
class FlightReport:
    """Figures of one flight."""

    # smallest separation by truth, of pairs with at least one in flight; None without truth
    smallest: Separation | None
    pairs: dict[str, Separation]  # "FIRST-SECOND" -> smallest separation of this pair
    collided: tuple[str, ...]
    loops: dict[str, LoopTiming]
    begin_ns: int  # first stamp of truth
    duration_s: float
    in_air_at_end: tuple[str, ...] = ()  # vehicles that were still in the air, by truth
    # of the vehicles that flew, by truth, else by their telemetry; None if no person was seen
    nearest_person: PersonDistance | None = None


def report(
    folder: Path,
    height_share: float = 0.0,
    from_ns: int = 0,
    *,
    people: Mapping[str, Person] = MappingProxyType({}),
) -> FlightReport:
    """Evaluate a record.

    Args:
        folder: flight folder.
        height_share: factor of height differences in separations, ``FleetSection.height_share``.
        from_ns: stamp [ns] at which the mission began; older positions are left out.
        people: the persons of the fleet file, by name.

    Returns:
        The figures of the flight.

    Raises:
        ConfigError: there is no record, or no part of it can be read.
    """
    truths: dict[str, list[Sample]] = defaultdict(list)
    telemetry: dict[str, list[Sample]] = defaultdict(list)
    poses: dict[str, list[Sample]] = defaultdict(list)
    samples_of = {"truth": truths, "telemetry": telemetry, "mocap": poses}
    topics = ["truth", "tick"]
    if people:
        topics += ["telemetry", "mocap"]
    periods_ms: dict[str, list[float]] = defaultdict(list)
    with contextlib.closing(Timeline(folder)) as timeline:
        for sample in timeline.samples(topics):
            if sample.topic == "tick":
                period_s = sample.values.get("period_s")
                if isinstance(period_s, float) and 0.0 < period_s < math.inf:
                    periods_ms[sample.name].append(1e3 * period_s)
            elif sample.stamp_ns < from_ns:
                continue
            elif is_vector(sample.values.get("position_enu_m"), 3):
                samples_of[sample.topic][sample.name].append(sample)

    tracks = _tracks(truths)
    begin_ns = min((int(motion.stamp_ns[0]) for motion in tracks.values()), default=0)
    end_ns = max((int(motion.stamp_ns[-1]) for motion in tracks.values()), default=0)

    pairs = separations(tracks, height_share)
    collided = sorted(name for name, motion in tracks.items() if motion.is_collided)
    in_air_at_end = sorted(name for name, motion in tracks.items() if not motion.is_on_ground[-1])
    return FlightReport(
        smallest=min(pairs.values(), key=lambda pair: pair.distance_m, default=None),
        pairs=pairs,
        collided=tuple(collided),
        loops={name: loop_timing(values) for name, values in sorted(periods_ms.items())},
        begin_ns=begin_ns,
        duration_s=(end_ns - begin_ns) * 1e-9,
        in_air_at_end=tuple(in_air_at_end),
        nearest_person=_nearest_person({**_tracks(telemetry), **tracks}, poses, people),
    )


def _tracks(samples: Mapping[str, list[Sample]]) -> dict[str, TrueMotion]:
    """Return the motion of each vehicle."""
    return {name: track([_row(one) for one in of_one_flight(own)]) for name, own in samples.items()}


def _nearest_person(
    vehicles: Mapping[str, TrueMotion],
    poses: Mapping[str, list[Sample]],
    people: Mapping[str, Person],
) -> PersonDistance | None:
    """Return the smallest distance of a vehicle that flies to the circle of a person who is seen.

    Args:
        vehicles: motion of each vehicle.
        poses: the motion capture's poses, by body.
        people: the persons of the fleet file, by name.
    """
    nearest = None
    for person, settings in people.items():
        seen = [pose for pose in poses.get(body_of(person, settings), ()) if _is_tracked(pose)]
        if not seen:
            continue
        walk = track([_row(pose) for pose in of_one_flight(seen)])

        for vehicle, motion in vehicles.items():
            stamps = _common_stamps(motion, walk)
            own = _sampled(motion, stamps)
            other = _sampled(walk, stamps)
            is_counted = own.is_covered & other.is_covered & ~own.is_on_ground
            if not is_counted.any():
                continue

            offsets_enu_m = own.position_enu_m[is_counted] - other.position_enu_m[is_counted]
            distances_m = np.hypot(offsets_enu_m[:, 0], offsets_enu_m[:, 1]) - settings.radius_m
            index = int(np.argmin(distances_m))
            if nearest is None or distances_m[index] < nearest.distance_m:
                nearest = PersonDistance(
                    vehicle=vehicle,
                    person=person,
                    distance_m=float(distances_m[index]),
                    stamp_ns=int(stamps[is_counted][index]),
                )
    return nearest


def _is_tracked(pose: Sample) -> bool:
    return bool(pose.values.get("is_tracked"))


class _Row(NamedTuple):
    """One sample of a vehicle's ground truth or telemetry, or a pose of a person."""

    stamp_ns: int
    position_enu_m: list[float]
    is_on_ground: bool
    is_collided: bool


def _row(sample: Sample) -> _Row:
    values = sample.values
    return _Row(
        stamp_ns=sample.stamp_ns,
        position_enu_m=values["position_enu_m"],
        is_on_ground=bool(values.get("is_on_ground", not values.get("is_airborne", True))),
        is_collided=bool(values.get("is_collided")),
    )


def track(rows: list[_Row]) -> TrueMotion:
    """Return the motion of one vehicle from its rows, sorted, and each stamp once."""
    all_stamps_ns = np.array([row.stamp_ns for row in rows], dtype=np.int64)
    stamps_ns, first = np.unique(all_stamps_ns, return_index=True)

    kept = [rows[index] for index in first]
    positions_enu_m = np.array([row.position_enu_m for row in kept], dtype=np.float64)
    return TrueMotion(
        stamp_ns=stamps_ns,
        position_enu_m=positions_enu_m.reshape(-1, 3),
        is_on_ground=np.array([row.is_on_ground for row in kept], dtype=np.bool_),
        is_collided=any(row.is_collided for row in rows),
    )


def separations(tracks: dict[str, TrueMotion], height_share: float = 0.0) -> dict[str, Separation]:
    """Find the smallest separation of each pair while at least one of the two flies.

    The distance is evaluated at both vehicles' stamps. Between samples positions are interpolated;
    gaps longer than MAX_GAP_S are left out.

    Args:
        tracks: true motion of each vehicle.
        height_share: factor of height differences in separations.

    Returns:
        Smallest separations by "FIRST-SECOND".
    """
    at_own_stamps = {name: _sampled(motion, motion.stamp_ns) for name, motion in tracks.items()}

    def sampled(name: str, stamps: NDArray[np.int64]) -> _Sampled:
        # One emulator gives all its vehicles the same stamps. Then a vehicle's motion at its own
        # stamps serves all pairs.
        if np.array_equal(stamps, tracks[name].stamp_ns):
            return at_own_stamps[name]
        return _sampled(tracks[name], stamps)

    closest = {}
    for first_name, second_name in itertools.combinations(sorted(tracks), 2):
        stamps = _common_stamps(tracks[first_name], tracks[second_name])
        first = sampled(first_name, stamps)
        second = sampled(second_name, stamps)

        is_one_flying = ~(first.is_on_ground & second.is_on_ground)
        is_counted = first.is_covered & second.is_covered & is_one_flying
        if not is_counted.any():
            continue

        offsets_enu_m = first.position_enu_m[is_counted] - second.position_enu_m[is_counted]
        distances_m = separations_m(offsets_enu_m, height_share)
        index = int(np.argmin(distances_m))
        closest[f"{first_name}-{second_name}"] = Separation(
            first=first_name,
            second=second_name,
            distance_m=float(distances_m[index]),
            stamp_ns=int(stamps[is_counted][index]),
            is_truth=True,
        )
    return closest


def _common_stamps(first: TrueMotion, second: TrueMotion) -> NDArray[np.int64]:
    """Return the stamps of both, in the time in which both motions are known."""
    # One emulator gives all its vehicles the same stamps, and then nothing has to be merged.
    stamps = first.stamp_ns
    if not np.array_equal(first.stamp_ns, second.stamp_ns):
        stamps = np.union1d(first.stamp_ns, second.stamp_ns)
    begin_ns = max(first.stamp_ns[0], second.stamp_ns[0])
    end_ns = min(first.stamp_ns[-1], second.stamp_ns[-1])
    common: NDArray[np.int64] = stamps[(stamps >= begin_ns) & (stamps <= end_ns)]
    return common


def loop_timing(periods_ms: list[float]) -> LoopTiming:
    """Return percentiles of the periods of one loop."""
    values_ms = np.array(periods_ms)
    if not values_ms.size:
        return LoopTiming(math.nan, math.nan, math.nan, 0)

    p50_ms, p99_ms = np.percentile(values_ms, [50, 99])
    return LoopTiming(
        period_p50_ms=round(float(p50_ms), 3),
        period_p99_ms=round(float(p99_ms), 3),
        period_max_ms=round(float(values_ms.max()), 3),
        ticks=int(values_ms.size),
    )


class _Sampled(NamedTuple):
    """A vehicle's motion at some stamps."""

    position_enu_m: NDArray[np.float64]  # (n, 3), interpolated linearly between two samples
    is_on_ground: NDArray[np.bool_]  # (n,), at the last sample before
    is_covered: NDArray[np.bool_]  # (n,), whether the gap between the samples around is short


def _sampled(motion: TrueMotion, stamps: NDArray[np.int64]) -> _Sampled:
    """Return the motion at these stamps."""
    # int64 nanoseconds do not fit into a double, but their differences do
    origin_ns = motion.stamp_ns[0]
    times = (stamps - origin_ns).astype(np.float64)
    known_times = (motion.stamp_ns - origin_ns).astype(np.float64)
    axes = [np.interp(times, known_times, motion.position_enu_m[:, axis]) for axis in (0, 1, 2)]

    before = np.searchsorted(motion.stamp_ns, stamps, side="right") - 1
    before = np.clip(before, 0, None)
    after = np.searchsorted(motion.stamp_ns, stamps, side="left")
    after = np.clip(after, None, motion.stamp_ns.size - 1)
    gaps_ns = motion.stamp_ns[after] - motion.stamp_ns[before]

    return _Sampled(
        position_enu_m=np.stack(axes, axis=-1),
        is_on_ground=motion.is_on_ground[before],
        is_covered=gaps_ns <= MAX_GAP_S * 1e9,
    )
