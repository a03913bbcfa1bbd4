"""A flight record as arrays per vehicle, on one time axis that starts when the first of them leaves
the ground.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from groundstation.recording.reader import (
    MAX_FLIGHT_NS,
    Sample,
    is_number,
    is_vector,
    of_one_flight,
)
from onboard.arrays import Array
from onboard.config.pair_separation import separations_m

TOPICS = ("truth", "tick", "telemetry")
GRID_S = 0.02
_AIRBORNE_Z_M = 0.12
_LEAD_S = 1.0
_LIFTED_M = 0.05  # above where it stood
_SLOT_STEP_M = 0.05


@dataclass(frozen=True, slots=True)
class Track:
    """One vehicle's flight."""

    name: str
    time_s: Array  # (n,)
    position_enu_m: Array  # (n, 3)
    setpoint_position_enu_m: Array  # (n, 3)
    thrust_baseline_enu_m_s2: Array  # (n, 3), before the law
    thrust_safe_enu_m_s2: Array  # (n, 3), after the law
    commanded_deg: Array  # (n, 2): roll and pitch, FLU in ENU
    flown_deg: Array  # (n, 2)
    path_time_s: Array  # (m,)
    path_enu_m: Array  # (m, 3): ground truth where is_truth, else the vehicle's estimate
    is_truth: bool
    slots_enu_m: Array  # (k, 3): goals in the order they were ordered

    def path_at(self, time_s: Array) -> Array:
        """Return positions (n, 3) at these times, NaN outside the record."""
        return np.stack(
            [
                np.interp(time_s, self.path_time_s, self.path_enu_m[:, axis], np.nan, np.nan)
                for axis in range(3)
            ],
            -1,
        )


@dataclass(frozen=True, slots=True)
class PairSeparation:
    """Two vehicles of a flight."""

    first: str
    second: str
    distance_m: Array  # separation, on the flight's grid; NaN while neither flies


@dataclass(frozen=True, slots=True)
class FlightData:
    """One flight."""

    title: str
    tracks: tuple[Track, ...]
    safety_distance_m: float
    grid_s: Array  # (n,): common time axis
    pairs: tuple[PairSeparation, ...]
    # zero of all times here, in the record's own seconds, as replay and verdict count
    take_off_s: float
    height_share: float = 0.0  # what a metre of height counts in a separation

    @property
    def source(self) -> str:
        """Source of the paths, in words."""
        return (
            "ground truth"
            if all(track.is_truth for track in self.tracks)
            else "the vehicles' estimates"
        )

    def closest(self) -> tuple[PairSeparation, int] | None:
        """Return the pair with the smallest distance and its index on the grid; None when no
        vehicle flew.
        """
        known = [pair for pair in self.pairs if np.isfinite(pair.distance_m).any()]
        if not known:
            return None
        pair = min(known, key=lambda item: float(np.nanmin(item.distance_m)))
        return pair, int(np.nanargmin(pair.distance_m))


def from_samples(
    samples: Iterable[Sample], *, title: str, safety_distance_m: float, height_share: float = 0.0
) -> FlightData | None:
    """Convert the samples of a record.

    Args:
        samples: of the topics in TOPICS.
        title: of the flight.
        safety_distance_m: limit between two vehicles [m].
        height_share: what a metre of height counts in a separation.

    Returns:
        The flight; None when no vehicle has two ticks.
    """
    rows: dict[str, dict[str, list[Sample]]] = {topic: {} for topic in TOPICS}
    for sample in samples:
        if sample.topic in rows:
            rows[sample.topic].setdefault(sample.name, []).append(sample)
    for kinds in rows.values():
        for name, own in kinds.items():
            kinds[name] = sorted(of_one_flight(own), key=lambda sample: sample.stamp_ns)
    names = sorted(name for name, ticks in rows["tick"].items() if len(ticks) > 1)
    if not names:
        return None
    start_ns = _start_ns(
        {name: rows["truth"].get(name, []) for name in names}, {n: rows["tick"][n] for n in names}
    )
    tracks = tuple(
        _track(
            name,
            rows["tick"][name],
            rows["truth"].get(name, []),
            rows["telemetry"].get(name, []),
            start_ns,
        )
        for name in names
    )
    end_s = max(float(track.path_time_s[-1]) for track in tracks)
    begin_s = max(-_LEAD_S, min(float(track.path_time_s[0]) for track in tracks))
    end_s = min(end_s, begin_s + MAX_FLIGHT_NS * 1e-9)  # vehicles' clocks may be far apart
    grid_s = np.arange(begin_s, end_s, GRID_S) if end_s > begin_s else np.array([begin_s])
    record_ns = min(own[0].stamp_ns for kinds in rows.values() for own in kinds.values() if own)
    take_off_s = (start_ns - record_ns) * 1e-9
    title = f"{title} (take-off at {take_off_s:.1f} s of the record)"
    pairs = _pairs(tracks, grid_s, height_share)
    return FlightData(title, tracks, safety_distance_m, grid_s, pairs, take_off_s, height_share)


