"""Makes, cuts, slows and moves paths, which are polynomial pieces. Pure.

A piece is an array (33,): its duration, and eight coefficients each for x, y, z and yaw. Several
pieces are an array (P, 33).
"""

from __future__ import annotations

import math

import numpy as np

from onboard.arrays import Array, BoolArray
from onboard.control.path import (
    AXES,
    DURATION,
    LONGEST_S,
    MAX_TURN_RAD_S,
    NUMBER_COUNT,
    POWERS,
    YAW,
    Path,
    coefficients_of,
    path_of,
    piece_of,
)

GRID_S = 0.05  # time from one sample of the grid to the next
_WINDOW = 5  # samples of the grid on each side over which positions are smoothed
_DENSE_S = 0.2  # positions with smaller intervals than this are dense
# Largest distance of a curve from the line between two of its positions, or this share of the
# line's length. A spline may round a few positions on a circle, but leave no line by more than
# _SPLINE_M. The curve in its place stays nearer.
_NEAR_M = 0.1
_NEAR_SHARE = 0.1
_SPLINE_SHARE = 0.25
_SPLINE_M = 0.5
_CORNER_COSINE = math.cos(math.radians(70.0))  # a sharper bend is a corner
_HALF_TURN_RAD = math.pi + 1e-6  # with room for rounding
# A turn of more than half a circle that would be quicker on average is taken for numbers that wrap.
# A turn from rest to rest peaks at 1.5 times its mean rate.
_QUICKEST_TURN_RAD_S = MAX_TURN_RAD_S / 1.5
_TOLERANCE_M = 0.01  # largest error of a piece in position
# Largest error of a piece in acceleration, unless a tenth of the largest acceleration is more.
_TOLERANCE_M_S2 = 0.5
_FIRST_PIECE = 8  # the first piece that is tried has twice this many samples
_LONGEST_PIECE = 80  # samples of the grid that a piece covers at most
_SAME_SPOT_M = 1e-3  # waypoints that are nearer than this are at one spot
_SHORTEST_S = 1e-6  # shorter pieces of a cut path are left out
_SAME_TIME_S = 1e-3  # a path is not divided nearer than this to an end of a piece
_BINOMIALS = np.array([[math.comb(k, i) for k in range(8)] for i in range(8)], dtype=float)


def fitted(times_s: Array, values: Array) -> Path:
    """Return the path through time-stamped positions.

    Dense positions are smoothed over half a second, because rounded positions would shake the
    vehicle. Sparse positions are joined first: by a cubic spline, or, where that would swing, by a
    curve that does not. The path rests for a quarter of a second at both ends.

    Args:
        times_s: times (T,), rising.
        values: x, y, z [m] and yaw [rad] (T, 4).
    """
    grid_s = _grid_of(times_s)
    step_s = float(grid_s[1] - grid_s[0])

    unwrapped = values.copy()
    unwrapped[:, 3] = _unwrapped(times_s, values[:, 3])

    if _is_dense(times_s):
        on_grid = np.stack([np.interp(grid_s, times_s, axis) for axis in unwrapped.T], axis=-1)
    else:
        on_grid = _joined(times_s, unwrapped, grid_s)

    # A quarter of a second of rest on either side.
    padded = np.pad(on_grid, ((_WINDOW, _WINDOW), (0, 0)), mode="edge")
    positions, velocities, accelerations = _smoothed(padded, step_s)
    return path_of(_merged(positions, velocities, accelerations, step_s))


def would_swing(times_s: Array, values: Array) -> bool:
    """Whether a cubic spline through sparse positions would swing far off the lines between them.

    Between long and short steps it swings over its positions, and so it does where a vehicle stands
    between two moves. Then :func:`fitted` takes another curve, which stays near the lines.

    Args:
        times_s: times (T,), rising.
        values: x, y, z [m] and yaw [rad] (T, 4).
    """
    if _is_dense(times_s):
        return False

    points = values[:, :3]
    return _does_swing(times_s, points, _spline_velocities(times_s, points))


def _does_swing(times_s: Array, points: Array, velocities: Array) -> bool:
    """Whether the spline with these velocities leaves a line between two points too far."""
    lengths_m = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    allowed_m = np.clip(_SPLINE_SHARE * lengths_m, _NEAR_M, _SPLINE_M)
    return bool(_swings(times_s, points, velocities, allowed_m).any())


