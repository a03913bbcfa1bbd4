"""Choice of the mocap bodies of other vehicles whose poses are received. Pure.

They are the bodies of vehicles that are silent, and of those whose word about themselves is watched
(judged.py).

Poses of other vehicles are not requested while our own position is late. On a full radio each
request would delay our own poses further.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

from onboard.neighbours.subscription import FAR_SILENT_S

SILENT_AFTER_S = 0.12  # age of its messages from which on a vehicle is tracked by the mocap
_OWN_LATE_S = 0.1
_KEPT_NS = 5_000_000_000  # a body is watched for so long after its last reason


@dataclass(slots=True)
class WatchedBodies:
    """Memory of the vehicles whose bodies are watched, by index."""

    late_s: float = 0.0  # by which the radio makes states later than usual
    reason_ns: dict[int, int] = field(default_factory=dict)  # when there was a reason last
    # whose newest state is the mocap's, not of a message
    seen: set[int] = field(default_factory=set)

    def update(
        self, silent: Iterable[int], watched: Collection[int], now_ns: int, own_age_s: float
    ) -> tuple[int, ...] | None:
        """Return the indices of all vehicles to watch from now on; None while they stay the same.

        Args:
            silent: vehicles that are silent, see :meth:`is_silent`.
            watched: vehicles in reach whose word is watched.
            now_ns: our clock.
            own_age_s: age of the own position.
        """
        before = set(self.reason_ns)

        is_own_late = own_age_s > self.late_s + _OWN_LATE_S
        if not is_own_late:
            for index in (*silent, *watched):
                self.reason_ns[index] = now_ns

        for index in before:
            has_ended = now_ns - self.reason_ns[index] > _KEPT_NS
            if is_own_late or has_ended:
                del self.reason_ns[index]

        if self.reason_ns.keys() == before:
            return None
        return tuple(sorted(self.reason_ns))

    def is_silent(
        self,
        index: int,
        *,
        age_s: float,
        is_followed: bool,
        is_expected: bool,
        is_airborne: bool,
    ) -> bool:
        """Return whether a vehicle's silence is a reason to watch its body.

        Of the vehicles out of reach only one that flew gives any.

        Args:
            index: of the vehicle.
            age_s: of its newest message; inf when never heard.
            is_followed: whether its states have been received at full rate for a while.
            is_expected: whether it must be there.
            is_airborne: whether it flew when it was last heard or seen.
        """
        if not is_followed:
            return is_airborne and age_s > self.late_s + FAR_SILENT_S

        is_known = index in self.reason_ns or is_expected or age_s < math.inf
        return is_known and age_s > self.late_s + SILENT_AFTER_S
