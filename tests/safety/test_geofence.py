"""Geofence: distances by hand, and against a brute search."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from onboard.safety import geofence
from onboard.safety.geofence import Fence

ROOM = Fence((-4.0, -4.0, 0.0), (4.0, 4.0, 3.0))
RNG = np.random.default_rng(11)


@pytest.mark.parametrize(
    ("position", "distance"),
    [
        ((0, 0, 1), 2.0),  # the ceiling is nearest
        ((3.5, 0, 1), 0.5),
        ((-3.8, 0, 1), 0.2),
        ((0, 3.9, 0.0), 0.1),
        ((0, 0, 0.0), 3.0),  # standing on the floor is no closeness to a wall
        ((4.0, 0, 1), 0.0),
        ((4.3, 0, 1), -0.3),
        ((4.3, 4.4, 1), -0.5),  # past a corner
        ((0, 0, 3.2), -0.2),
        ((0, 0, -0.3), 3.3),
        ((0, 0, -0.7), -0.2),
    ],
)
def test_distance_to_walls_and_ceiling(position: tuple[float, ...], distance: float) -> None:
    assert geofence.distance_m(np.array(position, dtype=float), fence=ROOM) == pytest.approx(distance)


def test_the_distance_changes_by_at_most_the_way_moved_above_the_floor() -> None:
    a = RNG.uniform(-6, 6, (2000, 3))
    a[:, 2] = np.abs(a[:, 2])
    b = a + 0.1 * RNG.normal(size=a.shape)
    b[:, 2] = np.abs(b[:, 2])
    moved = np.linalg.norm(a - b, axis=-1)
    change = np.abs(geofence.distance_m(a, fence=ROOM) - geofence.distance_m(b, fence=ROOM))
    assert (change <= moved + 1e-9).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_an_unknown_position_is_outside_without_a_warning(bad: float) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        position = np.array([0.0, bad, 1.0])
        assert geofence.distance_m(position, fence=ROOM) == -np.inf
        assert not geofence.contains(position, fence=ROOM)
        assert geofence.crossing_time_s(position, np.zeros(3), fence=ROOM) == 0.0


@pytest.mark.parametrize(
    ("velocity", "time"),
    [
        ((1, 0, 0), 3.0),
        ((-2, 0, 0), 2.5),
        ((0, 0, 1), 2.0),
        ((0, 0, -1), np.inf),
        ((0, 0, 0), np.inf),
        ((1, -2, 0), 2.0),
    ],
)
def test_time_until_the_fence_is_crossed(velocity: tuple[float, ...], time: float) -> None:
    position, v = np.array([1.0, 0.0, 1.0]), np.array(velocity, dtype=float)
    assert geofence.crossing_time_s(position, v, fence=ROOM) == pytest.approx(time)


def test_outside_the_fence_no_time_is_left() -> None:
    assert geofence.crossing_time_s(np.array([5.0, 0.0, 1.0]), np.array([-1.0, 0.0, 0.0]), fence=ROOM) == 0.0


def test_stopping_takes_reaction_and_braking() -> None:
    got = geofence.stopping_distance_m(np.array([0.0, 2.0]), deceleration_m_s2=2.0, reaction_s=0.3)
    assert got.tolist() == pytest.approx([0.0, 1.6])


def test_the_nearest_point_inside_keeps_the_margin_and_no_other_is_nearer() -> None:
    positions = RNG.uniform(-7, 7, (50, 3))
    nearest = geofence.nearest_inside(positions, fence=ROOM, margin_m=0.5)
    assert geofence.contains(nearest, fence=ROOM, margin_m=0.5 - 1e-9).all()
    others = RNG.uniform((-3.5, -3.5, 0.0), (3.5, 3.5, 2.5), (3000, 3))
    way = np.linalg.norm(nearest - positions, axis=-1)
    assert (way <= np.linalg.norm(others[None] - positions[:, None], axis=-1).min(axis=1) + 1e-9).all()


def test_a_margin_larger_than_the_room_gives_its_middle() -> None:
    assert geofence.nearest_inside(np.zeros(3), fence=ROOM, margin_m=9.0)[:2].tolist() == [0.0, 0.0]


def test_batch_equals_loop() -> None:
    p, v = RNG.uniform(-6, 6, (2, 5, 4, 3))
    distance, time = geofence.distance_m(p, fence=ROOM), geofence.crossing_time_s(p, v, fence=ROOM)
    for i in range(5):
        for j in range(4):
            assert distance[i, j] == geofence.distance_m(p[i, j], fence=ROOM)
            assert time[i, j] == geofence.crossing_time_s(p[i, j], v[i, j], fence=ROOM)
