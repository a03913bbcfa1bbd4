"""The paper's law for one moving obstacle: equations (5) to (22), with the turn of (8) or (9).

README.md beside this file names the paper. The paper orders its vehicles in a ring, and each
vehicle avoids only its successor.

All forces are per unit of mass, F / m. Positions, velocities and accelerations are in fleet ENU,
and only their horizontal x and y are used. The orthoradial velocity of (6) is positive when the
vehicle turns counter-clockwise about the obstacle as seen from above.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from onboard.avoidance.half_planes import into_disc
from onboard.avoidance.interface import INFEASIBLE, NOBODY, Answer
from onboard.avoidance.pairs import Own
from onboard.avoidance.params import LawParams, PaperParams
from onboard.avoidance.prediction import LARGEST
from onboard.avoidance.projection import INACTIVE, SATURATED
from onboard.types import Neighbour, State
from onboard.vectors import ZERO_XY, Vec2, cross_xy, dot_xy, horizontal_within

_COINCIDENT_2_M2 = 1e-12  # square of the distance below which two vehicles coincide


class PlanarState(NamedTuple):
    """Horizontal motion of one vehicle."""

    position_m: Vec2
    velocity_m_s: Vec2
    acceleration_m_s2: Vec2  # the law uses only the obstacle's acceleration


class PaperResult(NamedTuple):
    """Result of :func:`saturate_thrust`."""

    thrust_m_s2: Vec2  # F_d^sat / m
    is_changed: bool  # whether either of the two saturations acts
    is_usable: bool  # False: M_o of (11) has no inverse, and the thrust is unchanged


def saturate_thrust(
    own: PlanarState, thrust_m_s2: Vec2, obstacle: PlanarState, params: PaperParams
) -> PaperResult:
    """Return the saturated horizontal thrust (22).

    Implements: (5)-(22). (9) is (8) for the mirrored orthoradial velocity ``-phi_perp``.

    Args:
        own: absolute motion of this vehicle.
        thrust_m_s2: F_d / m of the baseline, horizontal.
        obstacle: motion of the vehicle to avoid.
        params: the paper's tuning.
    Returns:
        Thrust. Where the vehicles coincide, M_o has no inverse, (11), and the thrust is unchanged.
    Properties: rotation- and translation-equivariant; homogeneous; idempotent.
    """
    p = params
    v = own.velocity_m_s
    a_o = obstacle.acceleration_m_s2
    e = Vec2(own.position_m.x - obstacle.position_m.x, own.position_m.y - obstacle.position_m.y)
    w = Vec2(v.x - obstacle.velocity_m_s.x, v.y - obstacle.velocity_m_s.y)

    # the outputs, and the terms of their derivatives without the input
    d_o2 = dot_xy(e, e)  # (5)
    d_o2_rate = 2.0 * dot_xy(e, w)
    phi_perp = p.turn_sign * cross_xy(e, v)  # (6)
    d_1 = 2.0 * dot_xy(w, w) - 2.0 * dot_xy(e, a_o)  # (13)
    d_2 = p.turn_sign * cross_xy(w, v)  # (14)

    # bounds of the input
    outside = d_o2 - p.d_inf_m * p.d_inf_m
    h_1 = (  # (20)
        -d_1 - (p.kappa_1_1_s + p.kappa_2_1_s) * d_o2_rate - p.kappa_1_1_s * p.kappa_2_1_s * outside
    )
    h_2 = (  # (21)
        -d_2
        - p.kappa_3_1_s * d_o2_rate
        - p.kappa_4_1_s * (phi_perp - p.d_inf_m * p.v_perp_m_s)
        - p.kappa_3_1_s * p.kappa_4_1_s * outside
    )
    if not (d_o2 > _COINCIDENT_2_M2 and math.isfinite(h_1) and math.isfinite(h_2)):
        return PaperResult(thrust_m_s2, is_changed=False, is_usable=False)

    # the input (15), and the amount by which Sat, (4), raises it in (19)
    u_1 = 2.0 * dot_xy(e, thrust_m_s2)
    u_2 = p.turn_sign * cross_xy(e, thrust_m_s2)
    raised_1 = max(0.0, h_1 - u_1)
    raised_2 = max(0.0, h_2 - u_2)

    # (22) with M_o^-1 = M_o^T / (4 d_o2). Only the increments are transformed back, so that a
    # saturation that does not act changes no bit of the thrust.
    along = 0.5 * raised_1 / d_o2
    across = p.turn_sign * raised_2 / d_o2
    added_x = along * e.x - across * e.y
    added_y = along * e.y + across * e.x
    return PaperResult(
        thrust_m_s2=Vec2(thrust_m_s2.x + added_x, thrust_m_s2.y + added_y),
        is_changed=raised_1 > 0.0 or raised_2 > 0.0,
        is_usable=True,
    )


def saturate_pair(
    own: Own, state: State, neighbours: Sequence[Neighbour], params: LawParams
) -> Answer:
    """Return the thrust (22) that avoids the single neighbour assigned by the paper's ring.

    The law uses the estimates without prediction. Its thrust is shortened to what tilt and motors
    can deliver.

    Args:
        own: this vehicle; its thrust and thrust limits are used.
        state: own estimate, not predicted.
        neighbours: neighbours as received. If the assigned one is not among them, the thrust is not
            changed.
    """
    for neighbour in neighbours:
        if neighbour.is_paper_obstacle:
            return _saturate_against(neighbour, own, state, params)
    return _answer(own.thrust_m_s2, INACTIVE, NOBODY)


def _saturate_against(neighbour: Neighbour, own: Own, state: State, params: LawParams) -> Answer:
    """Return the thrust (22) that avoids one neighbour."""
    if not _is_known(neighbour):
        return _answer(own.thrust_m_s2, INFEASIBLE, NOBODY)

    # the paper's law gets the thrust without the compensation, which is added to its result
    s = own.compensation_m_s2
    thrust = Vec2(own.thrust_m_s2.x - s.x, own.thrust_m_s2.y - s.y)

    result = saturate_thrust(
        PlanarState(
            position_m=horizontal_within(state.position_enu_m, LARGEST),
            velocity_m_s=horizontal_within(state.velocity_enu_m_s, LARGEST),
            acceleration_m_s2=ZERO_XY,
        ),
        thrust,
        PlanarState(
            position_m=horizontal_within(neighbour.position_enu_m, LARGEST),
            velocity_m_s=horizontal_within(neighbour.velocity_enu_m_s, LARGEST),
            acceleration_m_s2=horizontal_within(neighbour.acceleration_enu_m_s2, LARGEST),
        ),
        params.paper,
    )
    if not result.is_usable:
        return _answer(own.thrust_m_s2, INFEASIBLE, NOBODY)
    if not result.is_changed:
        return _answer(own.thrust_m_s2, INACTIVE, NOBODY)

    compensated = Vec2(result.thrust_m_s2.x + s.x, result.thrust_m_s2.y + s.y)
    safe = into_disc(compensated, own.radius_m_s2)
    return _answer(safe, SATURATED, neighbour.table_index)


def _is_known(neighbour: Neighbour) -> bool:
    """Whether the neighbour's plain horizontal motion is finite."""
    p = neighbour.position_enu_m
    v = neighbour.velocity_enu_m_s
    a = neighbour.acceleration_enu_m_s2
    return (
        math.isfinite(p.x)
        and math.isfinite(p.y)
        and math.isfinite(v.x)
        and math.isfinite(v.y)
        and math.isfinite(a.x)
        and math.isfinite(a.y)
    )


def _answer(thrust_m_s2: Vec2, status: int, active: int) -> Answer:
    """Return an answer of the paper's law, which knows neither slack nor crowds."""
    return Answer(
        thrust_m_s2=thrust_m_s2,
        status=status,
        slack_m_s2=0.0,
        crowd_count=0.0,
        active=active,
    )
