"""Choice of the mocap bodies of other vehicles whose poses are received: of who is silent, or not
believed. Pure.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

from onboard.neighbours.subscription import FAR_SILENT_S

SILENT_AFTER_S = 0.12  # age of its messages from which on a vehicle is tracked by the mocap
_START_UP_NS = 2_000_000_000  # an agent that has just started has not heard anybody yet
_OWN_LATE_S = 0.1
_KEPT_NS = 5_000_000_000  # a body is watched for so long after there was a reason last


@dataclass(slots=True)
class WatchedBodies:
    """Memory of the vehicles whose bodies are watched, by index."""

    late_s: float = 0.0  # by which the radio makes states later than usual
    reason_ns: dict[int, int] = field(default_factory=dict)  # index -> when there was a reason last
    # whose newest state is the mocap's, not their own word
    seen: set[int] = field(default_factory=set)
    _first_ns: int = 0

    def update(
        self, silent: Iterable[int], doubtful: Collection[int], now_ns: int, own_age_s: float
    ) -> tuple[int, ...] | None:
        """Return the indices of all vehicles to watch from now on; None while they stay the same.

        None is watched while the own position is late: on a radio that is full, further poses would
        take the place of the own, for good.

        Args:
            silent: vehicles that are silent, see :meth:`is_silent`.
            doubtful: vehicles in reach that are not believed.
            now_ns: our clock.
            own_age_s: age of the own position.
        """
        before, is_late = set(self.reason_ns), own_age_s > self.late_s + _OWN_LATE_S
        if not is_late:
            self.reason_ns.update(dict.fromkeys([*silent, *doubtful], now_ns))
        for index in before:
            if is_late or now_ns - self.reason_ns[index] > _KEPT_NS:
                del self.reason_ns[index]
        return None if self.reason_ns.keys() == before else tuple(sorted(self.reason_ns))

    def begin(self, now_ns: int) -> bool:
        """Count the time from the first call; whether everybody who is there should have been heard
        by now.
        """
        self._first_ns = self._first_ns or now_ns
        return now_ns - self._first_ns > _START_UP_NS

    def is_silent(
        self, index: int, age_s: float, is_followed: bool, is_expected: bool, is_airborne: bool
    ) -> bool:
        """Whether a vehicle gives a reason to watch its body: of those out of reach only one that
        flew gives any.

        Args:
            index: of the vehicle.
            age_s: of its newest message; inf when never heard.
            is_followed: whether its states have been received at full rate for a while.
            is_expected: whether it must be there.
            is_airborne: whether it flew when it was last heard or seen.
        """
        if not is_followed:
            return is_airborne and age_s > self.late_s + FAR_SILENT_S
        return age_s > self.late_s + SILENT_AFTER_S and (
            index in self.reason_ns or is_expected or age_s < math.inf
        )
