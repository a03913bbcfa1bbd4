"""Exact Euclidean projection of a point of the plane on half-planes and a disc, batched.

The paper's (22) is such a projection for two orthogonal half-planes; any number of neighbours gives any number of
half-planes. In the plane the nearest feasible point is one of few: the point itself, its foot on one line, the corner
of two lines, or a point of the circle. All are enumerated and the nearest feasible one is taken: no iterations, no
solver status to interpret, the same cost every tick. Elements of a batch that need nothing leave at once.

Where the hard rows leave nothing, the smallest common slack ``t`` is found as exactly, by the same enumeration for
``min t`` subject to ``n.u >= b - t``; soft rows are then given up. Soft rows alone are dropped one by one, last first.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from onboard.types import Array, BoolArray, IntArray, LawStatus

_FEASIBLE_TOLERANCE = 1e-10
_ONE_POINT = 1e-4  # two solutions nearer than this (times the bounds) are one, seen through rounding
_LARGEST_WORK_SET = 2_000_000  # floats of one chunk of candidates x rows; keeps big batches inside the caches


@dataclass(frozen=True, slots=True)
class Rows:
    """Half-planes ``normals . u >= bounds``: normals (..., H, 2) [-], bounds (..., H) [m/s^2], is_on (..., H).

    Entries that are off, not finite or have a zero normal are no rows.
    """

    normals: Array
    bounds_m_s2: Array
    is_on: BoolArray


@dataclass(frozen=True, slots=True)
class Projection:
    """point (..., 2) [m/s^2]; status (...) as LawStatus; slack (...) [m/s^2] in the units of the given hard bounds."""

    point_m_s2: Array
    status: IntArray
    slack_m_s2: Array
    dropped_soft: IntArray


def no_rows(batch_shape: tuple[int, ...]) -> Rows:
    """An empty set of rows for a batch."""
    return Rows(np.zeros((*batch_shape, 0, 2)), np.zeros((*batch_shape, 0)), np.zeros((*batch_shape, 0), bool))


def project(point_m_s2: Array, hard: Rows, soft: Rows, *, radius_m_s2: Array) -> Projection:
    """Nearest point that satisfies all hard rows, the disc ``|u| <= radius`` and as many leading soft rows as fit.

    Args:
        point_m_s2: (..., 2), finite.
        hard: (..., H) rows, relaxed by one common slack only where no point satisfies them all.
        soft: (..., S) rows in order of importance; the last is dropped first.
        radius_m_s2: (...) >= 0.
    Returns:
        The projection. With an infeasible hard set it satisfies ``n.u >= b - slack`` with the smallest slack.
    Properties: rotation-equivariant; homogeneous; independent of the order of the hard rows; no rows change nothing
        inside the disc.
    """
    batch = point_m_s2.shape[:-1]
    u0 = point_m_s2.reshape(-1, 2).astype(np.float64)
    radius = np.broadcast_to(radius_m_s2, batch).reshape(-1)
    n_hard, b_hard, on_hard = _flat(hard, len(u0))
    n_soft, b_soft, on_soft = _flat(soft, len(u0))
    tolerance = _FEASIBLE_TOLERANCE
    violated = (on_hard & (_dot(n_hard, u0) < b_hard - tolerance)).any(-1)
    violated |= (on_soft & (_dot(n_soft, u0) < b_soft - tolerance)).any(-1)
    violated |= np.einsum("mc,mc->m", u0, u0) > radius**2 * (1.0 + 1e-12)
    out = u0.copy()
    status = np.full(len(u0), int(LawStatus.INACTIVE), np.int64)
    slack = np.zeros(len(u0))
    dropped = np.zeros(len(u0), np.int64)
    todo = np.flatnonzero(violated)
    if len(todo):
        normals = np.concatenate([n_hard[todo], n_soft[todo]], axis=1)
        bounds = np.concatenate([b_hard[todo], b_soft[todo]], axis=1)
        is_on = np.concatenate([on_hard[todo], on_soft[todo]], axis=1)
        solved = _solve(u0[todo], normals, bounds, is_on, on_hard.shape[1], radius[todo])
        out[todo], status[todo], slack[todo], dropped[todo] = solved
    return Projection(out.reshape(*batch, 2), status.reshape(batch), slack.reshape(batch), dropped.reshape(batch))


def _solve(
    u0: Array, normals: Array, bounds: Array, is_on: BoolArray, hard_count: int, radius: Array
) -> tuple[Array, IntArray, Array, IntArray]:
    """Project the elements (M, ...) that violate something; the first ``hard_count`` rows are hard."""
    count = len(u0)
    status = np.full(count, int(LawStatus.SATURATED), np.int64)
    slack = np.zeros(count)
    dropped = np.zeros(count, np.int64)
    point, is_found = nearest_feasible(u0, normals, bounds, is_on, radius)
    failed = np.flatnonzero(~is_found)
    if not len(failed):
        return point, status, slack, dropped
    hard_on = is_on.copy()
    hard_on[:, hard_count:] = False
    hard_point, hard_found = nearest_feasible(
        u0[failed], normals[failed], bounds[failed], hard_on[failed], radius[failed]
    )
    point[failed] = hard_point
    dropped[failed] = is_on[failed, hard_count:].sum(-1)
    # soft rows: give up the last one until a point is left; the hard set alone is known to be feasible here
    todo = failed[hard_found]
    keep = is_on.copy()
    while len(todo):
        soft = keep[todo, hard_count:]
        todo, soft = todo[soft.any(-1)], soft[soft.any(-1)]
        if not len(todo):
            break
        last = soft.shape[1] - 1 - np.argmax(soft[:, ::-1], axis=1)
        keep[todo, hard_count + last] = False
        candidate, found = nearest_feasible(u0[todo], normals[todo], bounds[todo], keep[todo], radius[todo])
        point[todo[found]] = candidate[found]
        dropped[todo[found]] = (is_on[todo[found], hard_count:] & ~keep[todo[found], hard_count:]).sum(-1)
        todo = todo[~found]
    # hard rows: the smallest common slack
    empty = failed[~hard_found]
    if len(empty):
        rows = normals[empty, :hard_count], bounds[empty, :hard_count], is_on[empty, :hard_count]
        least, point[empty] = least_slack(*rows, radius[empty])
        scale = 1.0 + np.abs(np.where(rows[2], rows[1], 0.0)).max(-1, initial=0.0)
        target, rest = empty, np.arange(len(empty))
        for widen in (1e-12, 1e-10, 1e-8, 1e-6):  # rounding must not hide the one point that is left
            relaxed = bounds[target] - (least[rest] + widen * scale[rest])[:, None]
            candidate, found = nearest_feasible(u0[target], normals[target], relaxed, hard_on[target], radius[target])
            # where several points have the least slack, the nearest of them
            is_other = found & (np.abs(candidate - point[target]).sum(-1) > _ONE_POINT * scale[rest])
            point[target[is_other]] = candidate[is_other]
            target, rest = target[~found], rest[~found]
            if not len(target):
                break
        slack[empty] = least
        status[empty] = int(LawStatus.RELAXED)
    return point, status, slack, dropped


def nearest_feasible(
    u0: Array, normals: Array, bounds: Array, is_on: BoolArray, radius: Array
) -> tuple[Array, BoolArray]:
    """Nearest point of the intersection: (M, 2), and whether there is one (M,). Without one the point is clipped."""
    normals, bounds, is_on = _compact(normals, bounds, is_on)
    rows = normals.shape[1]
    chunk = max(1, _LARGEST_WORK_SET // max(1, (2 + 3 * rows + rows * rows // 2) * rows))
    if len(u0) > chunk:
        cuts = [slice(k, k + chunk) for k in range(0, len(u0), chunk)]
        parts = [nearest_feasible(u0[c], normals[c], bounds[c], is_on[c], radius[c]) for c in cuts]
        return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])
    # rows of unit length; those switched off become 0.u >= -inf, which everything satisfies
    length = np.sqrt(np.einsum("mhc,mhc->mh", normals, normals))
    safe = np.where(is_on, length, 1.0)
    n = np.where(is_on[..., None], normals / safe[..., None], 0.0)
    b = np.where(is_on, bounds / safe, 0.0)
    size = np.sqrt(np.einsum("mc,mc->m", u0, u0))
    clipped = u0 * np.minimum(1.0, radius / np.maximum(size, 1e-300))[:, None]
    lack = np.maximum(0.0, b - _dot(n, u0))
    foot = u0[:, None, :] + n * lack[..., None]
    half = np.sqrt(np.maximum(0.0, radius[:, None] ** 2 - b * b))
    along = np.stack([-n[..., 1], n[..., 0]], axis=-1) * half[..., None]
    base = n * b[..., None]
    first, second = _pairs(rows)
    corner, is_corner = _intersect(n[:, first], b[:, first], n[:, second], b[:, second])
    candidates = np.concatenate([clipped[:, None, :], foot, base + along, base - along, corner], axis=1)
    value = np.einsum("mkc,mhc->mkh", candidates, n)
    margin = _FEASIBLE_TOLERANCE * (1.0 + np.abs(b))
    is_ok = (value >= (b - margin)[:, None, :]).all(-1)
    squared = np.einsum("mkc,mkc->mk", candidates, candidates)
    is_ok &= squared <= ((radius * (1.0 + 1e-12) + 1e-12) ** 2)[:, None]
    is_ok[:, 1 + 3 * rows :] &= is_corner
    gap = candidates - u0[:, None, :]
    cost = np.where(is_ok, np.einsum("mkc,mkc->mk", gap, gap), np.inf)
    best = np.argmin(cost, axis=1)
    index = np.arange(len(u0))
    is_found = is_ok[index, best]
    return np.where(is_found[:, None], candidates[index, best], clipped), is_found


def least_slack(normals: Array, bounds: Array, is_on: BoolArray, radius: Array) -> tuple[Array, Array]:
    """``min t >= 0`` such that a point of the disc satisfies ``n.u >= b - t`` for all rows: (M,) [m/s^2], and a point.

    ``max(b - n.u)`` is convex and piecewise linear: its minimum over the disc lies where three rows are equal, on the
    circle where two are, or on the circle in the direction of one row.
    """
    normals, bounds, is_on = _compact(normals, bounds, is_on)
    rows = normals.shape[1]
    if rows == 0:
        return np.zeros(len(radius)), np.zeros((len(radius), 2))
    work = (3 * rows + rows * rows + rows**3 // 6) * rows
    chunk = max(1, _LARGEST_WORK_SET // work)
    if len(radius) > chunk:
        cuts = [slice(k, k + chunk) for k in range(0, len(radius), chunk)]
        parts = [least_slack(normals[c], bounds[c], is_on[c], radius[c]) for c in cuts]
        return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])
    n = np.where(is_on[..., None], normals, 0.0)
    length = np.sqrt(np.einsum("mhc,mhc->mh", n, n))
    single = n * (radius[:, None] / np.maximum(length, 1e-300))[..., None]
    first, second = _pairs(rows)
    gradient = n[:, first] - n[:, second]
    step = bounds[:, first] - bounds[:, second]
    size = np.sqrt(np.einsum("mkc,mkc->mk", gradient, gradient))
    is_line = size > 1e-12
    unit = gradient / np.where(is_line, size, 1.0)[..., None]
    offset = step / np.where(is_line, size, 1.0)
    half = np.sqrt(np.maximum(0.0, radius[:, None] ** 2 - offset**2))
    along = np.stack([-unit[..., 1], unit[..., 0]], axis=-1) * half[..., None]
    one, two, three = _triples(rows)
    corner, _ = _intersect(
        n[:, one] - n[:, two],
        bounds[:, one] - bounds[:, two],
        n[:, one] - n[:, three],
        bounds[:, one] - bounds[:, three],
    )
    base = unit * offset[..., None]
    candidates = np.concatenate([single, base + along, base - along, corner, np.zeros((len(radius), 1, 2))], axis=1)
    need = np.where(is_on, bounds, -np.inf)
    lack = (need[:, None, :] - np.einsum("mkc,mhc->mkh", candidates, n)).max(-1)
    squared = np.einsum("mkc,mkc->mk", candidates, candidates)
    lack = np.where(squared <= ((radius * (1.0 + 1e-12) + 1e-12) ** 2)[:, None], lack, np.inf)
    best = np.argmin(lack, axis=-1)
    index = np.arange(len(radius))
    return np.maximum(0.0, lack[index, best]), candidates[index, best]


def _intersect(n1: Array, b1: Array, n2: Array, b2: Array) -> tuple[Array, BoolArray]:
    """Corner of two lines ``n.u = b`` (..., 2) and whether they cross; parallel ones give the origin."""
    det = n1[..., 0] * n2[..., 1] - n1[..., 1] * n2[..., 0]
    is_crossing = np.abs(det) > 1e-13
    det = np.where(is_crossing, det, 1.0)
    x = (b1 * n2[..., 1] - b2 * n1[..., 1]) / det
    y = (n1[..., 0] * b2 - n2[..., 0] * b1) / det
    corner = np.stack([x, y], axis=-1)
    return np.where(is_crossing[..., None], corner, 0.0), is_crossing


def _dot(normals: Array, u: Array) -> Array:
    return np.asarray(np.einsum("mhc,mc->mh", normals, u))


def _flat(rows: Rows, count: int) -> tuple[Array, Array, BoolArray]:
    """Rows as (M, H, ...) with every unusable entry switched off and zeroed."""
    height = rows.bounds_m_s2.shape[-1]
    normals = rows.normals.reshape(count, height, 2)
    bounds = rows.bounds_m_s2.reshape(count, height)
    is_on = rows.is_on.reshape(count, height) & np.isfinite(bounds) & np.isfinite(normals).all(-1)
    is_on &= np.abs(normals).max(-1, initial=0.0) > 1e-12
    return np.where(is_on[..., None], normals, 0.0), np.where(is_on, bounds, 0.0), is_on


def _compact(normals: Array, bounds: Array, is_on: BoolArray) -> tuple[Array, Array, BoolArray]:
    """Move the rows that are on to the front and cut what no element uses; most ticks have very few."""
    width = int(is_on.sum(-1).max(initial=0))
    if width == is_on.shape[1]:
        return normals, bounds, is_on
    order = np.argsort(~is_on, axis=1, kind="stable")[:, :width]
    index = np.arange(len(is_on))[:, None]
    return normals[index, order], bounds[index, order], is_on[index, order]


@lru_cache(maxsize=64)
def _pairs(rows: int) -> tuple[IntArray, IntArray]:
    first, second = np.triu_indices(rows, 1)
    return first, second


@lru_cache(maxsize=64)
def _triples(rows: int) -> tuple[IntArray, IntArray, IntArray]:
    i, j, k = np.indices((rows, rows, rows)).reshape(3, -1)
    keep = (i < j) & (j < k)
    return i[keep], j[keep], k[keep]
