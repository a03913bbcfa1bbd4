"""Motion of the identification: acceleration by attitude and throttle, integrated twice, against
positions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from groundstation.identification.attitude_fit import commanded_tilt, response
from groundstation.identification.flight_log import Fit, Log, TooLittleFlown, jackknife
from onboard.arrays import Array, IntArray
from onboard.types import GRAVITY_M_S2

WINDOW_S = 2.0
_GRID_S = 0.005
_MOTOR_LAG_S = 0.05
# only weights: the jackknife does not believe them
_GUST_M_S2, _GUST_TIME_S, POSITION_NOISE_M = 0.03, 1.0, 0.003


@dataclass(frozen=True, slots=True)
class _Drive:
    """Input of the motion on a fine grid."""

    time_s: Array  # (g,)
    push: Array  # (g, 3): throttle behind the motors times the thrust's direction
    position_enu_m: Array  # (g, 3)


def _drive(log: Log, attitude: Fit, shift_s: float, begin_s: float, end_s: float) -> _Drive:
    time_s = np.arange(begin_s, end_s, _GRID_S)
    theta = attitude.theta
    coarse_s = np.arange(begin_s, end_s + 2.0 * _GRID_S, 2.0 * _GRID_S)
    coarse = theta[3] * response(commanded_tilt(log, coarse_s - shift_s), theta) + theta[4:6]
    tilt = np.stack([np.interp(time_s, coarse_s, coarse[:, axis]) for axis in range(2)], axis=-1)
    angle = np.sqrt((tilt * tilt).sum(-1))
    direction = np.concatenate(
        [tilt * np.sinc(angle / np.pi)[:, None], np.cos(angle)[:, None]], axis=-1
    )
    early = np.arange(begin_s - 0.5, end_s, _GRID_S)
    held = log.thrust_frac[
        np.maximum(np.searchsorted(log.command_time_s, early, side="right") - 1, 0)
    ]
    kernel = np.exp(-np.arange(0.0, 0.4, _GRID_S) / _MOTOR_LAG_S)
    throttle = np.convolve(held, kernel / kernel.sum())[: early.size][-time_s.size :]
    position = np.stack(
        [np.interp(time_s, log.position_time_s, log.position_enu_m[:, axis]) for axis in range(3)],
        axis=-1,
    )
    return _Drive(time_s, throttle[:, None] * direction, position)


def _windows(
    log: Log,
    drive: _Drive,
    axes: tuple[int, ...],
    inputs: list[Array],
    target: Array,
    gust_m_s2: float,
) -> tuple[Array, Array, IntArray]:
    """Regression over windows with free initial position and velocity: columns (r, p), right side
    (r,), clusters (r,).

    ``inputs``: contribution of each parameter on the grid (g, axes); ``target``: known motion to
    subtract (g, axes).
    """
    rows: list[Array] = []
    right: list[Array] = []
    clusters: list[IntArray] = []
    count = math.floor((drive.time_s[-1] - drive.time_s[0]) / WINDOW_S)
    for number in range(count):
        begin_s = drive.time_s[0] + number * WINDOW_S
        used = (log.position_time_s >= begin_s) & (log.position_time_s < begin_s + WINDOW_S)
        if used.sum() < 20:
            continue
        time_s = log.position_time_s[used]
        whiten = np.linalg.inv(np.linalg.cholesky(_covariance_m2(time_s, gust_m_s2)))
        basis, _ = np.linalg.qr(whiten @ np.stack([np.ones_like(time_s), time_s - begin_s], axis=1))
        first = np.searchsorted(drive.time_s, begin_s)
        last = np.searchsorted(drive.time_s, begin_s + WINDOW_S) + 1
        grid_s = drive.time_s[first:last]
        for column, axis in enumerate(axes):
            columns = [np.interp(time_s, grid_s, one[first:last, column]) for one in inputs]
            known = np.interp(time_s, grid_s, target[first:last, column])
            all_columns = whiten @ np.stack(
                [*columns, log.position_enu_m[used, axis] - known], axis=1
            )
            all_columns -= basis @ (basis.T @ all_columns)
            rows.append(all_columns[:, :-1])
            right.append(all_columns[:, -1])
            clusters.append(np.full(time_s.size, number + 10_000 * axis, dtype=np.int64))
    if len(rows) < 3 * len(axes):
        raise TooLittleFlown(
            "Positions are missing for most of the flight. Check the mocap, and fly again."
        )
    return np.concatenate(rows), np.concatenate(right), np.concatenate(clusters)


def _covariance_m2(time_s: Array, gust_m_s2: float) -> Array:
    """Covariance (n, n) of positions at these times: white measurement noise, and gusts that are
    correlated in time.
    """
    step_s = np.diff(time_s, prepend=time_s[0])
    once = np.tril(np.broadcast_to(step_s, (time_s.size, time_s.size)))
    twice = np.tril(once @ once)
    gusts = gust_m_s2**2 * np.exp(-np.abs(time_s[:, None] - time_s) / _GUST_TIME_S)
    return np.asarray(twice @ gusts @ twice.T + POSITION_NOISE_M**2 * np.eye(time_s.size))


def _solve(columns: Array, right: Array, cluster: IntArray) -> Fit:
    theta, *_ = np.linalg.lstsq(columns, right, rcond=None)
    residual = right - columns @ theta
    std, clusters = jackknife(columns, residual, cluster)
    return Fit(
        np.asarray(theta, dtype=np.float64), std, float(np.sqrt(np.mean(residual**2))), clusters
    )


def _integral(values: Array) -> Array:
    """Cumulative integral (g, c) from the start of the grid, by trapezoids."""
    halves = 0.5 * _GRID_S * (values[1:] + values[:-1])
    return np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(halves, axis=0)])


def fit_vertical(log: Log, attitude: Fit, begin_s: float, end_s: float) -> tuple[float, float]:
    """Fit the acceleration per throttle [m/s^2]; vertical drag and the motors' own lag are free.

    Args:
        log: one stretch in the air.
        attitude: fit of its attitude.
        begin_s: first time used [s].
        end_s: last time used [s].

    Returns:
        The acceleration and its standard deviation.
    """
    drive = _drive(log, attitude, -log.attitude_age_s, begin_s, end_s)
    push, height = drive.push[:, 2:], drive.position_enu_m[:, 2:]
    once = _integral(push)
    fall = -0.5 * GRAVITY_M_S2 * (drive.time_s - drive.time_s[0])[:, None] ** 2
    fit = _solve(
        *_windows(
            log, drive, (2,), [_integral(once), -_integral(height - height[0]), -once], fall, 0.0
        )
    )
    return float(fit.theta[0]), float(fit.std[0])


def fit_horizontal(log: Log, attitude: Fit, scale: float, begin_s: float, end_s: float) -> Fit:
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
        theta: drag [1/s], time shift of the motion against the attitude's stamps [s], error x and y
            [m/s^2].
    """
    known_s, weight = -log.attitude_age_s, 1.0 / log.attitude_age_std_s
    shift_s = known_s
    for _ in range(2):
        drive = _drive(log, attitude, shift_s, begin_s, end_s)
        push, position = scale * drive.push[:, :2], drive.position_enu_m[:, :2]
        once = _integral(push)
        square = 0.5 * (drive.time_s - drive.time_s[0])[:, None] ** 2
        inputs = [
            -_integral(position - position[0]),
            -once,
            square * np.array([1.0, 0.0]),
            square * np.array([0.0, 1.0]),
        ]
        columns, right, cluster = _windows(log, drive, (0, 1), inputs, _integral(once), _GUST_M_S2)
        # residuals are whitened to about one, and so is this row
        columns = np.concatenate([columns, [[0.0, weight, 0.0, 0.0]]])
        right = np.concatenate([right, [weight * (known_s - shift_s)]])
        cluster = np.concatenate([cluster, [-10]])
        fit = _solve(columns, right, cluster)
        shift_s += float(fit.theta[1])
    theta = fit.theta.copy()
    theta[1] = shift_s
    return Fit(theta, fit.std, fit.rms, fit.clusters)
