"""Geofence: whether a vehicle is outside, above it, or about to leave it. Pure, in plain floats,
for every tick.

The fence is a box in fleet ENU. Its floor does not count as a wall, since vehicles stand there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

Vec3 = tuple[float, float, float]


class FenceStatus(NamedTuple):
    """Position of a vehicle relative to the fence."""

    is_near: bool  # about to cross a wall or the ceiling
    is_outside: bool  # beyond a wall, or below the floor
    is_above: bool  # above the ceiling


@dataclass(frozen=True, slots=True)
class Fence:
    """Box in fleet ENU [m], and how a vehicle brakes before it."""

    low_enu_m: Vec3
    high_enu_m: Vec3
    brake_m_s2: Vec3  # deceleration along each axis
    reaction_s: float  # for so long the vehicle goes on as it does now
    floor_tolerance_m: float = 0.5  # below the floor, where a landed vehicle may be measured

    def status(self, position_enu_m: Vec3, velocity_enu_m_s: Vec3) -> FenceStatus:
        """Judge one vehicle. A position that is not finite counts as outside.

        Args:
            position_enu_m: of the vehicle.
            velocity_enu_m_s: of the vehicle.
        Returns:
            its position relative to the fence.
        """
        if not math.isfinite(sum(position_enu_m)):
            return FenceStatus(False, True, False)
        (x, y, z), (west, south, floor), (east, north, top) = (
            position_enu_m,
            self.low_enu_m,
            self.high_enu_m,
        )
        is_above = z > top
        is_outside = (
            not (west <= x <= east and south <= y <= north) or z < floor - self.floor_tolerance_m
        )
        (u, v, w), (brake_x, brake_y, brake_z) = velocity_enu_m_s, self.brake_m_s2
        is_near = (
            self._is_near(east - x if u > 0.0 else x - west, abs(u), brake_x)
            or self._is_near(north - y if v > 0.0 else y - south, abs(v), brake_y)
            or (w > 0.0 and self._is_near(top - z, w, brake_z))
        )
        return FenceStatus(is_near, is_outside, is_above)

    def _is_near(self, distance_m: float, speed_m_s: float, brake_m_s2: float) -> bool:
        """Whether braking does not stop the vehicle before a wall at that distance."""
        return 0.0 < distance_m < speed_m_s * (self.reaction_s + speed_m_s / (2.0 * brake_m_s2))
