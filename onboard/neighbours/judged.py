"""Neighbours that we rely on less than on the others, and what follows from that.

Supervision judges what each neighbour says; three states follow from that, each with an effect of
its own on how the neighbour is avoided:

    watched          something contradicts it, or did some seconds ago. The mocap poses of its body
                     are received, so that there is something to compare its word with. It still
                     counts where it says.

    contradicted     it was contradicted more often than a mistake explains. It counts where it says
                     or where the mocap sees it, whichever is nearer to us, as airborne and without
                     any promise. When it falls silent it counts where the mocap sees it, as
                     any other: what it said last, true or not, stays behind.

    not cooperating  its announcement that it cooperates does not count, so we go aside alone. In
                     this state is whoever is contradicted, flies otherwise than it predicts, or
                     has another configuration than we.

Nobody knows which of two contradicting sources is wrong: a vehicle lies or is mistaken, or the
motion capture takes a body for another. Whoever keeps away from the nearer of both positions keeps
away from the other as well.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from onboard.neighbours.mocap_tracker import POSITION_STD_M, VELOCITY_STD_M_S, BodyTracker
from onboard.neighbours.plausibility import Claim, Seen
from onboard.neighbours.state_arrays import (
    SCALAR_COLUMN,
    STATE_WIDTH,
    VECTOR_COLUMNS,
    NeighbourArrays,
)
from onboard.tuples import Xyz

_SEEN_FOR_S = 0.25  # a tracked motion that is older does not count any more


class _Row(NamedTuple):
    """A row of the arrays: one neighbour's state, from its message or from the mocap."""

    stamp_ns: int
    numbers: tuple[float, ...]


@dataclass(slots=True)
class JudgedNeighbours:
    """The neighbours in each of the three states, by index, and what they said last."""

    watched: set[int] = field(default_factory=set)
    contradicted: set[int] = field(default_factory=set)
    not_cooperating: set[int] = field(default_factory=set)
    # newest position of each body by the mocap, also of those that nothing contradicts
    seen: dict[int, Seen] = field(default_factory=dict)
    # newest message of each that is contradicted: its row in the arrays may be the mocap's
    _said: dict[int, _Row] = field(default_factory=dict)

    def set_watched(self, index: int, is_watched: bool) -> None:
        """Have a neighbour's body watched, or not."""
        if is_watched:
            self.watched.add(index)
        else:
            self.watched.discard(index)

    def set_contradicted(self, index: int, is_contradicted: bool) -> None:
        """Let the nearer of two positions of a neighbour count, or the one that it says."""
        if is_contradicted:
            self.contradicted.add(index)
        else:
            self.contradicted.discard(index)
            self._said.pop(index, None)

    def set_not_cooperating(self, index: int, is_not_cooperating: bool) -> None:
        """Let a neighbour's announcement that it cooperates not count, or count again."""
        if is_not_cooperating:
            self.not_cooperating.add(index)
        else:
            self.not_cooperating.discard(index)

    def claim(self, arrays: NeighbourArrays, index: int) -> Claim | None:
        """Return what a neighbour says of itself; None while it says nothing."""
        if index in self.contradicted:
            said = self._newest_said(arrays, index)
        else:
            said = _newest_message(arrays, index)
        if said is None:
            return None

        numbers = said.numbers
        return Claim(
            stamp_ns=said.stamp_ns,
            position_enu_m=_vector(numbers, "position_enu_m"),
            velocity_enu_m_s=_vector(numbers, "velocity_enu_m_s"),
            predicted_position_enu_m=_vector(numbers, "predicted_position_enu_m"),
            predicted_velocity_enu_m_s=_vector(numbers, "predicted_velocity_enu_m_s"),
            lead_time_s=numbers[SCALAR_COLUMN["lead_time_s"]],
            position_std_m=numbers[SCALAR_COLUMN["position_std_m"]],
        )

    def write_positions(
        self,
        arrays: NeighbourArrays,
        trackers: Mapping[int, BodyTracker],
        own_enu_m: Xyz,
        now_ns: int,
        *,
        silent_after_s: float,
    ) -> None:
        """Write into the arrays where each contradicted neighbour counts, without any promise.

        Args:
            arrays: of all neighbours.
            trackers: motions of the watched bodies, by index.
            own_enu_m: our position [m].
            now_ns: our clock.
            silent_after_s: age of a message from which on it counts only without a mocap pose.
        """
        for index in self.contradicted:
            candidates: list[_Row] = []
            tracker = trackers.get(index)
            if tracker is not None and (now_ns - tracker.stamp_ns) * 1e-9 < _SEEN_FOR_S:
                stamp_ns = min(tracker.stamp_ns, now_ns)
                candidates.append(_Row(stamp_ns, tracked_numbers(tracker)))

            said = self._newest_said(arrays, index)
            if said is not None:
                is_silent = (now_ns - said.stamp_ns) * 1e-9 > silent_after_s
                if not (is_silent and candidates):
                    candidates.append(said)

            if candidates:
                nearest = min(candidates, key=lambda row: math.dist(row.numbers[:2], own_enu_m[:2]))
                # It may say that it stands on the ground: nothing is left to its word, so it
                # counts as airborne.
                flags = (True, False, False)
                arrays.set_state(index, nearest.stamp_ns, nearest.numbers, flags)

    def _newest_said(self, arrays: NeighbourArrays, index: int) -> _Row | None:
        """Return a contradicted neighbour's newest message, also when the mocap took its row."""
        newest = _newest_message(arrays, index)
        if newest is not None:
            self._said[index] = newest
        return self._said.get(index)


def tracked_numbers(tracker: BodyTracker) -> tuple[float, ...]:
    """Return the row of a neighbour that is where the mocap sees it, and promises nothing."""
    position_enu_m = tracker.position_enu_m
    velocity_enu_m_s = tracker.velocity_enu_m_s
    no_command_enu_m_s2 = (0.0, 0.0, 0.0)
    age_s = 0.0
    lead_time_s = 0.0
    crowd_count = 0.0

    # in the order of the columns: see state_arrays.VECTOR_COLUMNS
    return (
        *position_enu_m,
        *velocity_enu_m_s,
        *tracker.acceleration_enu_m_s2,
        *position_enu_m,  # predicted
        *velocity_enu_m_s,  # predicted
        *no_command_enu_m_s2,
        *velocity_enu_m_s,  # intent
        age_s,
        lead_time_s,
        POSITION_STD_M,
        VELOCITY_STD_M_S,
        crowd_count,
    )


def _newest_message(arrays: NeighbourArrays, index: int) -> _Row | None:
    """Return a neighbour's row if it is of a message, and not of the motion capture."""
    heard_ns = int(arrays.heard_ns[index])
    if not heard_ns or heard_ns != arrays.stamp_ns[index]:
        return None
    return _Row(heard_ns, tuple(arrays.numbers[index, :STATE_WIDTH].tolist()))


def _vector(numbers: tuple[float, ...], name: str) -> Xyz:
    x, y, z = numbers[VECTOR_COLUMNS[name]]
    return x, y, z
