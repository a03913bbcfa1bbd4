"""Newest states of all neighbours as arrays, so that one call serves all of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.bus.schema import StateMessage
from onboard.safety.limits import LARGEST_POSITION_STD_M, LARGEST_VELOCITY_STD_M_S
from onboard.types import Neighbour
from onboard.vectors import Vec3

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
COLUMNS = {name: slice(3 * index, 3 * index + 3) for index, name in enumerate(_VECTORS)}
COLUMNS_1 = {name: 3 * len(_VECTORS) + index for index, name in enumerate(_SCALARS)}
WIDTH = 3 * len(_VECTORS) + len(_SCALARS)
# rows of NeighbourArrays.flags
KNOWN, AIRBORNE, COOPERATIVE, ANNOUNCED = range(4)
_vectors_of, _scalars_of = attrgetter(*_VECTORS), attrgetter(*_SCALARS)
_LARGEST = 1e4
_LARGEST_INT = 1 << 62


@dataclass(slots=True)
class NeighbourArrays:
    """Newest valid state of each of K neighbours."""

    numbers: Array  # (K, WIDTH), see COLUMNS
    stamp_ns: IntArray  # (K,) of the numbers, on our clock
    heard_ns: IntArray  # (K,) stamp of the newest valid message, on our clock; 0 never
    newest_ns: IntArray  # (K,) stamp of the newest message, valid or not, on our clock; -1 never
    # (4, K): is anything known, airborne, counts as cooperative, announces that it cooperates
    flags: BoolArray
    is_lost: BoolArray  # (K,) the newest message says that it knows no position
    is_followed: BoolArray  # (K,) its state is received at full rate
    silent_after_s: Array  # (K,) age from which on it counts as silent

    def set_state(
        self, index: int, stamp_ns: int, numbers: tuple[float, ...], flags: tuple[bool, bool, bool]
    ) -> None:
        """Store a state; ``flags`` say airborne, counts as cooperative, announces that it
        cooperates.
        """
        self.numbers[index] = numbers
        self.stamp_ns[index] = stamp_ns
        self.flags[:, index] = True, *flags


def empty(count: int, silent_after_s: float) -> NeighbourArrays:
    """Return the arrays of neighbours that were never heard."""
    return NeighbourArrays(
        numbers=np.zeros((count, WIDTH)),
        stamp_ns=np.zeros(count, dtype=np.int64),
        heard_ns=np.zeros(count, dtype=np.int64),
        newest_ns=np.full(count, -1, dtype=np.int64),
        flags=np.zeros((4, count), dtype=bool),
        is_lost=np.zeros(count, dtype=bool),
        is_followed=np.ones(count, dtype=bool),
        silent_after_s=np.full(count, silent_after_s),
    )


class NeighbourRow(NamedTuple):
    """State of one neighbour."""

    name: str
    age_s: float
    stamp_ns: int
    is_cooperative: bool  # by its own announcement
    numbers: list[float]

    def value(self, name: str) -> float:
        """Return a scalar of its message."""
        return self.numbers[COLUMNS_1[name]]

    def vector(self, name: str) -> list[float]:
        """Return a vector of its message."""
        return self.numbers[COLUMNS[name]]


def numbers_of(message: StateMessage) -> tuple[float, ...]:
    """Return the numbers of a message in the order of the columns; its accuracy is bounded as its
    sender's is.
    """
    p, v, a, pp, pv, c, i = _vectors_of(message)
    std_m, crowd_count, lead_s, std_m_s = _scalars_of(message)
    std_m, std_m_s = (
        _believed(std_m, LARGEST_POSITION_STD_M),
        _believed(std_m_s, LARGEST_VELOCITY_STD_M_S),
    )
    return (*p, *v, *a, *pp, *pv, *c, *i, std_m, crowd_count, lead_s, std_m_s)


def _believed(std: float, largest: float) -> float:
    return min(abs(std), largest) if math.isfinite(std) else std


def is_usable(message: StateMessage, numbers: tuple[float, ...]) -> bool:
    """Whether all numbers of a message are finite and small enough for the arrays."""
    return (
        math.isfinite(sum(numbers))
        and min(numbers) > -_LARGEST
        and max(numbers) < _LARGEST
        and 0 <= message.stamp_ns < _LARGEST_INT
    )


def is_plausible(*vectors: Vec3 | tuple[float, ...]) -> bool:
    """Whether all numbers are finite and small enough to calculate with."""
    return all(abs(value) < _LARGEST for vector in vectors for value in vector)


def neighbours(
    arrays: NeighbourArrays, ages_s: list[float], is_successor: BoolArray
) -> list[Neighbour]:
    """Return the values for the law of all neighbours that are known; a silent or grounded one does
    not cooperate.
    """
    is_cooperative = arrays.flags[COOPERATIVE] & (ages_s <= arrays.silent_after_s)
    columns = (
        arrays.numbers.tolist(),
        ages_s,
        arrays.flags[KNOWN].tolist(),
        is_cooperative.tolist(),
        is_successor.tolist(),
    )
    return [
        _neighbour(index, numbers, age_s, cooperates, follows)
        for index, (numbers, age_s, is_known, cooperates, follows) in enumerate(
            zip(*columns, strict=True)
        )
        if is_known
    ]


def _neighbour(
    index: int, numbers: list[float], age_s: float, is_cooperative: bool, is_paper_obstacle: bool
) -> Neighbour:
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
