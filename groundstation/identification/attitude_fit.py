"""The attitude part of the identification: how the measured tilt follows the commanded one.

The model is the commanded tilt after a dead time and a second-order response, times a static gain,
plus a constant error. The fit is Gauss-Newton with damping (Levenberg and Marquardt), which starts
at the best point of a coarse grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from groundstation.identification.logged_stretch import (
    MEMORY_S,
    LeastSquares,
    Log,
    jackknife,
    tilt_vector_rad,
)
from onboard.arrays import Array

# Indexes of the parameters theta of this fit, and of their standard deviations.
DELAY_S, WN_RAD_S, ZETA, STATIC_GAIN, ERROR_X_RAD, ERROR_Y_RAD = range(6)
ERRORS_RAD = slice(ERROR_X_RAD, ERROR_Y_RAD + 1)  # constant error of the measured attitude

_CLUSTER_S = 1.0  # duration of a cluster of residuals, for the jackknife
# the coarse grid: delays [s] and natural frequencies wn [rad/s]
_GRID_DELAYS_S = (0.0, 0.03, 0.06, 0.1, 0.15, 0.2)
_GRID_WN = (4.0, 6.0, 9.0, 14.0, 22.0)
_OUTLIER = 6.0  # a difference above this multiple of the median is an outlier
# half steps of the numeric derivatives with respect to delay [s], wn [rad/s] and zeta
_HALF_STEPS = (1e-3, 1e-2, 1e-3)
_LEAST = [-0.02, 1.5, 0.15]  # lower bounds of delay, wn, zeta
_MOST = [0.5, 60.0, 3.0]  # upper bounds of the same
_MAX_ROUNDS = 25  # of Gauss-Newton
_MAX_DAMPING = 1e6


def fit_attitude(log: Log, begin_s: float, end_s: float) -> LeastSquares:
    """Fit the attitude's response to the commanded tilt.

    Args:
        log: one stretch in the air.
        begin_s: first time used [s].
        end_s: last time used [s].

    Returns:
        theta: dead time [s], wn [rad/s], zeta, static gain, and the constant error of the attitude
            along x and y [rad]. The indexes above name them.
    """
    used = (log.attitude_time_s >= begin_s) & (log.attitude_time_s <= end_s)
    time_s = log.attitude_time_s[used]
    measured = tilt_vector_rad(log.attitude_quaternion_wxyz[used])
    commands = commanded_tilt(log, time_s)

    start = _best_of_grid(measured[::4], commands.every(4))
    theta, residual, jacobian = _refined(start, measured, commands)

    # both axes of a sample belong to the cluster of its second
    cluster = np.repeat((time_s / _CLUSTER_S).astype(np.int64), 2)
    std, clusters = jackknife(jacobian, residual, cluster)
    rms = float(np.sqrt(np.mean(residual**2)))
    return LeastSquares(theta=theta, std=std, rms=rms, clusters=clusters)


def _best_of_grid(measured: Array, commands: CommandedTilt) -> Array:
    """Return theta at the point of a coarse grid of delays and wn that fits best.

    Args:
        measured: measured tilt (m, 2) [rad].
        commands: commands at the same times.
    """
    fits: list[tuple[float, Array]] = []  # sum of the squared residuals, and theta
    for delay_s in _GRID_DELAYS_S:
        for wn in _GRID_WN:
            shape = np.array([delay_s, wn, 0.7])
            unit_tilt = response(commands, shape)  # the tilt for a gain of one
            theta = np.concatenate([shape, _best_gain_and_errors(measured, unit_tilt)])
            cost = float((_residual(theta, unit_tilt, measured) ** 2).sum())
            fits.append((cost, theta))

    _, best = min(fits, key=lambda fit: fit[0])
    return best


def _best_gain_and_errors(measured: Array, unit_tilt: Array) -> Array:
    """Return the gain, error x and error y (3,) with which a response fits best.

    Args:
        measured: measured tilt (m, 2) [rad].
        unit_tilt: response with a gain of one (m, 2) [rad].
    """
    centred = unit_tilt - unit_tilt.mean(0)
    gain = float((centred * measured).sum() / max(float((centred * centred).sum()), 1e-12))
    error = (measured - gain * unit_tilt).mean(0)
    return np.concatenate([[gain], error])


def _refined(theta: Array, measured: Array, commands: CommandedTilt) -> tuple[Array, Array, Array]:
    """Improve theta by damped Gauss-Newton steps.

    Args:
        theta: a first guess (6,).
        measured: measured tilt (m, 2) [rad].
        commands: commands at the same times.

    Returns:
        theta (6,), its residual (2 m,) and the derivatives of the model's tilt (2 m, 6).
    """
    damping = 1e-3
    unit_tilt = response(commands, theta)
    residual = _residual(theta, unit_tilt, measured)
    jacobian = _derivatives(theta, unit_tilt, commands)
    for _ in range(_MAX_ROUNDS):
        normal = jacobian.T @ jacobian
        damped = normal + damping * np.diag(np.diag(normal) + 1e-12)
        trial = theta + np.linalg.solve(damped, jacobian.T @ residual)
        trial[:3] = np.clip(trial[:3], _LEAST, _MOST)

        trial_unit_tilt = response(commands, trial)
        trial_residual = _residual(trial, trial_unit_tilt, measured)
        is_better = trial_residual @ trial_residual < residual @ residual
        if not is_better:
            damping *= 10.0
            if damping > _MAX_DAMPING:
                break
            continue

        is_done = bool(np.all(np.abs(trial - theta) < 1e-5 * (1.0 + np.abs(theta))))
        theta = trial
        residual = trial_residual
        damping = max(0.2 * damping, 1e-9)
        jacobian = _derivatives(theta, trial_unit_tilt, commands)
        if is_done:
            break
    return theta, residual, jacobian


def _residual(theta: Array, unit_tilt: Array, measured: Array) -> Array:
    """Return the measured tilt minus the model's (2 m,) [rad]."""
    gain = theta[STATIC_GAIN]
    error = theta[ERRORS_RAD]
    return np.asarray((measured - gain * unit_tilt - error).ravel())


