"""Rule-based Lloyd: each vehicle flies to the centroid of its cell, weighted towards its goal.

Boldrer, Serra-Gomez, Lyons, Kratky, Alonso-Mora, Ferranti: Rule-Based Lloyd Algorithm for
Multi-Robot Motion Planning and Control with Safety and Convergence Guarantees, arXiv 2310.19511.
The cell is the disc of the sensing radius within the buffered Voronoi cell; the density is
exp(-|q - goal| / beta). Two rules act while the centroid is near the vehicle because of its
neighbours: beta falls, which draws the centroid to the cell's edge, and the goal turns to the
right. Afterwards both return to their old values. Two things are simpler than in the paper: the
centroid is a sum over a grid, and the goal lies one radius ahead.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from onboard.avoidance.own_law import LawInputs
from onboard.types import Thrust
from onboard.vectors import Vec2, length_xy
from sitl.monte_carlo.open_benchmark.laws.around import (
    bodies,
    preferred_velocity,
    shortened,
    steered,
    turned_right,
)
from sitl.monte_carlo.open_benchmark.laws.cells import cell_row

_RADIUS_M = 1.5  # sensing radius
_GAIN_1_S = 3.0  # the centroid times this is the velocity
_BETA_M = 0.5  # beta without the rules
_MIN_BETA_M = 0.1
_NEAR_M = 0.1  # a centroid within this distance is near the vehicle; d_1 of the paper
_MOVED_M = 0.2  # neighbours that move the centroid further hold the vehicle up; d_2 of the paper
_RATE_1_S = 1.0  # rate at which both rules act and end

_AXIS_M = np.linspace(-_RADIUS_M, _RADIUS_M, 13)
_GRID = np.stack(np.meshgrid(_AXIS_M, _AXIS_M), axis=-1).reshape(-1, 2)
_DISC = _GRID[np.hypot(*_GRID.T) <= _RADIUS_M + 1e-9]  # (Q, 2)


class Rules(NamedTuple):
    """State of the two rules."""

    beta_m: float = _BETA_M
    turn_rad: float = 0.0


def law(memory: Rules | None, inputs: LawInputs) -> tuple[Rules, Thrust]:
    """Return the thrust towards the centroid of the cell."""
    rules = memory
    if rules is None:
        rules = Rules()
    preferred = preferred_velocity(inputs)
    ahead_m = min(1.0, length_xy(preferred) / inputs.vehicle.max_speed_m_s) * _RADIUS_M
    # a vector in the preferred direction, longer than ahead_m, is shortened to just this length
    straight = shortened(Vec2(1e3 * preferred.x, 1e3 * preferred.y), ahead_m)
    goal = np.array(turned_right(straight, rules.turn_rad))

    weight = np.exp(-np.hypot(*(_DISC - goal).T) / rules.beta_m)
    free_centroid = weight @ _DISC / weight.sum()  # without the neighbours
    for body in bodies(inputs):
        normal, bound = cell_row(body)
        weight = np.where(_DISC @ normal >= bound, weight, 0.0)
    centroid = np.zeros(2)
    if weight.sum() > 0.0:
        centroid = weight @ _DISC / weight.sum()

    is_near = math.hypot(*centroid) < _NEAR_M
    is_moved = math.hypot(*(centroid - free_centroid)) > _MOVED_M
    is_held_up = is_near and is_moved
    goal_beta_m = _BETA_M
    goal_turn_rad = 0.0
    if is_held_up:
        goal_beta_m = _MIN_BETA_M
        goal_turn_rad = 0.5 * math.pi
    step = _RATE_1_S * inputs.dt_s
    after = Rules(
        beta_m=rules.beta_m + step * (goal_beta_m - rules.beta_m),
        turn_rad=rules.turn_rad + step * (goal_turn_rad - rules.turn_rad),
    )
    velocity = Vec2(*(_GAIN_1_S * centroid).tolist())
    return after, steered(inputs, shortened(velocity, inputs.vehicle.max_speed_m_s))
