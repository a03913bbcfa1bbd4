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
        (x, y, z), (west, south, floor), (east, north, top) = position_enu_m, self.low_enu_m, self.high_enu_m
        is_above = z > top
        is_outside = not (west <= x <= east and south <= y <= north) or z < floor - self.floor_tolerance_m
        (u, v, w), (brake_x, brake_y, brake_z) = velocity_enu_m_s, self.brake_m_s2
        is_near = (
            self._is_near(east - x if u > 0.0 else x - west, abs(u), brake_x)
            or self._is_near(north - y if v > 0.0 else y - south, abs(v), brake_y)
            or (w > 0.0 and self._is_near(top - z, w, brake_z))
        )
        return Where(is_near, is_outside, is_above)

    def _is_near(self, left_m: float, speed_m_s: float, brake_m_s2: float) -> bool:
        """Whether a wall that is so far ahead cannot be kept by braking."""
        return 0.0 < left_m < speed_m_s * (self.reaction_s + speed_m_s / (2.0 * brake_m_s2))
