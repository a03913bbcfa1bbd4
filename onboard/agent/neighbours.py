"""What this agent knows of the others: newest state message and telemetry of each, on our own clock."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter

import numpy as np

from onboard.agent.seen import POSITION_STD_M, VELOCITY_STD_M_S, SeenBody
from onboard.bus.codec import is_finite
from onboard.bus.schema import MocapPose, StateMessage, Telemetry
from onboard.config import FleetConfig
from onboard.types import Array, BoolArray, IntArray, Neighbours

SILENT_S = 0.25  # with two ticks of confirmation a silence is acted on within 0.3 s
STALE_S = 0.15
_SEEK_S = 0.12  # from this age of its messages on a neighbour is looked for in the mocap
_SEEK_AFTER_NS = 2_000_000_000
_BELIEVED_S = 1.0
_ON_FLOOR_M = 0.15
_LARGEST = 1e4
_LARGEST_INT = 1 << 62
_FORGET_NODE_S = 2.0
_MANY = 16  # neighbours from which on arrays are cheaper than floats


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
_COLUMNS = {name: slice(3 * place, 3 * place + 3) for place, name in enumerate(_VECTORS)}
_COLUMNS_1 = {name: 3 * len(_VECTORS) + place for place, name in enumerate(_SCALARS)}
_WIDTH = 3 * len(_VECTORS) + len(_SCALARS)
_vectors_of, _scalars_of = attrgetter(*_VECTORS), attrgetter(*_SCALARS)


@dataclass(frozen=True, slots=True)
class Round:
    """State messages that arrive together, one of each vehicle at most, as arrays (N, ...) over the whole fleet.

    numbers (N, 25): all vectors and scalars of the messages. whole (3, N): stamp, boot id, sequence. flags (5, N): is
    there a message, is it finite, is_valid, is_airborne, is_cooperative.
    """

    numbers: Array
    whole: IntArray
    flags: BoolArray

    @classmethod
    def of(cls, messages: Sequence[StateMessage], places: Mapping[str, int]) -> Round:
        """Of messages of vehicles that stand in ``places``."""
        count = len(places)
        numbers, whole = np.zeros((count, _WIDTH)), np.zeros((3, count), dtype=np.int64)
        flags = np.zeros((5, count), dtype=bool)
        at = [places[m.vehicle] for m in messages]
        numbers[at] = [_numbers(m) for m in messages]
        whole[:, at] = np.array([(m.stamp_ns, m.boot_id, m.sequence) for m in messages], dtype=np.int64).T
        flags[:, at] = np.array(
            [(True, _is_usable(m, _numbers(m)), m.is_valid, m.is_airborne, m.is_cooperative) for m in messages]
        ).T
        return cls(numbers, whole, flags)


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
    _flags: BoolArray = field(init=False)  # is there one at all, is_airborne, is_cooperative, (3, K)
    _heard_ns: IntArray = field(init=False)  # stamp of the newest valid message, on our clock; 0 never
    _is_lost: BoolArray = field(init=False)  # whether the newest message said that it knows no position
    _bodies: dict[str, int] = field(init=False)
    _seen: dict[int, SeenBody] = field(default_factory=dict)
    _first_ns: int = 0
    distrusted: set[int] = field(default_factory=set)
    _telemetry: dict[str, Telemetry] = field(default_factory=dict)
    _aged_ns: int = -1  # the time of the ages below, which several ask for at each tick
    _ages_s: Array = field(init=False)
    _ages_told_s: list[float] = field(init=False)
    _oldest_s: float = math.inf

    def __post_init__(self) -> None:
        order = self.fleet.enabled_names
        self.names = tuple(name for name in order if name != self.own_name)
        self._places = {name: place for place, name in enumerate(self.names)}
        self._others = np.array([place for place, name in enumerate(order) if name != self.own_name], dtype=np.int64)
        count = len(self.names)
        own = order.index(self.own_name) if self.own_name in order else 0
        successor = order[(own + 1) % len(order)] if order else ""
        self._is_successor = np.array([name == successor for name in self.names], dtype=bool)
        self._numbers = np.zeros((count, _WIDTH))
        self._stamp_ns = np.zeros(count, dtype=np.int64)
        self._newest = np.array([[0], [-1]], dtype=np.int64).repeat(count, axis=1)
        self._flags = np.zeros((3, count), dtype=bool)
        self._ages_s = np.full(count, np.inf)
        self._ages_told_s = self._ages_s.tolist()
        self._heard_ns = np.zeros(count, dtype=np.int64)
        self._is_lost = np.zeros(count, dtype=bool)
        bodies = [(self.fleet.vehicles[name].body, place) for name, place in self._places.items()]
        self._bodies = {body: place for body, place in bodies if body is not None}

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
        numbers = _numbers(message)
        if (boot_id == message.boot_id and message.sequence <= sequence) or not _is_usable(message, numbers):
            self.ignored_messages += 1
            return False
        self._newest[:, place] = message.boot_id, message.sequence
        self._is_lost[place] = not message.is_valid
        if not message.is_valid:
            return True  # it knows no position: the last valid one ages, and is avoided like a silent vehicle's
        self._stamp_ns[place] = min(message.stamp_ns, received_ns)  # nothing comes from the future
        self._heard_ns[place] = self._stamp_ns[place]
        self._numbers[place] = numbers
        self._flags[:, place] = True, message.is_airborne, message.is_cooperative and place not in self.distrusted
        self._aged_ns = -1
        return True

    def see(self, pose: MocapPose, received_ns: int) -> bool:
        """Take a neighbour's mocap pose; it counts only while the neighbour says nothing."""
        place = self._bodies.get(pose.body)
        if place is None:
            return False
        body = self._seen.get(place)
        if body is None:
            body = self._seen[place] = SeenBody()
        if not body.stamp_ns and received_ns - int(self._heard_ns[place]) < _BELIEVED_S * 1e9:
            x, y, z = self._numbers[place, _COLUMNS["velocity_enu_m_s"]].tolist()
            body.velocity_enu_m_s = (x, y, z)
        if not body.hear(pose, received_ns):
            return False
        if received_ns - int(self._heard_ns[place]) < _SEEK_S * 1e9:
            return True
        p, v, none = body.position_enu_m, body.velocity_enu_m_s, (0.0, 0.0, 0.0)
        self._numbers[place] = (*p, *v, *none, *p, *v, *none, *v, POSITION_STD_M, 0.0, 0.0, VELOCITY_STD_M_S)
        self._stamp_ns[place] = min(body.stamp_ns, received_ns)
        floor_m = self.fleet.vehicles[self.names[place]].start_enu_m[2]
        self._flags[:, place] = True, p[2] > floor_m + _ON_FLOOR_M, False
        self._aged_ns = -1
        return True

    def sought(self, now_ns: int) -> list[str]:
        """Bodies that are to be looked for in the mocap, since their vehicles have begun to be silent."""
        self._first_ns = self._first_ns or now_ns
        ages_s = self._told_s(now_ns)
        if self._oldest_s < _SEEK_S or len(self._seen) == len(self._bodies):
            return []
        long_here = now_ns - self._first_ns > _SEEK_AFTER_NS  # who starts has not heard anybody yet
        found = []
        for body, place in self._bodies.items():
            if place not in self._seen and ages_s[place] > _SEEK_S and (long_here or ages_s[place] < math.inf):
                self._seen[place] = SeenBody()
                found.append(body)
        return found

    def hear_round(self, arrived: Round, received_ns: int) -> None:
        """:meth:`hear` of every message of a round but our own."""
        others, self._aged_ns = self._others, -1
        stamp_ns, boot_id, sequence = arrived.whole[:, others]
        is_here, is_usable, is_valid, is_airborne, is_cooperative = arrived.flags[:, others]
        if is_here.any():
            self.last_heard_ns = max(self.last_heard_ns, received_ns)
        is_repeated = (self._newest[0] == boot_id) & (sequence <= self._newest[1])
        is_news = is_here & is_usable & ~is_repeated
        self.ignored_messages += int(np.count_nonzero(is_here & ~is_news))
        np.copyto(self._newest, arrived.whole[1:, others], where=is_news)
        np.copyto(self._is_lost, ~is_valid, where=is_news)
        taken = is_news & is_valid
        np.copyto(self._stamp_ns, np.minimum(stamp_ns, received_ns), where=taken)
        if taken.all():
            np.take(arrived.numbers, others, axis=0, out=self._numbers, mode="clip")
        else:
            np.copyto(self._numbers, arrived.numbers[others], where=taken[:, None])
        np.copyto(self._flags, [is_valid, is_airborne, is_cooperative], where=taken)
        np.copyto(self._heard_ns, self._stamp_ns, where=taken)
        if self.distrusted:
            self._flags[2, list(self.distrusted)] = False

    def ages_s(self, now_ns: int) -> Array:
        """Age (K,) of the newest state of each; inf when never heard."""
        if self._aged_ns != now_ns:
            ages = np.maximum(now_ns - self._stamp_ns, 0) * 1e-9
            self._aged_ns, self._ages_s = now_ns, np.where(self._flags[0], ages, np.inf)
            self._ages_told_s = self._ages_s.tolist()
            self._oldest_s = max(self._ages_told_s, default=0.0)
        return self._ages_s

    def _told_s(self, now_ns: int) -> list[float]:
        """:meth:`ages_s` as floats."""
        self.ages_s(now_ns)
        return self._ages_told_s

    def known_ages_s(self, now_ns: int) -> dict[str, float]:
        """Age of the newest state of each that was ever heard."""
        rows = zip(self.names, self._told_s(now_ns), strict=True)
        if self._oldest_s < math.inf:
            return dict(rows)
        return {name: age_s for name, age_s in rows if age_s < math.inf}

    def age_s(self, name: str, now_ns: int) -> float:
        """Age of the newest state; inf when never heard."""
        place = self._places[name]
        return max(0.0, (now_ns - int(self._stamp_ns[place])) * 1e-9) if self._flags[0, place] else math.inf

    def oldest_age_s(self, now_ns: int) -> float:
        """Largest age of all that were ever heard; 0 without neighbours."""
        known = self._flags[0]
        return float(self.ages_s(now_ns)[known].max()) if known.any() else 0.0

    def heard_ages_s(self, now_ns: int) -> list[float]:
        """Age of each one's newest message; of a body that is only seen it grows, inf when never heard."""
        if not self._seen:
            return self._told_s(now_ns)
        return [max(now_ns - heard_ns, 0) * 1e-9 if heard_ns else math.inf for heard_ns in self._heard_ns.tolist()]

    def missing(self, now_ns: int) -> tuple[str, ...]:
        """Vehicles that must be there (enabled = true) and are not heard."""
        ages_s = self.heard_ages_s(now_ns)
        return tuple(
            name
            for name, age_s in zip(self.names, ages_s, strict=True)
            if self.fleet.vehicles[name].enabled is True and age_s > _FORGET_NODE_S
        )

    def silent(self, now_ns: int) -> tuple[str, ...]:
        """Vehicles that were in the air when last heard and have been silent too long."""
        return self._airborne_of(now_ns, SILENT_S, math.inf)

    def unseen(self, now_ns: int) -> tuple[str, ...]:
        """Those of them that the mocap does not show either: nobody knows where they are."""
        ages_s = self._told_s(now_ns)
        if self._oldest_s <= SILENT_S:
            return ()
        return tuple(name for name in self.silent(now_ns) if ages_s[self._places[name]] > SILENT_S)

    def stale(self, now_ns: int) -> tuple[str, ...]:
        """Vehicles in the air whose messages are old, though not yet silent."""
        return self._airborne_of(now_ns, STALE_S, SILENT_S)

    def invalid(self) -> tuple[str, ...]:
        """Vehicles in the air that say that they know no position."""
        if not self._is_lost.any():
            return ()
        return tuple(itertools.compress(self.names, (self._is_lost & self._flags[1]).tolist()))

    def _airborne_of(self, now_ns: int, above_s: float, up_to_s: float) -> tuple[str, ...]:
        self.ages_s(now_ns)
        if self._oldest_s <= above_s and not self._seen:
            return ()
        airborne = self._flags[1].tolist()
        ages_s = zip(self.names, self.heard_ages_s(now_ns), airborne, strict=True)
        return tuple(name for name, age_s, is_up in ages_s if is_up and above_s < age_s <= up_to_s)

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
        """Horizontal distance to each neighbour ever heard, extrapolated over at most the silence limit."""
        x, y, _ = position_enu_m
        if len(self.names) >= _MANY:
            ages_s, n = self.ages_s(now_ns), self._numbers
            ahead = np.minimum(ages_s, SILENT_S)
            far = np.hypot(n[:, 0] + ahead * n[:, 3] - x, n[:, 1] + ahead * n[:, 4] - y)
            pairs = zip(self.names, far.tolist(), strict=True)
            return dict(pairs) if self._flags[0].all() else dict(itertools.compress(pairs, self._flags[0].tolist()))
        found = {}
        rows = zip(self.names, self._told_s(now_ns), self._numbers[:, :6].tolist(), strict=True)
        for name, age_s, (px, py, _, vx, vy, _) in rows:
            if age_s < math.inf:
                ahead_s = min(age_s, SILENT_S)
                found[name] = math.hypot(px + ahead_s * vx - x, py + ahead_s * vy - y)
        return found

    def snapshot(self, now_ns: int) -> Neighbours:
        """The frozen picture for one tick, (K, 3); a silent or grounded neighbour does not cooperate."""
        if not self.names:
            return _NOBODY
        numbers, ages_s = self._numbers.copy(), self.ages_s(now_ns)
        is_present = self._flags[0].copy()
        return Neighbours(
            age_s=np.where(is_present, ages_s, 0.0),
            is_present=is_present,
            is_cooperative=self._flags[2] & (ages_s <= SILENT_S),
            is_paper_obstacle=self._is_successor & is_present,
            **{name: numbers[:, columns] for name, columns in _COLUMNS.items()},
            **{name: numbers[:, column] for name, column in _COLUMNS_1.items()},
        )


