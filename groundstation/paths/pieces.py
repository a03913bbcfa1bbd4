"""Paths made, cut, joined and slowed: polynomial pieces as arrays (P, 33). Pure."""

from __future__ import annotations

import math

import numpy as np

from onboard.arrays import Array
from onboard.control.path import NUMBERS, Path, path_of

GRID_S = 0.05
_WINDOW = 5  # samples on each side that a dense sample is smoothed with
_DENSE_S = 0.2
_TOLERANCE_M = 0.01
_LONGEST_PIECE = 80  # samples of the grid
_BINOMIALS = np.array([[math.comb(k, i) for k in range(8)] for i in range(8)], dtype=float)


def fitted(times_s: Array, values: Array) -> Path:
    """Return the path through time-stamped positions.

    Dense samples are smoothed over half a second, since rounded positions would otherwise shake the
    vehicle; sparse ones are joined by a cubic spline. The path rests for a quarter of a second at
    both ends.

    Args:
        times_s: (T,), rising.
        values: (T, 4) of x, y, z [m] and yaw [rad].
    """
    is_dense = len(times_s) > 2 * _WINDOW and float(np.median(np.diff(times_s))) < _DENSE_S
    count = max(2, math.ceil((times_s[-1] - times_s[0]) / GRID_S) + 1)
    grid = np.linspace(times_s[0], times_s[-1], count)
    step_s = float(grid[1] - grid[0])
    flat = values.copy()
    flat[:, 3] = np.unwrap(values[:, 3])
    if is_dense:
        p = np.stack([np.interp(grid, times_s, axis) for axis in flat.T], axis=-1)
    else:
        p = _spline(times_s, flat, grid)
    p = np.pad(p, ((_WINDOW, _WINDOW), (0, 0)), mode="edge")
    return path_of(_merged(*_smoothed(p, step_s), step_s))


def through(points: Array, speeds_m_s: Array) -> Path:
    """Return the path through waypoints, from rest to rest.

    Args:
        points: (T, 4) of x, y, z [m] and yaw [rad].
        speeds_m_s: (T,) at the waypoints; at the first and the last it rests.

    Raises:
        ValueError: fewer than two waypoints, two in one spot, or a speed that is not positive.
    """
    ways_m = np.sqrt((np.diff(points[:, :3], axis=0) ** 2).sum(-1))
    if len(points) < 2 or (ways_m < 1e-3).any():
        raise ValueError("waypoints must be at least two, and each away from the one before.")
    if (speeds_m_s[1:-1] <= 0.0).any():
        raise ValueError("each waypoint between the first and the last needs a speed above 0.")
    speeds = speeds_m_s.copy()
    speeds[[0, -1]] = 0.0
    mean_m_s = 0.5 * (speeds[:-1] + speeds[1:])
    if len(points) == 2:
        mean_m_s[:] = 0.5 * max(speeds_m_s)
        if mean_m_s[0] <= 0.0:
            raise ValueError("two waypoints need a speed above 0.")
    return fitted(np.concatenate([[0.0], np.cumsum(ways_m / mean_m_s)]), points)


def quintic(duration_s: float, begin: Array, end: Array) -> Array:
    """Return the piece (33,) between two motions (3, 4) of value, first and second derivative."""
    t = duration_s
    out = np.zeros((4, 8))
    out[:, 0], out[:, 1], out[:, 2] = begin[0], begin[1], 0.5 * begin[2]
    p = end[0] - (begin[0] + t * begin[1] + 0.5 * t * t * begin[2])
    v = (end[1] - (begin[1] + t * begin[2])) * t
    a = (end[2] - begin[2]) * t * t
    out[:, 3] = (10.0 * p - 4.0 * v + 0.5 * a) / t**3
    out[:, 4] = (-15.0 * p + 7.0 * v - a) / t**4
    out[:, 5] = (6.0 * p - 3.0 * v + 0.5 * a) / t**5
    return np.concatenate([[t], out.reshape(-1)])


def resting(duration_s: float, value: Array) -> Array:
    """Return the piece (33,) that stays at one value (4,)."""
    out = np.zeros((4, 8))
    out[:, 0] = value
    return np.concatenate([[duration_s], out.reshape(-1)])


def slowed(path: Path, factor: float) -> Path:
    """Return a path that takes ``factor`` times as long."""
    pieces = np.array(path.pieces)
    pieces[:, 0] *= factor
    pieces[:, 1:] /= np.tile(factor ** np.arange(8.0), 4)
    return path_of(pieces.tolist())


