"""ORCA: each vehicle of a pair makes half of the velocity change that keeps them apart.

van den Berg, Guy, Lin, Manocha: Reciprocal n-Body Collision Avoidance, ISRR 2009, sections 3 to 5.
Each neighbour gives a row, a half-plane of allowed velocities. Where the rows cannot all hold, each
gives way by the same amount, as in section 5.3.
"""

from __future__ import annotations

import math
from typing import Any

from onboard.avoidance.own_law import LawInputs
from onboard.types import Thrust
from onboard.vectors import Vec2, dot_xy, length_xy
from sitl.monte_carlo.open_benchmark.laws.around import (
    Body,
    HalfPlane,
    bodies,
    nearest,
    own_velocity,
    preferred_velocity,
    steered,
)

_HORIZON_S = 4.0  # tau: no body comes too close within this time
_TOO_NEAR_S = 0.2  # tau for a body that is already too close


def law(memory: Any, inputs: LawInputs) -> tuple[Any, Thrust]:
    """Return the thrust towards the nearest velocity that all rows allow."""
    around = bodies(inputs)
    velocity = own_velocity(inputs)
    rows = [orca_row(body, velocity, body.share, _HORIZON_S) for body in around]
    return None, steered(inputs, nearest(preferred_velocity(inputs, around), rows))


def orca_row(body: Body, velocity: Vec2, share: float, horizon_s: float) -> HalfPlane:
    """Return the half-plane of velocities that a body leaves: ORCA of section 4.

    Args:
        body: neighbour or obstacle.
        velocity: own velocity.
        share: share of the change u that this vehicle makes; 1/2 in the paper.
        horizon_s: tau.
    """
    tau_s = horizon_s
    if body.distance_m <= body.d_m:
        tau_s = _TOO_NEAR_S
    # the velocity obstacle: a cone about -e, cut off by a disc of radius d / tau about -e / tau
    centre = Vec2(-body.e_m.x / tau_s, -body.e_m.y / tau_s)
    radius_m_s = body.d_m / tau_s
    from_centre = Vec2(body.w_m_s.x - centre.x, body.w_m_s.y - centre.y)

    normal, u_m_s = _out_of_disc(from_centre, radius_m_s)
    sin = min(1.0, body.d_m / body.distance_m)
    # whether the nearest edge of the velocity obstacle is a leg of the cone, and not the disc
    is_at_cone = dot_xy(from_centre, body.unit) < sin * length_xy(from_centre)
    if body.distance_m > body.d_m and is_at_cone:
        normal, u_m_s = _out_of_cone(body, sin)

    # (v - (v_A + share u)) . n >= 0
    return HalfPlane(normal, dot_xy(velocity, normal) + share * u_m_s)


def _out_of_disc(from_centre: Vec2, radius_m_s: float) -> tuple[Vec2, float]:
    """Return the direction out of the disc, and the distance to its edge; negative outside."""
    size = max(length_xy(from_centre), 1e-9)
    return Vec2(from_centre.x / size, from_centre.y / size), radius_m_s - size


def _out_of_cone(body: Body, sin: float) -> tuple[Vec2, float]:
    """Return the direction out of the cone across its nearer leg, and the distance to that leg."""
    cos = math.sqrt(max(0.0, 1.0 - sin * sin))
    along = Vec2(-body.unit.x, -body.unit.y)
    # The cross product says on which side of the axis of the cone the relative velocity lies. The
    # left leg is nearer to it on the left side (1), and the right leg on the right side (-1).
    side = -1.0
    if along.x * body.w_m_s.y - along.y * body.w_m_s.x > 0.0:
        side = 1.0
    # outward normal of that leg
    normal = Vec2(
        -sin * along.x - side * cos * along.y,
        -sin * along.y + side * cos * along.x,
    )
    return normal, -dot_xy(normal, body.w_m_s)
