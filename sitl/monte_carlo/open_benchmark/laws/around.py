"""What the laws share: the bodies around a vehicle, the thrust for a velocity, and half-planes.

A row is a half-plane of allowed velocities, accelerations or positions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from onboard.avoidance.own_law import LawInputs
from onboard.avoidance.params import Capsule
from onboard.types import Thrust
from onboard.vectors import Vec2, dot_xy, length_xy

SHARE_OF_PAIR = 0.5  # share of a correction that each vehicle of a cooperating pair makes
_GAIN_1_S = 4.0  # a velocity error times this is an acceleration
_STUCK_M_S = 0.12  # a slower vehicle that is blocked turns to the right
_BLOCKED_FRAC = 1.3  # as a multiple of the distance to keep: closer bodies ahead block
_MIN_DISTANCE_M = 1e-6  # smaller distances are raised to this one, to avoid 0
_MIN_BLOCKED_M_S2 = 0.3  # a vehicle whose baseline commands less is at its goal
_AHEAD_COS = 0.2  # cosine of the largest angle between the wanted direction and a body ahead
# rows that cannot all hold give way by the first of these amounts that is enough
_GIVES_WAY = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4)


class Body(NamedTuple):
    """A neighbour, or the nearest point of an obstacle; horizontal, at t + L."""

    e_m: Vec2  # own position minus the body's
    w_m_s: Vec2  # own velocity minus the body's
    d_m: float  # distance to keep
    share: float  # share of a correction that this vehicle makes
    distance_m: float
    unit: Vec2  # direction of e_m


class HalfPlane(NamedTuple):
    """All points u with ``normal . u >= bound``; the normal has unit length."""

    normal: Vec2
    bound: float


def bodies(inputs: LawInputs) -> list[Body]:
    """Return the nearest neighbours, and the nearest point of each obstacle."""
    found = []
    for near in inputs.neighbours:
        share = 1.0
        if near.is_cooperative:
            share = SHARE_OF_PAIR
        found.append(_body(near.e_m, near.w_m_s, near.d_m, share))

    x, y, _ = inputs.predicted.position_enu_m
    vx, vy, _ = inputs.predicted.velocity_enu_m_s
    for obstacle in inputs.obstacles:
        nearest = _nearest_point(obstacle, x, y)
        keep_m = obstacle.radius_m + inputs.vehicle.spacing.clearance_m
        found.append(_body(Vec2(x - nearest.x, y - nearest.y), Vec2(vx, vy), keep_m, 1.0))
    return found


def _body(e_m: Vec2, w_m_s: Vec2, d_m: float, share: float) -> Body:
    distance_m = max(length_xy(e_m), _MIN_DISTANCE_M)
    unit = Vec2(e_m.x / distance_m, e_m.y / distance_m)
    return Body(e_m=e_m, w_m_s=w_m_s, d_m=d_m, share=share, distance_m=distance_m, unit=unit)


def _nearest_point(obstacle: Capsule, x: float, y: float) -> Vec2:
    """Return the point of an obstacle's axis that is nearest to (x, y)."""
    begin, end = obstacle.begin_enu_m, obstacle.end_enu_m
    along = Vec2(end.x - begin.x, end.y - begin.y)
    length_squared_m2 = max(dot_xy(along, along), 1e-12)  # a pillar has length 0
    share = dot_xy(Vec2(x - begin.x, y - begin.y), along) / length_squared_m2
    share = min(1.0, max(0.0, share))
    return Vec2(begin.x + share * along.x, begin.y + share * along.y)


def own_velocity(inputs: LawInputs) -> Vec2:
    """Return this vehicle's horizontal velocity at t + L."""
    x_m_s, y_m_s, _ = inputs.predicted.velocity_enu_m_s
    return Vec2(x_m_s, y_m_s)


