"""Exact projection of a point of the plane on half-planes and a disc: line Q of README.md.

The paper's (22) is such a projection for two orthogonal half-planes; any number of neighbours gives
any number of half-planes. In the plane, there are only a few candidates for the nearest feasible
point: the point itself, its foot on one edge, the corner of two edges, or a point of the circle.
All of them are tried. Only the rows that matter take part: the most violated row is added, one at a
time, until none is violated. If the optimum for some of the rows satisfies all rows, it is also the
optimum for all rows.

The law calls three functions. In a few rounds, :func:`pulled` moves the thrust towards rows that
need not hold. The later projection of the resulting point is exact. :func:`project` returns the
nearest point that satisfies all rows that must hold. If there is no such point,
:func:`relaxed_in_order` decides which rows are relaxed, and by how much.
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
    scaled_row,
    unit_row,
)
from onboard.avoidance.relaxation import least_slack
from onboard.types import LawStatus
from onboard.vectors import Vec2, dot_xy, length_xy

# values of LawStatus, as plain numbers for compiled code
INACTIVE = int(LawStatus.INACTIVE)
SATURATED = int(LawStatus.SATURATED)
RELAXED = int(LawStatus.RELAXED)

_TOLERANCE = 1e-10  # amount by which a point may violate a row, relative to 1 plus the bound

# two solutions nearer than this, times the scale of the bounds, differ by rounding only
_ONE_POINT = 1e-4

# The slack of firm rows is smaller than the slack of yielding rows by this factor.
_FIRMNESS = 1000.0

# Only violated rows pull, and the resting point decides which rows are violated. Two or three
# rounds usually find that point. None of 20,000 random cases with up to 12 rows took more than
# eight.
_MAX_PULLS = 8
_MAX_HALVINGS = 8  # the motion of one round is halved at most this often

# The smallest slack leaves only one point, and rounding may exclude it. So the slack is widened by
# the first of these numbers that leaves a point, times the scale of the bounds.
_WIDENINGS = (1e-12, 1e-10, 1e-8, 1e-6)


class Projection(NamedTuple):
    """Result of :func:`project` or :func:`relaxed_in_order`."""

    point: Vec2
    status: int  # a LawStatus
    slack: float  # amount by which hard rows had to be relaxed, in the units of the bounds


class Candidate(NamedTuple):
    """A point that may be the nearest feasible point."""

    is_feasible: bool
    point: Vec2
    cost: float  # squared distance from the point that is projected


def project(u: Vec2, hard: list[HalfPlane], radius: float) -> Projection:
    """Return the nearest point that satisfies all rows and the disc.

    Args:
        u: point to project, finite.
        hard: rows that must hold.
        radius: radius of the disc about the origin, at least 0.
    Returns:
        The projection; if no point satisfies the rows, the given point with the status RELAXED.
    Properties: rotation-equivariant; homogeneous; independent of the order of the rows; a point
    that satisfies everything is returned bit for bit.
    """
    is_inside = dot_xy(u, u) <= radius * radius * (1.0 + 1e-12)
    if is_inside and largest_violation(u, hard) <= _TOLERANCE:
        return Projection(u, INACTIVE, 0.0)

    best = nearest(u, [unit_row(row) for row in hard], radius)
    if not best.is_feasible:
        return Projection(u, RELAXED, 0.0)
    return Projection(best.point, SATURATED, 0.0)


def pulled(u: Vec2, soft: list[HalfPlane], stiffness: float) -> Vec2:
    """Return a point moved towards soft rows, as if each violated row pulled it by a spring.

    The result x minimizes ``|x - u|^2 + stiffness * sum of squared violations``. A single row moves
    the point to its edge by the share ``stiffness / (1 + stiffness)``. If rows contradict each
    other, x is a compromise. It is continuous in all rows.

    Args:
        u: point to move, finite.
        soft: rows with normals of any length.
        stiffness: stiffness of a row's spring, relative to the spring that holds the point at u; at
            least 0.
    Properties: rotation-equivariant; homogeneous; independent of the order of the rows; a point
    that satisfies all rows is returned bit for bit.
    """
    springs = [unit_row(row) for row in soft]
    x = u
    for _ in range(_MAX_PULLS):
        pulling = [row for row in springs if dot_xy(row.normal, x) < row.bound_m_s2]
        aim = at_rest(u, pulling, stiffness)
        if aim.x == x.x and aim.y == x.y:
            break

        # At `aim` other rows may be violated, so the energy may be larger than at x. Then `aim` is
        # moved nearer to x.
        energy = energy_of(x, u, springs, stiffness)
        for _ in range(_MAX_HALVINGS):
            if energy_of(aim, u, springs, stiffness) <= energy:
                break
            aim = Vec2(0.5 * (x.x + aim.x), 0.5 * (x.y + aim.y))
        x = aim
    return x


def energy_of(x: Vec2, u: Vec2, springs: list[HalfPlane], stiffness: float) -> float:
    """Return what :func:`pulled` minimizes.

    Args:
        x: point.
        u: point at which a spring of stiffness 1 holds it.
        springs: half-planes with normals of unit length.
        stiffness: of each of their springs, at least 0.
    """
    energy = (x.x - u.x) * (x.x - u.x) + (x.y - u.y) * (x.y - u.y)
    for normal, bound in springs:
        missing = max(0.0, bound - dot_xy(normal, x))
        energy += stiffness * missing * missing
    return energy


def at_rest(u: Vec2, springs: list[HalfPlane], stiffness: float) -> Vec2:
    """Return where a point comes to rest that springs pull towards the edges of rows.

    The forces balance: ``x - u = stiffness * sum of (b - n . x) n``, two linear equations for x.

    Args:
        u: point at which a spring of stiffness 1 holds it.
        springs: half-planes with normals of unit length, all of which pull.
        stiffness: of each of these springs, at least 0.
    """
    xx = 1.0
    xy = 0.0
    yy = 1.0
    pull_x = u.x
    pull_y = u.y
    for normal, bound in springs:
        xx += stiffness * normal.x * normal.x
        xy += stiffness * normal.x * normal.y
        yy += stiffness * normal.y * normal.y
        pull_x += stiffness * bound * normal.x
        pull_y += stiffness * bound * normal.y

    det = xx * yy - xy * xy
    return Vec2((yy * pull_x - xy * pull_y) / det, (xx * pull_y - xy * pull_x) / det)


def relaxed_in_order(
    u: Vec2, yielding: list[HalfPlane], firm: list[HalfPlane], radius: float
) -> Projection:
    """Return the nearest point of the disc for rows that contradict each other.

    If a point satisfies the firm rows, all rows get the smallest slack with which some point
    satisfies all of them: yielding rows the whole slack, firm rows only a thousandth of it. If no
    point satisfies the firm rows, the yielding rows are left out, and the firm rows get their
    smallest common slack. The point moves continuously from one case to the other.

    Args:
        u: point to project.
        yielding: rows that are relaxed first.
        firm: rows that are relaxed last: weaker forms of the yielding rows, or rows of another
            kind.
        radius: radius of the disc.
    """
    is_firm_possible = nearest(u, [unit_row(row) for row in firm], radius).is_feasible
    if not is_firm_possible:
        return relaxed(u, firm, radius, bound_scale(firm))

    # The slack of a row is in the units of its bound. So rows with both sides multiplied by
    # _FIRMNESS are the same half-planes, and a common slack moves their edges by a thousandth.
    stiff = [scaled_row(row, _FIRMNESS) for row in firm]
    scale = max(bound_scale(yielding), bound_scale(firm))
    return relaxed(u, yielding + stiff, radius, scale)


def bound_scale(rows: list[HalfPlane]) -> float:
    """Return 1 plus the largest absolute bound, to which rounding errors are relative.

    Args:
        rows: half-planes with normals of any length.
    """
    scale = 1.0
    for row in rows:
        scale = max(scale, 1.0 + abs(row.bound_m_s2))
    return scale


def relaxed(u: Vec2, hard: list[HalfPlane], radius: float, scale: float) -> Projection:
    """Return the nearest point of the disc for the hard rows with their smallest common slack.

    Args:
        u: point to project.
        hard: rows that no point of the disc satisfies together.
        radius: radius of the disc about the origin.
        scale: result of :func:`bound_scale`.
    """
    slack, point = least_slack(hard, radius)

    for widening in _WIDENINGS:
        widened = slack + widening * scale
        rows = [unit_row(HalfPlane(row.normal, row.bound_m_s2 - widened)) for row in hard]
        best = nearest(u, rows, radius)

        # Usually only `point` has the least slack, and no widening has moved it. If `best` is a
        # different point, several points have the least slack, and `best` is the nearest.
        if best.is_feasible:
            apart = abs(best.point.x - point.x) + abs(best.point.y - point.y)
            if apart > _ONE_POINT * scale:
                point = best.point
            break

    return Projection(point, RELAXED, slack)


def nearest(u: Vec2, rows: list[HalfPlane], radius: float) -> Candidate:
    """Return the nearest point of the disc and of all rows; infeasible if there is no such point.

    Args:
        u: point to project.
        rows: half-planes with normals of unit length.
        radius: radius of the disc about the origin.
    """
    taken = rows[:0]  # an empty list whose type compiled code knows
    while True:
        best = nearest_of(u, taken, radius)
        if not best.is_feasible:
            return best

        k = most_violated(best.point, rows)
        if k < 0 or rows[k] in taken:  # a row that is already taken is violated only by rounding
            return best

        taken.append(rows[k])


def most_violated(u: Vec2, rows: list[HalfPlane]) -> int:
    """Return the index of the most violated row; -1 if no row is violated.

    Args:
        u: point.
        rows: half-planes with normals of unit length.
    """
    worst = -1
    most = 0.0
    for k in range(len(rows)):
        normal, bound = rows[k]
        violation = bound - normal.x * u.x - normal.y * u.y - EXACT * (1.0 + abs(bound))
        if violation > most:
            worst = k
            most = violation
    return worst


def nearest_of(u: Vec2, rows: list[HalfPlane], radius: float) -> Candidate:
    """Return the nearest point of the disc and of a few rows, by trying all candidates.

    Args:
        u: point to project.
        rows: half-planes with normals of unit length.
        radius: radius of the disc about the origin.
    """
    share = min(1.0, radius / max(length_xy(u), 1e-300))
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
    """Return the point as a candidate if it is feasible and nearer than the best so far.

    Args:
        best: best candidate so far, which is returned if the point is no better.
        point: point to compare with it; NaN is never nearer.
        u: point that is projected.
        rows: half-planes with normals of unit length, all to be satisfied.
        radius: radius of the disc about the origin.
    """
    x = point.x - u.x
    y = point.y - u.y
    cost = x * x + y * y
    if not cost < best.cost or not in_disc(point, radius):
        return best

    for normal, bound in rows:
        if normal.x * point.x + normal.y * point.y < bound - _TOLERANCE * (1.0 + abs(bound)):
            return best

    return Candidate(True, point, cost)
