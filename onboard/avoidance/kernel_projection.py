"""The projection on half-planes and a disc for one vehicle, in plain floats; see kernels.py, and projection.py.

Rows are taken in one by one, the most violated first, until none is: the optimum of some of the rows that satisfies all
of them is the optimum of all. For the few rows taken, all candidates are tried, as projection.py does for all rows.
"""

from __future__ import annotations

import math
from typing import Any

Scalars = Any  # a list when interpreted, an array when compiled
_TOLERANCE = 1e-10
_EXACT = 1e-13  # rounding
ONE_POINT = 1e-4  # two solutions nearer than this (times the bounds) are one, seen through rounding
INACTIVE, SATURATED, RELAXED, INFEASIBLE = 0, 1, 2, 3


def best_of(
    u_x: float, u_y: float, n_x: Scalars, n_y: Scalars, b: Scalars, chosen: Scalars, count: int, radius: float
) -> tuple[bool, float, float]:
    """Nearest point of the disc and of the ``count`` chosen rows of unit length, by trying all candidates."""
    size = math.sqrt(u_x * u_x + u_y * u_y)
    scale = min(1.0, radius / max(size, 1e-300))
    limit = radius * (1.0 + 1e-12) + 1e-12
    limit_2 = limit * limit
    found, best, x, y = False, math.inf, u_x * scale, u_y * scale
    for i in range(-1, count):
        for j in range(-3, i):
            # (-1, .): the clipped point; (i, -3): foot of row i; (i, -2), (i, -1): on the circle; (i, j): corner
            if i < 0:
                p_x, p_y = u_x * scale, u_y * scale
            else:
                r = chosen[i]
                if j == -3:
                    lack = max(0.0, b[r] - n_x[r] * u_x - n_y[r] * u_y)
                    p_x, p_y = u_x + lack * n_x[r], u_y + lack * n_y[r]
                elif j < 0:
                    half = math.sqrt(max(0.0, radius * radius - b[r] * b[r]))
                    if j == -1:
                        half = -half
                    p_x, p_y = b[r] * n_x[r] - half * n_y[r], b[r] * n_y[r] + half * n_x[r]
                else:
                    s = chosen[j]
                    det = n_x[r] * n_y[s] - n_y[r] * n_x[s]
                    if abs(det) <= 1e-13:
                        continue
                    p_x = (b[r] * n_y[s] - b[s] * n_y[r]) / det
                    p_y = (n_x[r] * b[s] - n_x[s] * b[r]) / det
            cost = (p_x - u_x) * (p_x - u_x) + (p_y - u_y) * (p_y - u_y)
            if not cost < best or p_x * p_x + p_y * p_y > limit_2:
                continue
            is_ok = True
            for k in range(count):
                t = chosen[k]
                if n_x[t] * p_x + n_y[t] * p_y < b[t] - _TOLERANCE * (1.0 + abs(b[t])):
                    is_ok = False
                    break
            if is_ok:
                found, best, x, y = True, cost, p_x, p_y
    return found, x, y


def nearest(
    u_x: float, u_y: float, n_x: Scalars, n_y: Scalars, b: Scalars, count: int, radius: float, chosen: Scalars
) -> tuple[bool, float, float]:
    """Nearest point of the disc and of the first ``count`` rows of unit length; whether there is one.

    Rows are taken in one by one, the most violated first, until none is: the optimum of some of the rows that satisfies
    all of them is the optimum of all.
    """
    taken = 0
    while True:
        found, x, y = best_of(u_x, u_y, n_x, n_y, b, chosen, taken, radius)
        if not found:
            return False, x, y
        worst, most = -1, 0.0
        for k in range(count):
            lack = b[k] - n_x[k] * x - n_y[k] * y - _EXACT * (1.0 + abs(b[k]))
            if lack > most:
                worst, most = k, lack
        for k in range(taken):
            if chosen[k] == worst:
                worst = -1
        if worst < 0:
            return True, x, y
        chosen[taken] = worst
        taken += 1


