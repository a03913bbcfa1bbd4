"""One member of a fleet whose position is false: by a spoofed receiver, or by its own lie.

A spoofed vehicle believes the false position: it flies by it and tells it. A liar flies by its true
one, and tells the false one. Either is off by an offset that rises over a while, stays or swings,
and ends: the law of the others sees a vehicle where none is, and none where one is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple, Protocol

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.rollout.rows import Rows

LieKind = Literal["spoof", "lie"]


class MemberLie(NamedTuple):
    """What is false about one vehicle's position, and when."""

    member: int
    kind: LieKind
    start_s: float
    lasts_s: float
    size_m: float  # of the offset at its largest, horizontal
    direction_rad: float  # counterclockwise from east
    rise_s: float  # until it is as large as that
    swings_hz: float  # between both sides; 0: it stays

    @property
    def words(self) -> str:
        """The lie in words."""
        whose = "a spoofed receiver" if self.kind == "spoof" else "a lie"
        return (
            f"{whose} of vehicle {self.member}: {self.size_m:.2f} m towards "
            f"{np.degrees(self.direction_rad) % 360.0:.0f} degrees from {self.start_s:.1f} s on, "
            f"for {self.lasts_s:.1f} s, risen within {self.rise_s:.1f} s, "
            f"swinging {self.swings_hz:.2f} times a second"
        )


class _Plan(Protocol):
    @property
    def lie(self) -> MemberLie | None:
        """What is false in this flight."""

    @property
    def count(self) -> int:
        """Number of vehicles."""


class MemberLies:
    """The lies of F flights of N vehicles, tick by tick."""

    def __init__(self, plans: Sequence[_Plan]) -> None:
        count = plans[0].count
        self._is_liar = np.zeros((len(plans), count), bool)
        self._is_spoof = np.zeros(len(plans), bool)
        self._numbers = np.zeros((len(plans), 6))
        self._numbers[:, 4] = 1.0
        for f, plan in enumerate(plans):
            lie = plan.lie
            if lie is None:
                continue
            self._is_liar[f, lie.member] = True
            self._is_spoof[f] = lie.kind == "spoof"
            self._numbers[f] = lie[2:]
        self.has_any = bool(self._is_liar.any())

    def offsets(self, time_s: float) -> tuple[Array, Array]:
        """Return the offsets (F, N, 3) of the positions [m], and how fast they change [m/s]."""
        now_m = self._offset(time_s)
        before_m = self._offset(time_s - _STEP_S)
        return now_m, (now_m - before_m) / _STEP_S

    def is_believed(self) -> BoolArray:
        """Return in which flights (F,) the vehicle believes its false position itself."""
        return self._is_spoof

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""
        self._is_liar = self._is_liar[flights]
        self._is_spoof = self._is_spoof[flights]
        self._numbers = self._numbers[flights]

    def _offset(self, time_s: float) -> Array:
        start_s, lasts_s, size_m, direction_rad, rise_s, swings_hz = self._numbers.T
        since_s = time_s - start_s
        is_on = (since_s >= 0.0) & (since_s < lasts_s)
        risen = np.clip(since_s / np.maximum(rise_s, _STEP_S), 0.0, 1.0)
        swing = np.cos(2.0 * np.pi * swings_hz * since_s)
        length_m = np.where(is_on, size_m * risen * swing, 0.0)

        offset = np.zeros((*self._is_liar.shape, 3))
        offset[..., 0] = (length_m * np.cos(direction_rad))[:, None]
        offset[..., 1] = (length_m * np.sin(direction_rad))[:, None]
        return np.where(self._is_liar[..., None], offset, 0.0)


def shifted(rows: Rows, offset_m: Array, velocity_m_s: Array, names: tuple[str, str]) -> Rows:
    """Return a copy of rows whose position and velocity are off.

    Args:
        rows: (F, N).
        offset_m: (F, N, 3).
        velocity_m_s: (F, N, 3).
        names: of the position and of the velocity in these rows.
    """
    copy = rows.copy()
    position, velocity = names
    copy[position] += offset_m
    copy[velocity] += velocity_m_s
    return copy


_STEP_S = 0.02
