"""Artificial potential field: closer bodies push harder, and closing speed is damped.

Khatib: Real-Time Obstacle Avoidance for Manipulators and Mobile Robots, IJRR 1986: the force
eta (1 / rho - 1 / rho_0) / rho^2 within rho_0. We add the damping, because vehicles have inertia.
"""

from __future__ import annotations

from typing import Any

from onboard.avoidance.own_law import LawInputs
from onboard.types import Thrust
from onboard.vectors import dot_xy
from sitl.monte_carlo.open_benchmark.laws.around import (
    bodies,
    own_velocity,
    preferred_velocity,
)

_ETA_M3_S2 = 0.02
_RHO_0_M = 1.0  # range of the force, counted from the distance to keep
_DAMPING_1_S = 2.0
_GAIN_1_S = 4.0  # a velocity error times this is the wanted acceleration
_MIN_ROOM_M = 0.05  # a smaller room is raised to this one, so that the force stays finite


def law(memory: Any, inputs: LawInputs) -> tuple[Any, Thrust]:
    """Return the baseline's thrust, pushed away from all bodies."""
    around = bodies(inputs)
    preferred = preferred_velocity(inputs, around)
    velocity = own_velocity(inputs)
    x_m_s2 = _GAIN_1_S * (preferred.x - velocity.x)
    y_m_s2 = _GAIN_1_S * (preferred.y - velocity.y)

    for body in around:
        rho_m = max(body.distance_m - body.d_m, _MIN_ROOM_M)
        if rho_m < _RHO_0_M:
            force_m_s2 = _ETA_M3_S2 * (1.0 / rho_m - 1.0 / _RHO_0_M) / rho_m**2
            closing_m_s = min(0.0, dot_xy(body.unit, body.w_m_s))
            force_m_s2 -= _DAMPING_1_S * closing_m_s
            x_m_s2 += force_m_s2 * body.unit.x
            y_m_s2 += force_m_s2 * body.unit.y
    return None, inputs.limited(x_m_s2, y_m_s2)
