"""Pairs of this vehicle with a neighbour or an obstacle: geometry, distance to keep, and crowd.

Everything is horizontal and at the time t + L, when a command given now takes effect. Heights only
decide how much of a distance counts (:mod:`onboard.avoidance.heights`). README.md beside this file
lists the lines of the algorithm (P3, D) and the deviations from the paper (D5).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from onboard.avoidance.heights import Climb, is_ahead, share_of, sink_limit_m_s
from onboard.avoidance.params import DIRECTION_INTENT, Capsule, LawParams, Spacing
from onboard.avoidance.prediction import LONGEST_LEAD_S, Received, known_std, receive
from onboard.types import Neighbour
from onboard.vectors import Vec2, dot_xy, length_xy

MAX_OBSTACLES = 6  # number of obstacles that count: the nearest
LARGEST_MARGIN_M = 5.0  # a larger margin is reduced to this
LARGEST_RADIUS_M = 5.0  # a larger circle of a person is reduced to this
COINCIDENT_M = 1e-6  # nearer vehicles count as at one point: avoids a division by zero
_STANDING_M_S = 1e-6  # a slower relative velocity has no direction
SETTLED_M_S = 0.1  # a vehicle that intends to move no faster than this is not part of a crowd

# A climb or descent waits while the horizontal distance from a neighbour above or below is less
# than _WAITS_FRAC of the distance to keep. At _GOES_FRAC and above, the climb has its full speed.
_WAITS_FRAC = 0.5
_GOES_FRAC = 0.9

# In a descent without poses, distances are less certain. The vehicle counts as above a neighbour if
# their horizontal distance is less than _ABOVE_FRAC of the distance to keep, and as beside it at
# _BESIDE_FRAC or more. Between these two, the limit of the sinking speed grows by _BESIDE_M_S.
_ABOVE_FRAC = 0.7
_BESIDE_FRAC = 1.0
_BESIDE_M_S = 1.0
_MIN_DISTANCE_M = 0.01  # rows are divided by the distance to keep


class Own(NamedTuple):
    """This vehicle at t + L; everything except the climb and thrust_z_m_s2 is horizontal."""

    position_m: Vec2
    velocity_m_s: Vec2
    velocity_std_m_s: float
    intent_m_s: Vec2  # velocity straight to the goal
    margin_2_m2: float  # its own part of the square of the accuracy margin
    thrust_m_s2: Vec2  # F_d / m of the baseline with the compensation, within the radius
    thrust_z_m_s2: float  # vertical thrust, which the law does not change
    compensation_m_s2: Vec2  # added to the command against drag and disturbance
    radius_m_s2: float  # largest horizontal thrust
    climb: Climb  # its vertical motion
    has_motion: bool  # whether the baseline's thrust and our own motion are finite
    is_usable: bool  # whether these and the compensation are finite


class NeighbourPair(NamedTuple):
    """This vehicle and one neighbour; differences are own minus neighbour's."""

    e: Vec2  # position [m]
    w: Vec2  # velocity [m/s]
    command_m_s2: Vec2  # u_j, the neighbour's commanded acceleration
    intent_m_s: Vec2  # relative velocity that decides the side of a turn
    d_m: float  # distance to keep
    distance_2_m2: float  # square of the distance
    crowd_count: float  # as the neighbour publishes it; 0 if unknown
    # whether it counts towards this vehicle's crowd: it is nearer than 2 d and intends to move
    is_near: bool
    is_cooperative: bool
    table_index: int  # of the neighbour, for the record


class Pairs(NamedTuple):
    """Pairs with the nearest neighbours, and two values about all neighbours."""

    pairs: list[NeighbourPair]  # nearest first
    crowd_count: float  # number of near neighbours
    # False: a neighbour's motion is not finite, or a neighbour coincides with this vehicle
    is_sound: bool


