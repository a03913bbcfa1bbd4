"""One member of a fleet publishes a false position: its receiver is spoofed, or it lies.

A spoofed vehicle believes the false position, flies by it and publishes it. A liar flies by its
true position and publishes the false one. The false position differs from the true one by an offset
that rises, then stays or swings, and then ends. The other vehicles therefore avoid an empty place,
and not the place where the vehicle really is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple, Protocol

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.rollout.rows import Rows

LieKind = Literal["spoof", "lie"]
_STEP_S = 0.02  # a tick


class MemberLie(NamedTuple):
    """The offset of one vehicle's published position from the true one, over time."""

    member: int  # index of the vehicle
    kind: LieKind
    start_s: float
    lasts_s: float
    size_m: float  # greatest length of the horizontal offset
    direction_rad: float  # direction of the offset, counterclockwise from east
    rise_s: float  # time in which the offset rises to its full length
    swings_hz: float  # frequency at which the offset swings to the other side; 0: it does not

    @property
    def words(self) -> str:
        """The lie in words."""
        origin = "a lie"
        if self.kind == "spoof":
            origin = "a spoofed receiver"
        return (
            f"{origin} of vehicle {self.member}: {self.size_m:.2f} m towards "
            f"{np.degrees(self.direction_rad) % 360.0:.0f} degrees from {self.start_s:.1f} s on, "
            f"for {self.lasts_s:.1f} s, risen within {self.rise_s:.1f} s, "
            f"swinging {self.swings_hz:.2f} times a second"
        )


class _Plan(Protocol):
    @property
    def lie(self) -> MemberLie | None:
        """The lie of this flight; None if no vehicle lies."""

    @property
    def count(self) -> int:
        """Number of vehicles."""


class MemberLies:
    """The lies of F flights of N vehicles, tick by tick."""

    def __init__(self, plans: Sequence[_Plan]) -> None:
        count = plans[0].count
        self._is_liar = np.zeros((len(plans), count), bool)
        self._is_spoof = np.zeros(len(plans), bool)
        # the fields of MemberLie from start_s on; without a lie its size is 0
        self._numbers = np.zeros((len(plans), 6))
        for f, plan in enumerate(plans):
            lie = plan.lie
            if lie is None:
                continue
            self._is_liar[f, lie.member] = True
            self._is_spoof[f] = lie.kind == "spoof"
            _, _, *numbers = lie
            self._numbers[f] = numbers
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
        """Keep only these rows (flights), and drop the others."""
        self._is_liar = self._is_liar[flights]
        self._is_spoof = self._is_spoof[flights]
        self._numbers = self._numbers[flights]

    def _offset(self, time_s: float) -> Array:
        """Return the offsets (F, N, 3) of the positions [m] at a time."""
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
    """Return a copy of rows with an offset of position and velocity.

    Args:
        rows: the rows (F, N).
        offset_m: offset (F, N, 3) of the position.
        velocity_m_s: offset (F, N, 3) of the velocity.
        names: names of the fields with the position and the velocity.
    """
    copy = rows.copy()
    position, velocity = names
    copy[position] += offset_m
    copy[velocity] += velocity_m_s
    return copy
