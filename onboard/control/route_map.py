"""Finds the shortest routes around static things, by a visibility graph.

A straight line to a goal may lead through an obstacle, or pass it more closely than the law allows.
The law makes a vehicle slide along an obstacle towards the goal, so the vehicle stops if the goal
lies straight behind a wall. The shortest route around is a chain of straight pieces whose corners
lie beside the ends of obstacles (Lozano-Perez and Wesley, An algorithm for planning collision-free
paths among polyhedral obstacles, 1979). All corners, and the shortest routes between them, are
computed once. For a position and a goal only the pieces to and from the corners are computed.

A static thing is an obstacle or an edge of an area. Everything here is horizontal: the caller
passes only the things whose heights matter for the flight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.avoidance.params import Capsule, Walls
from onboard.vectors import Vec2

# A corner is farther from its thing than necessary, so that the law does not push a vehicle away
# from the corner. A piece may be too near a thing, because the law keeps the distance there.
_CORNER_SPARE_M = 0.05
_PIECE_SPARE_M = 0.05

_BAR_M = 0.001  # distance that a piece keeps from a bar that closes a too narrow passage
_BEYOND_WALL_M = 1.0  # length of a bar beyond a wall of the box

_NARROW_M = 0.3  # a passage that is less than this wider than necessary has a corner in its middle
CORNERS_PER_END = 8  # a regular octagon around each end of an obstacle

# A route on another side of a thing is taken only if it is shorter by this. Otherwise a vehicle
# with a noisy estimate would alternate between two routes of the same length.
_SHORTER_M = 0.5

_FIRST_TRIES = 8  # this many corners are tried together first: those with the shortest routes

# Each test checks whether a piece between two corners keeps its distance from a thing, so the
# number of tests is the squared number of corners times the number of things. With more tests than
# this, the map would take too long to compute (a second on a small computer). It then has no
# corners, and every route is straight.
MAX_TESTS = 1_000_000

# Rounding may make a distance too small by this: first at a point, second along a piece.
_POINT_ROUNDING_M = 1e-6
_PIECE_ROUNDING_M = 1e-9


class _Things(NamedTuple):
    """O static things: each is a segment, and the distance that vehicles keep from it."""

    begin_m: Array  # (O, 2)
    end_m: Array  # (O, 2)
    keep_m: Array  # (O,) least distance of a vehicle's centre from the segment
    area: IntArray  # (O,) number of the area that it is an edge of; 0: an obstacle


class _Ends(NamedTuple):
    """The E ends of things around which routes turn, without repetition."""

    points_m: Array  # (E, 2)
    keep_m: Array  # (E,)


class _CornerRoutes(NamedTuple):
    """The shortest routes between all C corners."""

    corners_m: Array  # (C, 2)
    pieces_m: Array  # (C, C) lengths of the straight pieces, infinite if a piece is not free
    length_m: Array  # (C, C), infinite where there is no route
    following: IntArray  # (C, C) index of the next corner on the route from one corner to another
    is_complete: bool  # False: there were too many corners, and all are left out


class _GoalRoutes(NamedTuple):
    """The shortest routes from all corners to one goal."""

    length_m: Array  # (C,), infinite where there is no route
    last: IntArray  # (C,) index of the last corner of each route


class RouteMap:
    """Corners around static things, and the shortest routes between them.

    The constructor computes all of them.

    Args:
        still: obstacles and edges of areas, in fleet ENU.
        clearance_m: distance that a vehicle's centre keeps from an obstacle's outline.
        walls: walls of the box.
    """

    def __init__(self, still: Sequence[Capsule], clearance_m: float, walls: Walls) -> None:
        blocking = [capsule for capsule in still if not _is_round_field(capsule)]
        free_standing = _things_of(blocking, clearance_m)
        ends = _ends_of(blocking, free_standing)
        self._walls = walls
        self._obstacles = _things_of([thing for thing in still if thing.area == 0], clearance_m)
        self._things = _with_bars(free_standing, ends, walls)

        corners = _corners(ends, free_standing, walls)
        is_complete = len(corners) ** 2 * len(self._things.keep_m) <= MAX_TESTS
        if not is_complete:
            corners = corners[:0]  # none

        # lengths of the free pieces between two corners
        between_m = np.full((len(corners), len(corners)), np.inf)
        for row, corner in zip(between_m, corners, strict=True):
            is_free = self._are_free(corner, corners)
            row[is_free] = _lengths(corners - corner)[is_free]
        self._routes = _shortest(corners, between_m, is_complete)

    @property
    def is_complete(self) -> bool:
        """Whether the map has all corners, so that it finds every route that exists."""
        return self._routes.is_complete

    @property
    def corners(self) -> list[Vec2]:
        """All corners, in fleet ENU [m]."""
        return [Vec2(*corner) for corner in self._routes.corners_m.tolist()]

    def route(self, begin_m: Vec2, goal_m: Vec2, present_m: Vec2 | None = None) -> list[Vec2]:
        """Return the points of the shortest route: its corners, then the goal.

        Args:
            begin_m, goal_m: positions in fleet ENU. Either may be nearer to an obstacle than
                allowed; the route then leads away from the obstacle. The start may be beyond the
                edge of an area; this area is then ignored until the first corner.
            present_m: the corner that the vehicle now flies to. Routes on the same side of a thing
                are preferred.
        Returns:
            Only the goal if the straight line is free. Empty if there is no route.
        """
        begin = np.array(begin_m)
        is_relevant = self._relevant_things(begin)
        if self._are_free(begin, np.array(goal_m), is_relevant):
            return [goal_m]

        # corners in the order of the lengths of their routes, the shortest first
        corners = self._routes.corners_m
        from_corners = self._routes_to(goal_m)
        total_m = _lengths(corners - begin) + from_corners.length_m
        order = np.argsort(total_m)
        order = order[np.isfinite(total_m[order])]

        first = self._first_in_sight(begin, order[:_FIRST_TRIES], is_relevant)
        if first is None:
            first = self._first_in_sight(begin, order[_FIRST_TRIES:], is_relevant)
        if first is None:
            return []

        # stay on the present side of a thing unless the other side is much shorter
        present = self._index_of(present_m)
        if present is not None and total_m[present] < total_m[first] + _SHORTER_M:
            is_other_side = not np.isfinite(self._routes.pieces_m[present, first])
            if is_other_side and self._are_free(begin, corners[present], is_relevant):
                first = present
        last = int(from_corners.last[first])
        return [*self._corners_between(first, last), goal_m]

    def _first_in_sight(
        self, begin: Array, indices: IntArray, is_relevant: BoolArray
    ) -> int | None:
        """Return the index of the first corner that a free straight line leads to."""
        is_free = self._are_free(begin, self._routes.corners_m[indices], is_relevant)
        if not is_free.any():
            return None
        return int(indices[int(is_free.argmax())])

    def _index_of(self, corner_m: Vec2 | None) -> int | None:
        """Return the index of a corner; None if this map has no such corner."""
        if corner_m is None:
            return None
        is_same = (self._routes.corners_m == np.array(corner_m)).all(-1)
        if not is_same.any():
            return None
        return int(is_same.argmax())

    def _corners_between(self, corner: int, last: int) -> list[Vec2]:
        """Return the corners of the shortest route from one corner to another."""
        routes = self._routes
        points = [Vec2(*routes.corners_m[corner].tolist())]
        while corner != last:
            corner = int(routes.following[corner, last])
            points.append(Vec2(*routes.corners_m[corner].tolist()))
        return points

    def _routes_to(self, goal_m: Vec2) -> _GoalRoutes:
        """Return the shortest routes from all corners to a goal."""
        corners = self._routes.corners_m
        goal = np.array(goal_m)
        last_m = np.where(self._are_free(goal, corners), _lengths(corners - goal), np.inf)
        total_m = self._routes.length_m + last_m[None]
        return _GoalRoutes(total_m.min(1, initial=np.inf), _nearest_column(total_m))

    def _relevant_things(self, point_m: Array) -> BoolArray:
        """Return whether each thing (O,) matters for a piece from a point.

        If the point is beyond the edges of an area, these edges do not matter, because every route
        back crosses one.
        """
        is_beyond = _is_beyond_areas(point_m, self._things)
        return np.asarray(~is_beyond[self._things.area])

    def lengths_past(self, begin_m: Vec2, other_m: Vec2, keep_m: float) -> list[float]:
        """Return, for each corner, the length [m] of the shortest route that stays away from a
        point.

        Args:
            begin_m: start of the routes; it may be nearer to the point than ``keep_m``.
            other_m: the point.
            keep_m: distance to keep from the point.
        Returns:
            The lengths, in the order of the corners; infinite where there is no route.
        """
        begin = np.array(begin_m)
        other = np.array(other_m)
        corners = self._routes.corners_m

        # routes of one piece
        kept_m = min(keep_m, math.dist(begin_m, other_m)) - _PIECE_ROUNDING_M
        is_open = _point_distances(other, begin, corners) >= kept_m
        is_open &= self._are_free(begin, corners, self._relevant_things(begin))
        lengths_m = np.where(is_open, _lengths(corners - begin), np.inf)

        # longer routes, by the algorithm of Bellman and Ford
        is_clear = _point_distances(other, corners[:, None], corners[None]) >= keep_m
        pieces_m = np.where(is_clear, self._routes.pieces_m, np.inf)
        for _ in range(len(corners)):
            through_m = (lengths_m[:, None] + pieces_m).min(0, initial=np.inf)
            if (through_m >= lengths_m).all():
                break
            lengths_m = np.minimum(lengths_m, through_m)
        return [float(length) for length in lengths_m]

    def room_m(self, point_m: Vec2) -> float:
        """Return how much farther a point is from all obstacles than necessary [m].

        It is negative for a point that is too near, and infinite without obstacles.
        """
        things = self._obstacles
        distance_m = _point_distances(np.array(point_m), things.begin_m, things.end_m)
        return float((distance_m - things.keep_m).min(initial=math.inf))

    def is_free(self, begin_m: Vec2, end_m: Vec2) -> bool:
        """Whether a straight piece keeps its distance from all things, and ends inside the box."""
        end = np.array(end_m)
        return bool(_is_inside(end, self._walls) and self._are_free(np.array(begin_m), end))

    def _are_free(
        self, begins_m: Array, ends_m: Array, is_relevant: BoolArray | None = None
    ) -> BoolArray:
        """Return whether each straight piece, (..., 2) to (..., 2), keeps its distances.

        If an end of a piece is nearer to a thing than allowed, the whole piece may be as near.

        Args:
            begins_m, ends_m: ends of the pieces.
            is_relevant: whether each thing matters (O,); None: all of them do.
        """
        things = self._things
        begins = begins_m[..., None, :]
        ends = ends_m[..., None, :]
        from_begin_m = _point_distances(begins, things.begin_m, things.end_m)
        from_end_m = _point_distances(ends, things.begin_m, things.end_m)
        distance_m = _piece_distances(begins, ends, things, np.minimum(from_begin_m, from_end_m))

        allowed_m = np.minimum(things.keep_m - _PIECE_SPARE_M, from_begin_m)
        allowed_m = np.minimum(allowed_m, from_end_m)
        is_far = distance_m >= allowed_m - _PIECE_ROUNDING_M
        if is_relevant is not None:
            is_far = is_far | ~is_relevant
        return np.asarray(is_far.all(-1))


def _nearest_column(lengths_m: Array) -> IntArray:
    """Return the column of the smallest value in each row; without columns there are no rows."""
    if lengths_m.size == 0:
        return np.zeros(0, dtype=np.intp)
    return np.asarray(lengths_m.argmin(1))


def _is_beyond_areas(point_m: Array, things: _Things) -> BoolArray:
    """Return for each area, by its number, whether a point (2,) is beyond its edges.

    The allowed side of an edge is on its left. So the allowed space is inside an outline that
    turns left, and outside of an outline that turns right. A point is inside an outline if a ray
    from the point to the east crosses an odd number of edges. Number 0 stands for the obstacles,
    and its entry is False.
    """
    begin = things.begin_m - point_m
    end = things.end_m - point_m
    doubled_m2 = _cross(begin, end)  # area between the point and each edge

    # if the ray crosses an upward edge, the point is on its left; for a downward edge, on its right
    is_upward = end[:, 1] > begin[:, 1]
    is_above_or_below = (begin[:, 1] > 0.0) == (end[:, 1] > 0.0)  # the edge, of the ray's line
    is_crossed = ~is_above_or_below & (is_upward == (doubled_m2 > 0.0))

    crossings = np.bincount(things.area, weights=is_crossed)
    is_inside = crossings % 2 == 1
    is_left_turn = np.bincount(things.area, weights=doubled_m2) > 0.0
    is_beyond = is_inside != is_left_turn
    is_beyond[:1] = False  # a slice, because without things there is no entry
    return np.asarray(is_beyond)


def is_beyond(point_m: Vec2, edges: Sequence[Capsule]) -> bool:
    """Return whether a point [m] is beyond the edges of areas to stay out of.

    Args:
        point_m: the point, in fleet ENU.
        edges: all edges of these areas.
    """
    for edge in edges:
        is_circle = edge.begin_enu_m == edge.end_enu_m
        if is_circle and math.dist(edge.begin_enu_m, point_m) < edge.radius_m:
            return True
    return bool(_is_beyond_areas(np.array(point_m), _things_of(edges, 0.0)).any())


def _is_round_field(capsule: Capsule) -> bool:
    """Return whether an edge is the circle of an area to stay inside.

    A straight line between two points inside a circle stays inside.
    """
    is_round = capsule.begin_enu_m == capsule.end_enu_m
    return capsule.area > 0 and is_round and not capsule.is_turned_about


def _things_of(still: Sequence[Capsule], clearance_m: float) -> _Things:
    """Return obstacles and edges of areas as arrays."""
    keep_m = []
    for capsule in still:
        beyond_outline_m = capsule.keep_m
        if capsule.area == 0:
            beyond_outline_m = clearance_m
        keep_m.append(capsule.radius_m + beyond_outline_m)
    return _Things(
        begin_m=np.array([capsule.begin_enu_m for capsule in still]).reshape(-1, 2),
        end_m=np.array([capsule.end_enu_m for capsule in still]).reshape(-1, 2),
        keep_m=np.array(keep_m),
        area=np.array([capsule.area for capsule in still], dtype=np.intp),
    )


def _ends_of(still: Sequence[Capsule], things: _Things) -> _Ends:
    """Return the ends of obstacles, and the corners of areas that point into the allowed space."""
    ends: dict[tuple[Vec2, float], None] = {}  # (end, distance to keep), without repetition
    for capsule, keep_m in zip(still, things.keep_m.tolist(), strict=True):
        is_segment = capsule.begin_enu_m != capsule.end_enu_m
        if capsule.area == 0 or not is_segment or capsule.is_begin_inwards:
            ends[capsule.begin_enu_m, keep_m] = None
        if capsule.area == 0 and is_segment:  # the end of an area's edge is the start of the next
            ends[capsule.end_enu_m, keep_m] = None
    return _Ends(
        points_m=np.array([end for end, _ in ends]).reshape(-1, 2),
        keep_m=np.array([keep_m for _, keep_m in ends]),
    )


def _with_bars(things: _Things, ends: _Ends, walls: Walls) -> _Things:
    """Return the things, plus a bar across each passage that is slightly too narrow.

    A piece may be nearer to a thing than the distance to keep by _PIECE_SPARE_M. So without the bar
    a route could lead through a passage that is too narrow by up to twice that, where the law stops
    the vehicle.
    """
    across, free_m = _passages(ends, things)
    is_too_narrow = free_m < -_POINT_ROUNDING_M
    is_little = free_m > -2.0 * _PIECE_SPARE_M - _POINT_ROUNDING_M
    is_closed = is_too_narrow & is_little
    begins = np.broadcast_to(ends.points_m[:, None], across.shape)
    bars = [np.stack([begins[is_closed], (begins + across)[is_closed]], axis=1)]

    # also put bars between an end and a wall of the box; a vehicle may be slightly beyond the wall
    for axis, wall_m, sign in _sides(walls):
        room_m = sign * (wall_m - ends.points_m[:, axis])
        is_closed = (room_m > 0.0) & (room_m < ends.keep_m - _POINT_ROUNDING_M)
        feet = ends.points_m[is_closed].copy()
        feet[:, axis] = wall_m + sign * _BEYOND_WALL_M
        bars.append(np.stack([ends.points_m[is_closed], feet], axis=1))

    # a piece may be nearer to a bar by _PIECE_SPARE_M, as to every thing; _BAR_M remains
    all_bars = np.concatenate(bars)
    count = len(all_bars)
    return _Things(
        begin_m=np.concatenate([things.begin_m, all_bars[:, 0]]),
        end_m=np.concatenate([things.end_m, all_bars[:, 1]]),
        keep_m=np.concatenate([things.keep_m, np.full(count, _PIECE_SPARE_M + _BAR_M)]),
        area=np.concatenate([things.area, np.zeros(count, dtype=np.intp)]),
    )


def _sides(walls: Walls) -> tuple[tuple[int, float, float], ...]:
    """Return the walls of the box: axis (0: x, 1: y), coordinate [m], sign of the outward axis."""
    return (
        (0, walls.low_x_m, -1.0),
        (0, walls.high_x_m, 1.0),
        (1, walls.low_y_m, -1.0),
        (1, walls.high_y_m, 1.0),
    )


def _corners(ends: _Ends, things: _Things, walls: Walls) -> Array:
    """Return the points (C, 2) at which routes turn.

    They lie around the ends of things, and in the middle of narrow passages.
    """
    around = _octagon_corners(ends)
    middles = np.concatenate([_passage_middles(ends, things), _wall_passage_middles(ends, walls)])

    # A corner needs half of its spare distance from other things. The middle of a passage needs no
    # spare distance.
    around = around[_is_clear(around, things, 0.5 * _CORNER_SPARE_M)]
    middles = middles[_is_clear(middles, things, -_POINT_ROUNDING_M)]
    corners = np.concatenate([around, middles])

    return np.asarray(corners[_is_inside(corners, walls)])


def _is_inside(points_m: Array, walls: Walls) -> BoolArray:
    """Return whether each point (..., 2) is inside the box."""
    x = points_m[..., 0]
    y = points_m[..., 1]
    is_inside_x = (x >= walls.low_x_m) & (x <= walls.high_x_m)
    is_inside_y = (y >= walls.low_y_m) & (y <= walls.high_y_m)
    return np.asarray(is_inside_x & is_inside_y)


def _octagon_corners(ends: _Ends) -> Array:
    """Return the corners (.., 2) of an octagon around each end; its sides keep the distance."""
    angle = 2.0 * np.pi * np.arange(CORNERS_PER_END) / CORNERS_PER_END
    directions = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    radius_m = (ends.keep_m + _CORNER_SPARE_M) / math.cos(math.pi / CORNERS_PER_END)
    corners = ends.points_m[:, None] + radius_m[:, None, None] * directions
    return np.asarray(corners.reshape(-1, 2))


def _passage_middles(ends: _Ends, things: _Things) -> Array:
    """Return the middle (.., 2) of each narrow passage between an end and another thing.

    Its distances from both exceed the distances to keep by the same amount.
    """
    across, free_m = _passages(ends, things)
    width_m = _lengths(across)
    is_narrow = (free_m > -_POINT_ROUNDING_M) & (free_m < _NARROW_M)

    share = (ends.keep_m[:, None] + 0.5 * free_m) / np.maximum(width_m, 1e-12)
    middles = ends.points_m[:, None] + share[..., None] * across
    return np.asarray(middles[is_narrow])


def _wall_passage_middles(ends: _Ends, walls: Walls) -> Array:
    """Return the middle (.., 2) of each narrow passage between an end and a wall of the box.

    The vehicle's centre may be at the wall, so only the distance from the end must be kept.
    """
    middles = []
    for axis, wall_m, sign in _sides(walls):
        free_m = sign * (wall_m - ends.points_m[:, axis]) - ends.keep_m
        is_narrow = (free_m > -_POINT_ROUNDING_M) & (free_m < _NARROW_M)
        beside_wall = ends.points_m[is_narrow].copy()
        beside_wall[:, axis] += sign * (ends.keep_m + 0.5 * free_m)[is_narrow]
        middles.append(beside_wall)
    return np.concatenate(middles)


def _passages(ends: _Ends, things: _Things) -> tuple[Array, Array]:
    """Return the passage from each end to each thing, and how much wider than necessary it is.

    Returns:
        Vectors (E, O, 2) from the ends to the nearest points of the things, and widths (E, O).
    """
    nearest = _nearest_points(ends.points_m[:, None], things.begin_m, things.end_m)
    across = nearest - ends.points_m[:, None]
    return across, _lengths(across) - ends.keep_m[:, None] - things.keep_m


def _is_clear(points_m: Array, things: _Things, spare_m: float) -> BoolArray:
    """Return whether each point (P, 2) is farther from all things than necessary, by a spare
    distance.
    """
    distance_m = _point_distances(points_m[:, None], things.begin_m, things.end_m)
    return np.asarray((distance_m >= things.keep_m + spare_m).all(-1))


def _shortest(corners_m: Array, between_m: Array, is_complete: bool) -> _CornerRoutes:
    """Return the shortest routes between corners, by Floyd's and Warshall's algorithm.

    Args:
        corners_m: the corners (C, 2).
        between_m: lengths (C, C) of the straight pieces, infinite if a piece is not free.
        is_complete: whether these are all corners.
    """
    count = len(between_m)
    length_m = between_m.copy()
    following = np.broadcast_to(np.arange(count), (count, count)).copy()
    for middle in range(count):
        through_m = length_m[:, middle, None] + length_m[None, middle]
        is_shorter = through_m < length_m
        length_m = np.where(is_shorter, through_m, length_m)
        following = np.where(is_shorter, following[:, middle, None], following)
    return _CornerRoutes(
        corners_m=corners_m,
        pieces_m=between_m,
        length_m=length_m,
        following=following,
        is_complete=is_complete,
    )


def _lengths(vectors_m: Array) -> Array:
    return np.hypot(vectors_m[..., 0], vectors_m[..., 1])


def _cross(a: Array, b: Array) -> Array:
    """Return the cross products of plane vectors; positive if b is to the left of a."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _nearest_shares(points_m: Array, begins_m: Array, ends_m: Array) -> Array:
    """Return the points of segments that are nearest to given points, as shares from 0 to 1."""
    # by components, because a sum over an axis of length two takes three times as long
    along_x = ends_m[..., 0] - begins_m[..., 0]
    along_y = ends_m[..., 1] - begins_m[..., 1]
    x = points_m[..., 0] - begins_m[..., 0]
    y = points_m[..., 1] - begins_m[..., 1]
    squared_length_m2 = np.maximum(
        along_x * along_x + along_y * along_y, 1e-12
    )  # 0: the segment is a point
    return np.asarray(np.clip((x * along_x + y * along_y) / squared_length_m2, 0.0, 1.0))