def turns_far(times_s: Array, yaw_rad: Array) -> bool:
    """Whether sparse headings (T,) turn by more than half a circle from one to the next."""
    far = np.abs(np.diff(yaw_rad)) > _HALF_TURN_RAD
    return bool(far.any()) and not _is_dense(times_s)


def through(points: Array, speeds_m_s: Array) -> Path:
    """Return the path through waypoints, from rest to rest.

    Args:
        points: x, y, z [m] and yaw [rad] of the waypoints (T, 4).
        speeds_m_s: speeds at the waypoints (T,); the vehicle rests at the first and the last.

    Raises:
        ValueError: see :func:`waypoint_times_s`.
    """
    return fitted(waypoint_times_s(points, speeds_m_s), points)


def waypoint_times_s(points: Array, speeds_m_s: Array) -> Array:
    """Return the times (T,) at which waypoints are passed, from rest to rest.

    Where :func:`fitted` stops at a corner, the speed is 0 instead of the given one, so that the way
    between two corners takes longer and is not flown quicker.

    Args:
        points: x, y, z [m] and yaw [rad] of the waypoints (T, 4).
        speeds_m_s: speeds at the waypoints (T,); the vehicle rests at the first and the last.

    Raises:
        ValueError: there are fewer than two waypoints, two successive ones are at one spot, a speed
            is not positive, or the way takes too long.
    """
    lengths_m = np.sqrt((np.diff(points[:, :3], axis=0) ** 2).sum(-1))
    if len(points) < 2 or (lengths_m < _SAME_SPOT_M).any():
        raise ValueError("waypoints must be at least two, and each away from the one before.")
    if (speeds_m_s[1:-1] <= 0.0).any():
        raise ValueError("each waypoint between the first and the last needs a speed above 0.")
    if speeds_m_s.max() <= 0.0:
        raise ValueError("two waypoints need a speed above 0.")

    speeds = speeds_m_s.copy()
    stops = np.zeros(len(points), dtype=bool)
    stops[[0, -1]] = True

    while True:
        speeds[stops] = 0.0
        mean_m_s = 0.5 * (speeds[:-1] + speeds[1:])

        # From stop to stop both speeds are 0, and so is their mean. Half of the larger given speed
        # is used instead.
        from_stop_to_stop = stops[:-1] & stops[1:]
        larger_m_s = np.maximum(speeds_m_s[:-1], speeds_m_s[1:])
        mean_m_s[from_stop_to_stop] = 0.5 * larger_m_s[from_stop_to_stop]

        times_s = np.concatenate([[0.0], np.cumsum(lengths_m / mean_m_s)])
        if not times_s[-1] <= LONGEST_S:
            raise ValueError(
                f"the waypoints take {times_s[-1]:g} s at these speeds; {LONGEST_S:.0f} s are the "
                "longest that a path lasts. Give higher speeds, or fewer waypoints."
            )

        if _is_dense(times_s):
            return times_s

        # With the new times the curve may stop at further corners.
        velocities = _calm_velocities(times_s, points[:, :3])
        further_stops = (velocities == 0.0).all(axis=-1) & ~stops
        if not further_stops.any():
            return times_s
        stops |= further_stops


def quintic(duration_s: float, begin: Array, end: Array) -> Array:
    """Return the piece (33,) between two motions (3, 4) of value, first and second derivative."""
    t = duration_s
    begin_value, begin_first, begin_second = begin
    end_value, end_first, end_second = end
    coefficients = np.zeros((AXES, POWERS))

    # The motion at the start gives the first three coefficients.
    coefficients[:, 0] = begin_value
    coefficients[:, 1] = begin_first
    coefficients[:, 2] = 0.5 * begin_second

    # The other three follow from value, first and second derivative at the end, minus the part that
    # the first three contribute.
    value = end_value - (begin_value + t * begin_first + 0.5 * t * t * begin_second)
    first = (end_first - (begin_first + t * begin_second)) * t
    second = (end_second - begin_second) * t * t

    coefficients[:, 3] = (10.0 * value - 4.0 * first + 0.5 * second) / t**3
    coefficients[:, 4] = (-15.0 * value + 7.0 * first - second) / t**4
    coefficients[:, 5] = (6.0 * value - 3.0 * first + 0.5 * second) / t**5

    return piece_of(t, coefficients)