def _derivatives(theta: Array, unit_tilt: Array, commands: CommandedTilt) -> Array:
    """Return the derivatives of the model's tilt with respect to theta (2 m, 6)."""
    gain = theta[STATIC_GAIN]
    columns = []
    for index, half_step in enumerate(_HALF_STEPS):
        step = np.zeros(3)
        step[index] = half_step
        difference = response(commands, theta[:3] + step) - response(commands, theta[:3] - step)
        columns.append(gain * difference.ravel() / (2.0 * half_step))
    errors = np.tile(np.eye(2), (len(unit_tilt), 1))
    return np.stack([*columns, unit_tilt.ravel(), errors[:, 0], errors[:, 1]], axis=1)


def unexplained_times_s(log: Log, fit: LeastSquares, begin_s: float, end_s: float) -> Array:
    """Return the times at which the attitude did not follow the log's commands.

    The reason may be a failsafe, a push or a fall.

    Args:
        log: one stretch in the air.
        fit: fit of its attitude.
        begin_s: first time used [s].
        end_s: last time used [s].

    Returns:
        Times (k,) [s].
    """
    used = (log.attitude_time_s >= begin_s) & (log.attitude_time_s <= end_s)
    time_s = log.attitude_time_s[used]
    measured = tilt_vector_rad(log.attitude_quaternion_wxyz[used])

    gain = fit.theta[STATIC_GAIN]
    error = fit.theta[ERRORS_RAD]
    modelled = gain * response(commanded_tilt(log, time_s), fit.theta) + error
    difference = np.abs(measured - modelled).max(-1)
    return np.asarray(time_s[difference > _OUTLIER * np.median(difference)])


@dataclass(frozen=True, slots=True)
class CommandedTilt:
    """The last w commands before each of m times."""

    ago_s: Array  # (m, w): time since each command
    change: Array  # (m, w, 2): change of the commanded tilt by each command
    oldest: Array  # (m, 2): commanded tilt before the first of them

    def every(self, step: int) -> CommandedTilt:
        """Return the commands of every so-many-th time."""
        return CommandedTilt(
            ago_s=self.ago_s[::step], change=self.change[::step], oldest=self.oldest[::step]
        )


def commanded_tilt(log: Log, time_s: Array) -> CommandedTilt:
    """Return the commands that still influence the attitude at each time (m,)."""
    command = tilt_vector_rad(log.command_quaternion_wxyz)
    width = math.ceil(MEMORY_S / float(np.median(np.diff(log.command_time_s))))

    # for each time the indices of the last commands before it, the oldest first
    newest = np.searchsorted(log.command_time_s, time_s)
    index = newest[:, None] - np.arange(width, 0, -1)
    is_known = index > 0  # the first command has none before it, and so changes nothing
    index = np.maximum(index, 1)

    return CommandedTilt(
        ago_s=time_s[:, None] - log.command_time_s[index],
        change=np.diff(command, axis=0)[index - 1] * is_known[..., None],
        oldest=command[np.maximum(newest - width - 1, 0)],
    )


def response(commands: CommandedTilt, theta: Array) -> Array:
    """Return the tilt (m, 2) that follows commands with a gain of one; theta: delay, wn, zeta."""
    delay_s, wn, zeta = (float(value) for value in theta[:3])
    followed_share = step_response(commands.ago_s - delay_s, wn, zeta)  # of each command's change
    return np.asarray(commands.oldest + (followed_share[:, None, :] @ commands.change)[:, 0])


def step_response(time_s: Array, wn_rad_s: float, zeta: float) -> Array:
    """Return the response (...) of a second-order system to a step at time 0.

    It is looked up in a table in steps of 0.5 ms.
    """
    # the two poles; 1e-9 keeps them apart at critical damping, where fast - slow would be 0
    root = np.sqrt(complex(zeta * zeta - 1.0)) + 1e-9
    fast = wn_rad_s * (-zeta - root)
    slow = wn_rad_s * (-zeta + root)

    table_s = np.arange(0.0, MEMORY_S + 0.3, 0.0005)
    table = 1.0 + (slow * np.exp(fast * table_s) - fast * np.exp(slow * table_s)) / (fast - slow)
    return np.asarray(np.interp(time_s, table_s, table.real, left=0.0))
