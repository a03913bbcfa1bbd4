"""Rows of the law: half-planes ``n . u >= b`` of the horizontal thrust, one for each constrained
output.

The paper constrains two outputs of a pair: the squared distance d_o,2 of (5), and the orthoradial
velocity phi_perp of (6). It derives each until the input appears, (10), and bounds the input such
that the output decays to its limit no faster than the kappas say, (17) and (18). The bounds are
:func:`separating_bound` and :func:`h_2`. With e and w for position and velocity relative to the other one, ``u_1
= 2 e . u`` and ``u_2 = e x u``, (15): so (17) and (18) are half-planes, with the normals e and e
turned by 90 degrees. A row is divided by the distance to keep, so that its bound is in m/s^2.
"""

from __future__ import annotations

from onboard.avoidance.half_planes import HalfPlane
from onboard.avoidance.pairs import NeighbourPair, Surface
from onboard.avoidance.params import (
    DIRECTION_CROWD,
    DIRECTION_FIXED,
    RESPONSIBILITY_FULL,
    RESPONSIBILITY_HALF,
    Fence,
    Gains,
    LawParams,
)
from onboard.vectors import Vec2, cross_2, dot_2, length_2

SPEED_GAIN_1_S = 4.0
_CONFLICT_FADE, _CONFLICT_WIDTH = 0.2, 0.9  # times the distance to keep
_CONFLICT_M_S = 0.3  # relative intent from which a conflict counts in full


def separating_bound(e: Vec2, w: Vec2, d_m: float, kappa_1_1_s: float, kappa_2_1_s: float) -> float:
    """Return half of the bound (20) [m^2/s^2], without the acceleration of the other one, which
    belongs to D_1.

    ``e . (a_i - a_j) >= separating_bound`` keeps the squared distance, (5), above d^2, (7).

    Args:
        e, w: relative position and velocity [m, m/s].
        d_m: distance to keep.
    """
    closing = dot_2(e, w)  # half of the rate of d_o,2
    outside = dot_2(e, e) - d_m * d_m
    return (
        -dot_2(w, w)
        - (kappa_1_1_s + kappa_2_1_s) * closing
        - 0.5 * kappa_1_1_s * kappa_2_1_s * outside
    )


def h_2(
    e: Vec2, w: Vec2, v: Vec2, d_m: float, v_perp_m_s: float, sign: float, gains: Gains
) -> float:
    """Return the bound (21) [m^2/s^2] for turning about the other one.

    ``sign (e x a) >= h_2`` keeps the orthoradial velocity, (6), above (8), or for the sign -1 below
    (9).

    Args:
        e, w: relative position and velocity [m, m/s].
        v: velocity whose orthoradial part is constrained [m/s].
        d_m: distance to keep.
        v_perp_m_s: v_perp^#.
        sign: +1 counter-clockwise, -1 clockwise.
    """
    d_2 = sign * cross_2(w, v)  # (14)
    phi_perp = sign * cross_2(e, v)  # (6)
    d_o2_rate = 2.0 * dot_2(e, w)
    outside = dot_2(e, e) - d_m * d_m
    kappa_3, kappa_4 = gains.kappa_3_1_s, gains.kappa_4_1_s
    return -d_2 - kappa_3 * d_o2_rate - kappa_4 * (phi_perp - d_m * v_perp_m_s + kappa_3 * outside)


def distance_row(pair: NeighbourPair, params: LawParams) -> HalfPlane:
    """Return the half-plane that keeps one neighbour outside the distance to keep (line D).

    Implements: (17), (20). DEVIATION D2: the policy says how much of the bound this vehicle takes
    on itself. full: all of it, and the other's acceleration (the paper). half: half. shortfall:
    half, and ``shortfall_gain`` times the part of the other half that the neighbour's command does
    not deliver. All of it for one that does not cooperate.

    Args:
        pair: this vehicle and the neighbour at t + L.
    Returns:
        normal [-] and bound [m/s^2].
    Properties: rotation-equivariant; homogeneous.
    """
    e, d, gains = pair.e, pair.d_m, params.gains
    needed = separating_bound(e, pair.w, d, gains.kappa_1_1_s, gains.kappa_2_1_s)
    pulled = dot_2(e, pair.command_m_s2)
    responsibility = params.policies.responsibility
    if responsibility == RESPONSIBILITY_FULL or not pair.is_cooperative:
        bound = needed + pulled
    elif responsibility == RESPONSIBILITY_HALF:
        bound = 0.5 * needed
    else:
        bound = 0.5 * needed + gains.shortfall_gain * max(0.0, 0.5 * needed + pulled)
    return HalfPlane(Vec2(e.x / d, e.y / d), bound / d)