def resting(duration_s: float, value: Array) -> Array:
    """Return the piece (33,) that stays at one value (4,)."""
    coefficients = np.zeros((AXES, POWERS))
    coefficients[:, 0] = value
    return piece_of(duration_s, coefficients)


def slowed(path: Path, factor: float) -> Path:
    """Return a path that takes ``factor`` times as long."""
    # the coefficient of t^k is divided by factor^k
    pieces = np.array(path.pieces)
    pieces[:, DURATION] *= factor
    coefficients = coefficients_of(pieces)
    coefficients /= factor ** np.arange(float(POWERS))
    return path_of(pieces.tolist())


def backwards(path: Path) -> Path:
    """Return a path flown from its end to its start."""
    # Each piece is shifted to its end, and then mirrored: t becomes -t, which changes the signs of
    # the odd powers.
    signs = (-1.0) ** np.arange(float(POWERS))

    pieces = []
    for piece in reversed(path.pieces):
        duration_s = piece[DURATION]
        coefficients = coefficients_of(np.array(piece))
        reversed_in_time = coefficients @ _shift(duration_s) * signs
        pieces.append(piece_of(duration_s, reversed_in_time).tolist())
    return path_of(pieces)


def cut(path: Path, begin_s: float, end_s: float) -> Array:
    """Return the pieces (P, 33) between two times of a path."""
    pieces = []
    for piece, piece_end_s in zip(path.pieces, path.ends_s, strict=True):
        duration_s = piece[DURATION]
        piece_begin_s = piece_end_s - duration_s

        # The part of this piece that lies between the two times, counted from the piece's start.
        first_s = max(begin_s - piece_begin_s, 0.0)
        last_s = min(end_s - piece_begin_s, duration_s)
        if last_s - first_s <= _SHORTEST_S:
            continue

        shifted = coefficients_of(np.array(piece)) @ _shift(first_s)
        pieces.append(piece_of(last_s - first_s, shifted))
    return np.array(pieces).reshape(-1, NUMBER_COUNT)


def divided(path: Path, times_s: Array) -> Array:
    """Return the pieces (P, 33) of a path whose pieces end at further times as well.

    Args:
        path: the path.
        times_s: rising times at which a piece shall end [s].
    """
    pieces = []
    for piece, piece_end_s in zip(path.pieces, path.ends_s, strict=True):
        duration_s = piece[DURATION]
        coefficients = coefficients_of(np.array(piece))

        # the times within this piece, counted from its start
        since_s = times_s - (piece_end_s - duration_s)
        first = np.searchsorted(since_s, _SAME_TIME_S)
        last = np.searchsorted(since_s, duration_s - _SAME_TIME_S)
        begins_s = [0.0, *since_s[first:last].tolist()]
        ends_s = [*begins_s[1:], duration_s]

        for begin_s, end_s in zip(begins_s, ends_s, strict=True):
            shifted = coefficients @ _shift(begin_s)
            pieces.append(piece_of(end_s - begin_s, shifted))
    return np.array(pieces)


def moved(path: Path, by: Array) -> Path:
    """Return a path that is shifted by x, y, z and yaw (4,)."""
    pieces = np.array(path.pieces)
    coefficients_of(pieces)[:, :, 0] += by
    return path_of(pieces.tolist())


def turned(path: Path, by_rad: float) -> Path:
    """Return a path that is turned about the z axis, counterclockwise, with its yaw."""
    cosine = math.cos(by_rad)
    sine = math.sin(by_rad)

    pieces = np.array(path.pieces)
    coefficients = coefficients_of(pieces)
    x = coefficients[:, 0].copy()
    y = coefficients[:, 1].copy()
    coefficients[:, 0] = cosine * x - sine * y
    coefficients[:, 1] = sine * x + cosine * y
    coefficients[:, YAW, 0] += by_rad
    return path_of(pieces.tolist())