def snapshots(tables: Sequence[NeighbourTable], now_ns: int) -> Neighbours:
    """The snapshots of several tables of equally many neighbours, (N, K, 3): as stacking them one by one."""
    if not tables[0].names:
        rows = len(tables)
        nobody = {
            f.name: np.repeat(getattr(_NOBODY, f.name)[None], rows, axis=0) for f in dataclasses.fields(Neighbours)
        }
        return Neighbours(**nobody)
    numbers = np.array([table._numbers for table in tables])
    ages_s = np.array([table.ages_s(now_ns) for table in tables])
    flags = np.array([table._flags for table in tables])
    is_present = flags[:, 0]
    return Neighbours(
        age_s=np.where(is_present, ages_s, 0.0),
        is_present=is_present,
        is_cooperative=flags[:, 2] & (ages_s <= SILENT_S),
        is_paper_obstacle=np.array([table._is_successor for table in tables]) & is_present,
        **{name: numbers[:, :, columns] for name, columns in _COLUMNS.items()},
        **{name: numbers[:, :, column] for name, column in _COLUMNS_1.items()},
    )


def _numbers(message: StateMessage) -> tuple[float, ...]:
    p, v, a, pp, pv, c, i = _vectors_of(message)
    return (*p, *v, *a, *pp, *pv, *c, *i, *_scalars_of(message))


def _is_usable(message: StateMessage, numbers: tuple[float, ...]) -> bool:
    return (
        is_finite(numbers)
        and min(numbers) > -_LARGEST
        and max(numbers) < _LARGEST
        and _fits(message.stamp_ns, message.boot_id, message.sequence)
    )


def _fits(*whole: int) -> bool:
    """Whether whole numbers of a message are such that arrays can hold them."""
    return all(0 <= number < _LARGEST_INT for number in whole)


def _is_sound(message: Telemetry) -> bool:
    """Whether what is used of a telemetry can be calculated with."""
    vectors = message.position_enu_m, message.goal_position_enu_m
    return is_finite(*vectors) and all(abs(value) < _LARGEST for vector in vectors for value in vector)


def _nobody() -> Neighbours:
    """No neighbour at all: one masked row, because there must be one."""
    nothing = np.zeros(1, dtype=bool)
    vectors = {name: np.zeros((1, 3)) for name in _VECTORS}
    scalars = {name: np.zeros(1) for name in _SCALARS}
    return Neighbours(
        age_s=np.zeros(1),
        is_present=nothing,
        is_cooperative=nothing,
        is_paper_obstacle=nothing,
        **vectors,
        **scalars,
    )


_NOBODY = _nobody()
