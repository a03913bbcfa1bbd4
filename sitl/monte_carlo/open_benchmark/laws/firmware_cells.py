"""The Voronoi cells of the Crazyflie's firmware, with its own rules and default values.

Bitcraze, crazyflie-firmware, modules/src/collision_avoidance.c, as its header describes it
(J. A. Preiss, 2020): the setpoint is moved into the buffered cell, in which the vehicle stays for a
horizon of 1 s; near a wall of the cell ahead it steps aside to the right; while the cell is empty
it holds the last place in it. Here the radius is half of the fleet's distance to keep instead of
0.3 m, and the speed is the fleet's instead of 0.5 m/s.
"""

from __future__ import annotations

import math
from typing import Any

from onboard.avoidance.own_law import LawInputs
from onboard.types import Thrust
from onboard.vectors import Vec2, dot_xy, length_xy
from sitl.monte_carlo.open_benchmark.laws.around import (
    bodies,
    nearest,
    preferred_velocity,
    shortened,
    steered,
    turned_right,
)
from sitl.monte_carlo.open_benchmark.laws.cells import cell_row

_HORIZON_S = 1.0
_SIDESTEP_M = 0.25


def law(memory: Vec2 | None, inputs: LawInputs) -> tuple[Any, Thrust]:
    """Return the thrust towards the setpoint in the cell; memory: last position in a cell."""
    rows = [cell_row(body) for body in bodies(inputs)]
    x, y, _ = inputs.predicted.position_enu_m
    is_empty = any(row.bound > 0.0 for row in rows)  # the vehicle is outside its own cell
    if is_empty and memory is not None:
        held = Vec2((memory.x - x) / _HORIZON_S, (memory.y - y) / _HORIZON_S)
        return memory, steered(inputs, shortened(held, inputs.vehicle.max_speed_m_s))

    preferred = preferred_velocity(inputs)
    goal_m = Vec2(_HORIZON_S * preferred.x, _HORIZON_S * preferred.y)
    to_wall_m = math.inf
    for normal, bound in rows:
        # cosine of the angle between the goal and the direction straight to this wall
        towards = -dot_xy(normal, goal_m) / max(length_xy(goal_m), 1e-9)
        if towards > 0.0:
            # distance to the wall in the direction of the goal
            to_wall_m = min(to_wall_m, max(0.0, -bound) / towards)
    if to_wall_m < min(_SIDESTEP_M, length_xy(goal_m)):
        aside = turned_right(goal_m, 0.5 * math.pi)
        amount = (1.0 - to_wall_m / _SIDESTEP_M) ** 2
        goal_m = Vec2(goal_m.x + amount * aside.x, goal_m.y + amount * aside.y)

    point_m = nearest(goal_m, rows)
    velocity = Vec2(point_m.x / _HORIZON_S, point_m.y / _HORIZON_S)
    return Vec2(x, y), steered(inputs, velocity)