def _shift(by_s: float) -> Array:
    """Return the matrix (8, 8), applied from the right, that shifts polynomials in time.

    The new polynomial has at t the value that the old one has at t + by_s.
    """
    powers = np.array([[by_s ** max(k - i, 0) for k in range(8)] for i in range(8)])
    return np.asarray((_BINOMIALS * powers * np.triu(np.ones((8, 8)))).T)


def _smoothed(padded: Array, step_s: float) -> tuple[Array, Array, Array]:
    """Return value, first and second derivative (T, 4) of smoothed positions.

    The positions are joined by straight lines, and averaged twice over a quarter of a second.
    Velocity and acceleration are the exact derivatives of the result, because derivatives that do
    not match the positions would make short pieces swing between the samples. At both ends the
    motion rests exactly.

    An average over a window is a difference of the integral at both ends of the window. So the
    positions are integrated twice, and the second difference over the window is taken.
    """
    window_s = _WINDOW * step_s
    # the first and the last position are repeated, so that the windows at the ends are complete
    extended = np.pad(padded, ((_WINDOW, _WINDOW), (0, 0)), mode="edge")

    # Integrals of the straight lines, once and twice, from the first sample on.
    begins = extended[:-1]
    ends = extended[1:]
    once = _summed(0.5 * step_s * (begins + ends))
    twice = _summed(step_s * once[:-1] + step_s**2 * (2.0 * begins + ends) / 6.0)

    def averaged(values: Array) -> Array:
        """Return the second difference over the window, divided by the square of its length."""
        ahead = values[2 * _WINDOW :]
        middle = values[_WINDOW:-_WINDOW]
        behind = values[: -2 * _WINDOW]
        return np.asarray((ahead - 2.0 * middle + behind) / window_s**2)

    positions = averaged(twice)
    velocities = averaged(once)
    accelerations = averaged(extended)
    for end in (0, -1):
        positions[end] = padded[end]
        velocities[end] = 0.0
        accelerations[end] = 0.0
    return positions, velocities, accelerations


def _summed(steps: Array) -> Array:
    """Return the sums (T + 1, 4) of steps (T, 4), the first one 0."""
    return np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])