def promised_row(pair: NeighbourPair, params: LawParams) -> HalfPlane:
    """Return the half-plane of the promised distance alone, without any margin: given up last (line
    Q).

    Args:
        pair: this vehicle and the neighbour at t + L.
    """
    promised_m = min(pair.d_m, params.spacing.safety_distance_m)
    bare = NeighbourPair(
        pair.e,
        pair.w,
        pair.command_m_s2,
        pair.intent_m_s,
        promised_m,
        pair.distance_2_m2,
        pair.crowd_count,
        pair.is_near,
        pair.is_cooperative,
        pair.table_index,
    )
    return distance_row(bare, params)


def rotation_row(
    pair: NeighbourPair, own_velocity_m_s: Vec2, is_crowded: bool, params: LawParams
) -> HalfPlane:
    """Return the soft half-plane that turns the pair about each other (line R).

    Implements: (18), (21). DEVIATION D4: in relative form with half a share for each, where both
    see the same numbers. A vehicle that has to do everything turns alone, relative to the other;
    under the paper's full responsibility by its absolute velocity, as (6) has it.

    Args:
        pair: this vehicle and the neighbour at t + L.
        own_velocity_m_s: absolute, horizontal, at t + L.
        is_crowded: whether one of the two has ``crowd_count`` near neighbours.
    Returns:
        normal [-] and bound [m/s^2].
    Properties: rotation-equivariant; homogeneous.
    """
    e, w, d, gains, policies = pair.e, pair.w, pair.d_m, params.gains, params.policies
    sign = turn_sign(e, pair.intent_m_s, d, is_crowded, policies.direction)
    is_fast = is_crowded and policies.direction >= DIRECTION_CROWD
    v_perp = gains.v_perp_crowd_m_s if is_fast else gains.v_perp_m_s
    if policies.responsibility == RESPONSIBILITY_FULL:
        bound = h_2(e, w, own_velocity_m_s, d, v_perp, sign, gains)
    elif not pair.is_cooperative:
        bound = h_2(e, w, w, d, v_perp, sign, gains)
    else:  # both turn with v_perp, so that the relative velocity is twice that
        bound = 0.5 * h_2(e, w, w, d, 2.0 * v_perp, sign, gains)
    return HalfPlane(Vec2(-e.y * sign / d, e.x * sign / d), bound / d)


def conflict(e: Vec2, intent_m_s: Vec2, d_m: float) -> float:
    """Return how far the straight ways that both intend come too near to each other, from 0 to 1.
    DEVIATION D4.

    Args:
        e: relative position [m].
        intent_m_s: relative velocity that both intend.
        d_m: distance to keep.
    Properties: rotation-equivariant; the same for both vehicles.
    """
    speed = length_2(intent_m_s)
    if speed < 1e-6 or dot_2(e, intent_m_s) >= 0.0:
        return 0.0
    miss_m = abs(cross_2(e, intent_m_s)) / speed
    share = min(max((_CONFLICT_WIDTH * d_m - miss_m) / (_CONFLICT_FADE * d_m), 0.0), 1.0)
    return share * min(speed / _CONFLICT_M_S, 1.0)


def turn_sign(e: Vec2, intent_m_s: Vec2, d_m: float, is_crowded: bool, direction: int) -> float:
    """Return the side of a turn: +1 counter-clockwise, (8), or -1 clockwise, (9); by policy.
    DEVIATION D4, D14.

    fixed: always +1. pair: as the relative velocity already turns the pair, which both see alike;
    +1 if undecided. crowd: a crowded pair always +1, so that all of a crowd go round the same way.
    intent: as crowd, but by the relative velocity that both intend, which does not keep a circling
    pair circling.

    Args:
        e: relative position [m].
        intent_m_s: relative velocity that decides.
        d_m: distance to keep.
    """
    if direction == DIRECTION_FIXED or (is_crowded and direction >= DIRECTION_CROWD):
        return 1.0
    return -1.0 if cross_2(e, intent_m_s) < -0.25 * d_m * max(length_2(intent_m_s), 0.1) else 1.0


