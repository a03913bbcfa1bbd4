"""Constraints of the law, as half-planes ``n . u >= b`` of the horizontal thrust u ("rows").

README.md beside this file names the paper, and explains the lines of the algorithm (line D) and the
deviations from the paper (D4). Numbers in brackets are equations of the paper.

The paper constrains two outputs of a pair: the squared distance d_o,2 of (5), and the orthoradial
velocity phi_perp of (6). Each output is differentiated until the input appears, (10). The input is
bounded so that the output decays to its limit no faster than the kappas say, (17) and (18). The
bounds are :func:`separating_bound` and :func:`h_2`.

Let e and w be position and velocity relative to the other vehicle. The inputs are ``u_1 = 2 e . u``
and ``u_2 = e x u``, (15). So (17) and (18) are half-planes. Their normals are e, and e turned by 90
degrees. A row is divided by the distance to keep, so that its bound is in m/s^2.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.avoidance.half_planes import HalfPlane
from onboard.avoidance.interface import NOT_A_VEHICLE
from onboard.avoidance.pairs import NeighbourPair, Own, Surface
from onboard.avoidance.params import (
    DIRECTION_CROWD,
    DIRECTION_FIXED,
    DIRECTION_INTENT,
    RESPONSIBILITY_FULL,
    RESPONSIBILITY_HALF,
    ROTATION_AHEAD,
    ROTATION_ALWAYS,
    ROTATION_NEVER,
    Gains,
    LawParams,
    Walls,
)
from onboard.vectors import ZERO_XY, Vec2, cross_xy, dot_xy, length_xy

SPEED_GAIN_1_S = 8.0  # rate at which the speed may approach its limit
# Jerk for each m/s of the top speed. It has to reduce the acceleration to zero before the speed
# reaches its limit, which bounds the acceleration.
SPEED_JERK_1_S2 = 6.0
# A vehicle that flees from a neighbour that does not cooperate may fly faster by this factor.
FLEEING_FACTOR = 2.0
# The distance row of a neighbour that cannot be outrun demands at most this share of the largest
# thrust.
_OUTRUN_SHARE = 0.7
VIOLATED_M_S2 = 1e-10  # a row that is violated by more changes the thrust; less is rounding

# Two intended straight paths conflict if they pass each other nearer than _CONFLICT_WIDTH times the
# distance to keep. The strength of the conflict grows to 1 while the passing distance falls by
# _CONFLICT_FADE times the distance to keep. It also grows with the relative intended speed, up to
# _CONFLICT_M_S.
_CONFLICT_WIDTH = 0.9
_CONFLICT_FADE = 0.2
_CONFLICT_M_S = 0.3
_NO_INTENT_M_S = 1e-6  # below this relative intended speed, two vehicles intend the same motion

# A pair turns clockwise only if its relative velocity clearly requires it: the passing distance is
# at least this share of the distance to keep.
_CLOCKWISE_WIDTH = 0.25
_CLOCKWISE_FLOOR_M_S = 0.1  # a smaller relative speed counts as this speed

NO_ROW = HalfPlane(ZERO_XY, -math.inf)


class Constraint(NamedTuple):
    """The rows of one neighbour, obstacle or wall."""

    row: HalfPlane  # hard: keeps the distance
    turn: HalfPlane  # soft: turns the vehicle about the neighbour or obstacle
    is_turning: bool  # whether there is a soft row
    violation_m_s2: float  # by how much the baseline violates the hard row; negative: it holds
    table_index: int  # index of the neighbour, or NOT_A_VEHICLE


def constraints_around(
    own: Own,
    pairs: list[NeighbourPair],
    surfaces: list[Surface],
    crowd_count: float,
    params: LawParams,
) -> list[Constraint]:
    """Return the constraints of the neighbours, the obstacles and the walls, in this order.

    Args:
        own: this vehicle at t + L.
        pairs: this vehicle and each of the neighbours that count.
        surfaces: nearest points of the obstacles that count.
        crowd_count: number of neighbours near this vehicle.
    """
    constraints = [neighbour_constraint(own, pair, crowd_count, params) for pair in pairs]
    constraints.extend([obstacle_constraint(own, surface, params) for surface in surfaces])

    # walls have no rotation rows
    walls = fence_rows(own.position_m, own.velocity_m_s, params.fence, params.gains)
    constraints.extend([hard_constraint(own, wall, NOT_A_VEHICLE) for wall in walls])
    return constraints


def neighbour_constraint(
    own: Own, pair: NeighbourPair, crowd_count: float, params: LawParams
) -> Constraint:
    """Return the rows of one neighbour: its distance (line D), and turning about it (line R).

    Args:
        own: this vehicle at t + L.
        pair: this vehicle and the neighbour at t + L.
        crowd_count: number of neighbours near this vehicle.
    """
    distance = distance_row(pair, pair.d_m, params)
    if cannot_be_outrun(own, pair, params):
        distance = with_room_to_turn(distance, own)

    hard = hard_constraint(own, distance, pair.table_index)
    strength = turning_strength(hard.violation_m_s2, pair, params)
    if strength <= 0.0:
        return hard

    is_crowded = max(crowd_count, pair.crowd_count) >= params.gains.crowd_count
    turn = rotation_row(pair, own.velocity_m_s, is_crowded, params)
    full_turn = compensated(turn, own.compensation_m_s2)
    return Constraint(
        row=hard.row,
        turn=faded(full_turn, own.thrust_m_s2, strength),
        is_turning=True,
        violation_m_s2=hard.violation_m_s2,
        table_index=hard.table_index,
    )


def cannot_be_outrun(own: Own, pair: NeighbourPair, params: LawParams) -> bool:
    """Whether a neighbour that does not cooperate is faster than this vehicle may flee.

    Args:
        own: this vehicle at t + L.
        pair: this vehicle and the neighbour at t + L.
    """
    if pair.is_cooperative:
        return False

    theirs_m_s = Vec2(own.velocity_m_s.x - pair.w.x, own.velocity_m_s.y - pair.w.y)
    return length_xy(theirs_m_s) > FLEEING_FACTOR * params.top_speed_m_s


def with_room_to_turn(row: HalfPlane, own: Own) -> HalfPlane:
    """Return a distance row that leaves a part of the thrust for the turn. DEVIATION D18.

    The distance row of a fast neighbour demands all thrust, straight away from it. The vehicle
    would fly ahead of the neighbour until it is caught, and would not step aside.

    Args:
        row: distance row of a neighbour that cannot be outrun.
        own: this vehicle at t + L.
    """
    most_m_s2 = _OUTRUN_SHARE * own.radius_m_s2 * length_xy(row.normal)
    return HalfPlane(row.normal, min(row.bound_m_s2, most_m_s2))


def turning_strength(violation_m_s2: float, pair: NeighbourPair, params: LawParams) -> float:
    """Return how much of a neighbour's rotation row counts under the policy, from 0 to 1.

    Under the policy "violated", the strength grows with the violation of the distance row. Under
    "ahead", it also grows before any violation, if the intended paths come too near each other.
    DEVIATION D4, D15.

    Args:
        violation_m_s2: by how much the baseline violates the distance row.
        pair: this vehicle and the neighbour at t + L.
    """
    rotation = params.policies.rotation
    if rotation == ROTATION_ALWAYS:
        return 1.0

    strength = 0.0
    if rotation != ROTATION_NEVER and violation_m_s2 > VIOLATED_M_S2:
        strength = violation_m_s2 / params.gains.rotation_fade_m_s2
    if rotation == ROTATION_AHEAD:
        strength = max(strength, conflict(pair.e, pair.intent_m_s, pair.d_m))
    return min(strength, 1.0)


def obstacle_constraint(own: Own, surface: Surface, params: LawParams) -> Constraint:
    """Return the rows of one static obstacle.

    They are its distance row and, while the baseline violates the distance row, a rotation row.

    Args:
        own: this vehicle at t + L.
        surface: the obstacle's nearest point.
    """
    hard = hard_constraint(own, obstacle_row(surface, params.gains), NOT_A_VEHICLE)

    rotation = params.policies.rotation
    is_violated = hard.violation_m_s2 > VIOLATED_M_S2
    is_turning = is_violated and rotation != ROTATION_NEVER
    if not is_turning and rotation != ROTATION_ALWAYS:
        return hard

    turn = obstacle_rotation_row(surface, own.velocity_m_s, own.intent_m_s, params)
    return Constraint(
        row=hard.row,
        turn=compensated(turn, own.compensation_m_s2),
        is_turning=True,
        violation_m_s2=hard.violation_m_s2,
        table_index=hard.table_index,
    )


def hard_constraint(own: Own, net_row: HalfPlane, table_index: int) -> Constraint:
    """Return the constraint of one row alone, without a turn.

    Args:
        own: this vehicle at t + L.
        net_row: row that keeps the distance, for the acceleration (see :func:`compensated`).
        table_index: index of the neighbour, or NOT_A_VEHICLE.
    """
    row = compensated(net_row, own.compensation_m_s2)
    return Constraint(
        row=row,
        turn=NO_ROW,
        is_turning=False,
        violation_m_s2=row.bound_m_s2 - dot_xy(row.normal, own.thrust_m_s2),
        table_index=table_index,
    )


def separating_bound(e: Vec2, w: Vec2, d_m: float, kappa_1_1_s: float, kappa_2_1_s: float) -> float:
    """Return the bound [m^2/s^2] of ``e . (a_i - a_j)`` that keeps a pair's distance, (7).

    The bound is half of h_1 of (20), without the other vehicle's acceleration, which the paper
    includes in D_1.

    Args:
        e, w: relative position and velocity [m, m/s].
        d_m: distance to keep.
        kappa_1_1_s, kappa_2_1_s: decay of the constraint.
    """
    half_rate = dot_xy(e, w)  # half of the rate of d_o,2
    outside = dot_xy(e, e) - d_m * d_m
    return (
        -dot_xy(w, w)
        - (kappa_1_1_s + kappa_2_1_s) * half_rate
        - 0.5 * kappa_1_1_s * kappa_2_1_s * outside
    )


def h_2(
    e: Vec2, w: Vec2, v: Vec2, d_m: float, v_perp_m_s: float, sign: float, gains: Gains
) -> float:
    """Return the bound (21) [m^2/s^2] for turning about the other vehicle.

    ``sign (e x a) >= h_2`` keeps the orthoradial velocity, (6), above (8) with the sign +1, and
    below (9) with the sign -1.

    Args:
        e, w: relative position and velocity [m, m/s].
        v: velocity whose orthoradial part is constrained [m/s].
        d_m: distance to keep.
        v_perp_m_s: the paper's v_perp^#, the orthoradial velocity to reach [m/s].
        sign: +1 counter-clockwise, -1 clockwise.
        gains: kappa_3 and kappa_4.
    """
    kappa_3 = gains.kappa_3_1_s
    kappa_4 = gains.kappa_4_1_s

    phi_perp = sign * cross_xy(e, v)  # (6)
    d_2 = sign * cross_xy(w, v)  # (14)
    d_o2_rate = 2.0 * dot_xy(e, w)
    outside = dot_xy(e, e) - d_m * d_m

    return -d_2 - kappa_3 * d_o2_rate - kappa_4 * (phi_perp - d_m * v_perp_m_s + kappa_3 * outside)


def radial(e: Vec2, bound_m2_s2: float, d_m: float) -> HalfPlane:
    """Return the row ``e . u >= bound``, divided by the distance to keep.

    Args:
        e: relative position [m].
        bound_m2_s2: bound of the undivided row.
        d_m: distance to keep.
    """
    return HalfPlane(Vec2(e.x / d_m, e.y / d_m), bound_m2_s2 / d_m)


def orthoradial(e: Vec2, sign: float, bound_m2_s2: float, d_m: float) -> HalfPlane:
    """Return the row ``sign (e x u) >= bound``, divided by the distance to keep.

    Args:
        e: relative position [m].
        sign: +1 counter-clockwise, -1 clockwise.
        bound_m2_s2: bound of the undivided row.
        d_m: distance to keep.
    """
    return HalfPlane(Vec2(-e.y * sign / d_m, e.x * sign / d_m), bound_m2_s2 / d_m)


def distance_row(pair: NeighbourPair, d_m: float, params: LawParams) -> HalfPlane:
    """Return the half-plane that keeps one neighbour outside a distance (line D).

    Implements: (17), (20). DEVIATION D2: a policy says how much of the bound this vehicle takes.
    Under "full" it takes all of the bound and the other's acceleration, as in the paper. Under
    "half" it takes half. Under "shortfall" it takes half, and ``shortfall_gain`` times the part of
    the other half that the neighbour's command does not deliver. If the neighbour does not
    cooperate, this vehicle takes all of the bound under every policy.

    Args:
        pair: this vehicle and the neighbour at t + L.
        d_m: distance to keep.
    Returns:
        normal [-] and bound [m/s^2].
    Properties: rotation-equivariant; homogeneous.
    """
    gains = params.gains
    whole_bound = separating_bound(pair.e, pair.w, d_m, gains.kappa_1_1_s, gains.kappa_2_1_s)
    # what the neighbour's command adds to the bound: positive if it accelerates towards us
    closing = dot_xy(pair.e, pair.command_m_s2)

    responsibility = params.policies.responsibility
    if responsibility == RESPONSIBILITY_FULL or not pair.is_cooperative:
        bound = whole_bound + closing
    elif responsibility == RESPONSIBILITY_HALF:
        bound = 0.5 * whole_bound
    else:
        shortfall = max(0.0, 0.5 * whole_bound + closing)
        bound = 0.5 * whole_bound + gains.shortfall_gain * shortfall

    return radial(pair.e, bound, d_m)


def promised_row(pair: NeighbourPair, params: LawParams) -> HalfPlane:
    """Return the half-plane of the promised safety distance, without any margin (line Q).

    If rows contradict each other, this row is relaxed last.

    Args:
        pair: this vehicle and the neighbour at t + L.
    """
    promised_m = min(pair.d_m, params.spacing.safety_distance_m)
    return distance_row(pair, promised_m, params)


def rotation_row(
    pair: NeighbourPair, own_velocity_m_s: Vec2, is_crowded: bool, params: LawParams
) -> HalfPlane:
    """Return the soft half-plane that turns the pair about each other (line R).

    Implements: (18), (21). DEVIATION D4: the row constrains the relative velocity, and each of the
    two vehicles takes half of its bound, because both see the same numbers. If the neighbour does
    not cooperate, this vehicle takes all of the bound. Under the paper's full responsibility the
    row constrains the absolute velocity, as in (6).

    Args:
        pair: this vehicle and the neighbour at t + L.
        own_velocity_m_s: this vehicle's absolute horizontal velocity at t + L.
        is_crowded: whether either of the two has ``crowd_count`` near neighbours.
    Returns:
        normal [-] and bound [m/s^2].
    Properties: rotation-equivariant; homogeneous.
    """
    e = pair.e
    w = pair.w
    d = pair.d_m
    gains = params.gains
    policies = params.policies

    sign = turn_sign(e, pair.intent_m_s, d, is_crowded, policies.direction)

    v_perp = gains.v_perp_m_s
    if is_crowded and turns_crowds(policies.direction):
        v_perp = gains.v_perp_crowd_m_s

    if policies.responsibility == RESPONSIBILITY_FULL:
        bound = h_2(e, w, own_velocity_m_s, d, v_perp, sign, gains)
    elif not pair.is_cooperative:
        bound = h_2(e, w, w, d, v_perp, sign, gains)
    else:
        # both turn with v_perp, so the relative velocity is twice v_perp
        bound = 0.5 * h_2(e, w, w, d, 2.0 * v_perp, sign, gains)

    return orthoradial(e, sign, bound, d)


def conflict(e: Vec2, intent_m_s: Vec2, d_m: float) -> float:
    """Return how much the intended straight paths of a pair conflict, from 0 to 1. DEVIATION D4.

    They conflict if the two vehicles would pass each other too near.

    Args:
        e: relative position [m].
        intent_m_s: difference of the two intended velocities.
        d_m: distance to keep.
    Properties: rotation-equivariant; the same for both vehicles.
    """
    speed_m_s = length_xy(intent_m_s)
    if speed_m_s < _NO_INTENT_M_S or dot_xy(e, intent_m_s) >= 0.0:
        return 0.0  # the two agree, or fly apart

    passing_m = abs(cross_xy(e, intent_m_s)) / speed_m_s  # smallest distance on straight paths
    nearness = (_CONFLICT_WIDTH * d_m - passing_m) / (_CONFLICT_FADE * d_m)
    share = min(max(nearness, 0.0), 1.0)
    return share * min(speed_m_s / _CONFLICT_M_S, 1.0)


def turn_sign(e: Vec2, deciding_m_s: Vec2, d_m: float, is_crowded: bool, direction: int) -> float:
    """Return the side of a turn under the policy: +1 counter-clockwise, (8), or -1 clockwise, (9).

    * "fixed": always +1.
    * "pair": the side to which the relative velocity already turns the pair; +1 while it does not
      clearly turn the pair. Both vehicles see the same side.
    * "crowd": always +1 for a crowded pair, so that a whole crowd turns the same way; otherwise
      like "pair".
    * "intent": like "crowd", but the relative intended velocity decides, so that a pair does not
    circle forever.

    DEVIATION D4, D14.

    Args:
        e: relative position [m].
        deciding_m_s: relative velocity that decides; the policy says whether it is intended or
            flown.
        d_m: distance to keep.
        is_crowded: whether the pair is part of a crowd.
        direction: the policy.
    """
    if direction == DIRECTION_FIXED or (is_crowded and turns_crowds(direction)):
        return 1.0

    speed_m_s = max(length_xy(deciding_m_s), _CLOCKWISE_FLOOR_M_S)
    clearly_clockwise = -_CLOCKWISE_WIDTH * d_m * speed_m_s
    return -1.0 if cross_xy(e, deciding_m_s) < clearly_clockwise else 1.0


def turns_crowds(direction: int) -> bool:
    """Return whether all pairs of a crowd turn the same way under the policy."""
    return direction in (DIRECTION_CROWD, DIRECTION_INTENT)


def obstacle_row(surface: Surface, gains: Gains) -> HalfPlane:
    """Return the half-plane that keeps a static obstacle at its distance: (17). DEVIATION D13.

    Args:
        surface: the obstacle's nearest point.
        gains: holds the kappas; ``static_kappa_1_1_s`` is used in place of kappa_1.
    """
    bound = separating_bound(
        surface.e, surface.w, surface.d_m, gains.static_kappa_1_1_s, gains.kappa_2_1_s
    )
    return radial(surface.e, bound, surface.d_m)


def obstacle_rotation_row(
    surface: Surface, velocity_m_s: Vec2, intent_m_s: Vec2, params: LawParams
) -> HalfPlane:
    """Return the soft half-plane that turns the vehicle about an obstacle: (18). DEVIATION D13.

    Args:
        surface: the obstacle's nearest point.
        velocity_m_s, intent_m_s: flown and intended horizontal velocity of this vehicle at t + L.
    """
    e = surface.e
    d = surface.d_m
    gains = params.gains
    is_crowded = False
    sign = turn_sign(e, intent_m_s, d, is_crowded, params.policies.direction)
    bound = h_2(e, surface.w, velocity_m_s, d, gains.v_perp_m_s, sign, gains)
    return orthoradial(e, sign, bound, d)


def fence_rows(position_m: Vec2, velocity_m_s: Vec2, fence: Walls, gains: Gains) -> list[HalfPlane]:
    """Return the half-planes of the four walls: (17) for the distance from a line. DEVIATION D13.

    With the distance h from the wall and its inward normal n, the row is
    ``n . u >= -(k_1 + k_2) n . v - k_1 k_2 h``. The bound of a missing wall is -inf.

    Args:
        position_m, velocity_m_s: horizontal position and velocity of this vehicle at t + L.
        fence: the walls.
        gains: holds the kappas for static things.
    """
    p = position_m
    v = velocity_m_s
    rate = gains.static_kappa_1_1_s + gains.kappa_2_1_s
    stiffness = gains.static_kappa_1_1_s * gains.kappa_2_1_s
    return [
        HalfPlane(Vec2(1.0, 0.0), -rate * v.x - stiffness * (p.x - fence.low_x_m)),
        HalfPlane(Vec2(0.0, 1.0), -rate * v.y - stiffness * (p.y - fence.low_y_m)),
        HalfPlane(Vec2(-1.0, 0.0), rate * v.x - stiffness * (fence.high_x_m - p.x)),
        HalfPlane(Vec2(0.0, -1.0), rate * v.y - stiffness * (fence.high_y_m - p.y)),
    ]


def speed_row(velocity_m_s: Vec2, top_speed_m_s: float, jerk_m_s3: float) -> HalfPlane:
    """Return the half-plane that lets the speed approach its limit only slowly. DEVIATION D13.

    Just below the limit the acceleration is in proportion to what is left of the speed. Farther
    below it, the acceleration is at most ``sqrt(2 j left)``, which a constant jerk j reduces to
    zero exactly when the limit is reached. Attitude follows late, so a vehicle that may accelerate
    as strongly as it can until shortly before the limit exceeds it.

    Args:
        velocity_m_s: horizontal velocity of this vehicle, not zero.
        top_speed_m_s: the limit.
        jerk_m_s3: j; infinite for a vehicle that may accelerate as strongly as it can.
    """
    speed = length_xy(velocity_m_s)
    backwards = Vec2(-velocity_m_s.x / speed, -velocity_m_s.y / speed)

    left_m_s = top_speed_m_s - speed
    largest_m_s2 = SPEED_GAIN_1_S * left_m_s
    if left_m_s > 0.0:
        largest_m_s2 = min(largest_m_s2, math.sqrt(2.0 * jerk_m_s3 * left_m_s))
    return HalfPlane(backwards, -largest_m_s2)


def compensated(row: HalfPlane, compensation_m_s2: Vec2) -> HalfPlane:
    """Return the row for the thrust that includes the compensation.

    The law's rows constrain the acceleration, but the thrust that is projected also compensates
    drag and disturbance.

    Args:
        row: row for the acceleration.
        compensation_m_s2: horizontal part of the thrust against drag and disturbance.
    """
    return HalfPlane(row.normal, row.bound_m_s2 + dot_xy(row.normal, compensation_m_s2))


def can_bind(row: HalfPlane, radius_m_s2: float) -> bool:
    """Whether some thrust of the disc violates the row.

    Args:
        row: half-plane.
        radius_m_s2: radius of the disc of possible thrusts.
    """
    return row.bound_m_s2 > -radius_m_s2 * length_xy(row.normal)


def faded(row: HalfPlane, thrust_m_s2: Vec2, strength: float) -> HalfPlane:
    """Return the row, weakened towards one that the baseline satisfies. DEVIATION D15.

    Args:
        row: half-plane.
        thrust_m_s2: thrust of the baseline.
        strength: 0: the baseline satisfies the row exactly; 1: the row is unchanged.
    """
    if strength >= 1.0:
        return row

    baseline_m_s2 = dot_xy(row.normal, thrust_m_s2)
    bound_m_s2 = baseline_m_s2 + strength * (row.bound_m_s2 - baseline_m_s2)
    return HalfPlane(row.normal, bound_m_s2)
