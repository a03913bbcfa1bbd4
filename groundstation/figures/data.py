"""A flight record as arrays for the figures, on one time axis.

Time 0 is when the first vehicle leaves the ground.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from groundstation.recording.reader import (
    MAX_FLIGHT_NS,
    Sample,
    is_number,
    is_vector,
    of_one_flight,
)
from groundstation.recording.recorded_flight import IN_FLIGHT, at_times, has_lifted
from onboard.arrays import Array
from onboard.config.flight_space import Outline
from onboard.config.pair_separation import separations_m
from onboard.config.people import Person, body_of
from onboard.plain_text import natural_sort_key

TOPICS = ("truth", "tick", "telemetry")
POSES = "mocap"  # this topic is also read if the fleet has persons
GRID_S = 0.02
_LONGEST_START_NS = 600_000_000_000  # longest time from a record's start to its first vehicle
_LEAD_S = 1.0  # time before the start that is shown
_SLOT_STEP_M = 0.05  # largest distance of two goals that are the same slot


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
    path_enu_m: Array  # (m, 3): ground truth if is_truth, or else the vehicle's estimate
    is_up: Array  # (m,), 1 where the vehicle is off the ground, else 0
    is_truth: bool
    slots_enu_m: Array  # (k, 3): goals in the order of the orders

    def path_at(self, time_s: Array) -> Array:
        """Return positions (n, 3) at these times, NaN outside the record."""
        axes = [
            np.interp(time_s, self.path_time_s, self.path_enu_m[:, axis], np.nan, np.nan)
            for axis in range(3)
        ]
        return np.stack(axes, -1)


@dataclass(frozen=True, slots=True)
class Walk:
    """Where the motion capture saw a person."""

    name: str
    radius_m: float  # of the circle that the vehicles keep clear of
    time_s: Array  # (n,)
    position_enu_m: Array  # (n, 3), while the person was tracked

    def place_at(self, time_s: float) -> Array:
        """Return where the person was last seen before this time, or else first seen (3,)."""
        is_seen = np.isfinite(self.position_enu_m).all(-1)
        times_s = self.time_s[is_seen]
        before = int(np.searchsorted(times_s, time_s, side="right")) - 1
        place: Array = self.position_enu_m[is_seen][max(before, 0)]
        return place


@dataclass(frozen=True, slots=True)
class PairSeparation:
    """The distance of two vehicles over time."""

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
    # time 0 of the figures, in seconds of the record, which replay and verdict count
    take_off_s: float
    height_share: float = 0.0  # factor of height differences in separations
    outlines: tuple[Outline, ...] = ()  # of the fleet's fences and obstacles
    walks: tuple[Walk, ...] = ()  # of the persons who were seen

    @property
    def axis_s(self) -> tuple[float, float]:
        """Begin and end of a time axis; a short record has an axis, too."""
        begin_s = float(self.grid_s[0])
        return begin_s, max(float(self.grid_s[-1]), begin_s + 0.1)

    @property
    def source(self) -> str:
        """Source of the paths, in words."""
        if all(track.is_truth for track in self.tracks):
            return "ground truth"
        return "the vehicles' estimates"

    def closest(self) -> tuple[PairSeparation, int] | None:
        """Return the pair with the smallest distance, and the index of that time on the grid.

        Returns None if no vehicle flew.
        """
        known = [pair for pair in self.pairs if np.isfinite(pair.distance_m).any()]
        if not known:
            return None
        pair = min(known, key=lambda pair: float(np.nanmin(pair.distance_m)))
        return pair, int(np.nanargmin(pair.distance_m))


def from_samples(
    samples: Iterable[Sample],
    *,
    title: str,
    safety_distance_m: float,
    height_share: float = 0.0,
    outlines: tuple[Outline, ...] = (),
    people: Mapping[str, Person] = MappingProxyType({}),
    record_begin_ns: int | None = None,
) -> FlightData | None:
    """Convert the samples of a record.

    Args:
        samples: samples of the topics in TOPICS, and of POSES if there are persons.
        title: title of the flight.
        safety_distance_m: limit of the distance between two vehicles [m].
        height_share: factor of height differences in separations.
        outlines: outlines of the fleet's fences and obstacles.
        people: the persons of the fleet file, by name.
        record_begin_ns: stamp from which verdict and replay count the seconds of the record; None:
            the stamp of the first sample.

    Returns:
        The flight; None if no vehicle has two ticks.
    """
    by_topic = _sorted_samples(samples)
    ticks_by_name = by_topic["tick"]
    names = sorted(ticks_by_name, key=natural_sort_key)
    ticks = {name: ticks_by_name[name] for name in names if len(ticks_by_name[name]) > 1}
    if not ticks:
        return None
    truths = {name: by_topic["truth"].get(name, []) for name in ticks}

    start_ns = _start_ns(truths, ticks)
    tracks = tuple(
        _track(
            name,
            ticks=ticks[name],
            truth=truths[name],
            telemetry=by_topic["telemetry"].get(name, []),
            start_ns=start_ns,
        )
        for name in ticks
    )
    grid_s = _grid(tracks)

    first_stamps_ns = [
        samples[0].stamp_ns
        for by_name in by_topic.values()
        for samples in by_name.values()
        if samples
    ]
    begin_ns = min(first_stamps_ns)
    if record_begin_ns is not None and 0 <= begin_ns - record_begin_ns <= _LONGEST_START_NS:
        begin_ns = record_begin_ns
    take_off_s = (start_ns - begin_ns) * 1e-9
    return FlightData(
        title=f"{title} (take-off at {take_off_s:.1f} s of the record)",
        tracks=tracks,
        safety_distance_m=safety_distance_m,
        grid_s=grid_s,
        pairs=_pairs(tracks, grid_s, height_share),
        take_off_s=take_off_s,
        height_share=height_share,
        outlines=outlines,
        walks=_walks(by_topic[POSES], people, start_ns),
    )


def _sorted_samples(samples: Iterable[Sample]) -> dict[str, dict[str, list[Sample]]]:
    """Return the samples of one flight by topic and vehicle or body, sorted by stamp."""
    by_topic: dict[str, dict[str, list[Sample]]] = {topic: {} for topic in (*TOPICS, POSES)}
    for sample in samples:
        if sample.topic in by_topic:
            by_topic[sample.topic].setdefault(sample.name, []).append(sample)

    for by_name in by_topic.values():
        for name, own in by_name.items():
            by_name[name] = sorted(of_one_flight(own), key=lambda sample: sample.stamp_ns)
    return by_topic


def _grid(tracks: tuple[Track, ...]) -> Array:
    """Return the common time axis (n,) [s], from just before the start to the last path's end."""
    begin_s = max(-_LEAD_S, min(float(track.path_time_s[0]) for track in tracks))
    end_s = max(float(track.path_time_s[-1]) for track in tracks)
    end_s = min(end_s, begin_s + MAX_FLIGHT_NS * 1e-9)  # vehicles' clocks may be far apart
    if end_s <= begin_s:
        return np.array([begin_s])
    return np.arange(begin_s, end_s, GRID_S)


