"""Static obstacles of scenarios: a forest of pillars, and a wall with a gap; and how near bodies
come to them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onboard.arrays import Array
from onboard.avoidance.params import Capsule
from onboard.vectors import Vec2

PILLAR_RADIUS_M = 0.25
GAP_M = 2.6  # between the walls: room for two vehicles beside each other
_TREE_SPACING_M, _TREE_JITTER_M = 2.8, 0.3
_WALL_M, _WALL_RADIUS_M = 3.0, 0.1


def forest(rows: int, seed: int) -> tuple[Capsule, ...]:
    """Return pillars on a jittered grid about the origin, three deep in x; between any two is room
    to pass.

    Args:
        rows: of pillars, along y.
        seed: of their places.
    """
    rng = np.random.default_rng([seed, 17])
    pillars = []
    for column in range(3):
        for row in range(rows):
            shift = 0.5 * (column % 2)
            x = _TREE_SPACING_M * (column - 1)
            y = _TREE_SPACING_M * (row + shift - 0.5 * (rows - 0.5))
            dx, dy = rng.uniform(-_TREE_JITTER_M, _TREE_JITTER_M, 2)
            at = Vec2(float(x + dx), float(y + dy))
            pillars.append(Capsule(at, at, PILLAR_RADIUS_M))
    return tuple(pillars)


def gap() -> tuple[Capsule, ...]:
    """Return the two walls along x = 0 that leave a gap about the origin."""
    near = 0.5 * GAP_M + _WALL_RADIUS_M
    far = near + _WALL_M
    return tuple(
        Capsule(Vec2(0.0, side * near), Vec2(0.0, side * far), _WALL_RADIUS_M)
        for side in (-1.0, 1.0)
    )


def scaled(obstacles: Sequence[Capsule], scale: float) -> tuple[Capsule, ...]:
    """Return obstacles farther apart, of the same radius.

    Args:
        obstacles: to be moved.
        scale: factor of their places.
    """

    def at(place: Vec2) -> Vec2:
        return Vec2(scale * place.x, scale * place.y)

    return tuple(Capsule(at(one.begin_enu_m), at(one.end_enu_m), one.radius_m) for one in obstacles)


def clearances_m(position_enu_m: Array, obstacles: Sequence[Capsule], body_m: float) -> Array:
    """Return for each flight the smallest distance (F,) of a body's outline from an obstacle's; inf
    without any.

    Args:
        position_enu_m: (F, N, 3).
        obstacles: of all flights.
        body_m: diameter of a vehicle.
    """
    nearest = np.full(len(position_enu_m), np.inf)
    for one in obstacles:
        begin, along = (
            np.array(one.begin_enu_m),
            np.array(one.end_enu_m) - np.array(one.begin_enu_m),
        )
        offset = position_enu_m[..., :2] - begin
        share = np.clip(offset @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        away = np.hypot(*np.moveaxis(offset - share[..., None] * along, -1, 0))
        nearest = np.minimum(nearest, away.min(-1) - one.radius_m - 0.5 * body_m)
    return nearest
