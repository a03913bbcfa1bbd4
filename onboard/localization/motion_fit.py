"""Whether positions fit the own motion, for vehicles that fly on PX4's own position. Pure.

Attitude and throttle say how the vehicle accelerates, and the filter from that where the next
position has to be. A receiver whose positions come late contradicts this whenever the velocity
changes: the vehicle then flies by where it was, overshoots, and circles around its goal.

The measure is the root of the mean square of the horizontal innovations over a second. In 18
flights by satellites with the errors of PX4's simulator it stayed below 0.13 m; with positions
half a second late it was 0.2 m and more.

Positions that drift slowly fit any motion, so this does not notice them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.vectors import Vec3

_MEMORY_S = 1.0


@dataclass(slots=True)
class MotionFit:
    """Memory of one vehicle; :meth:`step` with each position."""

    _mean_square_m2: float = 0.0

    @property
    def miss_m(self) -> float:
        """By how much positions have missed the expected ones lately."""
        return math.sqrt(self._mean_square_m2)

    def step(self, innovation_m: Vec3, dt_s: float, is_on_ground: bool) -> None:
        """Take the next position.

        Args:
            innovation_m: measured less expected [m], ENU.
            dt_s: since the last position.
            is_on_ground: whether the vehicle stands; there nothing is learnt.
        """
        if is_on_ground:
            self._mean_square_m2 = 0.0
            return

        square_m2 = innovation_m.x * innovation_m.x + innovation_m.y * innovation_m.y
        share = 1.0 - math.exp(-dt_s / _MEMORY_S)
        self._mean_square_m2 += share * (square_m2 - self._mean_square_m2)