def preferred_velocity(inputs: LawInputs, around: Sequence[Body] = ()) -> Vec2:
    """Return the velocity that the baseline steers for, within the top speed.

    It is turned 60 degrees to the right while the vehicle stands still before one of the bodies.
    Otherwise two vehicles would stand face to face forever.

    Args:
        inputs: inputs of the law.
        around: bodies before which the vehicle turns; empty if the law has its own rule for that.
    """
    velocity = own_velocity(inputs)
    x_m_s2, y_m_s2, _ = inputs.baseline.thrust_enu_m_s2
    wanted_m_s2 = Vec2(x_m_s2, y_m_s2)
    size_m_s2 = length_xy(wanted_m_s2)
    is_stuck = length_xy(velocity) < _STUCK_M_S and size_m_s2 > _MIN_BLOCKED_M_S2
    for body in around:
        is_blocking = body.distance_m < _BLOCKED_FRAC * body.d_m
        is_ahead = -dot_xy(body.unit, wanted_m_s2) > _AHEAD_COS * size_m_s2
        if is_blocking and is_ahead and is_stuck:
            wanted_m_s2 = turned_right(wanted_m_s2, math.radians(60.0))
            break

    preferred = Vec2(velocity.x + wanted_m_s2.x / _GAIN_1_S, velocity.y + wanted_m_s2.y / _GAIN_1_S)
    return shortened(preferred, inputs.vehicle.top_speed_m_s)


def steered(inputs: LawInputs, velocity_m_s: Vec2) -> Thrust:
    """Return the thrust that steers for a velocity, within the vehicle's limits."""
    velocity = own_velocity(inputs)
    x_m_s2 = _GAIN_1_S * (velocity_m_s.x - velocity.x)
    y_m_s2 = _GAIN_1_S * (velocity_m_s.y - velocity.y)
    return inputs.limited(x_m_s2, y_m_s2)


def turned_right(vector: Vec2, angle_rad: float) -> Vec2:
    """Return a vector turned clockwise."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    return Vec2(cos * vector.x + sin * vector.y, cos * vector.y - sin * vector.x)


def shortened(vector: Vec2, longest: float) -> Vec2:
    """Return a vector, shortened if it is longer."""
    factor = min(1.0, longest / max(length_xy(vector), 1e-12))  # avoids a division by 0
    return Vec2(factor * vector.x, factor * vector.y)


def nearest(point: Vec2, rows: Sequence[HalfPlane]) -> Vec2:
    """Return the nearest point to a point that lies in all half-planes.

    If they have no point in common, each of them gives way by the same amount.
    """
    found = _nearest(point, rows)
    for amount in _GIVES_WAY:
        if found is not None:
            return found
        found = _nearest(point, [HalfPlane(row.normal, row.bound - amount) for row in rows])
    if found is None:
        return point
    return found


def _nearest(point: Vec2, rows: Sequence[HalfPlane]) -> Vec2 | None:
    """Return the nearest point in all half-planes; None if they have none in common.

    The rows are added one after the other. If the point so far violates the next row, the new point
    lies on the edge of that row, between the edges of the rows before it.
    """
    found = point
    for index, (normal, bound) in enumerate(rows):
        if dot_xy(normal, found) >= bound - 1e-9:
            continue

        # the point of the edge that is nearest to the given point
        missing = bound - dot_xy(normal, point)
        foot = Vec2(point.x + missing * normal.x, point.y + missing * normal.y)
        # the part of the edge that the earlier rows allow, as distances along the edge from the
        # foot
        along = Vec2(-normal.y, normal.x)
        low, high = -math.inf, math.inf
        for other, other_bound in rows[:index]:
            slope = dot_xy(other, along)
            gap = other_bound - dot_xy(other, foot)
            if abs(slope) < 1e-9:  # the edges are parallel
                if gap > 1e-9:
                    return None
            elif slope > 0.0:
                low = max(low, gap / slope)
            else:
                high = min(high, gap / slope)
        if low > high:
            return None
        nearest_to_foot = min(max(0.0, low), high)
        found = Vec2(foot.x + nearest_to_foot * along.x, foot.y + nearest_to_foot * along.y)
    return found