def _start_ns(truths: dict[str, list[Sample]], ticks: dict[str, list[Sample]]) -> int:
    """Return the stamp at which the first vehicle leaves the ground.

    The state "taking off" does not serve for this: it begins earlier, when the motors start. If no
    vehicle leaves the ground, the first tick counts.
    """
    lifted_ns = []
    for name, own_ticks in ticks.items():
        path = own_ticks
        if len(truths[name]) > 1:
            path = truths[name]
        height_m = _vectors(path, "position_enu_m", 3)[:, 2]
        lifted = np.flatnonzero(has_lifted(height_m))
        if lifted.size:
            lifted_ns.append(path[int(lifted[0])].stamp_ns)

    if lifted_ns:
        return min(lifted_ns)
    return min(own_ticks[0].stamp_ns for own_ticks in ticks.values())


def _track(
    name: str,
    *,
    ticks: list[Sample],
    truth: list[Sample],
    telemetry: list[Sample],
    start_ns: int,
) -> Track:
    """Return one vehicle's track from its samples."""
    has_truth = len(truth) > 1
    path = ticks
    if has_truth:
        path = truth
    return Track(
        name=name,
        time_s=_times(ticks, start_ns),
        position_enu_m=_vectors(ticks, "position_enu_m", 3),
        setpoint_position_enu_m=_vectors(ticks, "setpoint_position_enu_m", 3),
        thrust_baseline_enu_m_s2=_vectors(ticks, "thrust_baseline_enu_m_s2", 3),
        thrust_safe_enu_m_s2=_vectors(ticks, "thrust_safe_enu_m_s2", 3),
        commanded_deg=_roll_pitch_deg(_vectors(ticks, "setpoint_quaternion_enu_flu_wxyz", 4)),
        flown_deg=_roll_pitch_deg(_vectors(ticks, "attitude_quaternion_enu_flu_wxyz", 4)),
        path_time_s=_times(path, start_ns),
        path_enu_m=_vectors(path, "position_enu_m", 3),
        is_up=_is_up(path),
        is_truth=has_truth,
        slots_enu_m=_slots(telemetry),
    )


