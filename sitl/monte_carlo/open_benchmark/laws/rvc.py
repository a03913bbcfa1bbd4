"""Reciprocal velocity constraints over a horizon, inside the controller.

RVC-NMPC: Nonlinear Model Predictive Control with Reciprocal Velocity Constraints for Mutual
Collision Avoidance in Agile UAV Flight, arXiv 2512.08574, 2025. This is its idea, much simplified.
The rows (half-planes of allowed velocities, one for each neighbour, as in ORCA) hold for the
velocities that the controller itself predicts, and not for one that another controller follows
afterwards. Instead of a nonlinear program, the acceleration is constant over the horizon and the
model is a point mass.
"""

from __future__ import annotations

from typing import Any

from onboard.avoidance.own_law import LawInputs
from onboard.types import Thrust
from onboard.vectors import Vec2, dot_xy
from sitl.monte_carlo.open_benchmark.laws.around import (
    HalfPlane,
    bodies,
    nearest,
    own_velocity,
    preferred_velocity,
)
from sitl.monte_carlo.open_benchmark.laws.orca import orca_row

_AHEAD_S = (0.2, 0.5)  # times of the horizon at which the rows hold
_TAU_S = 3.0  # tau of ORCA now; a row at a later time looks less far ahead by that time
_GAIN_1_S = 4.0  # a velocity error times this is the wanted acceleration


def law(memory: Any, inputs: LawInputs) -> tuple[Any, Thrust]:
    """Return the acceleration nearest to the baseline's whose velocities keep all rows."""
    around = bodies(inputs)
    velocity = own_velocity(inputs)
    rows = []
    for ahead_s in _AHEAD_S:
        for body in around:
            normal, bound = orca_row(body, velocity, body.share, _TAU_S - ahead_s)
            # n . (v + a t) >= b
            rows.append(HalfPlane(normal, (bound - dot_xy(normal, velocity)) / ahead_s))

    preferred = preferred_velocity(inputs, around)
    wanted_m_s2 = Vec2(
        _GAIN_1_S * (preferred.x - velocity.x), _GAIN_1_S * (preferred.y - velocity.y)
    )
    allowed = nearest(wanted_m_s2, rows)
    return None, inputs.limited(allowed.x, allowed.y)