class Surface(NamedTuple):
    """This vehicle and the nearest point of one obstacle."""

    e: Vec2  # from that point to the vehicle [m]
    w: Vec2  # velocity relative to that point [m/s], which moves along a straight edge
    d_m: float  # distance to keep from that point
    gap_m: float  # distance from the outline


def nearest_pairs(own: Own, neighbours: Sequence[Neighbour], params: LawParams) -> Pairs:
    """Return the pairs with the nearest neighbours within range, and the crowd (lines P3 and D).

    Args:
        own: this vehicle at t + L.
        neighbours: all neighbours as received, in any order.
    Properties: independent of the neighbours' order.
    """
    spacing = params.spacing
    range_2_m2 = spacing.range_m * spacing.range_m
    lead_s = params.lead_time_s
    others = [receive(neighbour, lead_s) for neighbour in neighbours]

    in_range: list[int] = []
    is_sound = True
    for k in range(len(others)):
        other = others[k]
        e = Vec2(own.position_m.x - other.position_m.x, own.position_m.y - other.position_m.y)
        if not other.is_usable:
            is_sound = False
        elif dot_xy(e, e) <= range_2_m2:
            in_range.append(k)

    # share of the distance to keep that counts; 0 if the heights differ enough
    shares = [share_of(own.climb, neighbours[k], lead_s, spacing) for k in in_range]

    pairs: list[NeighbourPair] = []
    crowd_count = 0.0
    for k, share in zip(in_range, shares):  # noqa: B905  numba compiles no keywords of zip
        if share <= 0.0:
            continue

        pair = _pair(own, neighbours[k], others[k], share, params)
        pairs.append(pair)
        if pair.is_near:
            crowd_count += 1.0
        if pair.distance_2_m2 < COINCIDENT_M * COINCIDENT_M:
            is_sound = False

    order = ascending([pair.distance_2_m2 for pair in pairs])
    nearest = [pairs[k] for k in order[: spacing.max_neighbours]]
    return Pairs(nearest, crowd_count, is_sound)


def _pair(
    own: Own, neighbour: Neighbour, other: Received, share: float, params: LawParams
) -> NeighbourPair:
    """Return the pair with one neighbour; ``share`` of the distance to keep counts."""
    e = Vec2(own.position_m.x - other.position_m.x, own.position_m.y - other.position_m.y)
    w = Vec2(own.velocity_m_s.x - other.velocity_m_s.x, own.velocity_m_s.y - other.velocity_m_s.y)
    distance_2_m2 = dot_xy(e, e)

    whole_m = design_distance(own.margin_2_m2, neighbour, params.spacing)
    d_m = max(share * whole_m, _MIN_DISTANCE_M)

    intent_m_s = w
    is_settled = False
    if params.policies.direction == DIRECTION_INTENT and other.has_intent:
        theirs = other.intent_m_s
        intent_m_s = Vec2(own.intent_m_s.x - theirs.x, own.intent_m_s.y - theirs.y)
        is_slow = dot_xy(theirs, theirs) <= SETTLED_M_S * SETTLED_M_S
        is_settled = is_slow and neighbour.is_cooperative

    crowd_count = 0.0
    if math.isfinite(neighbour.crowd_count):
        crowd_count = neighbour.crowd_count

    return NeighbourPair(
        e=separated(e, w),
        w=w,
        command_m_s2=other.command_m_s2,
        intent_m_s=intent_m_s,
        d_m=d_m,
        distance_2_m2=distance_2_m2,
        crowd_count=crowd_count,
        is_near=distance_2_m2 < 4.0 * d_m * d_m and not is_settled,
        is_cooperative=neighbour.is_cooperative,
        table_index=neighbour.table_index,
    )


