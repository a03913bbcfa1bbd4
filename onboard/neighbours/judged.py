"""Neighbours that are trusted less than others, and how they are avoided.

Supervision compares each neighbour's messages with other sources. A neighbour may be in three
states, each with its own effect on avoidance:

    watched          Something contradicts its messages, or has done so in the last seconds. The
                     mocap poses of its body are received, to compare its messages with them. It is
                     still avoided at the position in its messages.

    contradicted     It was contradicted more often than a mistake explains. It is avoided as an
                     airborne vehicle that does not cooperate, both at the position in its messages
                     and at the mocap's position. Once it is overdue, it is avoided at the mocap's
                     position like any other overdue neighbour.

    not cooperating  Its announcement that it cooperates is ignored, so this vehicle does all the
                     avoiding. A neighbour is in this state if it is contradicted, does not fly as
                     it predicts, or has a different configuration from this vehicle.

It is not known which of two contradicting sources is wrong. A vehicle may lie or be mistaken, or
the motion capture may confuse two bodies. So both positions count. The nearer one is in the
neighbour's row, as its distance from us, and the other one is a further row of a tick's snapshot.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from onboard.neighbours.mocap_tracker import POSITION_STD_M, VELOCITY_STD_M_S, BodyTracker
from onboard.neighbours.plausibility import Claim, MocapPosition
from onboard.neighbours.state_arrays import (
    SCALAR_COLUMN,
    STATE_WIDTH,
    VECTOR_COLUMNS,
    NeighbourArrays,
    NeighbourSnapshot,
)
from onboard.tuples import Xyz

_MOCAP_KNOWN_S = 0.25  # an older motion from the mocap does not count


class _Row(NamedTuple):
    """A row of the arrays: one neighbour's state, from its message or from the mocap."""

    stamp_ns: int
    numbers: tuple[float, ...]


@dataclass(slots=True)
class JudgedNeighbours:
    """The neighbours in each of the three states, by index."""

    watched: set[int] = field(default_factory=set)
    contradicted: set[int] = field(default_factory=set)
    not_cooperating: set[int] = field(default_factory=set)
    # newest mocap position of each neighbour's body, in any state
    mocap_positions: dict[int, MocapPosition] = field(default_factory=dict)
    # newest message of each contradicted neighbour, because its row in the arrays may hold the
    # mocap's motion instead
    _messages: dict[int, _Row] = field(default_factory=dict)
    # the farther of the two states of each contradicted neighbour that has two
    _farther: dict[int, _Row] = field(default_factory=dict)

    def set_watched(self, index: int, is_watched: bool) -> None:
        """Start or stop watching a neighbour's body."""
        if is_watched:
            self.watched.add(index)
        else:
            self.watched.discard(index)

    def set_contradicted(self, index: int, is_contradicted: bool) -> None:
        """Set whether a neighbour is contradicted."""
        if is_contradicted:
            self.contradicted.add(index)
        else:
            self.contradicted.discard(index)
            self._messages.pop(index, None)
            self._farther.pop(index, None)

    def set_not_cooperating(self, index: int, is_not_cooperating: bool) -> None:
        """Set whether a neighbour's announcement that it cooperates is ignored."""
        if is_not_cooperating:
            self.not_cooperating.add(index)
        else:
            self.not_cooperating.discard(index)

    def claim(self, arrays: NeighbourArrays, index: int) -> Claim | None:
        """Return a neighbour's motion from its newest message; None if there is none."""
        if index in self.contradicted:
            message = self._kept_message(arrays, index)
        else:
            message = _newest_message(arrays, index)
        if message is None:
            return None

        numbers = message.numbers
        return Claim(
            stamp_ns=message.stamp_ns,
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
        overdue_s: float,
    ) -> None:
        """Write the nearer position of each contradicted neighbour into the arrays; keep the other.

        Args:
            arrays: arrays of all neighbours.
            trackers: motions of the watched bodies, by index.
            own_enu_m: our position [m].
            now_ns: our clock.
            overdue_s: a message older than this counts only if there is no mocap pose.
        """
        for index in self.contradicted:
            candidates: list[_Row] = []
            tracker = trackers.get(index)
            if tracker is not None and (now_ns - tracker.stamp_ns) * 1e-9 < _MOCAP_KNOWN_S:
                stamp_ns = min(tracker.stamp_ns, now_ns)
                candidates.append(_Row(stamp_ns, tracked_numbers(tracker)))

            message = self._kept_message(arrays, index)
            if message is not None:
                is_overdue = (now_ns - message.stamp_ns) * 1e-9 > overdue_s
                if not (is_overdue and candidates):
                    candidates.append(message)

            candidates.sort(key=lambda row: _distance_m(row, own_enu_m, now_ns))
            self._farther.pop(index, None)
            if candidates:
                nearest = candidates[0]
                # whatever its message says, it counts as one in the air that does not avoid
                arrays.set_state(index, nearest.stamp_ns, nearest.numbers, is_airborne=True)
            if len(candidates) > 1:
                self._farther[index] = candidates[1]

    def added_to(
        self, neighbours: NeighbourSnapshot, arrays: NeighbourArrays, now_ns: int
    ) -> NeighbourSnapshot:
        """Return the neighbours of one tick with the farther states added after them.

        Args:
            neighbours: all known neighbours, from the arrays.
            arrays: arrays of all neighbours.
            now_ns: our clock.
        """
        rows = [neighbours.rows]
        for index, farther in self._farther.items():
            row = arrays.numbers[index].copy()
            row[:STATE_WIDTH] = farther.numbers
            row[SCALAR_COLUMN["age_s"]] = max(now_ns - farther.stamp_ns, 0) * 1e-9
            row[SCALAR_COLUMN["is_cooperative"]] = 0.0
            rows.append(row[np.newaxis])
        return NeighbourSnapshot(np.vstack(rows))

    def _kept_message(self, arrays: NeighbourArrays, index: int) -> _Row | None:
        """Return a contradicted neighbour's newest message, even if its row is from the mocap."""
        newest = _newest_message(arrays, index)
        if newest is not None:
            self._messages[index] = newest
        return self._messages.get(index)


def tracked_numbers(tracker: BodyTracker) -> tuple[float, ...]:
    """Return the row of a neighbour from its mocap motion, without commands and predictions."""
    position_enu_m = tracker.position_enu_m
    velocity_enu_m_s = tracker.velocity_enu_m_s
    no_command_enu_m_s2 = (0.0, 0.0, 0.0)
    age_s = 0.0
    lead_time_s = 0.0
    crowd_count = 0.0

    # in the order of the columns (see state_arrays.VECTOR_COLUMNS)
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
    """Return a neighbour's row if it comes from a message, not from the motion capture."""
    heard_ns = int(arrays.heard_ns[index])
    if not heard_ns or heard_ns != arrays.stamp_ns[index]:
        return None
    return _Row(heard_ns, tuple(arrays.numbers[index, :STATE_WIDTH].tolist()))


def _distance_m(row: _Row, own_enu_m: Xyz, now_ns: int) -> float:
    """Return the horizontal distance of a neighbour from us, moved on to the present time."""
    age_s = (now_ns - row.stamp_ns) * 1e-9
    x, y, _ = _vector(row.numbers, "position_enu_m")
    vx, vy, _ = _vector(row.numbers, "velocity_enu_m_s")
    own_x, own_y, _ = own_enu_m
    return math.hypot(x + age_s * vx - own_x, y + age_s * vy - own_y)


def _vector(numbers: tuple[float, ...], name: str) -> Xyz:
    x, y, z = numbers[VECTOR_COLUMNS[name]]
    return x, y, z
