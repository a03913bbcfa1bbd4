"""A flight record as arrays for the figures, on one time axis.

Time 0 is when the first vehicle leaves the ground, or the start of a record in which none does. A
record of an hour has hundreds of thousands of messages, so only the fields that the figures need
are kept, as plain numbers.

A record may have gaps, for instance where a radio failed. In each gap stands a sample of NaN, so
that no line crosses it, and no position in it is made up.
"""

from __future__ import annotations

import itertools
import math
from array import array
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from groundstation.recording.reader import (
    MAX_FLIGHT_NS,
    Sample,
    indexes_by_time,
    is_number,
)
from groundstation.recording.recorded_flight import (
    PATH_GAP_S,
    at_times,
    is_off_ground,
    lift_off_index,
)
from onboard.arrays import Array, BoolArray, IntArray
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
_IN_FLIGHT = ("flying", "holding")  # states of an agent whose vehicle may move to a goal

# kept vectors of each topic, with their sizes
_VECTORS = {
    "truth": {"position_enu_m": 3},
    "tick": {
        "position_enu_m": 3,
        "setpoint_position_enu_m": 3,
        "thrust_baseline_enu_m_s2": 3,
        "thrust_safe_enu_m_s2": 3,
        "setpoint_quaternion_enu_flu_wxyz": 4,
        "attitude_quaternion_enu_flu_wxyz": 4,
    },
    "telemetry": {"goal_position_enu_m": 3},
    POSES: {"position_enu_m": 3},
}


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
        """Return positions (n, 3) at these times, NaN outside the record and in its gaps."""
        axes = [
            np.interp(time_s, self.path_time_s, self.path_enu_m[:, axis], np.nan, np.nan)
            for axis in range(3)
        ]
        return np.stack(axes, -1)

    def is_up_at(self, time_s: Array) -> BoolArray:
        """Return whether the vehicle is off the ground (n,) at these times."""
        is_up: BoolArray = at_times(self.path_time_s, self.is_up, time_s, math.inf) > 0.0
        return is_up


@dataclass(frozen=True, slots=True)
class Walk:
    """Where the motion capture saw a person."""

    name: str
    radius_m: float  # of the circle that the vehicles keep clear of
    time_s: Array  # (n,)
    position_enu_m: Array  # (n, 3), NaN in gaps and while the person is not tracked

    def position_at(self, time_s: float) -> Array:
        """Return where the person was last seen before this time, or else first seen (3,)."""
        is_seen = np.isfinite(self.position_enu_m).all(-1)
        times_s = self.time_s[is_seen]
        before = int(np.searchsorted(times_s, time_s, side="right")) - 1
        position: Array = self.position_enu_m[is_seen][max(before, 0)]
        return position


@dataclass(frozen=True, slots=True)
class PairSeparation:
    """The distance of two vehicles over time."""

    first: str
    second: str
    # separation, on the flight's grid; NaN while neither flies, or one of them is not known
    distance_m: Array


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
    took_off: bool = True  # whether any vehicle left the ground
    height_share: float = 0.0  # factor of height differences in separations
    outlines: tuple[Outline, ...] = ()  # of the fleet's fences and obstacles
    walks: tuple[Walk, ...] = ()  # of the persons who were seen

    @property
    def axis_s(self) -> tuple[float, float]:
        """Begin and end of a time axis; a short record has an axis, too."""
        begin_s = float(self.grid_s[0])
        return begin_s, max(float(self.grid_s[-1]), begin_s + 0.1)

    @property
    def time_label(self) -> str:
        """Name of the time axis."""
        if self.took_off:
            return "time since take-off [s]"
        return "time in the record [s]"

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
    by_topic = _series_by_topic(samples)
    ticks_by_name = by_topic["tick"]
    ticking = {name for name, own_ticks in ticks_by_name.items() if own_ticks.size > 1}
    if not ticking:
        return None
    truths = {name: truth for name, truth in by_topic["truth"].items() if truth.size > 1}

    # A vehicle without ticks, whose agent did not run, has a path and distances, too.
    without_ticks = _Collected("tick").series()
    ticks = {
        name: ticks_by_name.get(name, without_ticks)
        for name in sorted(ticking | set(truths), key=natural_sort_key)
    }

    telemetry = by_topic["telemetry"]
    is_up = {
        name: _is_up(truths.get(name, own_ticks), telemetry.get(name))
        for name, own_ticks in ticks.items()
    }
    begin_ns = min(
        int(series.stamps_ns[0]) for by_name in by_topic.values() for series in by_name.values()
    )
    if record_begin_ns is not None and 0 <= begin_ns - record_begin_ns <= _LONGEST_START_NS:
        begin_ns = record_begin_ns

    lift_off_ns = _lift_off_ns(truths, ticks, is_up)
    start_ns = begin_ns
    start_words = "nobody took off"
    if lift_off_ns is not None:
        start_ns = lift_off_ns
        start_words = f"take-off at {(start_ns - begin_ns) * 1e-9:.1f} s of the record"

    tracks = tuple(
        _track(
            name,
            ticks=ticks[name],
            truth=truths.get(name),
            telemetry=telemetry.get(name),
            is_up=is_up[name],
            start_ns=start_ns,
        )
        for name in ticks
    )
    grid_s = _grid(tracks)
    return FlightData(
        title=f"{title} ({start_words})",
        tracks=tracks,
        safety_distance_m=safety_distance_m,
        grid_s=grid_s,
        pairs=_pairs(tracks, grid_s, height_share),
        take_off_s=(start_ns - begin_ns) * 1e-9,
        took_off=lift_off_ns is not None,
        height_share=height_share,
        outlines=outlines,
        walks=_walks(by_topic[POSES], people, start_ns),
    )


