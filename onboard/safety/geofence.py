"""Is a vehicle outside of the fence, above it, or about to leave it? Pure, in plain floats, for every tick.

The fence is a box in fleet ENU. Its floor does not count as a wall: that is where vehicles stand.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

Vec3 = tuple[float, float, float]


class Where(NamedTuple):
    """About to cross a wall or the ceiling; outside of a wall, or below the floor; above the ceiling."""

    is_near: bool
    is_outside: bool
    is_above: bool


@dataclass(frozen=True, slots=True)
class Fence:
    """Box in fleet ENU [m], and how one brakes before it.

    brake_m_s2: deceleration along each axis. reaction_s: for so long it goes on as it does now. floor_tolerance_m: how
    far below the lowest corner a landed vehicle may be measured.
    """

    low_enu_m: Vec3
    high_enu_m: Vec3
    brake_m_s2: Vec3
    reaction_s: float
    floor_tolerance_m: float = 0.5

    def where(self, position_enu_m: Vec3, velocity_enu_m_s: Vec3) -> Where:
        """Of a vehicle; one whose position is not finite is outside, since nobody knows that it is inside."""
        if not math.isfinite(sum(position_enu_m)):
            return Where(False, True, False)
        is_near = is_outside = is_above = False
        rows = zip(self.low_enu_m, self.high_enu_m, self.brake_m_s2, position_enu_m, velocity_enu_m_s, strict=True)
        for axis, (low, high, brake, p, v) in enumerate(rows):
            if axis < 2:
                is_outside |= not low <= p <= high
            else:
                is_above, is_outside = p > high, is_outside or p < low - self.floor_tolerance_m
            left_m = high - p if v > 0.0 else p - low if axis < 2 else math.inf
            is_near |= left_m > 0.0 and abs(v) * (self.reaction_s + abs(v) / (2.0 * brake)) > left_m
        return Where(is_near, is_outside, is_above)
