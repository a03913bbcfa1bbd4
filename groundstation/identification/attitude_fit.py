"""Attitude of the identification: commanded tilt through dead time, second order, static gain and
constant error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from groundstation.identification.flight_log import MEMORY_S, Fit, Log, jackknife, tilt_vector_rad
from onboard.arrays import Array

_CLUSTER_S = 1.0
_GRID_DELAYS_S = (0.0, 0.03, 0.06, 0.1, 0.15, 0.2)
_GRID_WN = (4.0, 6.0, 9.0, 14.0, 22.0)
_OUTLIER = 6.0  # times the median
_STEPS = np.array([1e-3, 1e-2, 1e-3])


def fit_attitude(log: Log, begin_s: float, end_s: float) -> Fit:
    """Fit the attitude's response to the commanded tilt: Gauss-Newton from the best of a grid.

    Args:
        log: one stretch in the air.
        begin_s: first time used [s].
        end_s: last time used [s].

    Returns:
        theta: delay [s], wn [rad/s], zeta, gain, error x, error y [rad].
    """
    used = (log.attitude_time_s >= begin_s) & (log.attitude_time_s <= end_s)
    time_s = log.attitude_time_s[used]
    measured = tilt_vector_rad(log.attitude_quaternion_wxyz[used])
    commands = commanded_tilt(log, time_s)
    rough = CommandedTilt(commands.ago_s[::4], commands.change[::4], commands.oldest[::4])
    cluster = np.repeat((time_s / _CLUSTER_S).astype(np.int64), 2)

    def linear(theta: Array) -> tuple[Array, Array]:
        """Fit gain and errors, and return them with the model's tilt, on every fourth sample."""
        shape = response(rough, theta)
        centred = shape - shape.mean(0)
        gain = float((centred * measured[::4]).sum() / max(float((centred * centred).sum()), 1e-12))
        error = (measured[::4] - gain * shape).mean(0)
        return np.concatenate([[gain], error]), gain * shape + error

    def cost(theta: Array) -> float:
        return float(((measured[::4] - linear(theta)[1]) ** 2).sum())

    best = min(
        (np.array([delay, wn, 0.7]) for delay in _GRID_DELAYS_S for wn in _GRID_WN), key=cost
    )
    theta = np.concatenate([best, linear(best)[0]])

    def shape_at(values: Array) -> Array:
        return response(commands, values)

    def residuals(values: Array, shape: Array) -> Array:
        return np.asarray((measured - values[3] * shape - values[4:6]).ravel())

    def slopes(values: Array, shape: Array) -> Array:
        columns = [
            values[3]
            * (shape_at(values[:3] + one) - shape_at(values[:3] - one)).ravel()
            / (2.0 * one.sum())
            for one in np.diag(_STEPS)
        ]
        errors = np.tile(np.eye(2), (time_s.size, 1))
        return np.stack([*columns, shape.ravel(), errors[:, 0], errors[:, 1]], axis=1)

    damping, shape = 1e-3, shape_at(theta)
    residual = residuals(theta, shape)
    jacobian = slopes(theta, shape)
    for _ in range(25):
        normal = jacobian.T @ jacobian
        move = np.linalg.solve(
            normal + damping * np.diag(np.diag(normal) + 1e-12), jacobian.T @ residual
        )
        moved = theta + move
        moved[:3] = np.clip(moved[:3], [-0.02, 1.5, 0.15], [0.5, 60.0, 3.0])
        shape = shape_at(moved)
        left = residuals(moved, shape)
        if left @ left >= residual @ residual:
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        is_done = bool(np.all(np.abs(moved - theta) < 1e-5 * (1.0 + np.abs(theta))))
        theta, residual, damping = moved, left, max(0.2 * damping, 1e-9)
        jacobian = slopes(theta, shape)
        if is_done:
            break
    std, clusters = jackknife(jacobian, residual, cluster)
    return Fit(theta, std, float(np.sqrt(np.mean(residual**2))), clusters)


def unexplained_times_s(log: Log, fit: Fit, begin_s: float, end_s: float) -> Array:
    """Find the times at which the attitude did not follow the log's commands: a failsafe, a push, a
    fall.

    Args:
        log: one stretch in the air.
        fit: of its attitude.
        begin_s: first time used [s].
        end_s: last time used [s].

    Returns:
        Times (k,) [s].
    """
    used = (log.attitude_time_s >= begin_s) & (log.attitude_time_s <= end_s)
    time_s = log.attitude_time_s[used]
    modelled = fit.theta[3] * response(commanded_tilt(log, time_s), fit.theta) + fit.theta[4:6]
    off = np.abs(tilt_vector_rad(log.attitude_quaternion_wxyz[used]) - modelled).max(-1)
    return np.asarray(time_s[off > _OUTLIER * np.median(off)])


@dataclass(frozen=True, slots=True)
class CommandedTilt:
    """The last w commands before each of m times."""

    ago_s: Array  # (m, w): time since each command
    change: Array  # (m, w, 2): change of tilt by each command
    oldest: Array  # (m, 2): tilt before the first of them


def commanded_tilt(log: Log, time_s: Array) -> CommandedTilt:
    """Collect the commands that the attitude still remembers at each time (m,)."""
    command = tilt_vector_rad(log.command_quaternion_wxyz)
    width = math.ceil(MEMORY_S / float(np.median(np.diff(log.command_time_s))))
    newest = np.searchsorted(log.command_time_s, time_s)
    index = newest[:, None] - np.arange(width, 0, -1)
    is_known = index > 0
    index = np.maximum(index, 1)
    change = np.diff(command, axis=0)[index - 1] * is_known[..., None]
    oldest = command[np.maximum(newest - width - 1, 0)]
    return CommandedTilt(time_s[:, None] - log.command_time_s[index], change, oldest)


def response(commands: CommandedTilt, theta: Array) -> Array:
    """Return the tilt (m, 2) that follows the commands with a gain of one; theta: delay, wn, zeta."""
    delay_s, wn, zeta = (float(value) for value in theta[:3])
    share = step_response(commands.ago_s - delay_s, wn, zeta)
    return np.asarray(commands.oldest + (share[:, None, :] @ commands.change)[:, 0])


def step_response(time_s: Array, wn_rad_s: float, zeta: float) -> Array:
    """Return the response (...) of a second-order system to a step at time 0, from a table in steps
    of 0.5 ms.
    """
    root = np.sqrt(complex(zeta * zeta - 1.0)) + 1e-9
    fast, slow = wn_rad_s * (-zeta - root), wn_rad_s * (-zeta + root)
    late = np.arange(0.0, MEMORY_S + 0.3, 0.0005)
    answer = 1.0 + (slow * np.exp(fast * late) - fast * np.exp(slow * late)) / (fast - slow)
    return np.asarray(np.interp(time_s, late, answer.real, left=0.0))
