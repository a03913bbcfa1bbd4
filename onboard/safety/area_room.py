"""Distances of many positions at once to allowed and forbidden areas. Pure.

The geometry is that of :mod:`onboard.config.areas`, but for arrays, because paths and simulated
flights have thousands of positions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from onboard.arrays import Array, BoolArray
from onboard.config import areas
from onboard.config.areas import Area
from onboard.tuples import Xyz

_SAMPLE_M = 0.05  # distance between two samples of a straight line
_MAX_SAMPLES = 5000


def rooms_m(area: Area, positions_enu_m: Array) -> Array:
    """Return the horizontal distance [m] of each position to an area's edge.

    Args:
        area: any area.
        positions_enu_m: positions (..., 3).
    Returns:
        Distances (...). They are negative outside an allowed area and inside a forbidden one, at
        any height.
    """
    x = positions_enu_m[..., 0]
    y = positions_enu_m[..., 1]
    inside_sign = 1.0 if area.keeps_in else -1.0  # sign of the distances inside the outline
    if not area.corners_enu_m:
        center_x, center_y = area.center_enu_m
        from_center_m = np.hypot(x - center_x, y - center_y)
        return np.asarray(inside_sign * (area.radius_m - from_center_m))

    least_m = np.full(x.shape, np.inf)
    is_within = np.zeros(x.shape, dtype=bool)
    for (x1, y1), (x2, y2) in areas.edges_of(area.corners_enu_m):
        along_x = x2 - x1
        along_y = y2 - y1
        # the nearest point of the edge, as a share of the way from its start to its end
        share = ((x - x1) * along_x + (y - y1) * along_y) / (along_x**2 + along_y**2)
        share = np.clip(share, 0.0, 1.0)
        distance_m = np.hypot(x - x1 - share * along_x, y - y1 - share * along_y)
        least_m = np.minimum(least_m, distance_m)

        # a position is inside if a ray to the east crosses the outline an odd number of times
        if y1 != y2:
            spans_y = (y1 > y) != (y2 > y)
            is_west_of_edge = x < x1 + (y - y1) / (y2 - y1) * along_x
            is_within ^= spans_y & is_west_of_edge

    return np.asarray(np.where(is_within, inside_sign, -inside_sign) * least_m)


def clearances_m(fleet_areas: Sequence[Area], positions_enu_m: Array) -> Array:
    """Return the distance [m] of each position to where vehicles must not fly.

    Vehicles must not fly inside a forbidden area, outside an allowed area, or in the buffer at the
    edge of either.

    Args:
        fleet_areas: areas of a fleet.
        positions_enu_m: positions (..., 3).
    Returns:
        Distances (...). They are negative where vehicles must not fly, and infinite without areas.
    """
    least_m = np.full(positions_enu_m.shape[:-1], np.inf)
    for area in fleet_areas:
        clearance_m = _clearance_m(area, positions_enu_m, area.buffer_m)
        least_m = np.minimum(least_m, clearance_m)
    return least_m


def is_breached(fleet_areas: Sequence[Area], positions_enu_m: Array) -> BoolArray:
    """Return whether each position lies inside a forbidden area or outside an allowed one.

    Buffers do not count.

    Args:
        fleet_areas: areas of a fleet.
        positions_enu_m: positions (..., 3).
    """
    is_in_breach = np.zeros(positions_enu_m.shape[:-1], dtype=bool)
    for area in fleet_areas:
        is_in_breach |= _clearance_m(area, positions_enu_m, 0.0) < 0.0
    return is_in_breach


def length_beyond_m(fleet_areas: Sequence[Area], begin_enu_m: Xyz, end_enu_m: Xyz) -> float:
    """Return the length [m] of a straight line that lies in buffers or beyond edges.

    Args:
        fleet_areas: areas of a fleet.
        begin_enu_m: start of the line.
        end_enu_m: end of the line.
    """
    length_m = math.dist(begin_enu_m, end_enu_m)
    count = min(_MAX_SAMPLES, 2 + int(length_m / _SAMPLE_M))
    shares = np.linspace(0.0, 1.0, count)[:, None]

    begin = np.array(begin_enu_m)
    line_enu_m = begin + shares * (np.array(end_enu_m) - begin)
    is_beyond = clearances_m(fleet_areas, line_enu_m) < 0.0
    return float(length_m * is_beyond.mean())


def _clearance_m(area: Area, positions_enu_m: Array, buffer_m: float) -> Array:
    """Return the distance [m] of each position to where one area forbids vehicles to fly.

    It is negative where they must not fly. An allowed area has a buffer only at its edge, not at
    its ceiling or at its floor, where vehicles stand. A forbidden area also has a buffer above and
    below.
    """
    beside_m = rooms_m(area, positions_enu_m) - buffer_m
    z = positions_enu_m[..., 2]
    if area.keeps_in:
        below_ceiling_m = area.high_m - z
        above_floor_m = z - area.low_m + areas.BELOW_FLOOR_M  # heights have errors
        return np.minimum(beside_m, np.minimum(below_ceiling_m, above_floor_m))

    # a position beside, above or below the area is free
    above_or_below_m = np.maximum(z - area.high_m, area.low_m - z) - buffer_m
    return np.maximum(beside_m, above_or_below_m)