def least_of(
    n_x: Scalars, n_y: Scalars, b: Scalars, chosen: Scalars, count: int, radius: float
) -> tuple[float, float, float]:
    """Smallest common slack of the chosen rows over the disc, and its point: all candidates are tried."""
    limit = radius * (1.0 + 1e-12) + 1e-12
    limit_2 = limit * limit
    best, x, y = math.inf, 0.0, 0.0
    for i in range(-1, count):
        r = chosen[max(i, 0)]
        for j in range(-1, max(i, 0)):
            s = chosen[max(j, 0)]
            for k in range(-2, max(j, 0)):
                # (-1, ., .): the middle; (i, -1, .): the circle towards row i; (i, j, < 0): the circle where rows i, j
                # are equal; (i, j, k): where three rows are equal
                if (i < 0 or j < 0) and k > -2:
                    continue
                if i < 0:
                    p_x, p_y = 0.0, 0.0
                elif j < 0:
                    length = math.sqrt(n_x[r] * n_x[r] + n_y[r] * n_y[r])
                    p_x, p_y = radius * n_x[r] / max(length, 1e-300), radius * n_y[r] / max(length, 1e-300)
                else:
                    g_x, g_y, step = n_x[s] - n_x[r], n_y[s] - n_y[r], b[s] - b[r]
                    if k < 0:
                        size = math.sqrt(g_x * g_x + g_y * g_y)
                        if size <= 1e-12:
                            continue
                        g_x, g_y, step = g_x / size, g_y / size, step / size
                        half = math.sqrt(max(0.0, radius * radius - step * step))
                        if k == -1:
                            half = -half
                        p_x, p_y = step * g_x - half * g_y, step * g_y + half * g_x
                    else:
                        t = chosen[k]
                        f_x, f_y, rise = n_x[t] - n_x[r], n_y[t] - n_y[r], b[t] - b[r]
                        det = g_x * f_y - g_y * f_x
                        if abs(det) <= 1e-13:
                            continue
                        p_x, p_y = (step * f_y - rise * g_y) / det, (g_x * rise - f_x * step) / det
                if p_x * p_x + p_y * p_y > limit_2:
                    continue
                lack = -math.inf
                for m in range(count):
                    v = chosen[m]
                    lack = max(lack, b[v] - n_x[v] * p_x - n_y[v] * p_y)
                if lack < best:
                    best, x, y = lack, p_x, p_y
    return best, x, y


def least_slack(
    n_x: Scalars, n_y: Scalars, b: Scalars, count: int, radius: float, chosen: Scalars
) -> tuple[float, float, float]:
    """``min t >= 0`` such that a point of the disc satisfies ``n.u >= b - t`` for the first ``count`` rows; a point."""
    scale, first = 0.0, 0
    for k in range(count):
        scale = max(scale, abs(b[k]))
        if b[k] > b[first]:
            first = k
    chosen[0] = first
    taken = 1
    while True:
        slack, x, y = least_of(n_x, n_y, b, chosen, taken, radius)
        worst, most = -1, slack + _EXACT * (1.0 + scale)
        for k in range(count):
            lack = b[k] - n_x[k] * x - n_y[k] * y
            if lack > most:
                worst, most = k, lack
        for k in range(taken):
            if chosen[k] == worst:
                worst = -1
        if worst < 0:
            return max(0.0, slack), x, y
        chosen[taken] = worst
        taken += 1


def project(
    u_x: float,
    u_y: float,
    n_x: Scalars,
    n_y: Scalars,
    b: Scalars,
    hard: int,
    soft: int,
    radius: float,
    unit: tuple[Scalars, Scalars, Scalars],
    chosen: Scalars,
) -> tuple[float, float, int, float]:
    """Projection on ``hard`` rows, the disc and as many of the ``soft`` rows behind them as fit: point, status, slack.

    ``unit`` holds scratch memory for the rows at unit length. See projection.project.
    """
    m_x, m_y, c = unit
    violated = u_x * u_x + u_y * u_y > radius * radius * (1.0 + 1e-12)
    for k in range(hard + soft):
        if n_x[k] * u_x + n_y[k] * u_y < b[k] - _TOLERANCE:
            violated = True
        length = math.sqrt(n_x[k] * n_x[k] + n_y[k] * n_y[k])
        m_x[k], m_y[k], c[k] = n_x[k] / length, n_y[k] / length, b[k] / length
    if not violated:
        return u_x, u_y, INACTIVE, 0.0
    found, x, y = nearest(u_x, u_y, m_x, m_y, c, hard + soft, radius, chosen)
    if found:
        return x, y, SATURATED, 0.0
    found, x, y = nearest(u_x, u_y, m_x, m_y, c, hard, radius, chosen)
    if found:
        for kept in range(soft - 1, 0, -1):
            fits, p_x, p_y = nearest(u_x, u_y, m_x, m_y, c, hard + kept, radius, chosen)
            if fits:
                return p_x, p_y, SATURATED, 0.0
        return x, y, SATURATED, 0.0
    slack, x, y = least_slack(n_x, n_y, b, hard, radius, chosen)
    scale = 1.0
    for k in range(hard):
        scale = max(scale, 1.0 + abs(b[k]))
    widen = 1e-12
    while widen < 1e-5:  # rounding must not hide the one point that is left
        for k in range(hard):
            length = math.sqrt(n_x[k] * n_x[k] + n_y[k] * n_y[k])
            c[k] = (b[k] - (slack + widen * scale)) / length
        found, p_x, p_y = nearest(u_x, u_y, m_x, m_y, c, hard, radius, chosen)
        if found:
            if abs(p_x - x) + abs(p_y - y) > ONE_POINT * scale:
                x, y = p_x, p_y  # several points have the least slack: the nearest of them
            return x, y, RELAXED, slack
        widen *= 100.0
    return x, y, RELAXED, slack
