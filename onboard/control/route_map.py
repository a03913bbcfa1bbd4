"""Finds the shortest ways around static things, by a visibility graph.

A straight line to a goal may lead through an obstacle, or past it more closely than the law allows.
The law slides along an obstacle towards the goal, and so it stops where the goal lies straight
behind a wall. The shortest way around is a chain of straight pieces whose corners lie beside the
ends of obstacles (Lozano-Perez and Wesley, An algorithm for planning collision-free paths among
polyhedral obstacles, 1979). All corners, and the shortest ways between them, are computed once. For
a position and a goal only the pieces to and from the corners are computed.

Everything is horizontal: obstacles have no height limit, and areas with one are chosen before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.avoidance.params import Capsule, Walls
from onboard.vectors import Vec2

# A corner is farther than necessary from what it leads around, so that the law does not push a
# vehicle away from it. A piece may be nearer than necessary: the law holds the distance there.
_CORNER_SPARE_M = 0.05
_PIECE_SPARE_M = 0.05

_NARROW_M = 0.3  # a passage that is wider by less has a corner in its middle
_CORNERS_PER_END = 8  # a regular octagon around each end of an obstacle

# The corners, squared, times the things: with more, the map takes too long to compute (a second of
# a small computer), and every way is straight.
MOST_PIECES = 1_000_000


class _Things(NamedTuple):
    """Static things as arrays: all points nearer to a segment than the distance to keep."""

    begin_m: Array  # (O, 2)
    end_m: Array  # (O, 2)
    keep_m: Array  # (O,) least distance of a vehicle's centre from the segment


class _Ways(NamedTuple):
    """The shortest ways between all corners."""

    corners_m: Array  # (C, 2)
    pieces_m: Array  # (C, C) lengths of the straight pieces, infinite where one is not free
    length_m: Array  # (C, C), infinite where there is no way
    following: IntArray  # (C, C) the next corner on the way from one to another
    is_complete: bool  # False: there were too many corners, and all are left out


class RouteMap:
    """Corners around static things, and the shortest ways between them, computed when it is made.

    Args:
        still: obstacles and edges of areas, in fleet ENU.
        clearance_m: distance that a vehicle's centre keeps from an obstacle's outline.
        walls: walls of the box.
    """

    def __init__(self, still: Sequence[Capsule], clearance_m: float, walls: Walls) -> None:
        blocking = [capsule for capsule in still if not _is_round_field(capsule)]
        self._walls = walls
        self._things = _things(blocking, clearance_m)

        corners = _corners(blocking, self._things, walls)
        is_complete = len(corners) ** 2 * len(blocking) <= MOST_PIECES
        if not is_complete:
            corners = corners[:0]

        between_m = np.full((len(corners), len(corners)), np.inf)
        for row, corner in zip(between_m, corners, strict=True):
            is_free = self._are_free(corner, corners)
            row[is_free] = _lengths(corners - corner)[is_free]
        self._ways = _shortest(corners, between_m, is_complete)

    @property
    def is_complete(self) -> bool:
        """Whether there are few enough corners to say that there is no way."""
        return self._ways.is_complete

    @property
    def corners(self) -> list[Vec2]:
        """All corners, in fleet ENU [m]."""
        return [Vec2(*corner) for corner in self._ways.corners_m.tolist()]

    def route(self, begin_m: Vec2, goal_m: Vec2) -> list[Vec2]:
        """Return the points of the shortest way: its corners, then the goal.

        Args:
            begin_m, goal_m: positions in fleet ENU. Either may be nearer to an obstacle than
                allowed; the way then leads away from it.
        Returns:
            Only the goal, if the straight line is free; an empty list, if there is no way.
        """
        begin = np.array(begin_m)
        goal = np.array(goal_m)
        if self._are_free(begin, goal):
            return [goal_m]

        corners = self._ways.corners_m
        between_m = self._ways.length_m
        following = self._ways.following
        first_m = np.where(self._are_free(begin, corners), _lengths(corners - begin), np.inf)
        last_m = np.where(self._are_free(goal, corners), _lengths(corners - goal), np.inf)
        total_m = first_m[:, None] + between_m + last_m[None]
        if total_m.size == 0 or not np.isfinite(total_m.min()):
            return []

        corner, last = np.unravel_index(int(total_m.argmin()), total_m.shape)
        points = [Vec2(*corners[corner].tolist())]
        while corner != last:
            corner = following[corner, last]
            points.append(Vec2(*corners[corner].tolist()))
        return [*points, goal_m]

    def lengths_past(self, begin_m: Vec2, other_m: Vec2, keep_m: float) -> list[float]:
        """Return the length [m] of the shortest way to each corner that keeps off a point.

        Args:
            begin_m: begin of the ways, which may be nearer to the point.
            other_m: the point.
            keep_m: distance to keep from it.
        Returns:
            The lengths, in the order of the corners; infinite where there is no way.
        """
        begin = np.array(begin_m)
        other = np.array(other_m)
        corners = self._ways.corners_m

        kept_m = min(keep_m, math.dist(begin_m, other_m)) - 1e-9
        is_open = _point_distances(other, begin, corners) >= kept_m
        is_open &= self._are_free(begin, corners)
        lengths_m = np.where(is_open, _lengths(corners - begin), np.inf)

        is_clear = _point_distances(other, corners[:, None], corners[None]) >= keep_m
        pieces_m = np.where(is_clear, self._ways.pieces_m, np.inf)
        for _ in range(len(corners)):  # Bellman and Ford
            through_m = (lengths_m[:, None] + pieces_m).min(0, initial=np.inf)
            if (through_m >= lengths_m).all():
                break
            lengths_m = np.minimum(lengths_m, through_m)
        return [float(length) for length in lengths_m]

    def is_free(self, begin_m: Vec2, end_m: Vec2) -> bool:
        """Whether a straight piece keeps its distance from all things, and ends inside the box."""
        end = np.array(end_m)
        return bool(_is_inside(end, self._walls) and self._are_free(np.array(begin_m), end))

    def _are_free(self, begins_m: Array, ends_m: Array) -> BoolArray:
        """Return whether each straight piece, (..., 2) to (..., 2), keeps its distances.

        A piece that begins or ends nearer to a thing than allowed comes no nearer to it.
        """
        things = self._things
        begins = begins_m[..., None, :]
        ends = ends_m[..., None, :]
        from_begin_m = _point_distances(begins, things.begin_m, things.end_m)
        from_end_m = _point_distances(ends, things.begin_m, things.end_m)
        distance_m = _piece_distances(begins, ends, things, np.minimum(from_begin_m, from_end_m))

        allowed_m = np.minimum(things.keep_m - _PIECE_SPARE_M, from_begin_m)
        allowed_m = np.minimum(allowed_m, from_end_m)
        return np.asarray((distance_m >= allowed_m - 1e-9).all(-1))


def _is_round_field(capsule: Capsule) -> bool:
    """Whether an edge is the circle of an area to stay in, which no straight line inside leaves."""
    is_round = capsule.begin_enu_m == capsule.end_enu_m
    return capsule.area > 0 and is_round and not capsule.is_turned_about


def _things(still: Sequence[Capsule], clearance_m: float) -> _Things:
    keep_m = []
    for capsule in still:
        kept_m = clearance_m if capsule.area == 0 else capsule.keep_m
        keep_m.append(capsule.radius_m + kept_m)
    return _Things(
        begin_m=np.array([capsule.begin_enu_m for capsule in still]).reshape(-1, 2),
        end_m=np.array([capsule.end_enu_m for capsule in still]).reshape(-1, 2),
        keep_m=np.array(keep_m),
    )


def _corners(still: Sequence[Capsule], things: _Things, walls: Walls) -> Array:
    """Return the points (C, 2) about which ways turn.

    They lie around the ends of things, and in the middle of narrow passages.
    """
    ends: dict[tuple[Vec2, float], None] = {}  # in order, each once
    for capsule, keep_m in zip(still, things.keep_m.tolist(), strict=True):
        is_segment = capsule.begin_enu_m != capsule.end_enu_m
        if capsule.area == 0 or not is_segment or capsule.is_begin_inwards:
            ends[capsule.begin_enu_m, keep_m] = None
        if capsule.area == 0 and is_segment:
            ends[capsule.end_enu_m, keep_m] = None
    if not ends:
        return np.zeros((0, 2))

    points_m = np.array([end for end, _ in ends])
    keep_m = np.array([keep_m for _, keep_m in ends])
    around = _around(points_m, keep_m)
    middles = _middles(points_m, keep_m, things)

    around = around[_is_clear(around, things, 0.5 * _CORNER_SPARE_M)]
    middles = middles[_is_clear(middles, things, -_PIECE_SPARE_M)]
    corners = np.concatenate([around, middles])

    return np.asarray(corners[_is_inside(corners, walls)])


def _is_inside(points_m: Array, walls: Walls) -> BoolArray:
    """Return whether each point (..., 2) is inside the box."""
    x = points_m[..., 0]
    y = points_m[..., 1]
    is_inside_x = (x >= walls.low_x_m) & (x <= walls.high_x_m)
    is_inside_y = (y >= walls.low_y_m) & (y <= walls.high_y_m)
    return np.asarray(is_inside_x & is_inside_y)


def _around(ends_m: Array, keep_m: Array) -> Array:
    """Return the corners (.., 2) of an octagon around each end; its sides keep the distance."""
    angle = 2.0 * np.pi * np.arange(_CORNERS_PER_END) / _CORNERS_PER_END
    directions = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    radius_m = (keep_m + _CORNER_SPARE_M) / math.cos(math.pi / _CORNERS_PER_END)
    corners = ends_m[:, None] + radius_m[:, None, None] * directions
    return np.asarray(corners.reshape(-1, 2))


def _middles(ends_m: Array, keep_m: Array, things: _Things) -> Array:
    """Return the middle (.., 2) of each narrow passage between an end and another thing.

    It is where both are as far away as they have to be, or by as much nearer or farther.
    """
    nearest = _nearest_points(ends_m[:, None], things.begin_m, things.end_m)  # (E, O, 2)
    across = nearest - ends_m[:, None]
    width_m = _lengths(across)
    free_m = width_m - keep_m[:, None] - things.keep_m
    is_narrow = (np.abs(free_m) < _NARROW_M) & (width_m > 0.0)

    share = (keep_m[:, None] + 0.5 * free_m) / np.maximum(width_m, 1e-12)
    middles = ends_m[:, None] + share[..., None] * across
    return np.asarray(middles[is_narrow])


def _is_clear(points_m: Array, things: _Things, spare_m: float) -> BoolArray:
    """Return whether each point (P, 2) is farther from all things than it must be, by a spare."""
    distance_m = _point_distances(points_m[:, None], things.begin_m, things.end_m)
    return np.asarray((distance_m >= things.keep_m + spare_m).all(-1))


def _shortest(corners_m: Array, between_m: Array, is_complete: bool) -> _Ways:
    """Return the shortest ways between corners, by Floyd's and Warshall's algorithm.

    Args:
        corners_m: the corners (C, 2).
        between_m: lengths (C, C) of the straight pieces, infinite where one is not free.
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
    return _Ways(
        corners_m=corners_m,
        pieces_m=between_m,
        length_m=length_m,
        following=following,
        is_complete=is_complete,
    )


def _lengths(vectors_m: Array) -> Array:
    return np.hypot(vectors_m[..., 0], vectors_m[..., 1])


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _nearest_points(points_m: Array, begins_m: Array, ends_m: Array) -> Array:
    """Return the nearest points of segments to points; all (..., 2), broadcast."""
    along = ends_m - begins_m
    offset = points_m - begins_m
    length_2 = np.maximum((along * along).sum(-1), 1e-12)  # a point is a segment without length
    share = np.clip((offset * along).sum(-1) / length_2, 0.0, 1.0)
    return np.asarray(begins_m + share[..., None] * along)


def _point_distances(points_m: Array, begins_m: Array, ends_m: Array) -> Array:
    """Return the distances of points from segments; all (..., 2), broadcast."""
    return _lengths(points_m - _nearest_points(points_m, begins_m, ends_m))


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