def obstacle_row(surface: Surface, gains: Gains) -> HalfPlane:
    """Return the half-plane that keeps a static obstacle at its distance: (17) with all of the
    bound. DEVIATION D13.

    Args:
        surface: the obstacle's nearest point.
        gains: ``static_kappa_1_1_s`` in place of kappa_1.
    """
    e, d = surface.e, surface.d_m
    bound = separating_bound(e, surface.w, d, gains.static_kappa_1_1_s, gains.kappa_2_1_s)
    return HalfPlane(Vec2(e.x / d, e.y / d), bound / d)


def obstacle_rotation_row(
    surface: Surface, velocity_m_s: Vec2, intent_m_s: Vec2, params: LawParams
) -> HalfPlane:
    """Return the soft half-plane that turns the vehicle about a static obstacle: (18). DEVIATION
    D13.

    Args:
        surface: the obstacle's nearest point.
        velocity_m_s, intent_m_s: own, horizontal, at t + L.
    """
    e, d, gains = surface.e, surface.d_m, params.gains
    sign = turn_sign(e, intent_m_s, d, False, params.policies.direction)
    bound = h_2(e, surface.w, velocity_m_s, d, gains.v_perp_m_s, sign, gains)
    return HalfPlane(Vec2(-e.y * sign / d, e.x * sign / d), bound / d)


def fence_rows(position_m: Vec2, velocity_m_s: Vec2, fence: Fence, gains: Gains) -> list[HalfPlane]:
    """Return the half-planes of the four walls, with bound -inf for an open side: (17) for the
    distance from a line.

    With the distance h and the inward normal n: ``n . u >= -(k_1 + k_2) n . v - k_1 k_2 h``.
    DEVIATION D13.

    Args:
        position_m, velocity_m_s: own, horizontal, at t + L.
    """
    rate, stiffness = (
        gains.static_kappa_1_1_s + gains.kappa_2_1_s,
        gains.static_kappa_1_1_s * gains.kappa_2_1_s,
    )
    p, v = position_m, velocity_m_s
    return [
        HalfPlane(Vec2(1.0, 0.0), -rate * v.x - stiffness * (p.x - fence.low_x_m)),
        HalfPlane(Vec2(0.0, 1.0), -rate * v.y - stiffness * (p.y - fence.low_y_m)),
        HalfPlane(Vec2(-1.0, 0.0), rate * v.x - stiffness * (fence.high_x_m - p.x)),
        HalfPlane(Vec2(0.0, -1.0), rate * v.y - stiffness * (fence.high_y_m - p.y)),
    ]


def speed_row(velocity_m_s: Vec2, top_speed_m_s: float) -> HalfPlane:
    """Return the soft half-plane that lets the speed approach its limit only slowly. DEVIATION D13.

    Args:
        velocity_m_s: own, horizontal, not zero.
    """
    speed = length_2(velocity_m_s)
    normal = Vec2(-velocity_m_s.x / speed, -velocity_m_s.y / speed)
    return HalfPlane(normal, -SPEED_GAIN_1_S * (top_speed_m_s - speed))


def compensated(row: HalfPlane, compensation_m_s2: Vec2) -> HalfPlane:
    """Return the row for the thrust with its compensation; rows constrain the net motion, which is
    without it.

    Args:
        row: of the net motion.
        compensation_m_s2: horizontal.
    """
    return HalfPlane(row.normal, row.bound_m_s2 + dot_2(row.normal, compensation_m_s2))


def violation(row: HalfPlane, thrust_m_s2: Vec2) -> float:
    """Return by how much a thrust misses the bound [m/s^2]; negative where the row holds.

    Args:
        row: half-plane.
        thrust_m_s2: horizontal.
    """
    return row.bound_m_s2 - dot_2(row.normal, thrust_m_s2)


def can_bind(row: HalfPlane, radius_m_s2: float) -> bool:
    """Whether some thrust of the disc violates the row.

    Args:
        row: half-plane.
        radius_m_s2: of the disc of possible thrusts.
    """
    return row.bound_m_s2 > -radius_m_s2 * length_2(row.normal)


def faded(row: HalfPlane, thrust_m_s2: Vec2, strength: float) -> HalfPlane:
    """Return the row between what the thrust gives already, for strength 0, and its own bound, for
    1. DEVIATION D15.

    Args:
        row: half-plane.
        thrust_m_s2: of the baseline.
        strength: from 0 to 1.
    """
    if strength >= 1.0:
        return row
    given = dot_2(row.normal, thrust_m_s2)
    return HalfPlane(row.normal, given + strength * (row.bound_m_s2 - given))