def climb_share(own: Own, neighbours: Sequence[Neighbour], params: LawParams) -> float:
    """Return the share of its speed, from 0 to 1, that a climb or descent keeps. DEVIATION D16.

    The climb waits until the neighbours above or below are out of the way.

    Args:
        own: this vehicle at t + L.
        neighbours: all neighbours as received, in any order.
    """
    spacing = params.spacing
    lead_s = params.lead_time_s
    if math.isinf(spacing.vertical_separation_m):
        return 1.0

    least_share = 1.0
    for neighbour in neighbours:
        distance_share = share_of(own.climb, neighbour, lead_s, spacing)
        if distance_share <= 0.0 or not is_ahead(own.climb, neighbour, lead_s, spacing):
            continue

        other_m = receive(neighbour, lead_s).position_m
        away_m = length_xy(Vec2(own.position_m.x - other_m.x, own.position_m.y - other_m.y))
        d_m = distance_share * design_distance(own.margin_2_m2, neighbour, spacing)
        speed_share = max(away_m / d_m - _WAITS_FRAC, 0.0) / (_GOES_FRAC - _WAITS_FRAC)
        least_share = min(least_share, speed_share)
    return least_share


def sink_limit(own: Own, neighbours: Sequence[Neighbour], params: LawParams) -> float:
    """Return how fast this vehicle may sink without poses [m/s]; infinite if nothing limits it.

    Beside a neighbour this vehicle may sink freely. Above a neighbour, its speed must allow it to
    stop before it reaches the neighbour.

    Args:
        own: this vehicle at t + L.
        neighbours: all neighbours as received, in any order.
    """
    spacing = params.spacing
    lead_s = params.lead_time_s
    if math.isinf(spacing.vertical_separation_m):
        return math.inf

    least_m_s = math.inf
    for neighbour in neighbours:
        other_m = receive(neighbour, lead_s).position_m
        away_m = length_xy(Vec2(own.position_m.x - other_m.x, own.position_m.y - other_m.y))
        d_m = design_distance(own.margin_2_m2, neighbour, spacing)
        beside_share = (away_m / d_m - _ABOVE_FRAC) / (_BESIDE_FRAC - _ABOVE_FRAC)
        if not beside_share < 1.0:  # beside the neighbour, or NaN
            continue

        above_m_s = sink_limit_m_s(own.climb, neighbour, lead_s, spacing)
        least_m_s = min(least_m_s, above_m_s + _BESIDE_M_S * max(beside_share, 0.0))
    return least_m_s


def design_distance(own_margin_2_m2: float, neighbour: Neighbour, spacing: Spacing) -> float:
    """Return the distance d [m] to keep from a neighbour. DEVIATION D5, D12.

    The distance grows if the two vehicles' estimates are less accurate than with a mocap, and if
    one of them has a long lag. Around a person, it is measured from the person's circle
    (``radius_m``).

    Args:
        own_margin_2_m2: :func:`margin_2` of this vehicle.
        neighbour: the neighbour; its published standard deviations and lead time are used.
        spacing: distances and margins.
    Properties: the same for both vehicles of a pair that cooperate.
    """
    margin_m = spacing.margin_m

    # both vehicles of a pair keep the distance of the one with the longer lag
    if neighbour.is_cooperative and neighbour.lead_time_s > spacing.margin_lag_s:
        longer_s = min(neighbour.lead_time_s, LONGEST_LEAD_S) - spacing.margin_lag_s
        margin_m += spacing.lag_margin_m_s * longer_s

    if spacing.sigma_position > 0.0:
        theirs = margin_2(neighbour.position_std_m, neighbour.velocity_std_m_s, spacing)
        accuracy_m = spacing.margin_floor_m + math.sqrt(own_margin_2_m2 + theirs)
        margin_m = min(max(margin_m, accuracy_m), LARGEST_MARGIN_M)

    if not neighbour.is_cooperative:
        margin_m += spacing.uncooperative_margin_m

    radius_m = 0.0
    if math.isfinite(neighbour.radius_m):
        radius_m = min(max(neighbour.radius_m, 0.0), LARGEST_RADIUS_M)

    return spacing.safety_distance_m + margin_m + radius_m


