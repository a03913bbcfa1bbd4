"""Chooses the mocap bodies of other vehicles whose poses are received. Pure.

These are the bodies of vehicles whose next message is overdue, and of vehicles whose messages are
watched (judged.py).

Poses of other vehicles are not requested while our own position is late. On a full radio channel,
each request would delay our own poses further.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

from onboard.neighbours.subscription import FAR_SILENT_S

# A followed vehicle whose newest message is older than this is overdue, and is tracked by the
# mocap. It counts as silent later (table.py), once its mocap poses have arrived.
OVERDUE_S = 0.08
_OWN_LATE_S = 0.1  # our own position is late if it is older than this
_KEPT_NS = 5_000_000_000  # a body is watched for this time after the last reason to do so


@dataclass(slots=True)
class WatchedBodies:
    """Memory of the vehicles whose bodies are watched, by index."""

    late_s: float = 0.0  # delay that the radio adds to states
    # index of a watched vehicle -> when there was last a reason to watch it
    reason_ns: dict[int, int] = field(default_factory=dict)
    # indices of vehicles whose newest state comes from the mocap, not from a message
    located: set[int] = field(default_factory=set)

    def update(
        self, overdue: Iterable[int], watched: Collection[int], now_ns: int, own_age_s: float
    ) -> tuple[int, ...] | None:
        """Return the indices of all vehicles to watch from now on; None while they stay the same.

        Args:
            overdue: indices of overdue vehicles, see :meth:`is_overdue`.
            watched: indices of vehicles within reach whose messages are watched.
            now_ns: our clock.
            own_age_s: age of our own position.
        """
        before = set(self.reason_ns)

        is_own_late = own_age_s > self.late_s + _OWN_LATE_S
        if not is_own_late:
            for index in (*overdue, *watched):
                self.reason_ns[index] = now_ns

        for index in before:
            has_ended = now_ns - self.reason_ns[index] > _KEPT_NS
            if is_own_late or has_ended:
                del self.reason_ns[index]

        if self.reason_ns.keys() == before:
            return None
        return tuple(sorted(self.reason_ns))

    def is_overdue(
        self,
        index: int,
        *,
        age_s: float,
        is_followed: bool,
        is_expected: bool,
        is_airborne: bool,
    ) -> bool:
        """Return whether a vehicle's message is late enough that its body is watched.

        A vehicle that is not followed counts only if it was in the air.

        Args:
            index: index of the vehicle.
            age_s: age of its newest message; inf: never heard.
            is_followed: whether its states have been received at full rate for a while.
            is_expected: whether it should be on the bus.
            is_airborne: whether it was in the air when it was last heard or seen.
        """
        if not is_followed:
            return is_airborne and age_s > self.late_s + FAR_SILENT_S

        is_known = index in self.reason_ns or is_expected or age_s < math.inf
        return is_known and age_s > self.late_s + OVERDUE_S
