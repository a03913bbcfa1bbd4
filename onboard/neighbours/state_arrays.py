"""Newest states of all neighbours as arrays, so that one call serves all of them.

A state is a row of numbers: its vectors one behind the other, then its scalars, as COLUMNS and
COLUMNS_1 say. The row of a neighbour that is silent, or contradicted, may come from the motion
capture instead of its own message.
"""

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
KNOWN = 0  # anything is known
AIRBORNE = 1
COOPERATIVE = 2  # counts as cooperative
ANNOUNCED = 3  # announces that it cooperates

_LARGEST = 1e4
_LARGEST_INT = 1 << 62


class Decoded(NamedTuple):
    """The numbers of a state as the law takes them."""

    # in the order of the columns, which is that of Neighbour
    vectors: tuple[Vec3, Vec3, Vec3, Vec3, Vec3, Vec3, Vec3]
    lead_time_s: float
    position_std_m: float
    velocity_std_m_s: float
    crowd_count: float


@dataclass(slots=True)
class NeighbourArrays:
    """Newest valid state of each of K neighbours; times are on our clock."""

    numbers: Array  # (K, WIDTH), see COLUMNS
    decoded: list[Decoded | None]  # of K numbers; None: not decoded since they have come
    stamp_ns: IntArray  # (K,) of the numbers
    heard_ns: IntArray  # (K,) stamp of the newest valid message; 0 never
    newest_ns: IntArray  # (K,) stamp of the newest message, valid or not; -1 never
    flags: BoolArray  # (4, K) KNOWN, AIRBORNE, COOPERATIVE, ANNOUNCED
    is_lost: BoolArray  # (K,) the newest message says that it knows no position
    is_followed: BoolArray  # (K,) its state is received at full rate
    silent_after_s: Array  # (K,) age from which on it counts as silent

    def set_state(
        self, index: int, stamp_ns: int, numbers: tuple[float, ...], flags: tuple[bool, bool, bool]
    ) -> None:
        """Store a state.

        Args:
            index: of the neighbour.
            stamp_ns: of the state, on our clock.
            numbers: in the order of the columns.
            flags: airborne, counts as cooperative, announces that it cooperates.
        """
        self.numbers[index] = numbers
        self.decoded[index] = None
        self.stamp_ns[index] = stamp_ns
        self.flags[:, index] = (True, *flags)

    def decode(self, index: int) -> Decoded:
        """Return a state as the law takes it; its numbers are decoded once."""
        decoded = self.decoded[index]
        if decoded is None:
            decoded = _decoded(self.numbers[index].tolist())
            self.decoded[index] = decoded
        return decoded


def empty(count: int, silent_after_s: float) -> NeighbourArrays:
    """Return the arrays of neighbours that were never heard."""
    return NeighbourArrays(
        numbers=np.zeros((count, WIDTH)),
        decoded=[None] * count,
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


_vectors_of = attrgetter(*_VECTORS)


def numbers_of(message: StateMessage) -> tuple[float, ...]:
    """Return the numbers of a message in the order of the columns.

    Its accuracy is bounded as a sender bounds its own: no vehicle would publish a larger one.
    """
    numbers: list[float] = []
    for vector in _vectors_of(message):
        numbers.extend(vector)

    numbers.append(_bounded(message.position_std_m, LARGEST_POSITION_STD_M))
    numbers.append(message.crowd_count)
    numbers.append(message.lead_time_s)
    numbers.append(_bounded(message.velocity_std_m_s, LARGEST_VELOCITY_STD_M_S))
    return tuple(numbers)


def _bounded(std: float, largest: float) -> float:
    """Return a standard deviation within its bounds; one that is not finite stays as it is."""
    if not math.isfinite(std):
        return std
    return min(abs(std), largest)


def is_usable(message: StateMessage, numbers: tuple[float, ...]) -> bool:
    """Return whether all numbers of a message are finite and small enough for the arrays."""
    if not 0 <= message.stamp_ns < _LARGEST_INT:
        return False
    return math.isfinite(sum(numbers)) and min(numbers) > -_LARGEST and max(numbers) < _LARGEST


def is_plausible(*vectors: Vec3 | tuple[float, ...]) -> bool:
    """Return whether all numbers are finite and small enough to calculate with."""
    return all(abs(value) < _LARGEST for vector in vectors for value in vector)


def neighbours(
    arrays: NeighbourArrays, ages_s: list[float], is_successor: BoolArray
) -> list[Neighbour]:
    """Return the values for the law of all neighbours that are known.

    A silent neighbour does not cooperate.

    Args:
        arrays: of all K neighbours.
        ages_s: of their states.
        is_successor: (K,) whether one is the next of the fleet file, the paper's obstacle.
    """
    is_cooperative = arrays.flags[COOPERATIVE] & (ages_s <= arrays.silent_after_s)
    rows = zip(
        arrays.flags[KNOWN].tolist(),
        ages_s,
        is_cooperative.tolist(),
        is_successor.tolist(),
        strict=True,
    )

    known = []
    for index, (is_known, age_s, cooperates, is_paper_obstacle) in enumerate(rows):
        if is_known:
            state = arrays.decoded[index] or arrays.decode(index)
            neighbour = Neighbour(
                *state.vectors,
                age_s=age_s,
                lead_time_s=state.lead_time_s,
                position_std_m=state.position_std_m,
                velocity_std_m_s=state.velocity_std_m_s,
                crowd_count=state.crowd_count,
                is_cooperative=cooperates,
                is_paper_obstacle=is_paper_obstacle,
                table_index=index,
            )
            known.append(neighbour)
    return known


def _decoded(numbers: list[float]) -> Decoded:
    position, velocity, acceleration, predicted, flown, command, intent = (
        Vec3(*numbers[columns]) for columns in COLUMNS.values()
    )
    position_std_m, crowd_count, lead_time_s, velocity_std_m_s = numbers[3 * len(_VECTORS) :]
    return Decoded(
        vectors=(position, velocity, acceleration, predicted, flown, command, intent),
        lead_time_s=lead_time_s,
        position_std_m=position_std_m,
        velocity_std_m_s=velocity_std_m_s,
        crowd_count=crowd_count,
    )
