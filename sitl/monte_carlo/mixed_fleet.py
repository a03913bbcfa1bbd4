"""A fleet in which some vehicles use a second law.

Both controls compute all vehicles, and each vehicle flies the result of its own law. The unused
results have no effect, because a vehicle knows the others only by their messages. A user's own law
is called only for the vehicles that it flies (:mod:`onboard.rollout.own_law_fleet`).
"""

from __future__ import annotations

import numpy as np

from onboard.arrays import BoolArray, IntArray
from onboard.rollout import batch
from onboard.rollout.rows import Rows


class MixedFleet:
    """Two laws in one fleet: a :class:`onboard.rollout.batch.Controller`."""

    def __init__(
        self, first: batch.Controller, second: batch.Controller, is_of_second: BoolArray
    ) -> None:
        """Take the control by both laws.

        Args:
            first: control of all vehicles by the first law.
            second: control of all vehicles by the second law.
            is_of_second: (N,) whether a vehicle flies by the second law.
        """
        self._first = first
        self._second = second
        self._is_of_second = is_of_second

    @property
    def refusals(self) -> dict[int, str]:
        """Which law was refused and why, by flight number; both laws, if both were."""
        joined: dict[int, str] = dict(getattr(self._first, "refusals", {}))
        for flight, refusal in getattr(self._second, "refusals", {}).items():
            if flight in joined:
                joined[flight] += f"; {refusal}"
            else:
                joined[flight] = refusal
        return joined

    def step(
        self, states: Rows, goals: Rows, neighbours: Rows, is_present: BoolArray, dt_s: float
    ) -> Rows:
        """Return the ticks of all vehicles."""
        by_first = self._first.step(states, goals, neighbours, is_present, dt_s)
        by_second = self._second.step(states, goals, neighbours, is_present, dt_s)
        return np.where(self._is_of_second, by_second, by_first)

    def keep(self, flights: IntArray) -> None:
        """Keep only these rows (flights), and drop the others."""
        self._first.keep(flights)
        self._second.keep(flights)
