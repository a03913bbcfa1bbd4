"""Geometry of the areas that vehicles must stay inside or outside. Pure, in plain floats.

Seen from above, an area is a polygon or a circle. It counts between two heights. The corners of a
polygon are ordered so that vehicles are allowed on the left of each edge: counterclockwise for an
area to stay in, clockwise for an area to stay out of.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from onboard.tuples import Xyz

Point = tuple[float, float]  # east, north [m]

BELOW_FLOOR_M = 0.5  # a height measured on the ground may be this far below the floor of a fence
# A take-off spot may be only this far below it: the measured height errs by the rest.
START_BELOW_FLOOR_M = 0.1
_ON_EDGE_M = 1e-9  # a position nearer to an edge, or to a centre, has no direction from it


class Area(NamedTuple):
    """One area in the fleet frame."""

    name: str
    keeps_in: bool  # vehicles stay in it; False: they stay out of it
    corners_enu_m: tuple[Point, ...]  # the allowed side is on the left; empty for a circle
    center_enu_m: Point  # centre of a circle
    radius_m: float  # radius of a circle
    low_m: float  # least height at which it counts
    high_m: float  # largest height at which it counts
    buffer_m: float  # distance that goals and flights keep from its edge


class Nearest(NamedTuple):
    """The point of an area's edge that is nearest to a position, seen from above."""

    x: float
    y: float
    # unit vector from that point into the allowed space
    normal_x: float
    normal_y: float
    room_m: float  # distance to that point; negative if the position is not allowed


def edges_of(corners: Sequence[Point]) -> Iterator[tuple[Point, Point]]:
    """Yield both ends of each edge of a polygon.

    Args:
        corners: in order.
    """
    for index, begin in enumerate(corners):
        yield begin, corners[(index + 1) % len(corners)]


def area_m2(corners: Sequence[Point]) -> float:
    """Return the area of a polygon; negative if its corners are in clockwise order.

    Args:
        corners: in order.
    """
    doubled_m2 = 0.0
    for (x1, y1), (x2, y2) in edges_of(corners):
        doubled_m2 += x1 * y2 - x2 * y1
    return 0.5 * doubled_m2


def size_m2(area: Area) -> float:
    """Return the size of an area, seen from above.

    Args:
        area: any.
    """
    if area.corners_enu_m:
        return abs(area_m2(area.corners_enu_m))
    return math.pi * area.radius_m * area.radius_m


def is_in_polygon(corners: Sequence[Point], x: float, y: float) -> bool:
    """Whether a point lies in a polygon.

    Args:
        corners: in order.
        x: east [m].
        y: north [m].
    """
    is_inside = False
    x1, y1 = corners[-1]
    for x2, y2 in corners:
        # a point is inside if a ray to the east crosses the outline an odd number of times
        if (y1 > y) != (y2 > y) and x < x1 + (y - y1) / (y2 - y1) * (x2 - x1):
            is_inside = not is_inside
        x1 = x2
        y1 = y2
    return is_inside


def do_cross(one: tuple[Point, Point], two: tuple[Point, Point]) -> bool:
    """Whether two segments have a point in common.

    Args:
        one: ends of the first segment.
        two: ends of the second segment.
    """
    (ax, ay), (bx, by) = one
    (cx, cy), (dx, dy) = two
    if max(ax, bx) < min(cx, dx) or max(cx, dx) < min(ax, bx):
        return False
    if max(ay, by) < min(cy, dy) or max(cy, dy) < min(ay, by):
        return False

    # they cross if each segment separates the ends of the other, or touches one
    c_of_ab = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    d_of_ab = (bx - ax) * (dy - ay) - (by - ay) * (dx - ax)
    a_of_cd = (dx - cx) * (ay - cy) - (dy - cy) * (ax - cx)
    b_of_cd = (dx - cx) * (by - cy) - (dy - cy) * (bx - cx)
    return c_of_ab * d_of_ab <= 0.0 and a_of_cd * b_of_cd <= 0.0


def self_crossing(corners: Sequence[Point]) -> tuple[int, int] | None:
    """Return the numbers of the first two edges of a polygon that cross; None if no edges cross.

    Args:
        corners: in order; at least three, and no two consecutive ones the same.
    """
    edges = list(edges_of(corners))
    for first, one in enumerate(edges):
        for second in range(first + 1, len(edges)):
            two = edges[second]
            two_follows = second == first + 1
            one_follows = first == 0 and second == len(edges) - 1
            # edges that share a corner cross only if one folds back over the other
            if two_follows:
                is_crossing = _folds_back(one, two)
            elif one_follows:
                is_crossing = _folds_back(two, one)
            else:
                is_crossing = do_cross(one, two)

            if is_crossing:
                return first, second
    return None


def _folds_back(before: tuple[Point, Point], after: tuple[Point, Point]) -> bool:
    """Return whether an edge folds back over the previous edge."""
    (begin_x, begin_y), (shared_x, shared_y) = before
    _, (end_x, end_y) = after

    # both edges as vectors away from the corner that they share
    x1 = begin_x - shared_x
    y1 = begin_y - shared_y
    x2 = end_x - shared_x
    y2 = end_y - shared_y
    are_parallel = x1 * y2 - x2 * y1 == 0.0
    have_same_direction = x1 * x2 + y1 * y2 > 0.0
    return are_parallel and have_same_direction