def backwards(path: Path) -> Path:
    """Return a path flown from its end to its begin."""
    signs = (-1.0) ** np.arange(8.0)
    pieces = [
        [
            piece[0],
            *(np.array(piece[1:]).reshape(4, 8) @ _shift(piece[0]) * signs).reshape(-1).tolist(),
        ]
        for piece in reversed(path.pieces)
    ]
    return path_of(pieces)


def cut(path: Path, begin_s: float, end_s: float) -> Array:
    """Return the pieces (P, 33) between two times of a path."""
    out = []
    for piece, piece_end_s in zip(path.pieces, path.ends_s, strict=True):
        piece_begin_s = piece_end_s - piece[0]
        first_s, last_s = max(begin_s - piece_begin_s, 0.0), min(end_s - piece_begin_s, piece[0])
        if last_s - first_s > 1e-6:
            shifted = np.array(piece[1:]).reshape(4, 8) @ _shift(first_s)
            out.append(np.concatenate([[last_s - first_s], shifted.reshape(-1)]))
    return np.array(out).reshape(-1, NUMBERS)


def moved(path: Path, by: Array) -> Path:
    """Return a path that is shifted by (4,) in x, y, z and yaw."""
    pieces = np.array(path.pieces)
    pieces[:, 1::8] += by
    return path_of(pieces.tolist())


def _shift(by_s: float) -> Array:
    """Return the matrix (8, 8) that makes coefficients of t + by_s from those of t, applied from
    the right.
    """
    powers = np.array([[by_s ** max(k - i, 0) for k in range(8)] for i in range(8)])
    return np.asarray((_BINOMIALS * powers * np.triu(np.ones((8, 8)))).T)


def _smoothed(padded: Array, step_s: float) -> tuple[Array, Array, Array]:
    """Return value and derivatives (T, 4) by cubics fitted around each sample; at both ends it
    rests exactly.
    """
    offsets = step_s * np.arange(-_WINDOW, _WINDOW + 1)
    kernel = np.linalg.pinv(offsets[:, None] ** np.arange(4))[:3]
    held = np.pad(padded, ((_WINDOW, _WINDOW), (0, 0)), mode="edge")
    # (T, 4, 2 W + 1)
    windows = np.lib.stride_tricks.sliding_window_view(held, 2 * _WINDOW + 1, axis=0)
    p, v, a = (windows @ row for row in kernel)
    a = 2.0 * a
    for end in (0, -1):
        p[end], v[end], a[end] = padded[end], 0.0, 0.0
    return p, v, a


def _merged(p: Array, v: Array, a: Array, step_s: float) -> list[list[float]]:
    """Return few quintics through the motion on a grid, each as long as it stays within the
    tolerance.
    """
    pieces, at, length = [], 0, 8
    while at < len(p) - 1:
        length = min(2 * length, _LONGEST_PIECE, len(p) - 1 - at)
        while True:
            end = at + length
            piece = quintic(
                length * step_s, np.array([p[at], v[at], a[at]]), np.array([p[end], v[end], a[end]])
            )
            powers = (step_s * np.arange(length + 1))[:, None] ** np.arange(8)
            away = powers @ piece[1:].reshape(4, 8).T - p[at : end + 1]
            if length == 1 or np.abs(away).max() < _TOLERANCE_M:
                break
            length = max(1, length // 2)
        pieces.append(piece.tolist())
        at = end
    return pieces


def _spline(times_s: Array, values: Array, grid: Array) -> Array:
    """Return the cubic spline through samples (T, 4), at rest at both ends, on a grid."""
    steps = np.diff(times_s)
    slopes = np.diff(values, axis=0) / steps[:, None]
    count = len(times_s)
    # velocities, by elimination from the front
    upper, right = np.zeros(count), np.zeros((count, 4))
    for k in range(1, count - 1):
        left, ahead = steps[k], steps[k - 1]
        pivot = 2.0 * (left + ahead) - left * upper[k - 1]
        upper[k] = ahead / pivot
        right[k] = (3.0 * (left * slopes[k - 1] + ahead * slopes[k]) - left * right[k - 1]) / pivot
    velocity = np.zeros((count, 4))
    for k in range(count - 2, 0, -1):
        velocity[k] = right[k] - upper[k] * velocity[k + 1]
    index = np.clip(np.searchsorted(times_s, grid, side="right") - 1, 0, count - 2)
    h = steps[index][:, None]
    u = (grid - times_s[index])[:, None] / h
    begin, end = values[index], values[index + 1]
    rise_a, rise_b = velocity[index] * h, velocity[index + 1] * h
    return np.asarray(
        begin * (1 + 2 * u) * (1 - u) ** 2
        + end * u * u * (3 - 2 * u)
        + rise_a * u * (1 - u) ** 2
        - rise_b * u * u * (1 - u)
    )
