"""Static obstacles of scenarios, and how near bodies come to them.

There are a forest of pillars, and a wall with a gap.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onboard.arrays import Array
from onboard.avoidance.params import Capsule
from onboard.vectors import Vec2

PILLAR_RADIUS_M = 0.25
GAP_M = 2.6  # between the walls: room for two vehicles beside each other
_TREE_SPACING_M = 2.8
_TREE_JITTER_M = 0.3
_WALL_M = 3.0  # length of each wall
_WALL_RADIUS_M = 0.1


def forest(rows: int, seed: int) -> tuple[Capsule, ...]:
    """Return pillars on a jittered grid about the origin, three deep in x.

    Between any two is room to pass.

    Args:
        rows: of pillars, along y.
        seed: of their positions.
    """
    rng = np.random.default_rng([seed, 17])
    pillars = []
    for column in range(3):
        for row in range(rows):
            shift = 0.5 * (column % 2)  # of every second column, against the others
            x = _TREE_SPACING_M * (column - 1)
            y = _TREE_SPACING_M * (row + shift - 0.5 * (rows - 0.5))
            dx, dy = rng.uniform(-_TREE_JITTER_M, _TREE_JITTER_M, 2)

            middle = Vec2(float(x + dx), float(y + dy))
            pillars.append(Capsule(middle, middle, PILLAR_RADIUS_M))
    return tuple(pillars)


def gap() -> tuple[Capsule, ...]:
    """Return the two walls along x = 0 that leave a gap about the origin."""
    near = 0.5 * GAP_M + _WALL_RADIUS_M
    far = near + _WALL_M
    walls = []
    for side in (-1.0, 1.0):
        begin = Vec2(0.0, side * near)
        end = Vec2(0.0, side * far)
        walls.append(Capsule(begin, end, _WALL_RADIUS_M))
    return tuple(walls)


def scaled(obstacles: Sequence[Capsule], scale: float) -> tuple[Capsule, ...]:
    """Return obstacles farther apart, of the same radius.

    Args:
        obstacles: to be moved.
        scale: factor of their positions.
    """
    moved = []
    for obstacle in obstacles:
        begin = Vec2(scale * obstacle.begin_enu_m.x, scale * obstacle.begin_enu_m.y)
        end = Vec2(scale * obstacle.end_enu_m.x, scale * obstacle.end_enu_m.y)
        moved.append(Capsule(begin, end, obstacle.radius_m))
    return tuple(moved)


def clearances_m(position_enu_m: Array, obstacles: Sequence[Capsule], body_m: float) -> Array:
    """Return for each flight the smallest distance (F,) of a body's outline from an obstacle's.

    Without any obstacle it is inf.

    Args:
        position_enu_m: (F, N, 3).
        obstacles: of all flights.
        body_m: diameter of a vehicle.
    """
    nearest = np.full(len(position_enu_m), np.inf)
    for obstacle in obstacles:
        begin = np.array(obstacle.begin_enu_m)
        along = np.array(obstacle.end_enu_m) - begin  # from end to end
        length_2 = max(float(along @ along), 1e-12)

        offset = position_enu_m[..., :2] - begin  # (F, N, 2)
        share = np.clip(offset @ along / length_2, 0.0, 1.0)  # (F, N) of the nearest point
        beside = offset - share[..., None] * along
        away = np.hypot(*np.moveaxis(beside, -1, 0))  # (F, N) from the obstacle's axis

        nearest = np.minimum(nearest, away.min(-1) - obstacle.radius_m - 0.5 * body_m)
    return nearest