def nearest(area: Area, x: float, y: float) -> Nearest:
    """Return the nearest point of an area's edge.

    Args:
        area: any.
        x: east of the position [m].
        y: north of the position [m].
    """
    if not area.corners_enu_m:
        return _nearest_of_circle(area, x, y)

    least_m = math.inf
    nearest_edge: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # point and edge
    for (x1, y1), (x2, y2) in edges_of(area.corners_enu_m):
        along_x = x2 - x1
        along_y = y2 - y1
        # the nearest point of the edge, as a share of the edge's length
        edge_share = ((x - x1) * along_x + (y - y1) * along_y) / (along_x**2 + along_y**2)
        edge_share = min(1.0, max(0.0, edge_share))

        nearest_x = x1 + edge_share * along_x
        nearest_y = y1 + edge_share * along_y
        distance_m = math.hypot(x - nearest_x, y - nearest_y)
        if distance_m < least_m:
            least_m = distance_m
            nearest_edge = (nearest_x, nearest_y, along_x, along_y)

    nearest_x, nearest_y, along_x, along_y = nearest_edge
    is_allowed = is_in_polygon(area.corners_enu_m, x, y) == area.keeps_in
    sign = 1.0 if is_allowed else -1.0
    if least_m > _ON_EDGE_M:
        normal_x = sign * (x - nearest_x) / least_m
        normal_y = sign * (y - nearest_y) / least_m
    else:  # the edge's direction turned left, to where vehicles are allowed
        length_m = math.hypot(along_x, along_y)
        normal_x = -along_y / length_m
        normal_y = along_x / length_m
    return Nearest(
        x=nearest_x, y=nearest_y, normal_x=normal_x, normal_y=normal_y, room_m=sign * least_m
    )


def _nearest_of_circle(area: Area, x: float, y: float) -> Nearest:
    """Return the nearest point of a circle; from its centre, the easternmost point."""
    center_x, center_y = area.center_enu_m
    to_x = x - center_x
    to_y = y - center_y
    distance_m = math.hypot(to_x, to_y)
    outwards_x = 1.0
    outwards_y = 0.0
    if distance_m > _ON_EDGE_M:
        outwards_x = to_x / distance_m
        outwards_y = to_y / distance_m

    sign = -1.0 if area.keeps_in else 1.0
    return Nearest(
        x=center_x + area.radius_m * outwards_x,
        y=center_y + area.radius_m * outwards_y,
        normal_x=sign * outwards_x,
        normal_y=sign * outwards_y,
        room_m=sign * (distance_m - area.radius_m),
    )


def is_allowed(area: Area, position_enu_m: Xyz) -> bool:
    """Whether an area allows a position.

    Args:
        area: any area.
        position_enu_m: a finite position.
    """
    x, y, z = position_enu_m
    if area.keeps_in:
        has_height = area.low_m - BELOW_FLOOR_M <= z <= area.high_m
        return has_height and _is_within(area, x, y)

    has_height = area.low_m <= z <= area.high_m
    return not (has_height and _is_within(area, x, y))


def _is_within(area: Area, x: float, y: float) -> bool:
    """Whether a point lies in the polygon or circle, seen from above."""
    if area.corners_enu_m:
        return is_in_polygon(area.corners_enu_m, x, y)
    center_x, center_y = area.center_enu_m
    return math.hypot(x - center_x, y - center_y) <= area.radius_m


def _is_polygon_crossed(corners: Sequence[Point], leg: tuple[Point, Point]) -> bool:
    """Whether a straight line has a point in common with an edge.

    Most edges lie completely north or south of the line, which is checked first.
    """
    (_, leg_y1), (_, leg_y2) = leg
    south_m = min(leg_y1, leg_y2)
    north_m = max(leg_y1, leg_y2)
    begin = corners[-1]
    for end in corners:
        _, begin_y = begin
        _, end_y = end
        is_south = begin_y < south_m and end_y < south_m
        is_north = begin_y > north_m and end_y > north_m
        if not is_south and not is_north and do_cross((begin, end), leg):
            return True
        begin = end
    return False


def counts_at(area: Area, low_m: float, high_m: float) -> bool:
    """Whether an area counts for a flight between two heights, including its buffer.

    Args:
        area: any area.
        low_m: least height of the flight.
        high_m: largest height of the flight.
    """
    if area.keeps_in:
        return True
    return high_m >= area.low_m - area.buffer_m and low_m <= area.high_m + area.buffer_m


def is_crossed(area: Area, begin_enu_m: Xyz, end_enu_m: Xyz) -> bool:
    """Whether a straight line crosses an area's edge, seen from above, at a height that counts.

    Args:
        area: any area.
        begin_enu_m: start of the line.
        end_enu_m: end of the line.
    """
    x1, y1, z1 = begin_enu_m
    x2, y2, z2 = end_enu_m
    if not area.keeps_in and (max(z1, z2) < area.low_m or min(z1, z2) > area.high_m):
        return False

    leg = ((x1, y1), (x2, y2))
    if area.corners_enu_m:
        return _is_polygon_crossed(area.corners_enu_m, leg)

    # a line crosses a circle if its nearest point is inside and one of its ends is outside
    center_x, center_y = area.center_enu_m
    squared_length_m2 = (x2 - x1) ** 2 + (y2 - y1) ** 2
    leg_share = 0.0  # nearest point of the line, as a share of its length
    if squared_length_m2 > 0.0:
        leg_share = ((center_x - x1) * (x2 - x1) + (center_y - y1) * (y2 - y1)) / squared_length_m2
        leg_share = min(1.0, max(0.0, leg_share))

    nearest_x = x1 + leg_share * (x2 - x1)
    nearest_y = y1 + leg_share * (y2 - y1)
    nearest_m = math.hypot(nearest_x - center_x, nearest_y - center_y)
    farthest_m = max(math.hypot(x - center_x, y - center_y) for x, y in leg)
    return nearest_m <= area.radius_m <= farthest_m
