"""Half-planes, and the points where their edges meet each other or a circle about the origin."""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.vectors import Vec2, length_xy

EXACT = 1e-13  # rounding error of one expression, relative to its terms


class HalfPlane(NamedTuple):
    """All u with ``normal . u >= bound``."""

    normal: Vec2
    bound_m_s2: float


def unit_row(row: HalfPlane) -> HalfPlane:
    """Return the same half-plane with a normal of unit length.

    Args:
        row: half-plane with a normal that is not zero.
    """
    normal, bound = row
    length = length_xy(normal)
    return HalfPlane(Vec2(normal.x / length, normal.y / length), bound / length)


def scaled_row(row: HalfPlane, factor: float) -> HalfPlane:
    """Return the same half-plane with both sides multiplied by a factor.

    If the bound is lowered by a slack, the edge moves by the slack divided by the factor.

    Args:
        row: half-plane.
        factor: factor of normal and bound, greater than 0.
    """
    normal, bound = row
    return HalfPlane(Vec2(factor * normal.x, factor * normal.y), factor * bound)


def in_disc(u: Vec2, radius: float) -> bool:
    """Whether a point lies in the disc, up to rounding.

    Args:
        u: point.
        radius: radius of the disc about the origin.
    """
    limit = radius * (1.0 + 1e-12) + 1e-12
    return u.x * u.x + u.y * u.y <= limit * limit


def into_disc(u: Vec2, radius: float) -> Vec2:
    """Return the vector, shortened to the radius if it is longer.

    Args:
        u: vector.
        radius: largest length of the result, at least 0.
    """
    size = length_xy(u)
    if size <= radius:
        return u

    share = radius / max(size, 1e-12)
    return Vec2(share * u.x, share * u.y)


def largest_violation(u: Vec2, rows: list[HalfPlane]) -> float:
    """Return by how much a point violates its most violated row; negative if none is violated.

    Args:
        u: point.
        rows: half-planes with normals of any length.
    """
    largest = -math.inf
    for normal, bound in rows:
        largest = max(largest, bound - normal.x * u.x - normal.y * u.y)
    return largest


def foot(u: Vec2, row: HalfPlane) -> Vec2:
    """Return the point of a half-plane that is nearest to another point.

    Args:
        u: the other point.
        row: half-plane with a normal of unit length.
    """
    normal, bound = row
    missing = max(0.0, bound - normal.x * u.x - normal.y * u.y)
    return Vec2(u.x + missing * normal.x, u.y + missing * normal.y)


def on_circle(row: HalfPlane, radius: float, side: float) -> Vec2:
    """Return one of the two points where the edge of a half-plane meets the circle.

    If edge and circle do not meet, the result is the edge's nearest point to the origin.

    Args:
        row: half-plane with a normal of unit length.
        radius: radius of the circle about the origin.
        side: +1 or -1, to choose one of the two points.
    """
    normal, bound = row
    half = side * math.sqrt(max(0.0, radius * radius - bound * bound))
    return Vec2(bound * normal.x - half * normal.y, bound * normal.y + half * normal.x)


def corner(one: HalfPlane, two: HalfPlane) -> Vec2:
    """Return the point where the edges of two half-planes meet; NaN if they are parallel.

    Args:
        one, two: half-planes with normals of any length.
    """
    (n_x, n_y), b = one
    (m_x, m_y), c = two
    det = n_x * m_y - n_y * m_x
    if abs(det) <= EXACT:
        return Vec2(math.nan, math.nan)

    return Vec2((b * m_y - c * n_y) / det, (n_x * c - m_x * b) / det)


def difference(one: HalfPlane, two: HalfPlane) -> HalfPlane:
    """Return the half-plane whose edge holds the points that violate both rows by the same amount.

    Args:
        one, two: half-planes with normals of any length.
    """
    normal = Vec2(one.normal.x - two.normal.x, one.normal.y - two.normal.y)
    return HalfPlane(normal, one.bound_m_s2 - two.bound_m_s2)
