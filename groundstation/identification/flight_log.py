"""What the identification works on: one logged stretch in the air; least squares that admit correlated residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onboard.arrays import Array, IntArray

MEMORY_S = 2.0  # after which a command is forgotten by the attitude


class TooLittleFlown(ValueError):
    """The log does not hold what is needed: a sentence with the remedy."""


@dataclass(frozen=True, slots=True)
class Log:
    """One stretch in the air, all times on one clock [s], each increasing.

    Commands: command_time_s (n,), command_quaternion_wxyz (n, 4) FLU to ENU, thrust_frac (n,), held until the next.
    Attitude flown: attitude_time_s (m,), attitude_quaternion_wxyz (m, 4). Position: position_time_s (k,),
    position_enu_m (k, 3).
    attitude_age_s, attitude_age_std_s: how old an attitude is at its time, and how well that is known: a mocap's own
    stamps are exact, an attitude that came over a link was measured earlier.
    """

    command_time_s: Array
    command_quaternion_wxyz: Array
    thrust_frac: Array
    attitude_time_s: Array
    attitude_quaternion_wxyz: Array
    position_time_s: Array
    position_enu_m: Array
    attitude_age_s: float = 0.0
    attitude_age_std_s: float = 0.002


@dataclass(frozen=True, slots=True)
class Fit:
    """theta and its std (p,), rms of the residuals, number of clusters."""

    theta: Array
    std: Array
    rms: float
    clusters: int


def tilt_vector_rad(quaternion_wxyz: Array) -> Array:
    """Where the thrust leans (..., 2): angle from the vertical times its horizontal direction in ENU."""
    w, x, y, z = np.moveaxis(quaternion_wxyz, -1, 0)
    up = np.stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x)], axis=-1)  # horizontal part of the body's z axis
    horizontal = np.hypot(up[..., 0], up[..., 1])
    angle = np.arctan2(horizontal, 1.0 - 2.0 * (x * x + y * y))
    return np.asarray(up * np.where(horizontal > 1e-9, angle / np.maximum(horizontal, 1e-9), 1.0)[..., None])


def jackknife(jacobian: Array, residual: Array, cluster: IntArray) -> tuple[Array, int]:
    """Standard deviations (p,) by the jackknife over clusters (r,), and the number of clusters.

    Residuals may be correlated within a cluster, and between neighbours (numbers that differ by one), which enter with
    half their product. Leaving out whole clusters is honest where few of them carry most of what is known.
    """
    names, index = np.unique(cluster, return_inverse=True)
    count, size = names.size, jacobian.shape[1]
    scores, weights = np.zeros((count, size)), np.zeros((count, size, size))
    np.add.at(scores, index, jacobian * residual[:, None])
    np.add.at(weights, index, jacobian[:, :, None] * jacobian[:, None, :])
    moved = (np.linalg.pinv(weights.sum(0) - weights) @ scores[..., None])[..., 0]
    own = np.einsum("ci,ci->i", moved, moved)
    is_next = np.diff(names) == 1
    between = np.einsum("ci,ci->i", moved[:-1][is_next], moved[1:][is_next])
    variance = (count - 1) / count * np.maximum(own + between, own)
    return np.sqrt(variance), count
