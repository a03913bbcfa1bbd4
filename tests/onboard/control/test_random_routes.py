"""Ways among random obstacles, against a search on a fine grid that knows nothing of corners."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from onboard.arrays import Array
from onboard.avoidance.params import Capsule, Walls
from onboard.control.route_map import RouteMap
from onboard.vectors import Vec2
from sitl.monte_carlo.clutter import Outlines

CLEARANCE_M = 0.45
LINE_SPARE_M = 0.05  # by which a way may be nearer: the law holds the distance itself
# More than the clearance: a way with so much room has to be found.
ROOM_M = 0.05
HALF_M = 3.0
BOX = Walls(-HALF_M, HALF_M, -HALF_M, HALF_M)

CELL_M = 0.1
COUNT = round(2 * HALF_M / CELL_M) + 1
AXIS_M = np.linspace(-HALF_M, HALF_M, COUNT)
CELLS_M = np.stack(np.meshgrid(AXIS_M, AXIS_M, indexing="ij"), axis=-1).reshape(-1, 2)
# to the eight cells around, and by the knight's moves: a way on the grid is 3 % too long at most
STEPS = [(1, 0), (0, 1), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1)]

COORDINATE = st.integers(-28, 28).map(lambda tenths: tenths / 10.0)
POINT = st.builds(Vec2, COORDINATE, COORDINATE)
PILLAR = st.builds(lambda at, radius_m: Capsule(at, at, radius_m), POINT, st.floats(0.05, 0.6))
WALL = st.builds(lambda begin, end: Capsule(begin, end, 0.05), POINT, POINT)
OBSTACLES = st.lists(PILLAR | WALL, min_size=1, max_size=7)


def gaps_m(points: Array, still: Sequence[Capsule]) -> Array:
    """Return the distances of points (P, 2) from the nearest outline."""
    gaps = Outlines(tuple(still)).gaps_m(points[:, None])
    least_m: Array = np.asarray(gaps).reshape(len(points), -1).min(1)
    return least_m


def grid_length_m(begin: Vec2, goal: Vec2, still: Sequence[Capsule], gap_m: float) -> float:
    """Return the length of the shortest way on the grid that keeps a gap; infinite without one."""
    is_free = (gaps_m(CELLS_M, still) >= gap_m).reshape(COUNT, COUNT)
    number = np.arange(COUNT * COUNT).reshape(COUNT, COUNT)
    begins, ends, lengths_m = [], [], []
    for east, north in STEPS:
        low, high = max(0, -north), COUNT - max(0, north)
        here = (slice(0, COUNT - east), slice(low, high))
        there = (slice(east, COUNT), slice(low + north, high + north))
        is_open = is_free[here] & is_free[there]
        begins.append(number[here][is_open])
        ends.append(number[there][is_open])
        lengths_m.append(np.full(len(begins[-1]), CELL_M * math.hypot(east, north)))

    graph = coo_array(
        (np.concatenate(lengths_m), (np.concatenate(begins), np.concatenate(ends))),
        shape=(number.size, number.size),
    ).tocsr()
    cells = [round((axis + HALF_M) / CELL_M) for axis in (*begin, *goal)]
    from_begin_m = dijkstra(graph, directed=False, indices=number[cells[0], cells[1]])
    return float(from_begin_m[number[cells[2], cells[3]]])


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(OBSTACLES, POINT, POINT)
def test_every_way_keeps_its_distance_and_is_short_and_found_where_there_is_room(
    still: list[Capsule], begin: Vec2, goal: Vec2
) -> None:
    ends = np.array([begin, goal])
    assume(gaps_m(ends, still).min() >= CLEARANCE_M + ROOM_M)
    way = RouteMap(still, CLEARANCE_M, BOX).route(begin, goal)

    roomy_m = grid_length_m(begin, goal, still, CLEARANCE_M + ROOM_M)
    if not way:
        assert math.isinf(roomy_m)
        return

    length_m = 0.0
    shares = np.linspace(0.0, 1.0, 100)[:, None]
    for here, there in pairwise([begin, *way]):
        length_m += math.dist(here, there)
        points = np.array(here) + shares * (np.array(there) - np.array(here))
        assert gaps_m(points, still).min() >= CLEARANCE_M - LINE_SPARE_M - 1e-6
        assert np.abs(points).max() <= HALF_M
    assert length_m <= 1.1 * roomy_m
