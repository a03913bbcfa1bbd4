"""Exact projection of a point of the plane on half-planes and a disc: line Q of README.md.

The paper's (22) is such a projection for two orthogonal half-planes; any number of neighbours gives
any number of half-planes. In the plane the nearest feasible point is one of few: the point itself,
its foot on one edge, the corner of two edges, or a point of the circle. All of them are tried, for
the rows that matter: rows are taken in one by one, the most violated first, until none is violated.
The optimum of some of the rows that satisfies all is the optimum of all. So there are no iterations
to converge and no solver status to interpret.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.avoidance.half_planes import (
    EXACT,
    HalfPlane,
    corner,
    foot,
    in_disc,
    largest_violation,
    on_circle,
    unit_row,
)
from onboard.avoidance.relaxation import least_slack
from onboard.types import LawStatus
from onboard.vectors import Vec2, dot_2, length_2

INACTIVE, SATURATED, RELAXED = (
    int(LawStatus.INACTIVE),
    int(LawStatus.SATURATED),
    int(LawStatus.RELAXED),
)
_TOLERANCE = 1e-10
# two solutions nearer than this (times the bounds) are one, seen through rounding
_ONE_POINT = 1e-4
# of rows that others yield to: they miss their bounds by this share of the others' slack
_FIRMNESS = 1000.0
# of the slack, relative: rounding must not hide the one point that is left
_WIDENINGS = (1e-12, 1e-10, 1e-8, 1e-6)


class Projection(NamedTuple):
    """Result of :func:`project`."""

    point: Vec2
    status: int  # a LawStatus
    slack: float  # by which every hard row had to be relaxed, in the units of the bounds


class Candidate(NamedTuple):
    """A point that may be the nearest feasible one."""

    is_feasible: bool
    point: Vec2
    cost: float  # squared distance from the point that is projected


def project(u: Vec2, hard: list[HalfPlane], soft: list[HalfPlane], radius: float) -> Projection:
    """Return the nearest point that satisfies all hard rows, the disc and as many leading soft rows
    as fit.

    Args:
        u: point to project, finite.
        hard: rows, relaxed by one common slack only where no point satisfies them all.
        soft, radius: as for :func:`fit`.
    Returns:
        The projection. Without a feasible point it satisfies ``n . u >= b - slack`` with the
        smallest slack.
    Properties: rotation-equivariant; homogeneous; independent of the order of the hard rows; a
        point that satisfies everything comes back bit for bit.
    """
    found = fit(u, hard, soft, radius)
    return relaxed(u, hard, radius, largest_bound(hard)) if found.status == RELAXED else found


def fit(u: Vec2, hard: list[HalfPlane], soft: list[HalfPlane], radius: float) -> Projection:
    """Return the projection of :func:`project`, or the point itself as RELAXED where the hard rows
    leave none.

    Args:
        u: point to project, finite.
        hard: rows that must hold.
        soft: rows in order of importance; the last is dropped first.
        radius: of the disc about the origin, at least 0.
    """
    if (
        dot_2(u, u) <= radius * radius * (1.0 + 1e-12)
        and largest_violation(u, hard + soft) <= _TOLERANCE
    ):
        return Projection(u, INACTIVE, 0.0)
    rows = [unit_row(row) for row in hard] + [unit_row(row) for row in soft]
    found = nearest(u, rows, radius)
    if found.is_feasible:
        return Projection(found.point, SATURATED, 0.0)
    least = nearest(u, rows[: len(hard)], radius)
    if not least.is_feasible:
        return Projection(u, RELAXED, 0.0)
    for kept in range(len(soft) - 1, 0, -1):
        found = nearest(u, rows[: len(hard) + kept], radius)
        if found.is_feasible:
            return Projection(found.point, SATURATED, 0.0)
    return Projection(least.point, SATURATED, 0.0)


def relaxed_in_order(
    u: Vec2, yielding: list[HalfPlane], firm: list[HalfPlane], radius: float
) -> Projection:
    """Return the nearest point of the disc for rows that no point satisfies together: the yielding
    rows give way first.

    They get their smallest common slack while a point satisfies the firm ones; where none does, the
    yielding rows are left out and the firm ones get theirs. The point moves continuously from one
    case to the other.

    Args:
        u: point to project.
        yielding: rows that are given up first.
        firm: rows that are implied by the yielding ones, or of another kind.
        radius: of the disc.
    """
    if not nearest(u, [unit_row(row) for row in firm], radius).is_feasible:
        return relaxed(u, firm, radius, largest_bound(firm))
    stiff = [
        HalfPlane(
            Vec2(_FIRMNESS * row.normal.x, _FIRMNESS * row.normal.y), _FIRMNESS * row.bound_m_s2
        )
        for row in firm
    ]
    return relaxed(u, yielding + stiff, radius, max(largest_bound(yielding), largest_bound(firm)))


def largest_bound(rows: list[HalfPlane]) -> float:
    """Return the size of the largest bound, plus one: the scale of rounding.

    Args:
        rows: of any length.
    """
    scale = 1.0
    for row in rows:
        scale = max(scale, 1.0 + abs(row.bound_m_s2))
    return scale


def relaxed(u: Vec2, hard: list[HalfPlane], radius: float, scale: float) -> Projection:
    """Return the nearest point of the disc that satisfies the hard rows up to their smallest common
    slack.

    Args:
        u: point to project.
        hard: rows that no point of the disc satisfies together.
        radius: of the disc.
        scale: size of the bounds.
    """
    slack, point = least_slack(hard, radius)
    for widening in _WIDENINGS:
        widened = slack + widening * scale
        best = nearest(
            u, [unit_row(HalfPlane(row.normal, row.bound_m_s2 - widened)) for row in hard], radius
        )
        if best.is_feasible:
            if abs(best.point.x - point.x) + abs(best.point.y - point.y) > _ONE_POINT * scale:
                point = best.point  # several points have the least slack: the nearest of them
            break
    return Projection(point, RELAXED, slack)


def nearest(u: Vec2, rows: list[HalfPlane], radius: float) -> Candidate:
    """Return the nearest point of the disc and of all rows; ``is_feasible`` is False where there is
    none.

    Args:
        rows: of unit length.
    """
    taken = rows[:0]
    while True:
        best = nearest_of(u, taken, radius)
        if not best.is_feasible:
            return best
        k = most_violated(best.point, rows)
        if k < 0 or rows[k] in taken:
            return best
        taken.append(rows[k])


def most_violated(u: Vec2, rows: list[HalfPlane]) -> int:
    """Return the index of the most violated row; -1 if none is.

    Args:
        u: point.
        rows: of unit length.
    """
    worst, most = -1, 0.0
    for k in range(len(rows)):
        normal, bound = rows[k]
        violation = bound - normal.x * u.x - normal.y * u.y - EXACT * (1.0 + abs(bound))
        if violation > most:
            worst, most = k, violation
    return worst


def nearest_of(u: Vec2, rows: list[HalfPlane], radius: float) -> Candidate:
    """Return the nearest point of the disc and of a few rows of unit length, by trying all
    candidates.

    Args:
        u: point to project.
        rows: of unit length.
        radius: of the disc.
    """
    share = min(1.0, radius / max(length_2(u), 1e-300))
    clipped = Vec2(share * u.x, share * u.y)
    best = nearer(Candidate(False, clipped, math.inf), clipped, u, rows, radius)
    for i in range(len(rows)):
        best = nearer(best, foot(u, rows[i]), u, rows, radius)
        best = nearer(best, on_circle(rows[i], radius, 1.0), u, rows, radius)
        best = nearer(best, on_circle(rows[i], radius, -1.0), u, rows, radius)
        for j in range(i):
            best = nearer(best, corner(rows[i], rows[j]), u, rows, radius)
    return best


def nearer(
    best: Candidate, point: Vec2, u: Vec2, rows: list[HalfPlane], radius: float
) -> Candidate:
    """Return the point as a candidate if it is feasible and nearer than the best one so far, else
    that one.

    Args:
        best: candidate so far.
        point: to compare with it.
        u: point that is projected.
        rows: of unit length, all to be satisfied.
        radius: of the disc.
    """
    x, y = point.x - u.x, point.y - u.y
    cost = x * x + y * y
    if not cost < best.cost or not in_disc(point, radius):
        return best
    for normal, bound in rows:
        if normal.x * point.x + normal.y * point.y < bound - _TOLERANCE * (1.0 + abs(bound)):
            return best
    return Candidate(True, point, cost)