def _merged(
    positions: Array, velocities: Array, accelerations: Array, step_s: float
) -> list[list[float]]:
    """Return few quintics that are near a motion on a grid, in position and in acceleration.

    A quintic that is near in position only may swing between the samples with twice the
    acceleration.
    """
    pieces = []
    first = 0  # sample at which the next piece begins
    length = _FIRST_PIECE  # samples that the last piece covers
    tolerance_m_s2 = max(_TOLERANCE_M_S2, 0.1 * float(np.abs(accelerations[:, :3]).max()))

    while first < len(positions) - 1:
        # Try a piece twice as long as the last one, and halve it until it is near enough.
        length = min(2 * length, _LONGEST_PIECE, len(positions) - 1 - first)
        while True:
            last = first + length
            piece = quintic(
                duration_s=length * step_s,
                begin=np.array([positions[first], velocities[first], accelerations[first]]),
                end=np.array([positions[last], velocities[last], accelerations[last]]),
            )
            covered = slice(first, last + 1)
            error_m, error_m_s2 = _largest_errors(
                piece, positions[covered], accelerations[covered], step_s
            )
            is_near = error_m < _TOLERANCE_M and error_m_s2 < tolerance_m_s2
            if length == 1 or is_near:
                break
            length = max(1, length // 2)

        pieces.append(piece.tolist())
        first = last
    return pieces


def _largest_errors(
    piece: Array, positions: Array, accelerations: Array, step_s: float
) -> tuple[float, float]:
    """Return the largest errors with which a piece misses samples of a motion.

    Args:
        piece: the piece (33,).
        positions: positions and yaw (T, 4) at a grid from the start to the end of the piece.
        accelerations: accelerations (T, 4) at the same times.
        step_s: step of the grid.

    Returns:
        Largest errors of a position or yaw [m, rad], and of an acceleration [m/s^2].
    """
    coefficients = coefficients_of(piece).T
    times_s = (step_s * np.arange(len(positions)))[:, None]
    error_m = times_s ** np.arange(8) @ coefficients - positions

    # the second derivative of t^k is k (k - 1) t^(k - 2)
    factors = np.arange(2, 8) * np.arange(1, 7)
    acceleration = times_s ** np.arange(6) @ (factors[:, None] * coefficients[2:])
    error_m_s2 = (acceleration - accelerations)[:, :3]
    return float(np.abs(error_m).max()), float(np.abs(error_m_s2).max())


def _grid_of(times_s: Array) -> Array:
    """Return evenly spaced times from the first to the last of some times (T,)."""
    count = max(2, math.ceil((times_s[-1] - times_s[0]) / GRID_S) + 1)
    return np.linspace(times_s[0], times_s[-1], count)


def _is_dense(times_s: Array) -> bool:
    """Whether positions at these times (T,) are dense, so that they are smoothed and not joined."""
    return len(times_s) > 2 * _WINDOW and float(np.median(np.diff(times_s))) < _DENSE_S


def _unwrapped(times_s: Array, yaw_rad: Array) -> Array:
    """Return headings (T,) [rad] without the jumps of numbers that wrap.

    A turn of more than half a circle is such a jump if the headings are dense, or if it would be
    quicker than vehicles turn. Otherwise somebody has written it, and it is flown.
    """
    turns_rad = np.diff(yaw_rad)
    is_quick = np.abs(turns_rad) > _QUICKEST_TURN_RAD_S * np.diff(times_s)
    is_wrap = (np.abs(turns_rad) > _HALF_TURN_RAD) & (is_quick | _is_dense(times_s))
    rounds = np.where(is_wrap, np.round(turns_rad / (2.0 * math.pi)), 0.0)
    return np.asarray(yaw_rad - 2.0 * math.pi * np.concatenate([[0.0], np.cumsum(rounds)]))


def _joined(times_s: Array, values: Array, grid_s: Array) -> Array:
    """Return the smooth curve (G, 4) through sparse values, from rest to rest, on a grid of times.

    Positions are joined by a cubic spline, the smoothest curve, where it does not swing. Yaw stays
    between the two values around it.

    Args:
        times_s: times (T,), rising.
        values: x, y, z [m] and yaw [rad] (T, 4).
        grid_s: times (G,).
    """
    velocities = _bounded_velocities(times_s, values)
    velocities[:, :3] = _calm_velocities(times_s, values[:, :3])
    return _hermite(times_s, values, velocities, grid_s)


def _calm_velocities(times_s: Array, points: Array) -> Array:
    """Return velocities (T, 3) with which cubics stay near the lines between points (T, 3).

    They are those of the spline, or, if it swings, those with which each coordinate stays between
    two points, and 0 at corners. These bound each coordinate for itself, so between oblique lines
    the curve may still swing. The vehicle stops at both ends of such a step, which so becomes a
    straight line.
    """
    velocities = _spline_velocities(times_s, points)
    if not _does_swing(times_s, points, velocities):
        return velocities

    steps = np.diff(points, axis=0)
    lengths_m = np.sqrt((steps**2).sum(-1))
    products = (steps[:-1] * steps[1:]).sum(-1)
    is_corner = products < _CORNER_COSINE * lengths_m[:-1] * lengths_m[1:]

    allowed_m = np.maximum(_NEAR_M, _NEAR_SHARE * lengths_m)
    velocities = _bounded_velocities(times_s, points)
    velocities[1:-1][is_corner] = 0.0
    while True:
        is_moving = np.asarray((velocities != 0.0).any(axis=-1))
        is_curve = is_moving[:-1] | is_moving[1:]
        swinging = np.flatnonzero(is_curve & _swings(times_s, points, velocities, allowed_m))
        if not len(swinging):
            return velocities

        # this changes the steps on both sides as well, so all are judged again
        velocities[swinging] = 0.0
        velocities[swinging + 1] = 0.0


def _swings(times_s: Array, points: Array, velocities: Array, allowed_m: Array) -> BoolArray:
    """Return whether cubics leave the straight line between two points too far, by step (T - 1,).

    Args:
        times_s: times of the points (T,).
        points: the points (T, 3) [m].
        velocities: velocities at the points (T, 3) [m/s].
        allowed_m: largest distance from each line (T - 1,).
    """
    grid_s = _grid_of(times_s)
    curve = _hermite(times_s, points, velocities, grid_s)
    index = _steps_of(times_s, grid_s)
    steps = np.diff(points, axis=0)
    lengths_m = np.sqrt((steps**2).sum(-1))

    # the nearest point of the line is at this share of its length
    directions = steps / np.maximum(lengths_m, _SAME_SPOT_M)[:, None] ** 2
    from_begin = curve - points[index]
    share = np.clip((from_begin * directions[index]).sum(-1), 0.0, 1.0)
    from_line = from_begin - share[:, None] * steps[index]
    is_far = np.sqrt((from_line**2).sum(-1)) > allowed_m[index]
    return np.asarray(np.bincount(index[is_far], minlength=len(steps)) > 0)


def _spline_velocities(times_s: Array, values: Array) -> Array:
    """Return the velocities (T, D) of the cubic spline through samples (T, D).

    They are 0 at both ends. Between these they follow from the continuity of the acceleration, as
    the solution of a tridiagonal system. Its row for sample k has the steps as weights of the two
    neighbouring velocities: that after k for the one before, and that before k for the one after.
    """
    steps = np.diff(times_s)
    slopes = np.diff(values, axis=0) / steps[:, None]
    count = len(times_s)

    # First step of the solution: elimination from the front. It leaves
    # velocity[k] = right[k] - upper[k] * velocity[k + 1].
    upper = np.zeros(count)
    right = np.zeros_like(values)
    for k in range(1, count - 1):
        before = steps[k - 1]
        after = steps[k]
        pivot = 2.0 * (after + before) - after * upper[k - 1]
        upper[k] = before / pivot
        rise = 3.0 * (after * slopes[k - 1] + before * slopes[k])
        right[k] = (rise - after * right[k - 1]) / pivot

    # Second step: substitution from the back. The motion rests at both ends.
    velocity = np.zeros_like(values)
    for k in range(count - 2, 0, -1):
        velocity[k] = right[k] - upper[k] * velocity[k + 1]

    return velocity


def _bounded_velocities(times_s: Array, values: Array) -> Array:
    """Return velocities (T, D) with which cubics stay between each two samples (T, D).

    They are 0 at both ends, and where a coordinate turns or stands. Elsewhere they are a weighted
    harmonic mean of the slopes before and after, as in SciPy's PchipInterpolator: F. N. Fritsch and
    J. Butland, A method for constructing local monotone piecewise cubic interpolants, SIAM J. Sci.
    Stat. Comput. 5 (1984), 300-304.
    """
    steps = np.diff(times_s)[:, None]
    slopes = np.diff(values, axis=0) / steps
    before = slopes[:-1]
    after = slopes[1:]
    weight_before = steps[:-1] + 2.0 * steps[1:]
    weight_after = 2.0 * steps[:-1] + steps[1:]

    velocity = np.zeros_like(values)
    goes_on = before * after > 0.0
    weighted = weight_before * after + weight_after * before
    mean = (weight_before + weight_after) * before * after / np.where(goes_on, weighted, 1.0)
    velocity[1:-1] = np.where(goes_on, mean, 0.0)
    return velocity


def _hermite(times_s: Array, values: Array, velocities: Array, grid_s: Array) -> Array:
    """Return Hermite's cubics between samples (T, D) with velocities (T, D) there, on a grid."""
    index = _steps_of(times_s, grid_s)
    step = np.diff(times_s)[index][:, None]
    u = (grid_s - times_s[index])[:, None] / step  # share of the step that has passed
    begin = values[index]
    end = values[index + 1]
    begin_rise = velocities[index] * step
    end_rise = velocities[index + 1] * step
    return np.asarray(
        begin * (1 + 2 * u) * (1 - u) ** 2
        + end * u * u * (3 - 2 * u)
        + begin_rise * u * (1 - u) ** 2
        - end_rise * u * u * (1 - u)
    )


def _steps_of(times_s: Array, grid_s: Array) -> Array:
    """Return the index of the step between two samples (T,) in which each time of a grid lies."""
    index = np.searchsorted(times_s, grid_s, side="right") - 1
    return np.asarray(np.clip(index, 0, len(times_s) - 2))
