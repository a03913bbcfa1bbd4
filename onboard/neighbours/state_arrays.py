"""Newest states of all neighbours as arrays, so that one numpy call handles all of them.

Each neighbour has a row of numbers: the fields of :class:`onboard.types.Neighbour`, in order. Its
vectors come first, with three numbers each (VECTOR_COLUMNS), then its scalars (SCALAR_COLUMN).

The first STATE_WIDTH numbers of a row are the state that the neighbour has published. While it is
overdue or contradicted (judged.py), they may come from the motion capture instead. This agent adds
the other numbers: whether the neighbour cooperates, and its index.

A snapshot holds the rows of one tick, with the age of each state. The law reads them as Neighbours;
the compiled pipeline takes the rows directly.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple, overload

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.bus.schema import StateMessage
from onboard.safety.limits import LARGEST_POSITION_STD_M, LARGEST_VELOCITY_STD_M_S
from onboard.types import Neighbour
from onboard.vectors import Vec3

_VECTOR_COUNT = 7  # the first fields of a Neighbour, up to its intent
_VECTORS = Neighbour._fields[:_VECTOR_COUNT]
_SCALARS = Neighbour._fields[_VECTOR_COUNT:]

# field -> its columns in a row
VECTOR_COLUMNS = {name: slice(3 * index, 3 * index + 3) for index, name in enumerate(_VECTORS)}
SCALAR_COLUMN = {name: 3 * len(_VECTORS) + index for index, name in enumerate(_SCALARS)}
_WIDTH = 3 * len(_VECTORS) + len(_SCALARS)

# the first numbers of a row, up to crowd_count: a state
STATE_WIDTH = SCALAR_COLUMN["crowd_count"] + 1
_AGE = SCALAR_COLUMN["age_s"]
_COOPERATES = SCALAR_COLUMN["is_cooperative"]
_PAPER_OBSTACLE = SCALAR_COLUMN["is_paper_obstacle"]
_TABLE_INDEX = SCALAR_COLUMN["table_index"]
_RADIUS = SCALAR_COLUMN["radius_m"]

# rows of NeighbourArrays.flags
KNOWN = 0  # a state of the neighbour is known
AIRBORNE = 1
COOPERATIVE = 2  # the neighbour counts as cooperative
ANNOUNCED = 3  # the message says that it cooperates

_LARGEST_NUMBER = 1e4  # largest number of a message, in metres, metres per second and so on
_LARGEST_STAMP_NS = 1 << 62


@dataclass(slots=True)
class NeighbourArrays:
    """Newest valid state of each of K neighbours; times are on our clock."""

    numbers: Array  # (K, fields of a Neighbour), see VECTOR_COLUMNS and SCALAR_COLUMN
    stamp_ns: IntArray  # (K,) time of the numbers
    heard_ns: IntArray  # (K,) stamp of the newest valid message; 0: none yet
    newest_ns: IntArray  # (K,) stamp of the newest message, valid or not; -1: none yet
    flags: BoolArray  # (4, K) KNOWN, AIRBORNE, COOPERATIVE, ANNOUNCED
    is_lost: BoolArray  # (K,) whether its newest message says that its position is not known
    is_followed: BoolArray  # (K,) whether its states are received at full rate
    silent_after_s: Array  # (K,) age beyond which it counts as silent

    def set_state(
        self,
        index: int,
        stamp_ns: int,
        numbers: tuple[float, ...],
        *,
        is_airborne: bool,
        is_cooperative: bool = False,
        announces: bool = False,
    ) -> None:
        """Store a state, by default of somebody who does not avoid and says nothing.

        Args:
            index: index of the neighbour.
            stamp_ns: time of the state, on our clock.
            numbers: STATE_WIDTH numbers, in the order of the columns.
            is_airborne: whether it is in the air.
            is_cooperative: whether it counts as one that avoids.
            announces: whether its message says that it avoids.
        """
        self.numbers[index, :STATE_WIDTH] = numbers
        self.stamp_ns[index] = stamp_ns
        self.flags[:, index] = (True, is_airborne, is_cooperative, announces)


def empty(is_successor: BoolArray, silent_after_s: float) -> NeighbourArrays:
    """Return the arrays of neighbours that have never been heard.

    Args:
        is_successor: (K,) whether a neighbour is the next vehicle in the fleet file, which is the
            paper's obstacle.
        silent_after_s: age beyond which each of them counts as silent.
    """
    count = len(is_successor)
    numbers = np.zeros((count, _WIDTH))
    numbers[:, _PAPER_OBSTACLE] = is_successor
    numbers[:, _TABLE_INDEX] = np.arange(count)

    return NeighbourArrays(
        numbers=numbers,
        stamp_ns=np.zeros(count, dtype=np.int64),
        heard_ns=np.zeros(count, dtype=np.int64),
        newest_ns=np.full(count, -1, dtype=np.int64),
        flags=np.zeros((4, count), dtype=bool),
        is_lost=np.zeros(count, dtype=bool),
        is_followed=np.ones(count, dtype=bool),
        silent_after_s=np.full(count, silent_after_s),
    )


class NeighbourRow(NamedTuple):
    """Newest state of one neighbour, for callers that need only one state."""

    name: str
    age_s: float
    stamp_ns: int
    is_cooperative: bool  # ANNOUNCED: whether the message says that it cooperates
    numbers: list[float]  # its row in the arrays

    def value(self, name: str) -> float:
        """Return a scalar of its message."""
        return self.numbers[SCALAR_COLUMN[name]]

    def vector(self, name: str) -> list[float]:
        """Return a vector of its message."""
        return self.numbers[VECTOR_COLUMNS[name]]


_vectors_of = attrgetter(*_VECTORS)


def numbers_of(message: StateMessage) -> tuple[float, ...]:
    """Return the state (STATE_WIDTH,) of a message, in the order of the columns.

    Its standard deviations are limited to the largest that any vehicle publishes.
    """
    numbers: list[float] = []
    for vector in _vectors_of(message):
        numbers.extend(vector)

    numbers.append(0.0)  # the age
    numbers.append(message.lead_time_s)
    numbers.append(_bounded(message.position_std_m, LARGEST_POSITION_STD_M))
    numbers.append(_bounded(message.velocity_std_m_s, LARGEST_VELOCITY_STD_M_S))
    numbers.append(message.crowd_count)
    return tuple(numbers)


def _bounded(std: float, largest: float) -> float:
    """Return a standard deviation within its bound; unchanged if it is not finite."""
    if not math.isfinite(std):
        return std
    return min(abs(std), largest)


def is_usable(message: StateMessage, numbers: tuple[float, ...]) -> bool:
    """Return whether all numbers of a message are finite and small enough for the arrays."""
    if not 0 <= message.stamp_ns < _LARGEST_STAMP_NS:
        return False
    if not math.isfinite(sum(numbers)):
        return False
    return min(numbers) > -_LARGEST_NUMBER and max(numbers) < _LARGEST_NUMBER


def is_plausible(*vectors: Vec3 | tuple[float, ...]) -> bool:
    """Return whether all numbers are finite and small enough to calculate with."""
    return all(abs(value) < _LARGEST_NUMBER for vector in vectors for value in vector)


class NeighbourSnapshot(Sequence[Neighbour]):
    """The known neighbours at one tick, as a sequence of Neighbours.

    Attributes:
        rows: (N, fields of a Neighbour) numbers. They are converted to Neighbours at the first
            access, because the compiled pipeline needs only the rows.
    """

    def __init__(self, rows: Array) -> None:
        self.rows = rows
        self._neighbours: list[Neighbour] | None = None

    def __len__(self) -> int:
        return len(self.rows)

    @overload
    def __getitem__(self, index: int) -> Neighbour: ...
    @overload
    def __getitem__(self, index: slice) -> list[Neighbour]: ...
    def __getitem__(self, index: int | slice) -> Neighbour | list[Neighbour]:
        return self._read()[index]

    def __iter__(self) -> Iterator[Neighbour]:
        return iter(self._read())

    def _read(self) -> list[Neighbour]:
        if self._neighbours is None:
            self._neighbours = [_neighbour(numbers) for numbers in self.rows.tolist()]
        return self._neighbours


def snapshot(arrays: NeighbourArrays, ages_s: list[float]) -> NeighbourSnapshot:
    """Return all known neighbours; a silent neighbour counts as not cooperative.

    Args:
        arrays: arrays of all K neighbours.
        ages_s: age of each of their states.
    """
    rows = arrays.numbers.copy()
    rows[:, _AGE] = ages_s
    rows[:, _COOPERATES] = arrays.flags[COOPERATIVE] & (rows[:, _AGE] <= arrays.silent_after_s)

    is_known = arrays.flags[KNOWN]
    if not is_known.all():
        rows = rows[is_known]
    return NeighbourSnapshot(rows)


def _neighbour(numbers: list[float]) -> Neighbour:
    """Return the neighbour of a row."""
    (
        position,
        velocity,
        acceleration,
        predicted_position,
        predicted_velocity,
        commanded_acceleration,
        intent,
    ) = (Vec3(*numbers[columns]) for columns in VECTOR_COLUMNS.values())
    age_s, lead_time_s, position_std_m, velocity_std_m_s, crowd_count = numbers[_AGE:STATE_WIDTH]
    return Neighbour(
        position_enu_m=position,
        velocity_enu_m_s=velocity,
        acceleration_enu_m_s2=acceleration,
        predicted_position_enu_m=predicted_position,
        predicted_velocity_enu_m_s=predicted_velocity,
        commanded_acceleration_enu_m_s2=commanded_acceleration,
        intent_enu_m_s=intent,
        age_s=age_s,
        lead_time_s=lead_time_s,
        position_std_m=position_std_m,
        velocity_std_m_s=velocity_std_m_s,
        crowd_count=crowd_count,
        is_cooperative=numbers[_COOPERATES] != 0.0,
        is_paper_obstacle=numbers[_PAPER_OBSTACLE] != 0.0,
        table_index=int(numbers[_TABLE_INDEX]),
        radius_m=numbers[_RADIUS],
    )