class _Series(NamedTuple):
    """Samples of one channel within the flight, in the order of time; NaN in gaps."""

    stamps_ns: IntArray  # (n,)
    vectors: dict[str, Array]  # field -> (n, size); NaN where missing, null or of another size
    marks: Array  # (n,): see _mark
    is_up: Array  # (n,): see _said_up

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.stamps_ns.size


class _Collected:
    """The kept fields of one channel, while the samples are read."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._stamps_ns = array("q")
        self._numbers = {field: array("d") for field in _VECTORS[topic]}
        self._marks = array("d")
        self._is_up = array("d")

    def add(self, sample: Sample) -> None:
        """Add a sample."""
        self._stamps_ns.append(sample.stamp_ns)
        for field, size in _VECTORS[self._topic].items():
            self._numbers[field].extend(_vector(sample.values.get(field), size))
        self._marks.append(_mark(self._topic, sample.values))
        self._is_up.append(_said_up(sample.values))

    def series(self) -> _Series:
        """Return the samples that are of one flight."""
        stamps_ns = np.array(self._stamps_ns, np.int64)
        kept = indexes_by_time(stamps_ns)
        stamps_ns = stamps_ns[kept]

        lengths_ns = np.diff(stamps_ns)
        gaps = np.flatnonzero(lengths_ns > PATH_GAP_S * 1e9) + 1  # indexes of the samples after
        middles_ns = stamps_ns[gaps] - lengths_ns[gaps - 1] // 2

        sizes = _VECTORS[self._topic]
        return _Series(
            stamps_ns=np.insert(stamps_ns, gaps, middles_ns),
            vectors={
                field: np.insert(
                    np.reshape(numbers, (-1, sizes[field]))[kept], gaps, np.nan, axis=0
                )
                for field, numbers in self._numbers.items()
            },
            marks=np.insert(np.array(self._marks)[kept], gaps, np.nan),
            is_up=np.insert(np.array(self._is_up)[kept], gaps, np.nan),
        )


def _series_by_topic(samples: Iterable[Sample]) -> dict[str, dict[str, _Series]]:
    """Return the samples of one flight by topic and vehicle or body."""
    collected: dict[str, dict[str, _Collected]] = {topic: {} for topic in _VECTORS}
    for sample in samples:
        by_name = collected.get(sample.topic)
        if by_name is None:
            continue
        if sample.name not in by_name:
            by_name[sample.name] = _Collected(sample.topic)
        by_name[sample.name].add(sample)
    return {
        topic: {name: own.series() for name, own in by_name.items()}
        for topic, by_name in collected.items()
    }


def _vector(value: object, size: int) -> list[float]:
    """Return a field's numbers; NaN for those that are missing."""
    if not isinstance(value, list) or len(value) != size:
        return [math.nan] * size
    return [entry if is_number(entry) else math.nan for entry in value]


def _mark(topic: str, values: Mapping[str, Any]) -> float:
    """Return what a sample says beside its vectors.

    Of telemetry: 1 if the vehicle moves to a goal, else 0. Of a pose: 1 if the body is tracked,
    else 0. Of others: NaN.
    """
    if topic == "telemetry":
        state = values.get("state")
        is_in_flight = isinstance(state, str) and state in _IN_FLIGHT
        return float(is_in_flight and values.get("order_kind") == "move")
    if topic == POSES:
        return float(bool(values.get("is_tracked")))
    return math.nan


def _said_up(values: Mapping[str, Any]) -> float:
    """Return 1 if truth or telemetry says that a vehicle is up, 0 if it is not, else NaN."""
    is_on_ground = values.get("is_on_ground")
    if isinstance(is_on_ground, bool):
        return float(not is_on_ground)
    is_airborne = values.get("is_airborne")
    if isinstance(is_airborne, bool):
        return float(is_airborne)
    return math.nan


def _grid(tracks: tuple[Track, ...]) -> Array:
    """Return the common time axis (n,) [s], from just before the start to the last path's end."""
    begin_s = max(-_LEAD_S, min(float(track.path_time_s[0]) for track in tracks))
    end_s = max(float(track.path_time_s[-1]) for track in tracks)
    end_s = min(end_s, begin_s + MAX_FLIGHT_NS * 1e-9)  # vehicles' clocks may be far apart
    if end_s <= begin_s:
        return np.array([begin_s])
    return np.arange(begin_s, end_s, GRID_S)


