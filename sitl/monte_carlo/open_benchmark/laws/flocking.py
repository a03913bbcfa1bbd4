"""The flock of the thirty drones of Budapest: repulsion, and friction by a braking curve.

Vasarhelyi, Viragh, Somorjai, Nepusz, Eiben, Vicsek: Optimized Flocking of Autonomous Drones in
Confined Environments, Science Robotics 2018. This file uses its terms for repulsion and velocity
alignment; the common direction of the flock is replaced by each vehicle's own way to its goal, as
in the authors' later work on air traffic. Distances and gains are chosen for these vehicles.
"""

from __future__ import annotations

import math
from typing import Any

from onboard.avoidance.own_law import LawInputs
from onboard.types import Thrust
from onboard.vectors import Vec2, length_xy
from sitl.monte_carlo.open_benchmark.laws.around import (
    bodies,
    preferred_velocity,
    shortened,
    steered,
)

_REPULSION_1_S = 3.0  # p_rep
_RANGE_M = 0.7  # r_0, beyond the distance to keep
_FRICTION = 1.0  # C_frict
_SLACK_M_S = 0.2  # v_frict: smaller velocity differences are ignored
_BRAKE_M_S2 = 1.0  # a_frict of the braking curve
_SLOPE_1_S = 2.0  # p_frict, of its linear part


def law(memory: Any, inputs: LawInputs) -> tuple[Any, Thrust]:
    """Return the thrust towards the sum of the velocities."""
    around = bodies(inputs)
    preferred = preferred_velocity(inputs, around)
    x_m_s, y_m_s = preferred
    for body in around:
        room_m = body.distance_m - body.d_m
        repulsion_m_s = _REPULSION_1_S * max(0.0, _RANGE_M - room_m)
        x_m_s += repulsion_m_s * body.unit.x
        y_m_s += repulsion_m_s * body.unit.y

        difference_m_s = length_xy(body.w_m_s)
        allowed_m_s = max(_SLACK_M_S, braking_curve_m_s(room_m))
        if difference_m_s > allowed_m_s:
            factor = _FRICTION * (1.0 - allowed_m_s / difference_m_s)
            x_m_s -= factor * body.w_m_s.x
            y_m_s -= factor * body.w_m_s.y
    return None, steered(inputs, shortened(Vec2(x_m_s, y_m_s), inputs.vehicle.top_speed_m_s))


def braking_curve_m_s(room_m: float) -> float:
    """Return D(r, a, p): the largest speed from which a vehicle can brake within the room."""
    if room_m <= 0.0:
        return 0.0
    linear_m_s = _SLOPE_1_S * room_m
    if linear_m_s < _BRAKE_M_S2 / _SLOPE_1_S:
        return linear_m_s
    return math.sqrt(2.0 * _BRAKE_M_S2 * room_m - (_BRAKE_M_S2 / _SLOPE_1_S) ** 2)
