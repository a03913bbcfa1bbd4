"""Barrier certificates: the smallest change of the acceleration that lets each pair still brake.

Wang, Ames, Egerstedt: Safety Barrier Certificates for Collisions-Free Multirobot Systems, T-RO
2017: the barrier h = sqrt(2 a (|e| - d)) + e.w / |e| of a pair, with position e and velocity w
relative to the other vehicle, the distance to keep d, and a the braking of both vehicles together.
The law demands h' >= -gamma h^3, and each vehicle of a pair provides half of the change.
"""

from __future__ import annotations

import math
from typing import Any

from onboard.avoidance.own_law import LawInputs
from onboard.types import Thrust
from onboard.vectors import Vec2, dot_xy
from sitl.monte_carlo.open_benchmark.laws.around import (
    Body,
    HalfPlane,
    bodies,
    nearest,
    own_velocity,
    preferred_velocity,
)

_BRAKE_M_S2 = 2.0  # braking of one vehicle
_GAMMA = 1.0
_GAIN_1_S = 4.0  # a velocity error times this is the wanted acceleration
# A smaller room is raised to this one, because within the distance to keep the barrier has no
# value.
_MIN_ROOM_M = 0.005


def law(memory: Any, inputs: LawInputs) -> tuple[Any, Thrust]:
    """Return the thrust nearest to the baseline's that all certificates allow."""
    around = bodies(inputs)
    preferred = preferred_velocity(inputs, around)
    velocity = own_velocity(inputs)
    wanted_m_s2 = Vec2(
        _GAIN_1_S * (preferred.x - velocity.x), _GAIN_1_S * (preferred.y - velocity.y)
    )

    allowed = nearest(wanted_m_s2, [certificate_row(body) for body in around])
    return None, inputs.limited(allowed.x, allowed.y)


def certificate_row(body: Body) -> HalfPlane:
    """Return the half-plane of this vehicle's accelerations that keep the barrier."""
    together_m_s2 = _BRAKE_M_S2 / body.share  # a body that does not cooperate does not brake
    radial_m_s = dot_xy(body.unit, body.w_m_s)
    room_m = max(body.distance_m - body.d_m, _MIN_ROOM_M)
    root_m_s = math.sqrt(2.0 * together_m_s2 * room_m)
    barrier = root_m_s + radial_m_s

    turning = (dot_xy(body.w_m_s, body.w_m_s) - radial_m_s**2) / body.distance_m
    slowing = together_m_s2 * radial_m_s / root_m_s
    bound = -_GAMMA * barrier**3 - turning - slowing
    return HalfPlane(body.unit, body.share * bound)
