"""The motion part of the identification: how positions follow from attitude and thrust.

The acceleration from attitude and thrust is integrated twice and compared with the measured
positions, in windows of two seconds. The position and the velocity at the start of each window are
unknown; what they explain is removed by a projection. The rest is linear in the parameters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from groundstation.identification.attitude_fit import (
    ERRORS_RAD,
    STATIC_GAIN,
    commanded_tilt,
    response,
)
from groundstation.identification.logged_stretch import LeastSquares, Log, TooLittleFlown, jackknife
from onboard.arrays import Array, IntArray
from onboard.constants import GRAVITY_M_S2

# Indexes of the parameters theta of the horizontal fit, and of their standard deviations.
DRAG_1_S, SHIFT_S, PUSH_X_M_S2, PUSH_Y_M_S2 = range(4)
PUSHES_M_S2 = slice(PUSH_X_M_S2, PUSH_Y_M_S2 + 1)  # by a tilt of the thrust

WINDOW_S = 2.0
_GRID_S = 0.005
_MOTOR_LAG_S = 0.05

# these are only weights of the fit; the standard deviations come from the jackknife
_GUST_M_S2 = 0.03
_GUST_TIME_S = 1.0
POSITION_NOISE_M = 0.003


@dataclass(frozen=True, slots=True)
class _Drive:
    """The input of the motion on a fine grid of g times."""

    time_s: Array  # (g,)
    push: Array  # (g, 3): throttle after the motors' lag, times the direction of the thrust
    position_enu_m: Array  # (g, 3): measured, interpolated


def _drive(
    log: Log, attitude: LeastSquares, shift_s: float, begin_s: float, end_s: float
) -> _Drive:
    """Return the input of the motion.

    Args:
        log: one stretch in the air.
        attitude: fit of its attitude.
        shift_s: time by which the attitude's response is shifted.
        begin_s: first time of the grid.
        end_s: last time of the grid.
    """
    time_s = np.arange(begin_s, end_s, _GRID_S)

    # direction of the thrust by the fitted response, on every second point to save time
    coarse_s = np.arange(begin_s, end_s + 2.0 * _GRID_S, 2.0 * _GRID_S)
    static_gain = attitude.theta[STATIC_GAIN]
    tilt_error = attitude.theta[ERRORS_RAD]
    responded = response(commanded_tilt(log, coarse_s - shift_s), attitude.theta)
    coarse = static_gain * responded + tilt_error
    tilt = np.stack([np.interp(time_s, coarse_s, coarse[:, axis]) for axis in range(2)], axis=-1)
    angle = np.sqrt((tilt * tilt).sum(-1))
    horizontal = tilt * np.sinc(angle / np.pi)[:, None]
    direction = np.concatenate([horizontal, np.cos(angle)[:, None]], axis=-1)

    # Throttle after the motors' first-order lag. It remembers 0.4 s, so the commands are taken from
    # a little earlier than that before the window.
    early_s = np.arange(begin_s - 0.5, end_s, _GRID_S)
    index = np.searchsorted(log.command_time_s, early_s, side="right") - 1
    held = log.thrust_frac[np.maximum(index, 0)]
    kernel = np.exp(-np.arange(0.0, 0.4, _GRID_S) / _MOTOR_LAG_S)
    lagged = np.convolve(held, kernel / kernel.sum())[: early_s.size]
    throttle = lagged[-time_s.size :]

    axes = [
        np.interp(time_s, log.position_time_s, log.position_enu_m[:, axis]) for axis in range(3)
    ]
    return _Drive(
        time_s=time_s,
        push=throttle[:, None] * direction,
        position_enu_m=np.stack(axes, axis=-1),
    )


def _windows(
    log: Log,
    drive: _Drive,
    axes: tuple[int, ...],
    inputs: list[Array],
    known_m: Array,
    gust_m_s2: float,
) -> tuple[Array, Array, IntArray]:
    """Return the regression over all windows: columns (r, p), right side (r,), clusters (r,).

    Args:
        log: one stretch in the air.
        drive: input of the motion on the grid.
        axes: indexes of the used axes of the position.
        inputs: contribution of each parameter to the position on the grid (g, axes).
        known_m: known part of the position on the grid (g, axes), which is subtracted.
        gust_m_s2: standard deviation of the gusts, for the weights.

    Raises:
        TooLittleFlown: too few windows have enough positions.
    """
    rows: list[Array] = []
    right: list[Array] = []
    clusters: list[IntArray] = []
    count = math.floor((drive.time_s[-1] - drive.time_s[0]) / WINDOW_S)
    for number in range(count):
        begin_s = drive.time_s[0] + number * WINDOW_S
        end_s = begin_s + WINDOW_S
        used = (log.position_time_s >= begin_s) & (log.position_time_s < end_s)
        if used.sum() < 20:
            continue
        time_s = log.position_time_s[used]

        # basis of the motions by initial position and velocity, in whitened coordinates
        whiten = np.linalg.inv(np.linalg.cholesky(_covariance_m2(time_s, gust_m_s2)))
        free = np.stack([np.ones_like(time_s), time_s - begin_s], axis=1)
        basis, _ = np.linalg.qr(whiten @ free)

        first = np.searchsorted(drive.time_s, begin_s)
        last = np.searchsorted(drive.time_s, end_s) + 1
        grid_s = drive.time_s[first:last]
        for column, axis in enumerate(axes):
            columns = [
                np.interp(time_s, grid_s, contribution[first:last, column])
                for contribution in inputs
            ]
            subtracted_m = np.interp(time_s, grid_s, known_m[first:last, column])
            measured = log.position_enu_m[used, axis] - subtracted_m

            # remove what initial position and velocity explain
            all_columns = whiten @ np.stack([*columns, measured], axis=1)
            all_columns -= basis @ (basis.T @ all_columns)
            rows.append(all_columns[:, :-1])
            right.append(all_columns[:, -1])
            # neighbouring numbers are neighbouring windows, so the axes are far apart
            clusters.append(np.full(time_s.size, number + 10_000 * axis, dtype=np.int64))
    if len(rows) < 3 * len(axes):
        raise TooLittleFlown(
            "Positions are missing for most of the flight. Check the mocap, and fly again."
        )
    return np.concatenate(rows), np.concatenate(right), np.concatenate(clusters)


def _covariance_m2(time_s: Array, gust_m_s2: float) -> Array:
    """Return the covariance (n, n) of the errors of positions at these times.

    The errors are white measurement noise, and time-correlated gusts integrated twice.
    """
    # matrices that integrate values at these times once and twice
    step_s = np.diff(time_s, prepend=time_s[0])
    once = np.tril(np.broadcast_to(step_s, (time_s.size, time_s.size)))
    twice = np.tril(once @ once)

    gusts = gust_m_s2**2 * np.exp(-np.abs(time_s[:, None] - time_s) / _GUST_TIME_S)
    return np.asarray(twice @ gusts @ twice.T + POSITION_NOISE_M**2 * np.eye(time_s.size))


def _solve(columns: Array, right: Array, cluster: IntArray) -> LeastSquares:
    """Return the least-squares solution of a regression, with its standard deviations."""
    theta, *_ = np.linalg.lstsq(columns, right, rcond=None)
    residual = right - columns @ theta
    std, clusters = jackknife(columns, residual, cluster)
    return LeastSquares(
        theta=np.asarray(theta, dtype=np.float64),
        std=std,
        rms=float(np.sqrt(np.mean(residual**2))),
        clusters=clusters,
    )


def _integral(values: Array) -> Array:
    """Return the integral (g, c) from the start of the grid, by trapezoids."""
    trapezoids = 0.5 * _GRID_S * (values[1:] + values[:-1])
    return np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(trapezoids, axis=0)])


def fit_vertical(
    log: Log, attitude: LeastSquares, begin_s: float, end_s: float
) -> tuple[float, float]:
    """Fit the acceleration per throttle [m/s^2], together with vertical drag and the motors' lag.

    Args:
        log: one stretch in the air.
        attitude: fit of its attitude.
        begin_s: first time used [s].
        end_s: last time used [s].

    Returns:
        The acceleration and its standard deviation.
    """
    drive = _drive(log, attitude, -log.attitude_age_s, begin_s, end_s)
    height_m = drive.position_enu_m[:, 2:]
    push_once = _integral(drive.push[:, 2:])
    push_twice = _integral(push_once)
    fall_m = -0.5 * GRAVITY_M_S2 * (drive.time_s - drive.time_s[0])[:, None] ** 2

    # contributions of the acceleration per throttle, of drag, and of the throttle's shift in time
    inputs = [push_twice, -_integral(height_m - height_m[0]), -push_once]
    columns, right, cluster = _windows(log, drive, (2,), inputs, fall_m, 0.0)
    fit = _solve(columns, right, cluster)
    return float(fit.theta[0]), float(fit.std[0])


def fit_horizontal(
    log: Log, attitude: LeastSquares, scale: float, begin_s: float, end_s: float
) -> LeastSquares:
    """Fit drag, lag and tilt error of the horizontal motion.

    The known age of the attitude enters as one more measurement of the shift. The fit runs twice,
    since the shift is linearised: the second time about the first result.

    Args:
        log: one stretch in the air.
        attitude: fit of its attitude.
        scale: acceleration per throttle [m/s^2].
        begin_s: first time used [s].
        end_s: last time used [s].

    Returns:
        theta: drag [1/s], time shift of the motion against the attitude's stamps [s] (minus their
            age), and the acceleration along x and y by a tilt of the thrust [m/s^2]. The indexes
            above name them.
    """
    known_s = -log.attitude_age_s
    weight = 1.0 / log.attitude_age_std_s
    shift_s = known_s

    for _ in range(2):
        drive = _drive(log, attitude, shift_s, begin_s, end_s)
        position = drive.position_enu_m[:, :2]
        push_once = _integral(scale * drive.push[:, :2])
        push_twice = _integral(push_once)
        constant_twice = 0.5 * (drive.time_s - drive.time_s[0])[:, None] ** 2

        # contributions of drag, of the shift in time, and of a constant error along x and y
        inputs = [
            -_integral(position - position[0]),
            -push_once,
            constant_twice * np.array([1.0, 0.0]),
            constant_twice * np.array([0.0, 1.0]),
        ]
        columns, right, cluster = _windows(log, drive, (0, 1), inputs, push_twice, _GUST_M_S2)

        # The known age is one more row, weighted as the whitened rows are. Its cluster, -10, is not
        # a neighbour of any window's cluster.
        columns = np.concatenate([columns, [[0.0, weight, 0.0, 0.0]]])
        right = np.concatenate([right, [weight * (known_s - shift_s)]])
        cluster = np.concatenate([cluster, [-10]])

        fit = _solve(columns, right, cluster)
        shift_s += float(fit.theta[SHIFT_S])

    theta = fit.theta.copy()
    theta[SHIFT_S] = shift_s
    return LeastSquares(theta=theta, std=fit.std, rms=fit.rms, clusters=fit.clusters)
