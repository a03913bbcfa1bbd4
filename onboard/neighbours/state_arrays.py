"""Newest states of all neighbours as arrays (K, ...), on our own clock."""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.bus.schema import StateMessage
from onboard.types import Neighbour
from onboard.vectors import Vec3

LARGEST = 1e4  # a number beyond is no position, velocity or acceleration
_LARGEST_INT = 1 << 62
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
_vectors_of, _scalars_of = attrgetter(*_VECTORS), attrgetter(*_SCALARS)


@dataclass(slots=True)
class StateArrays:
    """One entry per neighbour, changed in place; simulations of whole fleets keep those of all vehicles together."""

    numbers: Array  # (K, WIDTH) vectors and scalars of the newest valid message
    stamp_ns: IntArray  # of these numbers, on our clock
    heard_ns: IntArray  # stamp of the newest valid message, on our clock; 0 never
    newest: IntArray  # (2, K) boot id and sequence of the newest message
    is_known: BoolArray
    is_airborne: BoolArray
    is_cooperative: BoolArray  # as far as we believe it
    is_promised: BoolArray  # says that it cooperates
    is_lost: BoolArray  # says that it knows no position
    is_followed: BoolArray  # heard at full rate
    silent_after_s: Array


def no_states(count: int, silent_after_s: float) -> StateArrays:
    """Return the arrays of neighbours of which nothing was heard yet, all of them followed."""
    return StateArrays(
        numbers=np.zeros((count, WIDTH)),
        stamp_ns=np.zeros(count, dtype=np.int64),
        heard_ns=np.zeros(count, dtype=np.int64),
        newest=np.array([[0], [-1]], dtype=np.int64).repeat(count, axis=1),
        is_known=np.zeros(count, dtype=bool),
        is_airborne=np.zeros(count, dtype=bool),
        is_cooperative=np.zeros(count, dtype=bool),
        is_promised=np.zeros(count, dtype=bool),
        is_lost=np.zeros(count, dtype=bool),
        is_followed=np.ones(count, dtype=bool),
        silent_after_s=np.full(count, silent_after_s),
    )


def numbers_of(message: StateMessage) -> tuple[float, ...]:
    """Return the vectors and scalars of a message, WIDTH numbers."""
    p, v, a, pp, pv, c, i = _vectors_of(message)
    return (*p, *v, *a, *pp, *pv, *c, *i, *_scalars_of(message))


def is_usable(message: StateMessage, numbers: tuple[float, ...]) -> bool:
    """Whether a message and its numbers can be calculated with."""
    return (
        math.isfinite(sum(numbers))
        and min(numbers) > -LARGEST
        and max(numbers) < LARGEST
        and 0 <= message.stamp_ns < _LARGEST_INT  # the range of arrays
        and 0 <= message.boot_id < _LARGEST_INT
        and 0 <= message.sequence < _LARGEST_INT
    )


def neighbour_of(
    numbers: list[float], age_s: float, is_cooperative: bool, is_paper_obstacle: bool, index: int
) -> Neighbour:
    """Return one row of numbers as the law takes it."""
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
