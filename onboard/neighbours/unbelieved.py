"""Neighbours that are not believed: what they say of themselves, what the motion capture sees, and
which of it counts.

Nobody knows which of the two is wrong: a vehicle lies or is mistaken, or the motion capture takes a
body for another. So the one that is nearer to us counts; whoever keeps away from that one keeps
away from the other as well.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from onboard.bus.schema import Vec3
from onboard.neighbours.mocap_tracker import POSITION_STD_M, VELOCITY_STD_M_S, BodyTracker
from onboard.neighbours.plausibility import Claim, Seen
from onboard.neighbours.state_arrays import COLUMNS, COLUMNS_1, NeighbourArrays

_SEEN_FOR_S = 0.25


class _Kept(NamedTuple):
    """Newest message of one neighbour, as a row of the arrays."""

    stamp_ns: int
    numbers: tuple[float, ...]


@dataclass(slots=True)
class UnbelievedNeighbours:
    """The neighbours that are not believed, by index."""

    indices: set[int] = field(default_factory=set)
    doubtful: set[int] = field(default_factory=set)  # their bodies are to be watched
    # newest position by the poses of all bodies
    seen: dict[int, Seen] = field(default_factory=dict)
    _kept: dict[int, _Kept] = field(default_factory=dict)

    def set(self, index: int, *, is_doubtful: bool, is_unbelieved: bool) -> None:
        """Begin or end to doubt a neighbour, or not to believe it."""
        (self.doubtful.add if is_doubtful else self.doubtful.discard)(index)
        (self.indices.add if is_unbelieved else self.indices.discard)(index)
        if not is_unbelieved:
            self._kept.pop(index, None)

    def claim(self, arrays: NeighbourArrays, index: int) -> Claim | None:
        """Return what a neighbour says of itself; None while it says nothing."""
        kept = self._keep(arrays, index) if index in self.indices else _newest(arrays, index)
        if kept is None:
            return None
        columns = (
            "position_enu_m",
            "velocity_enu_m_s",
            "predicted_position_enu_m",
            "predicted_velocity_enu_m_s",
        )
        vectors = [_vector(kept.numbers, name) for name in columns]
        scalars = [kept.numbers[COLUMNS_1[name]] for name in ("lead_time_s", "position_std_m")]
        return Claim(kept.stamp_ns, vectors[0], vectors[1], vectors[2], vectors[3], *scalars)

    def place(
        self,
        arrays: NeighbourArrays,
        trackers: Mapping[int, BodyTracker],
        own_enu_m: Vec3,
        now_ns: int,
    ) -> None:
        """Write into the arrays where each of them counts, without any promise."""
        for index in self.indices:
            kept, tracker = self._keep(arrays, index), trackers.get(index)
            places = [] if kept is None else [(kept.stamp_ns, kept.numbers)]
            if tracker is not None and (now_ns - tracker.stamp_ns) * 1e-9 < _SEEN_FOR_S:
                places.append((min(tracker.stamp_ns, now_ns), tracked_numbers(tracker)))
            if places:
                stamp_ns, numbers = min(
                    places, key=lambda place: math.dist(place[1][:2], own_enu_m[:2])
                )
                # it says that it stands: nothing that depends on it is left to its word
                arrays.set_state(index, stamp_ns, numbers, (True, False, False))

    def _keep(self, arrays: NeighbourArrays, index: int) -> _Kept | None:
        newest = _newest(arrays, index)
        if newest is not None:
            self._kept[index] = newest
        return self._kept.get(index)


def tracked_numbers(tracker: BodyTracker) -> tuple[float, ...]:
    """Return the numbers of a neighbour that is where the motion capture sees it, and promises
    nothing.
    """
    p, v, a, zero = (
        tracker.position_enu_m,
        tracker.velocity_enu_m_s,
        tracker.acceleration_enu_m_s2,
        (0.0, 0.0, 0.0),
    )
    return (*p, *v, *a, *p, *v, *zero, *v, POSITION_STD_M, 0.0, 0.0, VELOCITY_STD_M_S)


def _newest(arrays: NeighbourArrays, index: int) -> _Kept | None:
    """Return the row of a neighbour if it is of a message, and not of the motion capture."""
    stamp_ns = int(arrays.heard_ns[index])
    if not stamp_ns or stamp_ns != arrays.stamp_ns[index]:
        return None
    return _Kept(stamp_ns, tuple(arrays.numbers[index].tolist()))


def _vector(numbers: tuple[float, ...], name: str) -> Vec3:
    x, y, z = numbers[COLUMNS[name]]
    return x, y, z
