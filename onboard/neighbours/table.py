"""What this agent knows of the others: newest state message and telemetry of each, on our own clock."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.bus.codec import is_finite
from onboard.bus.schema import MocapPose, StateMessage, Telemetry
from onboard.config.fleet import FleetConfig
from onboard.neighbours import subscription
from onboard.neighbours.mocap_tracker import POSITION_STD_M, VELOCITY_STD_M_S, BodyTracker
from onboard.types import Neighbour
from onboard.vectors import Vec3

SILENT_S = 0.25  # with two ticks of confirmation a silence is acted on within 0.3 s
STALE_S = 0.15
_SEEK_S = 0.12  # from this age of its messages on a neighbour is looked for in the mocap
_SEEK_AFTER_NS = 2_000_000_000
_BELIEVED_S = 1.0
_ON_FLOOR_M = 0.15
_LARGEST = 1e4
_LARGEST_INT = 1 << 62
_FORGET_NODE_S = 2.0


_VECTORS = (
    "position_enu_m",
    "velocity_enu_m_s",
    "acceleration_enu_m_s2",
    "predicted_position_enu_m",
    "predicted_velocity_enu_m_s",
    "commanded_acceleration_enu_m_s2",
    "intent_enu_m_s",
)
_SCALARS = ("position_std_m", "crowd_count", "lead_time_s", "velocity_std_m_s")
COLUMNS = {name: slice(3 * place, 3 * place + 3) for place, name in enumerate(_VECTORS)}
COLUMNS_1 = {name: 3 * len(_VECTORS) + place for place, name in enumerate(_SCALARS)}
WIDTH = 3 * len(_VECTORS) + len(_SCALARS)
_vectors_of, _scalars_of = attrgetter(*_VECTORS), attrgetter(*_SCALARS)


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


@dataclass(slots=True)
class NeighbourTable:
    """Fixed order: the fleet file's enabled vehicles without our own; so that array places never change.

    Rows (K, ...) hold the newest valid state message of each: its numbers, and its stamp on our clock. When it says
    nothing for a while, the row holds what the mocap sees of it instead, and it does not cooperate.
    distrusted: vehicles whose word does not count, by place.
    """

    fleet: FleetConfig
    own_name: str
    names: tuple[str, ...] = field(init=False)
    ignored_messages: int = 0
    last_heard_ns: int = 0
    _places: dict[str, int] = field(init=False)
    _others: IntArray = field(init=False)
    _is_successor: BoolArray = field(init=False)
    _numbers: Array = field(init=False)
    _stamp_ns: IntArray = field(init=False)
    _newest: IntArray = field(init=False)  # boot id and sequence of the newest message, (2, K)
    _flags: BoolArray = field(init=False)  # is there one at all, airborne, cooperative, says that it is, (4, K)
    _heard_ns: IntArray = field(init=False)  # stamp of the newest valid message, on our clock; 0 never
    _is_lost: BoolArray = field(init=False)  # whether the newest message said that it knows no position
    _bodies: dict[str, int] = field(init=False)
    _seen: dict[int, BodyTracker] = field(default_factory=dict)
    _first_ns: int = 0
    distrusted: set[int] = field(default_factory=set)
    _telemetry: dict[str, Telemetry] = field(default_factory=dict)
    _reach_m: float = field(init=False)
    _followed: frozenset[str] = frozenset()
    _is_followed: BoolArray = field(init=False)
    _silent_after_s: Array = field(init=False)
    _near: list[str] = field(init=False)  # the names followed and their places, in the order of the table
    _near_places: IntArray = field(init=False)
    _aged_ns: int = -1  # the time of the ages below, which several ask for at each tick
    _ages_s: Array = field(init=False)
    _near_ages_s: list[float] = field(init=False)
    _oldest_s: float = math.inf
    _has_silent: bool = True

    def __post_init__(self) -> None:
        order = self.fleet.enabled_names
        self.names = tuple(name for name in order if name != self.own_name)
        self._places = {name: place for place, name in enumerate(self.names)}
        self._others = np.array([place for place, name in enumerate(order) if name != self.own_name], dtype=np.int64)
        count = len(self.names)
        own = order.index(self.own_name) if self.own_name in order else 0
        successor = order[(own + 1) % len(order)] if order else ""
        self._is_successor = np.array([name == successor for name in self.names], dtype=bool)
        self._numbers = np.zeros((count, WIDTH))
        self._stamp_ns = np.zeros(count, dtype=np.int64)
        self._newest = np.array([[0], [-1]], dtype=np.int64).repeat(count, axis=1)
        self._flags = np.zeros((4, count), dtype=bool)
        self._ages_s = np.full(count, np.inf)
        self._reach_m = subscription.reach_m(self.fleet, self.own_name)
        self._is_followed, self._silent_after_s = np.ones(count, dtype=bool), np.full(count, SILENT_S)
        self._follow(frozenset(self.names))
        self._heard_ns = np.zeros(count, dtype=np.int64)
        self._is_lost = np.zeros(count, dtype=bool)
        bodies = [(self.fleet.vehicles[name].body, place) for name, place in self._places.items()]
        self._bodies = {body: place for body, place in bodies if body is not None}

    @property
    def followed(self) -> frozenset[str]:
        """Whose states are to be heard at full rate; all of them at first."""
        return self._followed

    def choose(self, position_enu_m: tuple[float, float, float], now_ns: int) -> bool:
        """Choose anew whom to follow, from where we are; whether that changed anything."""
        if len(self.names) <= subscription.ALWAYS_FOLLOWED:
            return False
        ahead_s = np.minimum(self.ages_s(now_ns), subscription.FAR_SILENT_S)[:, None]
        ahead = self._numbers[:, :2] + ahead_s * self._numbers[:, 3:5]
        far_m = np.hypot(ahead[:, 0] - position_enu_m[0], ahead[:, 1] - position_enu_m[1]).tolist()
        is_placed = self._flags[0].tolist()
        placed = {name: far for name, far, known in zip(self.names, far_m, is_placed, strict=True) if known}
        unplaced = {name for name in self._telemetry if name not in placed}.union(self.silent(now_ns), self.invalid())
        found = subscription.select(placed, frozenset(unplaced), self._followed, self._reach_m)
        if found == self._followed:
            return False
        self._follow(found)
        return True

    def _follow(self, names: frozenset[str]) -> None:
        self._followed = names
        self._near = [name for name in self.names if name in names]
        self._near_places = np.array([self._places[name] for name in self._near], dtype=np.int64)
        self._is_followed[:] = False
        self._is_followed[self._near_places] = True
        self._silent_after_s[:] = np.where(self._is_followed, SILENT_S, subscription.FAR_SILENT_S)
        self._age(self._ages_s, -1, True)

    def hear(self, message: StateMessage | Telemetry, received_ns: int) -> bool:
        """Take a message with its stamp on our clock; False when from nobody we know, repeated, late or not finite."""
        place = self._places.get(message.vehicle)
        if place is None:
            return False
        self.last_heard_ns = max(self.last_heard_ns, received_ns)
        if isinstance(message, Telemetry):
            if not _is_sound(message):
                self.ignored_messages += 1
                return False
            self._telemetry[message.vehicle] = message
            return True
        boot_id, sequence = self._newest[:, place].tolist()
        numbers, stamp_ns = numbers_of(message), min(message.stamp_ns, received_ns)  # nothing comes from the future
        is_same_life = boot_id == message.boot_id
        # out of order, or out of a life that is over
        is_old = message.sequence <= sequence if is_same_life else stamp_ns < self._heard_ns[place]
        if is_old or not is_usable(message, numbers):
            self.ignored_messages += 1
            return False
        self._newest[:, place] = message.boot_id, message.sequence
        self._is_lost[place] = not message.is_valid
        if not message.is_valid:
            return True  # it knows no position: the last valid one ages, and is avoided like a silent vehicle's
        self._stamp_ns[place] = self._heard_ns[place] = stamp_ns
        self._numbers[place] = numbers
        says = message.is_cooperative
        self._flags[:, place] = True, message.is_airborne, says and place not in self.distrusted, says
        self._aged_ns = -1
        return True

    def see(self, pose: MocapPose, received_ns: int) -> bool:
        """Take a neighbour's mocap pose; it counts only while the neighbour says nothing."""
        place = self._bodies.get(pose.body)
        if place is None:
            return False
        body = self._seen.get(place)
        if body is None:
            body = self._seen[place] = BodyTracker()
        if not body.stamp_ns and received_ns - int(self._heard_ns[place]) < _BELIEVED_S * 1e9:
            x, y, z = self._numbers[place, COLUMNS["velocity_enu_m_s"]].tolist()
            body.velocity_enu_m_s = (x, y, z)
        if not body.hear(pose, received_ns):
            return False
        if received_ns - int(self._heard_ns[place]) < _SEEK_S * 1e9:
            return True
        p, v, none = body.position_enu_m, body.velocity_enu_m_s, (0.0, 0.0, 0.0)
        self._numbers[place] = (*p, *v, *none, *p, *v, *none, *v, POSITION_STD_M, 0.0, 0.0, VELOCITY_STD_M_S)
        self._stamp_ns[place] = min(body.stamp_ns, received_ns)
        floor_m = self.fleet.vehicles[self.names[place]].start_enu_m[2]
        self._flags[:, place] = True, p[2] > floor_m + _ON_FLOOR_M, False, False
        self._aged_ns = -1
        return True

    def sought(self, now_ns: int) -> list[str]:
        """Bodies that are to be looked for in the mocap, since vehicles that are followed have begun to be silent."""
        self._first_ns = self._first_ns or now_ns
        self.ages_s(now_ns)
        if self._oldest_s < _SEEK_S or len(self._seen) == len(self._bodies):
            return []
        long_here = now_ns - self._first_ns > _SEEK_AFTER_NS  # who starts has not heard anybody yet
        found = []
        for body, place in self._bodies.items():
            age_s = self._ages_s[place]
            is_sought = self._is_followed[place] and place not in self._seen
            if is_sought and age_s > _SEEK_S and (long_here or age_s < math.inf):
                self._seen[place] = BodyTracker()
                found.append(body)
        return found

    def hear_telemetry(self, arrived: Mapping[str, Telemetry], received_ns: int) -> None:
        """:meth:`hear` of the telemetry of several vehicles, by name; our own is passed over."""
        if arrived:
            self.last_heard_ns = max(self.last_heard_ns, received_ns)
            self._telemetry.update(arrived)
            self._telemetry.pop(self.own_name, None)

    def ages_s(self, now_ns: int) -> Array:
        """Age (K,) of the newest state of each; inf when never heard."""
        if self._aged_ns != now_ns:
            ages_s = np.where(self._flags[0], np.maximum(now_ns - self._stamp_ns, 0) * 1e-9, np.inf)
            self._age(ages_s, now_ns, bool((ages_s > self._silent_after_s).any()))
        return self._ages_s

    def _age(self, ages_s: Array, now_ns: int, has_silent: bool) -> None:
        self._aged_ns, self._ages_s, self._has_silent = now_ns, ages_s, has_silent
        self._near_ages_s = ages_s[self._near_places].tolist()
        self._oldest_s = max(self._near_ages_s, default=0.0)

    def near_ages_s(self, now_ns: int) -> dict[str, float]:
        """Age of the newest state of each vehicle that is followed and was ever heard."""
        self.ages_s(now_ns)
        if self._oldest_s < math.inf:
            return dict(zip(self._near, self._near_ages_s, strict=True))
        return {name: age_s for name, age_s in zip(self._near, self._near_ages_s, strict=True) if age_s < math.inf}

    def age_s(self, name: str, now_ns: int) -> float:
        """Age of the newest state; inf when never heard."""
        place = self._places[name]
        return max(0.0, (now_ns - int(self._stamp_ns[place])) * 1e-9) if self._flags[0, place] else math.inf

    def oldest_age_s(self, now_ns: int) -> float:
        """Largest age of all that are followed and were ever heard; 0 without any."""
        return max(self.near_ages_s(now_ns).values(), default=0.0)

    def heard_ages_s(self, now_ns: int) -> Array:
        """Age (K,) of each one's newest message; of a body that is only seen it grows, inf when never heard."""
        if not self._seen:
            return self.ages_s(now_ns)
        return np.where(self._heard_ns > 0, np.maximum(now_ns - self._heard_ns, 0) * 1e-9, np.inf)

    def rows(self, now_ns: int) -> list[NeighbourRow]:
        """What is known of each that is followed, for those who look at single neighbours."""
        self.ages_s(now_ns)
        at = self._near_places
        says = (self._flags[3] & self._flags[0])[at].tolist()
        stamps, numbers = self._stamp_ns[at].tolist(), self._numbers[at].tolist()
        return [NeighbourRow(*row) for row in zip(self._near, self._near_ages_s, stamps, says, numbers, strict=True)]

    def set_distrusted(self, name: str, is_distrusted: bool) -> None:
        """Let a vehicle's announcement that it cooperates count, or not."""
        (self.distrusted.add if is_distrusted else self.distrusted.discard)(self._places[name])

    def missing(self, now_ns: int) -> tuple[str, ...]:
        """Vehicles that must be there (enabled = true) and are not heard."""
        names = self._named(self.heard_ages_s(now_ns) > _FORGET_NODE_S)
        return tuple(name for name in names if self.fleet.vehicles[name].enabled is True)

    def silent(self, now_ns: int) -> tuple[str, ...]:
        """Vehicles that were in the air when last heard and have been silent too long."""
        self.ages_s(now_ns)
        if not self._has_silent and not self._seen:
            return ()
        return self._named(self._flags[1] & (self.heard_ages_s(now_ns) > self._silent_after_s))

    def unseen(self, now_ns: int) -> tuple[str, ...]:
        """Those of them that the mocap does not show either: nobody knows where they are."""
        is_old = self.ages_s(now_ns) > self._silent_after_s
        return self._named(self._flags[1] & is_old & (self.heard_ages_s(now_ns) > self._silent_after_s))

    def stale(self, now_ns: int) -> tuple[str, ...]:
        """Vehicles in the air that are followed and whose messages are old, though not yet silent."""
        self.ages_s(now_ns)
        if self._oldest_s <= STALE_S and not self._seen:
            return ()
        ages_s = self.heard_ages_s(now_ns)
        return self._named(self._flags[1] & self._is_followed & (ages_s > STALE_S) & (ages_s <= SILENT_S))

    def invalid(self) -> tuple[str, ...]:
        """Vehicles in the air that say that they know no position."""
        return self._named(self._is_lost & self._flags[1])

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
        found = {}
        for name, age_s, (px, py, _, vx, vy) in zip(
            self._near, self._near_ages_s, self._numbers[self._near_places, :5].tolist(), strict=True
        ):
            if age_s < math.inf:
                ahead_s = min(age_s, SILENT_S)
                found[name] = math.hypot(px + ahead_s * vx - x, py + ahead_s * vy - y)
        return found

    def snapshot(self, now_ns: int) -> list[Neighbour]:
        """Return all neighbours that were ever heard, as of one tick; a silent or grounded one does not cooperate."""
        ages_s = self.ages_s(now_ns)
        is_cooperative = self._flags[2] & (ages_s <= self._silent_after_s)
        return [
            _neighbour(index, numbers, age_s, promises, follows)
            for index, (numbers, age_s, is_known, promises, follows) in enumerate(
                zip(
                    self._numbers.tolist(),
                    ages_s.tolist(),
                    self._flags[0].tolist(),
                    is_cooperative.tolist(),
                    self._is_successor.tolist(),
                    strict=True,
                )
            )
            if is_known
        ]


