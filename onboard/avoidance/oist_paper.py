"""The paper's law for one moving obstacle, equations (5) to (22), with the turn direction of (8) or
(9).

Everything is per unit of mass: F / m instead of F, so that M_o of (11) is twice a scaled rotation
and m cancels. Planar: only x and y are used. Positions, velocities and accelerations are in fleet
ENU; the orthoradial velocity of (6) is positive when the vehicle turns counter-clockwise about the
obstacle as seen from above.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from onboard.avoidance.half_planes import into_disc
from onboard.avoidance.interface import INFEASIBLE, NOBODY, Answer
from onboard.avoidance.pairs import Own
from onboard.avoidance.params import LawParams, PaperParams
from onboard.avoidance.prediction import clipped
from onboard.avoidance.projection import INACTIVE, SATURATED
from onboard.types import Neighbour, State
from onboard.vectors import ZERO_2, Vec2, cross_2, dot_2


class PlanarState(NamedTuple):
    """Horizontal motion of one vehicle."""

    position_m: Vec2
    velocity_m_s: Vec2
    acceleration_m_s2: Vec2  # an input of the law for the obstacle only


class PaperResult(NamedTuple):
    """Result of :func:`saturate_thrust`."""

    thrust_m_s2: Vec2  # F_d^sat / m
    is_changed: bool  # whether one of the two saturations acts
    is_usable: bool  # False: M_o has no inverse, and the thrust is unchanged


def saturate_thrust(
    own: PlanarState, thrust_m_s2: Vec2, obstacle: PlanarState, params: PaperParams
) -> PaperResult:
    """Return the saturated horizontal thrust (22).

    Implements: (5)-(22). (9) is (8) for the mirrored orthoradial velocity ``-phi_perp``.

    Args:
        own: absolute motion.
        thrust_m_s2: F_d / m of the baseline, horizontal.
        obstacle: motion of the vehicle to avoid.
        params: the paper's tuning.
    Returns:
        Thrust. Where the vehicles coincide M_o has no inverse, (11), and the thrust is unchanged.
    Properties: rotation- and translation-equivariant; homogeneous; idempotent.
    """
    p, v, a_o = params, own.velocity_m_s, obstacle.acceleration_m_s2
    e = Vec2(own.position_m.x - obstacle.position_m.x, own.position_m.y - obstacle.position_m.y)
    w = Vec2(v.x - obstacle.velocity_m_s.x, v.y - obstacle.velocity_m_s.y)
    d_o2 = dot_2(e, e)  # (5)
    d_o2_rate = 2.0 * dot_2(e, w)
    phi_perp = p.turn_sign * cross_2(e, v)  # (6)
    d_1 = 2.0 * dot_2(w, w) - 2.0 * dot_2(e, a_o)  # (13)
    d_2 = p.turn_sign * cross_2(w, v)  # (14)
    outside = d_o2 - p.d_inf_m * p.d_inf_m
    # (20)
    h_1 = (
        -d_1 - (p.kappa_1_1_s + p.kappa_2_1_s) * d_o2_rate - p.kappa_1_1_s * p.kappa_2_1_s * outside
    )
    h_2 = (  # (21)
        -d_2
        - p.kappa_3_1_s * d_o2_rate
        - p.kappa_4_1_s * (phi_perp - p.d_inf_m * p.v_perp_m_s)
        - p.kappa_3_1_s * p.kappa_4_1_s * outside
    )
    if not (d_o2 > 1e-12 and math.isfinite(h_1) and math.isfinite(h_2)):
        return PaperResult(thrust_m_s2, False, False)
    u_1 = 2.0 * dot_2(e, thrust_m_s2)  # (15)
    u_2 = p.turn_sign * cross_2(e, thrust_m_s2)
    # by how much Sat, (4), raises u_1 and u_2 in (19)
    more_1, more_2 = max(0.0, h_1 - u_1), max(0.0, h_2 - u_2)
    # M_o^-1 = M_o^T / (4 d_o2): only what the saturations add is transformed back, so that inactive
    # ones change no bit
    along, across = 0.5 * more_1 / d_o2, p.turn_sign * more_2 / d_o2
    x, y = along * e.x - across * e.y, along * e.y + across * e.x
    return PaperResult(
        Vec2(thrust_m_s2.x + x, thrust_m_s2.y + y), more_1 > 0.0 or more_2 > 0.0, True
    )


def saturate_pair(
    own: Own, state: State, neighbours: Sequence[Neighbour], params: LawParams
) -> Answer:
    """Return the paper's thrust (22) against the ring's successor, on plain estimates and within
    the radius.

    Args:
        own: this vehicle; the thrust counts.
        state: own estimate, not predicted.
        neighbours: the ring's successor is among them, or nobody is avoided.
    """
    for neighbour in neighbours:
        if neighbour.is_paper_obstacle:
            return _saturate_pair(own, state, neighbour, params)
    return Answer(own.thrust_m_s2, INACTIVE, 0.0, 0.0, NOBODY)


def _saturate_pair(own: Own, state: State, neighbour: Neighbour, params: LawParams) -> Answer:
    s = own.compensation_m_s2
    p, v, a = neighbour.position_enu_m, neighbour.velocity_enu_m_s, neighbour.acceleration_enu_m_s2
    is_known = (
        math.isfinite(p.x) and math.isfinite(p.y) and math.isfinite(v.x) and math.isfinite(v.y)
    )
    is_known = is_known and math.isfinite(a.x) and math.isfinite(a.y)
    result = saturate_thrust(
        PlanarState(clipped(state.position_enu_m), clipped(state.velocity_enu_m_s), ZERO_2),
        Vec2(own.thrust_m_s2.x - s.x, own.thrust_m_s2.y - s.y),
        PlanarState(clipped(p), clipped(v), clipped(a)),
        params.paper,
    )
    if not is_known or not result.is_usable:
        return Answer(own.thrust_m_s2, INFEASIBLE, 0.0, 0.0, NOBODY)
    if not result.is_changed:
        return Answer(own.thrust_m_s2, INACTIVE, 0.0, 0.0, NOBODY)
    safe = into_disc(Vec2(result.thrust_m_s2.x + s.x, result.thrust_m_s2.y + s.y), own.radius_m_s2)
    return Answer(safe, SATURATED, 0.0, 0.0, neighbour.table_index)