def margin_2(position_std_m: float, velocity_std_m_s: float, spacing: Spacing) -> float:
    """Return one vehicle's part of the square of the accuracy margin [m^2].

    The parts of two vehicles add.

    Args:
        position_std_m, velocity_std_m_s: standard deviations per axis, as published.
        spacing: holds the weights sigma_position and sigma_velocity_s.
    """
    by_position = spacing.sigma_position * known_std(position_std_m)
    by_velocity = spacing.sigma_velocity_s * known_std(velocity_std_m_s)
    return by_position * by_position + by_velocity * by_velocity


def nearest_surfaces(own: Own, obstacles: Sequence[Capsule], clearance_m: float) -> list[Surface]:
    """Return the nearest points of the MAX_OBSTACLES nearest obstacles, nearest first.

    DEVIATION D13.

    Args:
        own: this vehicle at t + L.
        obstacles: capsules in fleet ENU.
        clearance_m: distance that the vehicle's centre keeps from an outline.
    """
    surfaces = [
        surface_of(capsule, own.position_m, own.velocity_m_s, clearance_m)
        for capsule in obstacles
        if capsule.area == 0  # edges of areas have rows of their own: fence_edges.py
    ]
    order = ascending([surface.gap_m for surface in surfaces])
    return [surfaces[k] for k in order[:MAX_OBSTACLES]]


def surface_of(
    capsule: Capsule, position_m: Vec2, velocity_m_s: Vec2, clearance_m: float
) -> Surface:
    """Return the nearest point of one obstacle.

    Beside the segment the nearest point moves along with the vehicle. So only the velocity towards
    this point counts.

    Args:
        capsule: the obstacle, in fleet ENU.
        position_m, velocity_m_s: horizontal position and velocity of this vehicle at t + L.
        clearance_m: distance that the vehicle's centre keeps from the outline.
    """
    begin = capsule.begin_enu_m
    end = capsule.end_enu_m
    segment = Vec2(end.x - begin.x, end.y - begin.y)
    offset = Vec2(position_m.x - begin.x, position_m.y - begin.y)

    # where the nearest point lies on the segment, from 0 to 1
    squared_length_m2 = dot_xy(segment, segment)
    divisor = squared_length_m2 if squared_length_m2 > 0.0 else 1.0  # a circle's segment is a point
    along = dot_xy(offset, segment) / divisor
    share = min(max(along, 0.0), 1.0)

    e = Vec2(offset.x - share * segment.x, offset.y - share * segment.y)
    gap_m = length_xy(e) - capsule.radius_m
    e = separated(e, velocity_m_s)

    w = velocity_m_s
    if 0.0 < along < 1.0:
        towards = dot_xy(e, w) / dot_xy(e, e)
        w = Vec2(towards * e.x, towards * e.y)

    return Surface(e, w, capsule.radius_m + clearance_m, gap_m)


def separated(e: Vec2, w: Vec2) -> Vec2:
    """Return e, or for coincident vehicles a tiny vector along the relative velocity.

    Args:
        e, w: relative position and velocity [m, m/s].
    """
    if dot_xy(e, e) >= COINCIDENT_M * COINCIDENT_M:
        return e

    speed_m_s = length_xy(w)
    if speed_m_s > _STANDING_M_S:
        return Vec2(COINCIDENT_M * (w.x / speed_m_s), COINCIDENT_M * (w.y / speed_m_s))
    return Vec2(COINCIDENT_M, 0.0)


def ascending(keys: list[float]) -> list[int]:
    """Return the indexes that sort numbers in ascending order; equal numbers keep their order.

    This is an insertion sort, because numba takes seconds to compile ``sorted``.

    Args:
        keys: numbers, none of them NaN.
    """
    order: list[int] = []
    for k in range(len(keys)):
        order.append(k)
        slot = k
        while slot > 0 and keys[order[slot - 1]] > keys[k]:
            order[slot] = order[slot - 1]
            slot -= 1
        order[slot] = k
    return order
