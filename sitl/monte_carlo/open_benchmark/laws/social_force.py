"""The social force of pedestrians: an exponential push away from each body, and from its next step.

Helbing, Molnar: Social Force Model for Pedestrian Dynamics, Physical Review E 1995, equations (3)
and (4): the push falls with the minor half axis b of the ellipse through this vehicle whose foci
are the body and the end of the body's next step. The strengths are chosen for these vehicles.
"""

from __future__ import annotations

import math
from typing import Any

from onboard.avoidance.own_law import LawInputs
from onboard.types import Thrust
from onboard.vectors import Vec2, length_xy
from sitl.monte_carlo.open_benchmark.laws.around import (
    bodies,
    own_velocity,
    preferred_velocity,
)

_PUSH_M_S2 = 3.0  # at the distance to keep
_RANGE_M = 0.3  # the push falls to 1/e over this distance
_STEP_S = 1.0  # duration of the body's next step
_GAIN_1_S = 4.0  # a velocity error times this is the wanted acceleration


def law(memory: Any, inputs: LawInputs) -> tuple[Any, Thrust]:
    """Return the baseline's thrust, with the push of all bodies."""
    around = bodies(inputs)
    preferred = preferred_velocity(inputs, around)
    velocity = own_velocity(inputs)
    x_m_s2 = _GAIN_1_S * (preferred.x - velocity.x)
    y_m_s2 = _GAIN_1_S * (preferred.y - velocity.y)

    for body in around:
        # as in later forms of the model, the step is relative to this vehicle
        step_m = Vec2(-_STEP_S * body.w_m_s.x, -_STEP_S * body.w_m_s.y)
        after_m = Vec2(body.e_m.x - step_m.x, body.e_m.y - step_m.y)
        axes_m = body.distance_m + length_xy(after_m)  # the distances to both foci
        b_m = 0.5 * math.sqrt(max(0.0, axes_m**2 - length_xy(step_m) ** 2))
        # at most e^3 times the push at the distance to keep
        push_m_s2 = _PUSH_M_S2 * math.exp(min(3.0, (body.d_m - b_m) / _RANGE_M))
        x_m_s2 += push_m_s2 * body.unit.x
        y_m_s2 += push_m_s2 * body.unit.y
    return None, inputs.limited(x_m_s2, y_m_s2)
