"""Edges of the areas that a vehicle must stay inside or outside, as rows (half-planes) of the law.

With the distance h from the edge, and the unit vector n from its nearest point into the allowed
space, the row is the same as for a wall of the fence:

    n . u >= -(k_1 + k_2) n . v - k_1 k_2 h.

Each near edge of an area has its own row, even in a concave area. While the vehicle turns about a
corner, its distance grows faster than n . u says; the row ignores this. Inside a circle of radius
r, the vehicle's tangential velocity v_t makes the distance shrink with v_t^2 / r; the row includes
this term. DEVIATION D13 (README.md beside this file).

If the vehicle is on the forbidden side of an area, only the nearest edge has a row, which leads the
vehicle back. The nearest edge alone shows on which side the vehicle is. If the nearest point lies
between the ends of this edge, the side of its line decides. If the nearest point is a corner, the
corner decides: a corner that points away from the allowed space is never the nearest point for a
vehicle on the allowed side.

A goal may lie behind a forbidden area, or behind a corner that points inwards. The edges there have
rotation rows, like obstacles.

Edges that are too far away to bind are left out first, by a quick comparison with the box around
each edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from onboard.avoidance.constraints import (
    VIOLATED_M_S2,
    Constraint,
    compensated,
    hard_constraint,
    obstacle_rotation_row,
)
from onboard.avoidance.half_planes import HalfPlane
from onboard.avoidance.interface import NOT_A_VEHICLE
from onboard.avoidance.pairs import Own, Surface, ascending, separated
from onboard.avoidance.params import ROTATION_NEVER, Capsule, Gains, LawParams
from onboard.vectors import Vec2, cross_xy, dot_xy, length_xy

MAX_EDGES = 8  # number of edges that count: the nearest
MIN_REACH_M = 2.0  # an edge leads a vehicle back that is up to this distance outside
PIVOT_M = 0.5  # least distance of the vehicle from the point about which it turns
_ON_EDGE_M = 1e-6  # a vehicle nearer to an edge than this is on it; avoids a division by zero


class Edge(NamedTuple):
    """This vehicle and the nearest point of one edge."""

    area: int  # number of the area that the edge belongs to
    e: Vec2  # from the nearest point to the vehicle [m], never zero
    distance_m: float  # length of e
    # whether the vehicle is on the allowed side; valid if this is the area's nearest edge
    is_allowed: bool
    keep_m: float  # distance to keep from the edge
    curvature_1_m: float  # 1 / radius of a circle that the vehicle flies inside; otherwise 0
    is_turned_about: bool  # whether the edge may have a rotation row
    # whether the nearest point is between the edge's ends, and so moves along with the vehicle
    is_flat: bool


def edge_constraints(own: Own, still: Sequence[Capsule], params: LawParams) -> list[Constraint]:
    """Return the constraints of the edges that are near enough to bind, nearest first.

    Args:
        own: this vehicle at t + L.
        still: static things: edges, and obstacles, which are ignored here.
        params: numbers of this vehicle's law.
    """
    reach = reach_m(own, params.gains)
    x = own.position_m.x
    y = own.position_m.y
    west = x - reach
    east = x + reach
    south = y - reach
    north = y + reach
    lowest_m = min(own.climb.height_m, own.climb.ahead_m)
    highest_m = max(own.climb.height_m, own.climb.ahead_m)

    edges = [
        edge_of(capsule, own)
        for capsule in still
        if capsule.west_m <= east
        and capsule.east_m >= west
        and capsule.south_m <= north
        and capsule.north_m >= south
        and capsule.area > 0
        and capsule.low_m <= highest_m
        and capsule.high_m >= lowest_m
    ]
    near = [edge for edge in edges if edge.distance_m - edge.keep_m <= reach]
    ordered = [near[index] for index in ascending([edge.distance_m for edge in near])]

    constraints: list[Constraint] = []
    for rank in range(min(len(ordered), MAX_EDGES)):
        nearest = nearest_of_area(ordered, rank)
        is_allowed = ordered[nearest].is_allowed
        # on the forbidden side only the nearest edge of an area has a row
        if is_allowed or nearest == rank:
            constraints.append(edge_constraint(own, ordered[rank], is_allowed, params))
    return constraints


def reach_m(own: Own, gains: Gains) -> float:
    """Return the distance [m], beyond the distance to keep, within which an edge counts.

    On the allowed side, rows of edges further away cannot change the thrust.

    Args:
        own: this vehicle at t + L.
        gains: holds the kappas for static things.
    """
    rate = gains.static_kappa_1_1_s + gains.kappa_2_1_s
    stiffness = gains.static_kappa_1_1_s * gains.kappa_2_1_s
    most_m_s2 = own.radius_m_s2 + length_xy(own.compensation_m_s2)
    from_inside_m = (most_m_s2 + rate * length_xy(own.velocity_m_s)) / stiffness
    return max(from_inside_m, MIN_REACH_M)


def nearest_of_area(edges: list[Edge], rank: int) -> int:
    """Return the index of the nearest edge of the same area.

    Args:
        edges: edges that are near, nearest first.
        rank: index of one of these edges.
    """
    area = edges[rank].area
    for nearer in range(rank):
        if edges[nearer].area == area:
            return nearer
    return rank


def edge_of(capsule: Capsule, own: Own) -> Edge:
    """Return the nearest point of one edge.

    Args:
        capsule: the edge, in fleet ENU.
        own: this vehicle at t + L.
    """
    begin = capsule.begin_enu_m
    end = capsule.end_enu_m
    segment = Vec2(end.x - begin.x, end.y - begin.y)
    offset = Vec2(own.position_m.x - begin.x, own.position_m.y - begin.y)
    squared_length_m2 = dot_xy(segment, segment)
    if squared_length_m2 <= 0.0:
        return round_edge(capsule, offset, own.velocity_m_s)

    along = dot_xy(offset, segment) / squared_length_m2
    share = min(max(along, 0.0), 1.0)
    e = Vec2(offset.x - share * segment.x, offset.y - share * segment.y)

    is_allowed = cross_xy(segment, offset) >= 0.0
    if along < 0.0:
        is_allowed = capsule.is_begin_inwards
    elif along > 1.0:
        is_allowed = capsule.is_end_inwards

    distance_m = length_xy(e)
    if distance_m < _ON_EDGE_M:  # e is then along the edge's normal
        length = length_xy(segment)
        e = Vec2(-_ON_EDGE_M * segment.y / length, _ON_EDGE_M * segment.x / length)
        is_allowed = True
    return Edge(
        area=capsule.area,
        e=e,
        distance_m=max(distance_m, _ON_EDGE_M),
        is_allowed=is_allowed,
        keep_m=capsule.keep_m,
        curvature_1_m=0.0,
        is_turned_about=capsule.is_turned_about,
        is_flat=0.0 < along < 1.0,
    )


def round_edge(capsule: Capsule, offset: Vec2, velocity_m_s: Vec2) -> Edge:
    """Return the nearest point of a circle.

    Args:
        capsule: the circle.
        offset: vector from its centre to the vehicle [m].
        velocity_m_s: horizontal velocity of the vehicle.
    """
    from_centre = separated(offset, velocity_m_s)
    radius_m = length_xy(from_centre)
    beyond_m = radius_m - capsule.radius_m
    is_outside = beyond_m > 0.0

    distance_m = max(abs(beyond_m), _ON_EDGE_M)
    outwards_m = distance_m if is_outside else -distance_m
    e = Vec2(outwards_m * from_centre.x / radius_m, outwards_m * from_centre.y / radius_m)
    return Edge(
        area=capsule.area,
        e=e,
        distance_m=distance_m,
        # a circle has a rotation row if the vehicle must stay out of it
        is_allowed=is_outside == capsule.is_turned_about,
        keep_m=capsule.keep_m,
        curvature_1_m=0.0 if capsule.is_turned_about else 1.0 / radius_m,
        is_turned_about=capsule.is_turned_about,
        is_flat=False,
    )


def edge_constraint(own: Own, edge: Edge, is_allowed: bool, params: LawParams) -> Constraint:
    """Return the distance row of one edge and, if a goal may lie behind it, a rotation row.

    Args:
        own: this vehicle at t + L.
        edge: an edge that is near.
        is_allowed: whether the vehicle is on the allowed side of the edge's area.
        params: numbers of this vehicle's law.
    """
    hard = hard_constraint(own, edge_row(own, edge, is_allowed, params.gains), NOT_A_VEHICLE)
    is_violated = hard.violation_m_s2 > VIOLATED_M_S2
    may_turn = edge.is_turned_about and is_allowed and params.policies.rotation != ROTATION_NEVER
    if not (may_turn and is_violated):
        return hard

    turn = obstacle_rotation_row(pivot_of(own, edge), own.velocity_m_s, own.intent_m_s, params)
    return Constraint(
        row=hard.row,
        turn=compensated(turn, own.compensation_m_s2),
        is_turning=True,
        violation_m_s2=hard.violation_m_s2,
        table_index=NOT_A_VEHICLE,
    )


def pivot_of(own: Own, edge: Edge) -> Surface:
    """Return the point about which a vehicle turns, as the surface of an obstacle.

    The point lies behind the edge, so that a vehicle at the distance to keep is at least PIVOT_M
    from it. The nearer the point, the slower the vehicle turns about it.

    Args:
        own: this vehicle at t + L.
        edge: an edge that is near.
    """
    behind_m = max(PIVOT_M - edge.keep_m, 0.0)
    stretch = (edge.distance_m + behind_m) / edge.distance_m
    e = Vec2(stretch * edge.e.x, stretch * edge.e.y)

    w = own.velocity_m_s
    if edge.is_flat:  # the pivot moves along with the vehicle
        towards = dot_xy(e, w) / dot_xy(e, e)
        w = Vec2(towards * e.x, towards * e.y)
    return Surface(e=e, w=w, d_m=edge.keep_m + behind_m, gap_m=edge.distance_m)


def edge_row(own: Own, edge: Edge, is_allowed: bool, gains: Gains) -> HalfPlane:
    """Return the half-plane that keeps a vehicle on the allowed side of an edge.

    Args:
        own: this vehicle at t + L.
        edge: an edge that is near.
        is_allowed: whether the vehicle is on that side.
        gains: holds the kappas for static things.
    """
    inwards = 1.0 if is_allowed else -1.0
    normal = Vec2(inwards * edge.e.x / edge.distance_m, inwards * edge.e.y / edge.distance_m)
    h_m = inwards * edge.distance_m - edge.keep_m

    v = own.velocity_m_s
    rate = gains.static_kappa_1_1_s + gains.kappa_2_1_s
    stiffness = gains.static_kappa_1_1_s * gains.kappa_2_1_s
    sideways_m_s = cross_xy(normal, v)
    bend_m_s2 = edge.curvature_1_m * sideways_m_s * sideways_m_s
    return HalfPlane(normal, bend_m_s2 - rate * dot_xy(normal, v) - stiffness * h_m)
