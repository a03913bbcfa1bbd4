"""Smallest common slack of half-planes that no point of a disc satisfies together.

The slack of a point u is its largest violation, ``max(b - n . u)`` over the rows. It is convex and
piecewise linear in u. A point of the plane has two unknowns, so its minimum over the disc is fixed
by two conditions:

    inside the disc, three rows are violated equally (two equations);
    on the circle, two rows are violated equally (one equation, and the circle);
    on the circle, only one row counts, and the point lies in the direction of its normal.

All of these points are tried. So is the origin, which satisfies all rows if no bound is positive.
Only the rows that matter take part: the most violated row is added, one at a time, until no other
row is violated by more.
"""

from __future__ import annotations

import math

from onboard.avoidance.half_planes import (
    EXACT,
    HalfPlane,
    corner,
    difference,
    in_disc,
    largest_violation,
    on_circle,
)
from onboard.vectors import Vec2, length_xy

_PARALLEL = 1e-12  # two normals whose difference is shorter than this are the same


def least_slack(rows: list[HalfPlane], radius: float) -> tuple[float, Vec2]:
    """Return the smallest common slack of all rows over the disc, and the point that has it.

    The slack is ``min t >= 0`` such that a point u of the disc has ``n . u >= b - t`` for all rows.

    Args:
        rows: at least one half-plane, with normals of any length.
        radius: radius of the disc about the origin.
    """
    scale = 0.0
    first = 0  # index of the row with the largest bound
    for k in range(len(rows)):
        scale = max(scale, abs(rows[k].bound_m_s2))
        if rows[k].bound_m_s2 > rows[first].bound_m_s2:
            first = k

    taken = [rows[first]]
    while True:
        slack, u = least_slack_of(taken, radius)

        worst = -1
        most = slack + EXACT * (1.0 + scale)
        for k in range(len(rows)):
            missing = rows[k].bound_m_s2 - rows[k].normal.x * u.x - rows[k].normal.y * u.y
            if missing > most:
                worst = k
                most = missing

        if worst < 0 or rows[worst] in taken:
            return max(0.0, slack), u
        taken.append(rows[worst])


def least_slack_of(rows: list[HalfPlane], radius: float) -> tuple[float, Vec2]:
    """Return the smallest common slack of a few rows over the disc, and its point.

    Args:
        rows: half-planes with normals of any length.
        radius: radius of the disc about the origin.
    """
    best = math.inf
    u = Vec2(0.0, 0.0)
    for point in candidates(rows, radius):
        if not in_disc(point, radius):
            continue
        slack = largest_violation(point, rows)
        if slack < best:
            best = slack
            u = point
    return best, u


def candidates(rows: list[HalfPlane], radius: float) -> list[Vec2]:
    """Return the points that may have the smallest common slack; NaN if rows are parallel.

    Args:
        rows: half-planes with normals of any length.
        radius: radius of the disc about the origin.
    """
    points = [Vec2(0.0, 0.0)]
    for i in range(len(rows)):
        # on the circle, in the direction of one row
        normal = rows[i].normal
        share = radius / max(length_xy(normal), 1e-300)
        points.append(Vec2(share * normal.x, share * normal.y))

        for j in range(i):
            equal = difference(rows[j], rows[i])
            size = length_xy(equal.normal)
            if size <= _PARALLEL:
                continue

            # on the circle, where two rows are violated equally
            unit_normal = Vec2(equal.normal.x / size, equal.normal.y / size)
            unit = HalfPlane(unit_normal, equal.bound_m_s2 / size)
            points.append(on_circle(unit, radius, 1.0))
            points.append(on_circle(unit, radius, -1.0))

            # where three rows are violated equally
            for k in range(j):
                points.append(corner(equal, difference(rows[k], rows[i])))
    return points
