"""What this agent knows of the others: newest state message and telemetry of each, on our own clock."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.bus.codec import is_finite
from onboard.bus.schema import MocapPose, StateMessage, Telemetry
from onboard.config.fleet import FleetConfig
from onboard.neighbours import subscription
from onboard.neighbours.mocap_tracker import POSITION_STD_M, VELOCITY_STD_M_S, BodyTracker
from onboard.neighbours.state_arrays import (
    COLUMNS,
    COLUMNS_1,
    LARGEST,
    StateArrays,
    is_usable,
    neighbour_of,
    no_states,
    numbers_of,
)
from onboard.types import Neighbour

SILENT_S = 0.25  # with two ticks of confirmation a silence is acted on within 0.3 s
STALE_S = 0.15
_SEEK_S = 0.12  # from this age of its messages on a neighbour is looked for in the mocap
_SEEK_AFTER_NS = 2_000_000_000
_BELIEVED_S = 1.0
_ON_FLOOR_M = 0.15
_FORGET_NODE_S = 2.0


class NeighbourRow(NamedTuple):
    """One neighbour: age and stamp of what is known of it, whether it says that it cooperates, and its numbers."""

    name: str
    age_s: float
    stamp_ns: int
    is_cooperative: bool
    numbers: list[float]

    def value(self, name: str) -> float:
        """A scalar of its message."""
        return self.numbers[COLUMNS_1[name]]

    def vector(self, name: str) -> list[float]:
        """A vector of its message."""
        return self.numbers[COLUMNS[name]]


class _Ages(NamedTuple):
    """Ages at one time, which several ask for at each tick."""

    now_ns: int
    all_s: Array  # (K,) inf when never heard
    near_s: list[float]  # of those that are followed
    oldest_s: float  # of those that are followed
    has_silent: bool


class _Following(NamedTuple):
    """The neighbours whose states are heard at full rate."""

    names: frozenset[str]
    near: list[str]  # the same in the order of the table
    at: IntArray  # their indexes


@dataclass(slots=True)
class NeighbourTable:
    """Newest state and telemetry of each neighbour.

    The order is fixed: the fleet file's enabled vehicles without our own, so that an index never changes. When a
    neighbour is silent for a while, its entry holds what the mocap shows of it instead, and it does not cooperate.
    """

    fleet: FleetConfig
    own_name: str
    names: tuple[str, ...] = field(init=False)
    ignored_messages: int = 0
    last_heard_ns: int = 0
    distrusted: set[int] = field(default_factory=set)  # indexes of vehicles whose promise to cooperate does not count
    arrays: StateArrays = field(init=False)
    order_index: IntArray = field(init=False)  # (K,) of each neighbour among all enabled vehicles
    is_successor: BoolArray = field(init=False)  # (K,) the next vehicle of the paper's ring
    _index: dict[str, int] = field(init=False)
    _bodies: dict[str, int] = field(init=False)
    _trackers: dict[int, BodyTracker] = field(default_factory=dict)
    _first_ns: int = 0
    _telemetry: dict[str, Telemetry] = field(default_factory=dict)
    _reach_m: float = field(init=False)
    _following: _Following = field(init=False)
    _ages: _Ages = field(init=False)

    def __post_init__(self) -> None:
        order = self.fleet.enabled_names
        self.names = tuple(name for name in order if name != self.own_name)
        self._index = {name: index for index, name in enumerate(self.names)}
        others = [index for index, name in enumerate(order) if name != self.own_name]
        self.order_index = np.array(others, dtype=np.int64)
        own = order.index(self.own_name) if self.own_name in order else 0
        successor = order[(own + 1) % len(order)] if order else ""
        self.is_successor = np.array([name == successor for name in self.names], dtype=bool)
        self.arrays = no_states(len(self.names), SILENT_S)
        self._reach_m = subscription.reach_m(self.fleet, self.own_name)
        self._ages = _Ages(-1, np.full(len(self.names), np.inf), [], 0.0, True)
        self._follow(frozenset(self.names))
        bodies = [(self.fleet.vehicles[name].body, index) for name, index in self._index.items()]
        self._bodies = {body: index for body, index in bodies if body is not None}

    @property
    def followed(self) -> frozenset[str]:
        """Whose states are to be heard at full rate; all of them at first."""
        return self._following.names

    def choose(self, position_enu_m: tuple[float, float, float], now_ns: int) -> bool:
        """Choose anew whom to follow, from where we are; whether that changed anything."""
        if len(self.names) <= subscription.ALWAYS_FOLLOWED:
            return False
        ahead_s = np.minimum(self.ages_s(now_ns), subscription.FAR_SILENT_S)[:, None]
        ahead = self.arrays.numbers[:, :2] + ahead_s * self.arrays.numbers[:, 3:5]
        far_m = np.hypot(ahead[:, 0] - position_enu_m[0], ahead[:, 1] - position_enu_m[1]).tolist()
        is_placed = self.arrays.is_known.tolist()
        placed = {name: far for name, far, known in zip(self.names, far_m, is_placed, strict=True) if known}
        unplaced = {name for name in self._telemetry if name not in placed}.union(self.silent(now_ns), self.invalid())
        found = subscription.select(placed, frozenset(unplaced), self._following.names, self._reach_m)
        if found == self._following.names:
            return False
        self._follow(found)
        return True

    def _follow(self, names: frozenset[str]) -> None:
        near = [name for name in self.names if name in names]
        at = np.array([self._index[name] for name in near], dtype=np.int64)
        self._following = _Following(names, near, at)
        arrays = self.arrays
        arrays.is_followed[:] = False
        arrays.is_followed[at] = True
        arrays.silent_after_s[:] = np.where(arrays.is_followed, SILENT_S, subscription.FAR_SILENT_S)
        self.set_ages(self._ages.all_s, -1, True)

    def hear(self, message: StateMessage | Telemetry, received_ns: int) -> bool:
        """Take a message with its stamp on our clock; False when from nobody we know, repeated, late or not finite."""
        index = self._index.get(message.vehicle)
        if index is None:
            return False
        self.last_heard_ns = max(self.last_heard_ns, received_ns)
        if isinstance(message, Telemetry):
            if not _is_sound(message):
                self.ignored_messages += 1
                return False
            self._telemetry[message.vehicle] = message
            return True
        arrays = self.arrays
        boot_id, sequence = arrays.newest[:, index].tolist()
        numbers, stamp_ns = numbers_of(message), min(message.stamp_ns, received_ns)  # nothing comes from the future
        is_same_boot = boot_id == message.boot_id
        # out of order, or of an earlier start of that agent
        is_old = message.sequence <= sequence if is_same_boot else stamp_ns < arrays.heard_ns[index]
        if is_old or not is_usable(message, numbers):
            self.ignored_messages += 1
            return False
        arrays.newest[:, index] = message.boot_id, message.sequence
        arrays.is_lost[index] = not message.is_valid
        if not message.is_valid:
            return True  # it knows no position: the last valid one ages, and is avoided like a silent vehicle's
        arrays.stamp_ns[index] = arrays.heard_ns[index] = stamp_ns
        arrays.numbers[index] = numbers
        arrays.is_known[index], arrays.is_airborne[index] = True, message.is_airborne
        arrays.is_promised[index] = message.is_cooperative
        arrays.is_cooperative[index] = message.is_cooperative and index not in self.distrusted
        self._ages = self._ages._replace(now_ns=-1)
        return True

    def see(self, pose: MocapPose, received_ns: int) -> bool:
        """Take a neighbour's mocap pose; it counts only while the neighbour says nothing."""
        index = self._bodies.get(pose.body)
        if index is None:
            return False
        arrays = self.arrays
        tracker = self._trackers.get(index)
        if tracker is None:
            tracker = self._trackers[index] = BodyTracker()
        if not tracker.stamp_ns and received_ns - int(arrays.heard_ns[index]) < _BELIEVED_S * 1e9:
            x, y, z = arrays.numbers[index, COLUMNS["velocity_enu_m_s"]].tolist()
            tracker.velocity_enu_m_s = (x, y, z)
        if not tracker.hear(pose, received_ns):
            return False
        if received_ns - int(arrays.heard_ns[index]) < _SEEK_S * 1e9:
            return True
        p, v, none = tracker.position_enu_m, tracker.velocity_enu_m_s, (0.0, 0.0, 0.0)
        arrays.numbers[index] = (*p, *v, *none, *p, *v, *none, *v, POSITION_STD_M, 0.0, 0.0, VELOCITY_STD_M_S)
        arrays.stamp_ns[index] = min(tracker.stamp_ns, received_ns)
        floor_m = self.fleet.vehicles[self.names[index]].start_enu_m[2]
        arrays.is_known[index], arrays.is_airborne[index] = True, p[2] > floor_m + _ON_FLOOR_M
        arrays.is_cooperative[index] = arrays.is_promised[index] = False
        self._ages = self._ages._replace(now_ns=-1)
        return True

    def sought(self, now_ns: int) -> list[str]:
        """Bodies that are to be looked for in the mocap, since vehicles that are followed have begun to be silent."""
        self._first_ns = self._first_ns or now_ns
        ages_s = self.ages_s(now_ns)
        if self._ages.oldest_s < _SEEK_S or len(self._trackers) == len(self._bodies):
            return []
        is_settled = now_ns - self._first_ns > _SEEK_AFTER_NS  # an agent that starts has not heard anybody yet
        bodies = []
        for body, index in self._bodies.items():
            age_s = ages_s[index]
            is_sought = self.arrays.is_followed[index] and index not in self._trackers
            if is_sought and age_s > _SEEK_S and (is_settled or age_s < math.inf):
                self._trackers[index] = BodyTracker()
                bodies.append(body)
        return bodies

    def hear_telemetry(self, arrived: Mapping[str, Telemetry], received_ns: int) -> None:
        """:meth:`hear` of the telemetry of several vehicles, by name; our own is passed over."""
        if arrived:
            self.last_heard_ns = max(self.last_heard_ns, received_ns)
            self._telemetry.update(arrived)
            self._telemetry.pop(self.own_name, None)

    def ages_s(self, now_ns: int) -> Array:
        """Age (K,) of the newest state of each; inf when never heard."""
        if self._ages.now_ns != now_ns:
            arrays = self.arrays
            ages_s = np.where(arrays.is_known, np.maximum(now_ns - arrays.stamp_ns, 0) * 1e-9, np.inf)
            self.set_ages(ages_s, now_ns, bool((ages_s > arrays.silent_after_s).any()))
        return self._ages.all_s

    def set_ages(self, ages_s: Array, now_ns: int, has_silent: bool) -> None:
        """Take the ages (K,) at a time, and whether one of them is a silence; for those who know them already."""
        near_s = ages_s[self._following.at].tolist()
        self._ages = _Ages(now_ns, ages_s, near_s, max(near_s, default=0.0), has_silent)

    def near_ages_s(self, now_ns: int) -> dict[str, float]:
        """Age of the newest state of each vehicle that is followed and was ever heard."""
        self.ages_s(now_ns)
        near = zip(self._following.near, self._ages.near_s, strict=True)
        if self._ages.oldest_s < math.inf:
            return dict(near)
        return {name: age_s for name, age_s in near if age_s < math.inf}

    def age_s(self, name: str, now_ns: int) -> float:
        """Age of the newest state; inf when never heard."""
        index, arrays = self._index[name], self.arrays
        return max(0.0, (now_ns - int(arrays.stamp_ns[index])) * 1e-9) if arrays.is_known[index] else math.inf

    def oldest_age_s(self, now_ns: int) -> float:
        """Largest age of all that are followed and were ever heard; 0 without any."""
        return max(self.near_ages_s(now_ns).values(), default=0.0)

    def heard_ages_s(self, now_ns: int) -> Array:
        """Age (K,) of the newest message of each; that of a body which only the mocap shows grows; inf when never."""
        if not self._trackers:
            return self.ages_s(now_ns)
        heard_ns = self.arrays.heard_ns
        return np.where(heard_ns > 0, np.maximum(now_ns - heard_ns, 0) * 1e-9, np.inf)

    def rows(self, now_ns: int) -> list[NeighbourRow]:
        """Entries of all that are followed, for conditions that regard single neighbours."""
        self.ages_s(now_ns)
        arrays, following = self.arrays, self._following
        columns = (
            following.near,
            self._ages.near_s,
            arrays.stamp_ns[following.at].tolist(),
            (arrays.is_promised & arrays.is_known)[following.at].tolist(),
            arrays.numbers[following.at].tolist(),
        )
        return [NeighbourRow(*row) for row in zip(*columns, strict=True)]

    def set_distrusted(self, name: str, is_distrusted: bool) -> None:
        """Let a vehicle's announcement that it cooperates count, or not."""
        (self.distrusted.add if is_distrusted else self.distrusted.discard)(self._index[name])

    def missing(self, now_ns: int) -> tuple[str, ...]:
        """Vehicles that must be there (enabled = true) and are not heard."""
        names = self._named(self.heard_ages_s(now_ns) > _FORGET_NODE_S)
        return tuple(name for name in names if self.fleet.vehicles[name].enabled is True)

    def silent(self, now_ns: int) -> tuple[str, ...]:
        """Vehicles that were in the air when last heard and have been silent too long."""
        self.ages_s(now_ns)
        if not self._ages.has_silent and not self._trackers:
            return ()
        return self._named(self.arrays.is_airborne & (self.heard_ages_s(now_ns) > self.arrays.silent_after_s))

    def unseen(self, now_ns: int) -> tuple[str, ...]:
        """Those of the silent vehicles that the mocap does not show either."""
        arrays = self.arrays
        is_old = self.ages_s(now_ns) > arrays.silent_after_s
        return self._named(arrays.is_airborne & is_old & (self.heard_ages_s(now_ns) > arrays.silent_after_s))

    def stale(self, now_ns: int) -> tuple[str, ...]:
        """Vehicles in the air that are followed and whose messages are old, though not yet silent."""
        self.ages_s(now_ns)
        if self._ages.oldest_s <= STALE_S and not self._trackers:
            return ()
        ages_s = self.heard_ages_s(now_ns)
        is_meant = self.arrays.is_airborne & self.arrays.is_followed
        return self._named(is_meant & (ages_s > STALE_S) & (ages_s <= SILENT_S))

    def invalid(self) -> tuple[str, ...]:
        """Vehicles in the air that say that they know no position."""
        return self._named(self.arrays.is_lost & self.arrays.is_airborne)

    def _named(self, is_meant: BoolArray) -> tuple[str, ...]:
        return tuple(itertools.compress(self.names, is_meant.tolist())) if is_meant.any() else ()

    def other_hashes(self, own_hash: str) -> dict[str, str]:
        """Configuration hashes that differ from ours."""
        return {
            name: telemetry.config_hash
            for name, telemetry in self._telemetry.items()
            if telemetry.config_hash != own_hash
        }

    def telemetries(self) -> dict[str, Telemetry]:
        """Newest telemetry of all that sent one."""
        return {name: self._telemetry[name] for name in self.names if name in self._telemetry}

    def distances_m(self, position_enu_m: tuple[float, float, float], now_ns: int) -> dict[str, float]:
        """Horizontal distance to each vehicle that is followed, extrapolated over at most the silence limit."""
        x, y, _ = position_enu_m
        self.ages_s(now_ns)
        following, distances_m = self._following, {}
        motions = self.arrays.numbers[following.at, :5].tolist()
        for name, age_s, (px, py, _, vx, vy) in zip(following.near, self._ages.near_s, motions, strict=True):
            if age_s < math.inf:
                ahead_s = min(age_s, SILENT_S)
                distances_m[name] = math.hypot(px + ahead_s * vx - x, py + ahead_s * vy - y)
        return distances_m

    def snapshot(self, now_ns: int) -> list[Neighbour]:
        """Return all neighbours that were ever heard, as of one tick; a silent or grounded one does not cooperate."""
        ages_s, arrays = self.ages_s(now_ns), self.arrays
        columns = (
            arrays.is_known.tolist(),
            arrays.numbers.tolist(),
            ages_s.tolist(),
            (arrays.is_cooperative & (ages_s <= arrays.silent_after_s)).tolist(),
            self.is_successor.tolist(),
            range(len(self.names)),
        )
        return [neighbour_of(*entry) for is_known, *entry in zip(*columns, strict=True) if is_known]


def _is_sound(message: Telemetry) -> bool:
    """Whether what is used of a telemetry can be calculated with."""
    vectors = message.position_enu_m, message.goal_position_enu_m
    return is_finite(*vectors) and all(abs(value) < LARGEST for vector in vectors for value in vector)
