"""Geofence: whether a vehicle is outside of it, above it, or about to leave it. Pure.

The fence is evaluated at every tick, in plain floats. It is a box in fleet ENU. Its floor does not
count as a wall, because vehicles stand there. Allowed and forbidden areas are further fences inside
the box. A vehicle is about to leave an area if it would cross an edge before it stops.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from onboard.config import areas
from onboard.config.areas import Area
from onboard.config.fleet import Geofence, Vehicle
from onboard.constants import GRAVITY_M_S2
from onboard.tuples import Xyz

# Assumed decelerations for braking before the fence: horizontally this share of the acceleration at
# the largest tilt, vertically this share of g.
_BRAKE_SHARE = 0.6
_VERTICAL_BRAKE_G = 0.5


class FenceStatus(NamedTuple):
    """Position of a vehicle relative to the fence."""

    is_near: bool  # about to cross a wall or the ceiling
    is_outside: bool  # beyond a wall, or below the floor
    is_above: bool  # above the ceiling


@dataclass(frozen=True, slots=True)
class FenceBox:
    """A box, and how a vehicle brakes before its walls."""

    low_enu_m: Xyz  # west, south and floor
    high_enu_m: Xyz  # east, north and top
    brake_m_s2: Xyz  # deceleration along each axis
    reaction_s: float  # how long the vehicle keeps its velocity before it brakes

    def status(self, position_enu_m: Xyz, velocity_enu_m_s: Xyz) -> FenceStatus:
        """Return where a vehicle is relative to the box.

        A position that is not finite counts as outside.

        Args:
            position_enu_m: position of the vehicle.
            velocity_enu_m_s: velocity of the vehicle.
        """
        if not math.isfinite(sum(position_enu_m)):
            return FenceStatus(is_near=False, is_outside=True, is_above=False)

        x, y, z = position_enu_m
        west, south, floor = self.low_enu_m
        east, north, top = self.high_enu_m
        is_between_walls = west <= x <= east and south <= y <= north
        is_below = z < floor - areas.BELOW_FLOOR_M

        # distance to the wall ahead, along each axis
        vx, vy, vz = velocity_enu_m_s
        ahead_x_m = east - x if vx > 0.0 else x - west
        ahead_y_m = north - y if vy > 0.0 else y - south
        brake_x, brake_y, brake_z = self.brake_m_s2
        is_near = (
            self._is_near(ahead_x_m, abs(vx), brake_x)
            or self._is_near(ahead_y_m, abs(vy), brake_y)
            or (vz > 0.0 and self._is_near(top - z, vz, brake_z))
        )
        return FenceStatus(
            is_near=is_near, is_outside=not is_between_walls or is_below, is_above=z > top
        )

    def status_in(
        self, fleet_areas: Sequence[Area], position_enu_m: Xyz, velocity_enu_m_s: Xyz
    ) -> FenceStatus:
        """Return where a vehicle is relative to the box and to the areas in it.

        Args:
            fleet_areas: areas of the fleet.
            position_enu_m: position of the vehicle.
            velocity_enu_m_s: velocity of the vehicle.
        """
        box_status = self.status(position_enu_m, velocity_enu_m_s)
        if not math.isfinite(sum(position_enu_m)):
            return box_status

        _, _, height_m = position_enu_m
        stop_enu_m = self._stop(position_enu_m, velocity_enu_m_s)
        is_near = box_status.is_near
        is_outside = box_status.is_outside
        is_above = box_status.is_above
        for area in fleet_areas:
            if area.keeps_in and height_m > area.high_m:
                is_above = True
            elif not areas.is_allowed(area, position_enu_m):
                is_outside = True
            elif _leaves(area, position_enu_m, stop_enu_m):
                is_near = True
        return FenceStatus(is_near=is_near, is_outside=is_outside, is_above=is_above)

    def _stop(self, position_enu_m: Xyz, velocity_enu_m_s: Xyz) -> Xyz:
        """Return the position at which a vehicle stops if it brakes now."""
        vx, vy, vz = velocity_enu_m_s
        brake_x, brake_y, brake_z = self.brake_m_s2
        horizontal_s = self._equivalent_s(math.hypot(vx, vy), min(brake_x, brake_y))
        vertical_s = self._equivalent_s(abs(vz), brake_z)
        x, y, z = position_enu_m
        return (x + horizontal_s * vx, y + horizontal_s * vy, z + vertical_s * vz)

    def _equivalent_s(self, speed_m_s: float, brake_m_s2: float) -> float:
        """Return the time that the stopping distance would take at the present speed.

        The stopping distance is v t for the reaction and v^2 / 2a for the braking.
        """
        return self.reaction_s + speed_m_s / (2.0 * brake_m_s2)

    def _is_near(self, distance_m: float, speed_m_s: float, brake_m_s2: float) -> bool:
        """Return whether a vehicle inside the fence cannot stop before a wall at that distance.

        A vehicle at or beyond the wall counts as outside, not as near.
        """
        return 0.0 < distance_m < self._stopping_m(speed_m_s, brake_m_s2)

    def _stopping_m(self, speed_m_s: float, brake_m_s2: float) -> float:
        return speed_m_s * self._equivalent_s(speed_m_s, brake_m_s2)

    def stopping_height_m(self, sinking_m_s: float) -> float:
        """Return the height [m] that a sinking vehicle needs to stop.

        Args:
            sinking_m_s: vertical speed, positive downwards.
        """
        _, _, brake_z = self.brake_m_s2
        return self._stopping_m(sinking_m_s, brake_z)

    def farthest_m(self, speed_m_s: float) -> tuple[float, float]:
        """Return how far from any point inside a vehicle can be if it brakes only at the fence.

        Args:
            speed_m_s: speed at which it crosses the fence.
        Returns:
            Horizontal and vertical distance [m] between the farthest point of the box and the point
            where the vehicle stops.
        """
        west, south, floor = self.low_enu_m
        east, north, top = self.high_enu_m
        brake_x, brake_y, brake_z = self.brake_m_s2

        across_m = math.hypot(east - west, north - south)
        across_m += self._stopping_m(speed_m_s, min(brake_x, brake_y))
        upwards_m = top - floor + self._stopping_m(speed_m_s, brake_z)
        return across_m, upwards_m


def _leaves(area: Area, position_enu_m: Xyz, stop_enu_m: Xyz) -> bool:
    """Return whether the line from an allowed position to the stop leaves the allowed space."""
    _, _, stop_height_m = stop_enu_m
    if area.keeps_in and stop_height_m > area.high_m:
        return True
    if areas.is_crossed(area, position_enu_m, stop_enu_m):
        return True
    return not area.keeps_in and not areas.is_allowed(area, stop_enu_m)


def fence_of(box: Geofence, vehicle: Vehicle) -> FenceBox:
    """Return the fence of a fleet, with the braking of one vehicle.

    Args:
        box: geofence of the fleet file.
        vehicle: vehicle of the fleet file.
    """
    tilt_rad = math.radians(vehicle.max_tilt_deg)
    brake_m_s2 = _BRAKE_SHARE * GRAVITY_M_S2 * math.tan(tilt_rad)
    west, east = box.x
    south, north = box.y
    floor, top = box.z
    return FenceBox(
        low_enu_m=(west, south, floor),
        high_enu_m=(east, north, top),
        brake_m_s2=(brake_m_s2, brake_m_s2, _VERTICAL_BRAKE_G * GRAVITY_M_S2),
        reaction_s=vehicle.lag_s,
    )