def _start_ns(truth: dict[str, list[Sample]], ticks: dict[str, list[Sample]]) -> int:
    """The stamp at which the first vehicle leaves the ground; "taking off" begins earlier, when the
    motors start.
    """
    lifted = []
    for name, flown in ticks.items():
        path = truth[name] if len(truth[name]) > 1 else flown
        height_m = _vectors(path, "position_enu_m", 3)[:, 2]
        known = height_m[np.isfinite(height_m)]
        up = np.flatnonzero(height_m > known[0] + _LIFTED_M) if known.size else known
        if up.size:
            lifted.append(path[int(up[0])].stamp_ns)
    return min(lifted, default=min(flown[0].stamp_ns for flown in ticks.values()))


def _track(
    name: str, ticks: list[Sample], truth: list[Sample], telemetry: list[Sample], start_ns: int
) -> Track:
    time_s = _times(ticks, start_ns)
    path = truth if len(truth) > 1 else ticks
    return Track(
        name=name,
        time_s=time_s,
        position_enu_m=_vectors(ticks, "position_enu_m", 3),
        setpoint_position_enu_m=_vectors(ticks, "setpoint_position_enu_m", 3),
        thrust_baseline_enu_m_s2=_vectors(ticks, "thrust_baseline_enu_m_s2", 3),
        thrust_safe_enu_m_s2=_vectors(ticks, "thrust_safe_enu_m_s2", 3),
        commanded_deg=_roll_pitch_deg(_vectors(ticks, "setpoint_quaternion_enu_flu_wxyz", 4)),
        flown_deg=_roll_pitch_deg(_vectors(ticks, "attitude_quaternion_enu_flu_wxyz", 4)),
        path_time_s=_times(path, start_ns),
        path_enu_m=_vectors(path, "position_enu_m", 3),
        is_truth=path is truth,
        slots_enu_m=_slots(telemetry),
    )


def _times(samples: list[Sample], start_ns: int) -> Array:
    return np.array([(sample.stamp_ns - start_ns) * 1e-9 for sample in samples], np.float64)


def _vectors(samples: list[Sample], field: str, size: int) -> Array:
    """The field (n, size); NaN where it is missing, of another shape, or null."""
    vectors = np.full((len(samples), size), np.nan)
    for index, sample in enumerate(samples):
        value = sample.values.get(field)
        if isinstance(value, list) and len(value) == size:
            vectors[index] = [entry if is_number(entry) else np.nan for entry in value]
    return vectors


def _roll_pitch_deg(quaternion_wxyz: Array) -> Array:
    w, x, y, z = np.moveaxis(quaternion_wxyz, -1, 0)
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    angles: Array = np.degrees(np.stack([roll, pitch], -1))
    return angles


def _slots(telemetry: list[Sample]) -> Array:
    slots: list[list[float]] = []
    for sample in telemetry:
        goal = sample.values.get("goal_position_enu_m")
        if (
            sample.values.get("state") not in ("flying", "holding")
            or sample.values.get("order_kind") != "move"
        ):
            continue
        if not isinstance(goal, list) or not is_vector(goal, 3):
            continue
        if not slots or np.linalg.norm(np.subtract(slots[-1], goal)) > _SLOT_STEP_M:
            slots.append([float(value) for value in goal])
    return np.array(slots, np.float64).reshape(-1, 3)


def _pairs(
    tracks: tuple[Track, ...], grid_s: Array, height_share: float
) -> tuple[PairSeparation, ...]:
    paths = {track.name: track.path_at(grid_s) for track in tracks}
    pairs = []
    for first, second in itertools.combinations(paths, 2):
        one, two = paths[first], paths[second]
        distance_m = separations_m(one - two, height_share)
        in_air = (one[:, 2] > _AIRBORNE_Z_M) | (two[:, 2] > _AIRBORNE_Z_M)
        pairs.append(PairSeparation(first, second, np.where(in_air, distance_m, np.nan)))
    return tuple(pairs)
