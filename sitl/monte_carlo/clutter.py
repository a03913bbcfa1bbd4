"""Static obstacles of scenarios, a forest of pillars and a wall with a gap, and the clearance of
vehicles from them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onboard.arrays import Array
from onboard.avoidance.params import Capsule
from onboard.vectors import Vec2

PILLAR_RADIUS_M = 0.25
GAP_M = 2.6  # width of the gap between the walls, in which two vehicles fit beside each other
_TREE_SPACING_M = 2.8
_TREE_JITTER_M = 0.3
_WALL_M = 3.0  # length of each wall
_WALL_RADIUS_M = 0.1


def forest(rows: int, seed: int) -> tuple[Capsule, ...]:
    """Return pillars on a jittered grid about the origin, in three columns along x.

    A vehicle can pass between any two of them.

    Args:
        rows: number of pillars in a column, along y.
        seed: the seed of the jitter.
    """
    rng = np.random.default_rng([seed, 17])  # 17: different numbers from the flights with this seed
    # In spacings: columns begin at 0 or 0.5, so all pillars lie between 0 and rows - 0.5.
    middle_row = 0.5 * (rows - 0.5)
    pillars = []
    for column in range(3):
        for row in range(rows):
            shift = 0.5 * (column % 2)  # every second column is shifted by half a spacing
            x_m = _TREE_SPACING_M * (column - 1)
            y_m = _TREE_SPACING_M * (row + shift - middle_row)
            dx_m, dy_m = rng.uniform(-_TREE_JITTER_M, _TREE_JITTER_M, 2)

            middle = Vec2(float(x_m + dx_m), float(y_m + dy_m))
            pillars.append(Capsule(middle, middle, PILLAR_RADIUS_M))
    return tuple(pillars)


def gap() -> tuple[Capsule, ...]:
    """Return the two walls along x = 0 that leave a gap about the origin."""
    near_end_m = 0.5 * GAP_M + _WALL_RADIUS_M
    far_end_m = near_end_m + _WALL_M
    walls = []
    for side in (-1.0, 1.0):
        begin = Vec2(0.0, side * near_end_m)
        end = Vec2(0.0, side * far_end_m)
        walls.append(Capsule(begin, end, _WALL_RADIUS_M))
    return tuple(walls)


def scaled(obstacles: Sequence[Capsule], scale: float) -> tuple[Capsule, ...]:
    """Return obstacles with scaled positions and unchanged radii.

    Args:
        obstacles: the obstacles.
        scale: factor of their positions.
    """
    moved = []
    for obstacle in obstacles:
        begin = Vec2(scale * obstacle.begin_enu_m.x, scale * obstacle.begin_enu_m.y)
        end = Vec2(scale * obstacle.end_enu_m.x, scale * obstacle.end_enu_m.y)
        moved.append(Capsule(begin, end, obstacle.radius_m))
    return tuple(moved)


class Outlines:
    """The outlines of obstacles (O), from which the distances of many points are computed."""

    def __init__(self, obstacles: Sequence[Capsule]) -> None:
        begin = np.array([obstacle.begin_enu_m for obstacle in obstacles]).reshape(-1, 1, 1, 2)
        end = np.array([obstacle.end_enu_m for obstacle in obstacles]).reshape(-1, 1, 1, 2)
        self._begin = begin  # (O, 1, 1, 2)
        self._along = end - begin  # from end to end, (O, 1, 1, 2)

        squared_length = np.matmul(self._along, self._along.mT)[..., 0]  # (O, 1, 1)
        self._length_2 = np.maximum(squared_length, 1e-12)  # avoids 0, the length of a pillar
        radius_m = np.array([obstacle.radius_m for obstacle in obstacles])
        self._radius_m = radius_m.reshape(-1, 1, 1)

    def gaps_m(self, points: Array) -> Array:
        """Return the distance [m] of each point (F, N, 2) from the nearest outline, (F, N).

        It is negative in an obstacle, and infinite without obstacles.
        """
        offset = points - self._begin  # (O, F, N, 2)
        # (O, F, N): nearest point of the obstacle's axis, as a share of its length
        share = np.clip(np.matmul(offset, self._along.mT)[..., 0] / self._length_2, 0.0, 1.0)
        from_axis = offset - share[..., None] * self._along
        from_axis_m = np.hypot(*np.moveaxis(from_axis, -1, 0))
        return np.asarray((from_axis_m - self._radius_m).min(0, initial=np.inf))