def _lift_off_ns(
    truths: Mapping[str, _Series], ticks: Mapping[str, _Series], is_up: Mapping[str, Array]
) -> int | None:
    """Return the stamp at which the first vehicle leaves the ground; None if none does.

    The state "taking off" does not serve for this: it begins earlier, when the motors start.
    """
    lifted_ns = []
    for name, own_ticks in ticks.items():
        path = truths.get(name, own_ticks)
        height_m = path.vectors["position_enu_m"][:, 2]
        index = lift_off_index(is_up[name] > 0.0, height_m)
        if index is not None:
            lifted_ns.append(int(path.stamps_ns[index]))

    return min(lifted_ns, default=None)


def _track(
    name: str,
    *,
    ticks: _Series,
    truth: _Series | None,
    telemetry: _Series | None,
    is_up: Array,
    start_ns: int,
) -> Track:
    """Return one vehicle's track from its samples."""
    path = ticks
    if truth is not None:
        path = truth
    slots_enu_m = np.zeros((0, 3))
    if telemetry is not None:
        slots_enu_m = _slots(telemetry)

    own = ticks.vectors
    return Track(
        name=name,
        time_s=_times(ticks.stamps_ns, start_ns),
        position_enu_m=own["position_enu_m"],
        setpoint_position_enu_m=own["setpoint_position_enu_m"],
        thrust_baseline_enu_m_s2=own["thrust_baseline_enu_m_s2"],
        thrust_safe_enu_m_s2=own["thrust_safe_enu_m_s2"],
        commanded_deg=_roll_pitch_deg(own["setpoint_quaternion_enu_flu_wxyz"]),
        flown_deg=_roll_pitch_deg(own["attitude_quaternion_enu_flu_wxyz"]),
        path_time_s=_times(path.stamps_ns, start_ns),
        path_enu_m=path.vectors["position_enu_m"],
        is_up=is_up,
        is_truth=truth is not None,
        slots_enu_m=slots_enu_m,
    )


def _is_up(path: _Series, telemetry: _Series | None) -> Array:
    """Return where a vehicle is off the ground (m,): 1, else 0.

    Ground truth says it, or else the telemetry, as ``is_off_ground`` describes.
    """
    begin_ns = int(path.stamps_ns[0])
    telemetry_s = np.zeros(0)
    is_airborne = np.zeros(0)
    if telemetry is not None:
        telemetry_s = _times(telemetry.stamps_ns, begin_ns)
        is_airborne = telemetry.is_up

    path_s = _times(path.stamps_ns, begin_ns)
    height_m = path.vectors["position_enu_m"][:, 2]
    has_left = is_off_ground(telemetry_s, is_airborne, path_s, height_m)
    return np.where(np.isnan(path.is_up), has_left, path.is_up)


def _walks(
    poses: Mapping[str, _Series], people: Mapping[str, Person], start_ns: int
) -> tuple[Walk, ...]:
    """Return the walks of the persons who were seen; ``poses`` are by body."""
    walks = []
    for name, person in people.items():
        own = poses.get(body_of(name, person))
        if own is None:
            continue
        is_tracked = own.marks > 0.0  # not so in gaps
        positions_enu_m = own.vectors["position_enu_m"].copy()
        positions_enu_m[~is_tracked] = np.nan
        if np.isfinite(positions_enu_m).all(-1).any():
            times_s = _times(own.stamps_ns, start_ns)
            walks.append(Walk(name, person.radius_m, times_s, positions_enu_m))
    return tuple(walks)


def _times(stamps_ns: IntArray, start_ns: int) -> Array:
    times_s: Array = (stamps_ns - start_ns).astype(np.float64) * 1e-9
    return times_s


def _roll_pitch_deg(quaternion_wxyz: Array) -> Array:
    w, x, y, z = np.moveaxis(quaternion_wxyz, -1, 0)
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    angles: Array = np.degrees(np.stack([roll, pitch], -1))
    return angles


def _slots(telemetry: _Series) -> Array:
    """Return the goals (k, 3) of orders to move, in the order in which they were given."""
    goals_enu_m = telemetry.vectors["goal_position_enu_m"]
    is_goal = (telemetry.marks > 0.0) & np.isfinite(goals_enu_m).all(-1)

    slots_enu_m: list[Array] = []
    for goal_m in goals_enu_m[is_goal]:
        is_first = not slots_enu_m
        if is_first or np.linalg.norm(slots_enu_m[-1] - goal_m) > _SLOT_STEP_M:
            slots_enu_m.append(goal_m)
    return np.array(slots_enu_m, np.float64).reshape(-1, 3)


def _pairs(
    tracks: tuple[Track, ...], grid_s: Array, height_share: float
) -> tuple[PairSeparation, ...]:
    paths_enu_m = {track.name: track.path_at(grid_s) for track in tracks}
    is_up = {track.name: track.is_up_at(grid_s) for track in tracks}

    pairs = []
    for first, second in itertools.combinations(paths_enu_m, 2):
        distance_m = separations_m(paths_enu_m[first] - paths_enu_m[second], height_share)
        in_air = is_up[first] | is_up[second]
        pairs.append(PairSeparation(first, second, np.where(in_air, distance_m, np.nan)))
    return tuple(pairs)
