"""People who walk back and forth along a path, for the emulated motion capture. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

_BODY_HEIGHT_M = 1.7  # of the markers on a head

Point = tuple[float, float]  # east, north
Position = tuple[float, float, float]  # east, north, up


def position_at(points: Sequence[Point], speed_m_s: float, time_s: float) -> Position:
    """Return where a person is [m], ENU.

    The person begins at the first point of the walk, goes to the last one and back, and so on.

    Args:
        points: points of the walk, at least one.
        speed_m_s: speed of the walk.
        time_s: time since the start.
    """
    there_m = sum(math.dist(begin, end) for begin, end in pairwise(points))
    if there_m == 0.0:
        return (*points[0], _BODY_HEIGHT_M)

    walked_m = (speed_m_s * max(time_s, 0.0)) % (2.0 * there_m)
    # distance along the walk from the first point; it shrinks on the way back
    along_m = min(walked_m, 2.0 * there_m - walked_m)
    return (*_point_at(points, along_m), _BODY_HEIGHT_M)


def _point_at(points: Sequence[Point], along_m: float) -> Point:
    """Return the point at a distance from the first one, along the segments."""
    left_m = along_m
    for begin, end in pairwise(points):
        length_m = math.dist(begin, end)
        if left_m < length_m:
            share = left_m / length_m
            begin_east_m, begin_north_m = begin
            end_east_m, end_north_m = end
            east_m = begin_east_m + share * (end_east_m - begin_east_m)
            north_m = begin_north_m + share * (end_north_m - begin_north_m)
            return east_m, north_m
        left_m -= length_m
    return points[-1]
