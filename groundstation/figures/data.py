"""A flight record as arrays per vehicle, on one time axis that starts when the first of them leaves the ground."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.recording.reader import Sample

Array = NDArray[np.float64]
TOPICS = ("truth", "tick", "telemetry")
GRID_S = 0.02
_AIRBORNE_Z_M = 0.12
_LEAD_S = 1.0
_LIFTED_M = 0.05  # above where it stood
_SLOT_STEP_M = 0.05


@dataclass(frozen=True, slots=True)
class Track:
    """One vehicle's flight.

    time_s (n,), and at those times position and setpoint (n, 3) [m ENU], thrust before and after the law (n, 3)
    [m/s^2 ENU, per mass], roll and pitch asked and flown (n, 2) [deg, FLU in ENU]. place_time_s (m,) and place_enu_m
    (m, 3): the flown path, ground truth where ``is_truth``. slots (k, 3): goals in the order they were given.
    """

    name: str
    time_s: Array
    position_enu_m: Array
    setpoint_position_enu_m: Array
    thrust_baseline_enu_m_s2: Array
    thrust_safe_enu_m_s2: Array
    asked_deg: Array
    flown_deg: Array
    place_time_s: Array
    place_enu_m: Array
    is_truth: bool
    slots_enu_m: Array

    def place_at(self, time_s: Array) -> Array:
        """Position (n, 3) at these times, nan outside the record."""
        return np.stack(
            [np.interp(time_s, self.place_time_s, self.place_enu_m[:, axis], np.nan, np.nan) for axis in range(3)], -1
        )


@dataclass(frozen=True, slots=True)
class Pair:
    """Horizontal distance between two vehicles on the flight's grid, nan while neither flies."""

    first: str
    second: str
    distance_m: Array


@dataclass(frozen=True, slots=True)
class FlightData:
    """All tracks, the grid (n,) in seconds and the distances of all pairs on it."""

    title: str
    tracks: tuple[Track, ...]
    safety_distance_m: float
    grid_s: Array
    pairs: tuple[Pair, ...]

    @property
    def source(self) -> str:
        """Where the paths come from."""
        return "ground truth" if all(track.is_truth for track in self.tracks) else "the vehicles' estimates"

    def closest(self) -> tuple[Pair, int] | None:
        """The pair and the place on the grid of the smallest distance; None with nobody in the air."""
        known = [pair for pair in self.pairs if np.isfinite(pair.distance_m).any()]
        if not known:
            return None
        pair = min(known, key=lambda item: float(np.nanmin(item.distance_m)))
        return pair, int(np.nanargmin(pair.distance_m))


def from_samples(samples: Iterable[Sample], *, title: str, safety_distance_m: float) -> FlightData | None:
    """Arrays of a record's samples; None when no vehicle has two ticks.

    Samples of a vehicle whose fields are not what a tick has are left out.
    """
    rows: dict[str, dict[str, list[Sample]]] = {topic: {} for topic in TOPICS}
    for sample in samples:
        if sample.topic in rows:
            rows[sample.topic].setdefault(sample.name, []).append(sample)
    names = sorted(name for name, ticks in rows["tick"].items() if len(ticks) > 1)
    if not names:
        return None
    for kinds in rows.values():
        for found in kinds.values():
            found.sort(key=lambda sample: sample.stamp_ns)
    start_ns = _start_ns({name: rows["truth"].get(name, []) for name in names}, {n: rows["tick"][n] for n in names})
    tracks = tuple(
        _track(name, rows["tick"][name], rows["truth"].get(name, []), rows["telemetry"].get(name, []), start_ns)
        for name in names
    )
    end_s = max(float(track.place_time_s[-1]) for track in tracks)
    begin_s = max(-_LEAD_S, min(float(track.place_time_s[0]) for track in tracks))
    grid_s = np.arange(begin_s, end_s, GRID_S) if end_s > begin_s else np.array([begin_s])
    return FlightData(title, tracks, safety_distance_m, grid_s, _pairs(tracks, grid_s))


