"""How far a vehicle is beyond the edge of an area that it must stay in, or stay out of.

The judge of a campaign calculates this with rays and segments of its own. It shares no code with
the agents and the ground, so that it does not repeat their mistakes.
"""

from __future__ import annotations

import itertools
import math

from onboard.config.areas import Area, Point
from onboard.tuples import Xyz


def beyond_m(area: Area, position_enu_m: Xyz) -> float:
    """Return how far [m] a vehicle is beyond the edge of an area; 0 if it may be there.

    Args:
        area: an area to stay in or to stay out of; its buffer does not count.
        position_enu_m: position of the vehicle.
    """
    east, north, up = position_enu_m
    is_within = _is_within(area, (east, north))
    edge_m = _edge_distance_m(area, (east, north))
    # distance to the nearer end of the area's range of heights; below 0 outside of the range
    from_ends_m = min(up - area.low_m, area.high_m - up)

    if area.keeps_in:
        aside_m = 0.0
        if not is_within:
            aside_m = edge_m
        return max(aside_m, -from_ends_m, 0.0)

    is_inside = is_within and from_ends_m > 0.0
    if is_inside:
        return min(edge_m, from_ends_m)
    return 0.0


def _is_within(area: Area, point: Point) -> bool:
    """Return whether a point is within the outline of an area.

    It is within if a ray from it to the east crosses the outline an odd number of times.
    """
    if not area.corners_enu_m:
        return math.dist(point, area.center_enu_m) < area.radius_m

    east, north = point
    crossings = 0
    for (x1, y1), (x2, y2) in _sides(area):
        has_ends_on_both_sides = (y1 > north) != (y2 > north)
        if has_ends_on_both_sides:
            crossing_east = x1 + (north - y1) / (y2 - y1) * (x2 - x1)
            if crossing_east > east:
                crossings += 1
    return crossings % 2 == 1


def _edge_distance_m(area: Area, point: Point) -> float:
    """Return the distance [m] of a point from the nearest point of an area's outline."""
    if not area.corners_enu_m:
        return abs(math.dist(point, area.center_enu_m) - area.radius_m)

    east, north = point
    least_m = math.inf
    for (x1, y1), (x2, y2) in _sides(area):
        dx = x2 - x1
        dy = y2 - y1
        # the nearest point of the side, as a share of the way from its start to its end
        along = ((east - x1) * dx + (north - y1) * dy) / (dx * dx + dy * dy)
        share = min(1.0, max(0.0, along))
        nearest = (x1 + share * dx, y1 + share * dy)
        least_m = min(least_m, math.dist(point, nearest))
    return least_m


def _sides(area: Area) -> list[tuple[Point, Point]]:
    """Return the start and the end of each side of a polygon."""
    corners = area.corners_enu_m
    return list(itertools.pairwise([*corners, corners[0]]))