def _is_up(path: list[Sample]) -> Array:
    """Return where a vehicle is off the ground (m,): 1, else 0.

    Ground truth says it. Else the height above the first position counts, and so does the agent's
    state, because a record may begin in flight.
    """
    has_left = has_lifted(_vectors(path, "position_enu_m", 3)[:, 2])
    is_up = np.zeros(len(path))
    for index, sample in enumerate(path):
        is_on_ground = sample.values.get("is_on_ground")
        if isinstance(is_on_ground, bool):
            is_up[index] = not is_on_ground
        else:
            is_up[index] = has_left[index] or sample.values.get("state") in IN_FLIGHT
    return is_up


def _walks(
    poses: Mapping[str, list[Sample]], people: Mapping[str, Person], start_ns: int
) -> tuple[Walk, ...]:
    """Return the walks of the persons who were seen; ``poses`` are by body."""
    walks = []
    for name, person in people.items():
        own = poses.get(body_of(name, person), [])
        seen = [pose for pose in own if pose.values.get("is_tracked")]
        positions_enu_m = _vectors(seen, "position_enu_m", 3)
        if np.isfinite(positions_enu_m).all(-1).any():
            walks.append(Walk(name, person.radius_m, _times(seen, start_ns), positions_enu_m))
    return tuple(walks)


def _times(samples: list[Sample], start_ns: int) -> Array:
    return np.array([(sample.stamp_ns - start_ns) * 1e-9 for sample in samples], np.float64)


def _vectors(samples: list[Sample], field: str, size: int) -> Array:
    """Return a field (n, size); NaN in samples in which it is missing, null or of another size."""
    vectors = np.full((len(samples), size), np.nan)
    for index, sample in enumerate(samples):
        value = sample.values.get(field)
        if not isinstance(value, list) or len(value) != size:
            continue
        for part, entry in enumerate(value):
            if is_number(entry):
                vectors[index, part] = entry
    return vectors


def _roll_pitch_deg(quaternion_wxyz: Array) -> Array:
    w, x, y, z = np.moveaxis(quaternion_wxyz, -1, 0)
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    angles: Array = np.degrees(np.stack([roll, pitch], -1))
    return angles


def _slots(telemetry: list[Sample]) -> Array:
    """Return the goals (k, 3) of orders to move, in the order in which they were given."""
    slots_enu_m: list[list[float]] = []
    for sample in telemetry:
        is_flying = sample.values.get("state") in IN_FLIGHT
        if not is_flying or sample.values.get("order_kind") != "move":
            continue

        goal = sample.values.get("goal_position_enu_m")
        if not isinstance(goal, list) or not is_vector(goal, 3):
            continue

        is_first = not slots_enu_m
        if is_first or np.linalg.norm(np.subtract(slots_enu_m[-1], goal)) > _SLOT_STEP_M:
            slots_enu_m.append([float(axis_m) for axis_m in goal])
    return np.array(slots_enu_m, np.float64).reshape(-1, 3)


def _pairs(
    tracks: tuple[Track, ...], grid_s: Array, height_share: float
) -> tuple[PairSeparation, ...]:
    paths_enu_m = {track.name: track.path_at(grid_s) for track in tracks}
    is_up = {
        track.name: at_times(track.path_time_s, track.is_up, grid_s, math.inf) > 0.0
        for track in tracks
    }

    pairs = []
    for first, second in itertools.combinations(paths_enu_m, 2):
        distance_m = separations_m(paths_enu_m[first] - paths_enu_m[second], height_share)
        in_air = is_up[first] | is_up[second]
        pairs.append(PairSeparation(first, second, np.where(in_air, distance_m, np.nan)))
    return tuple(pairs)