def _start_ns(truth: dict[str, list[Sample]], ticks: dict[str, list[Sample]]) -> int:
    """When the first vehicle leaves the ground; "taking off" begins seconds before, while the motors are started."""
    lifted = []
    for name, flown in ticks.items():
        place = truth[name] if len(truth[name]) > 1 else flown
        height_m = _vectors(place, "position_enu_m", 3)[:, 2]
        known = height_m[np.isfinite(height_m)]
        up = np.flatnonzero(height_m > known[0] + _LIFTED_M) if known.size else known
        if up.size:
            lifted.append(place[int(up[0])].stamp_ns)
    return min(lifted, default=min(flown[0].stamp_ns for flown in ticks.values()))


def _track(name: str, ticks: list[Sample], truth: list[Sample], told: list[Sample], start_ns: int) -> Track:
    time_s = _times(ticks, start_ns)
    place = truth if len(truth) > 1 else ticks
    return Track(
        name=name,
        time_s=time_s,
        position_enu_m=_vectors(ticks, "position_enu_m", 3),
        setpoint_position_enu_m=_vectors(ticks, "setpoint_position_enu_m", 3),
        thrust_baseline_enu_m_s2=_vectors(ticks, "thrust_baseline_enu_m_s2", 3),
        thrust_safe_enu_m_s2=_vectors(ticks, "thrust_safe_enu_m_s2", 3),
        asked_deg=_roll_pitch_deg(_vectors(ticks, "setpoint_quaternion_enu_flu_wxyz", 4)),
        flown_deg=_roll_pitch_deg(_vectors(ticks, "attitude_quaternion_enu_flu_wxyz", 4)),
        place_time_s=_times(place, start_ns),
        place_enu_m=_vectors(place, "position_enu_m", 3),
        is_truth=place is truth,
        slots_enu_m=_slots(told),
    )


def _times(samples: list[Sample], start_ns: int) -> Array:
    return np.array([(sample.stamp_ns - start_ns) * 1e-9 for sample in samples], np.float64)


def _vectors(samples: list[Sample], field: str, size: int) -> Array:
    """(n, size); what is missing, of another shape or no number (JSON null) is nan."""
    found = np.full((len(samples), size), np.nan)
    for index, sample in enumerate(samples):
        value = sample.values.get(field)
        if isinstance(value, list) and len(value) == size:
            found[index] = [entry if isinstance(entry, (int, float)) else np.nan for entry in value]
    return found


def _roll_pitch_deg(quaternion_wxyz: Array) -> Array:
    w, x, y, z = np.moveaxis(quaternion_wxyz, -1, 0)
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    angles: Array = np.degrees(np.stack([roll, pitch], -1))
    return angles


def _slots(told: list[Sample]) -> Array:
    slots: list[list[float]] = []
    for sample in told:
        goal = sample.values.get("goal_position_enu_m")
        if sample.values.get("state") not in ("flying", "holding") or sample.values.get("order_kind") != "move":
            continue
        if not isinstance(goal, list) or len(goal) != 3 or not all(isinstance(value, (int, float)) for value in goal):
            continue
        if not slots or np.linalg.norm(np.subtract(slots[-1], goal)) > _SLOT_STEP_M:
            slots.append([float(value) for value in goal])
    return np.array(slots, np.float64).reshape(-1, 3)


def _pairs(tracks: tuple[Track, ...], grid_s: Array) -> tuple[Pair, ...]:
    places = {track.name: track.place_at(grid_s) for track in tracks}
    found = []
    for first, second in itertools.combinations(places, 2):
        one, two = places[first], places[second]
        distance_m = np.hypot(one[:, 0] - two[:, 0], one[:, 1] - two[:, 1])
        in_air = (one[:, 2] > _AIRBORNE_Z_M) | (two[:, 2] > _AIRBORNE_Z_M)
        found.append(Pair(first, second, np.where(in_air, distance_m, np.nan)))
    return tuple(found)