def _neighbour(
    index: int, numbers: list[float], age_s: float, is_cooperative: bool, is_paper_obstacle: bool
) -> Neighbour:
    """A row of the table as the law takes it."""
    position_std_m, crowd_count, lead_time_s, velocity_std_m_s = numbers[21:]
    return Neighbour(
        Vec3(*numbers[0:3]),
        Vec3(*numbers[3:6]),
        Vec3(*numbers[6:9]),
        Vec3(*numbers[9:12]),
        Vec3(*numbers[12:15]),
        Vec3(*numbers[15:18]),
        Vec3(*numbers[18:21]),
        age_s,
        lead_time_s,
        position_std_m,
        velocity_std_m_s,
        crowd_count,
        is_cooperative,
        is_paper_obstacle,
        index,
    )


def numbers_of(message: StateMessage) -> tuple[float, ...]:
    p, v, a, pp, pv, c, i = _vectors_of(message)
    return (*p, *v, *a, *pp, *pv, *c, *i, *_scalars_of(message))


def is_usable(message: StateMessage, numbers: tuple[float, ...]) -> bool:
    return (
        math.isfinite(sum(numbers))
        and min(numbers) > -_LARGEST
        and max(numbers) < _LARGEST
        and 0 <= message.stamp_ns < _LARGEST_INT  # what arrays can hold
        and 0 <= message.boot_id < _LARGEST_INT
        and 0 <= message.sequence < _LARGEST_INT
    )


def _is_sound(message: Telemetry) -> bool:
    """Whether what is used of a telemetry can be calculated with."""
    vectors = message.position_enu_m, message.goal_position_enu_m
    return is_finite(*vectors) and all(abs(value) < _LARGEST for vector in vectors for value in vector)
