"""Projection on half-planes and a disc by slow, plain means, for checking the fast one."""

from __future__ import annotations

import itertools
import math

import numpy as np


def nearest_in_rows_and_disc(u0, normals, bounds, radius, tolerance=1e-9):
    """Nearest feasible point by trying every active set, scalar; None when there is none."""
    rows = [
        (n / np.hypot(*n), b / np.hypot(*n))
        for n, b in zip(normals, bounds, strict=True)
        if np.hypot(*n) > 0
    ]
    candidates = [np.array(u0, float)]
    size = np.hypot(*u0)
    if size > 0:
        candidates.append(np.array(u0) * (radius / size))
    for n, b in rows:
        candidates.append(np.array(u0) + (b - n @ u0) * n)
        if abs(b) <= radius:
            along = np.array([-n[1], n[0]]) * math.sqrt(radius**2 - b**2)
            candidates += [b * n + along, b * n - along]
    for (n1, b1), (n2, b2) in itertools.combinations(rows, 2):
        matrix = np.array([n1, n2])
        if abs(np.linalg.det(matrix)) > 1e-12:
            candidates.append(np.linalg.solve(matrix, np.array([b1, b2])))
    best = None
    best_cost = math.inf
    for u in candidates:
        feasible = np.hypot(*u) <= radius + tolerance and all(
            n @ u >= b - tolerance for n, b in rows
        )
        cost = float(np.sum((u - u0) ** 2))
        if feasible and cost < best_cost:
            best = u
            best_cost = cost
    return best


def least_common_slack(normals, bounds, radius):
    """min over the disc of max(b - n.u) by bisection on the slack, feasibility by the enumeration
    above.
    """
    low = 0.0
    high = max(0.0, float(np.max(bounds)) + 1.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        found = nearest_in_rows_and_disc(
            np.zeros(2), normals, np.array(bounds) - middle, radius, 1e-12
        )
        low, high = (low, middle) if found is not None else (middle, high)
    return high