def _nearest_points(points_m: Array, begins_m: Array, ends_m: Array) -> Array:
    """Return the nearest points of segments to points; all (..., 2), broadcast."""
    share = _nearest_shares(points_m, begins_m, ends_m)
    return np.asarray(begins_m + share[..., None] * (ends_m - begins_m))


def _point_distances(points_m: Array, begins_m: Array, ends_m: Array) -> Array:
    """Return the distances of points from segments; all (..., 2), broadcast."""
    share = _nearest_shares(points_m, begins_m, ends_m)
    x = begins_m[..., 0] + share * (ends_m[..., 0] - begins_m[..., 0]) - points_m[..., 0]
    y = begins_m[..., 1] + share * (ends_m[..., 1] - begins_m[..., 1]) - points_m[..., 1]
    return np.asarray(np.sqrt(x * x + y * y))


def _piece_distances(begins_m: Array, ends_m: Array, things: _Things, from_ends_m: Array) -> Array:
    """Return the distances of straight pieces from things, 0 where they cross.

    Two segments that do not cross are nearest at an end of one of them.

    Args:
        begins_m, ends_m: ends (..., 1, 2) of the pieces.
        things: static things (O,).
        from_ends_m: distances (..., O) of the nearer end of each piece from each thing.
    """
    of_begin_m = _point_distances(things.begin_m, begins_m, ends_m)
    of_end_m = _point_distances(things.end_m, begins_m, ends_m)
    distance_m = np.minimum(np.minimum(of_begin_m, of_end_m), from_ends_m)

    # two segments cross if the ends of each lie on different sides of the other
    piece = ends_m - begins_m
    thing = things.end_m - things.begin_m
    sides_of_piece = _cross(piece, things.begin_m - begins_m) * _cross(
        piece, things.end_m - begins_m
    )
    sides_of_thing = _cross(thing, begins_m - things.begin_m) * _cross(
        thing, ends_m - things.begin_m
    )
    is_crossing = (sides_of_piece < 0.0) & (sides_of_thing < 0.0)
    return np.where(is_crossing, 0.0, distance_m)
