"""Input of the identification: one logged stretch in the air; and least squares for correlated
residuals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onboard.arrays import Array, IntArray

MEMORY_S = 2.0  # a command has no effect on the attitude any more


class TooLittleFlown(ValueError):
    """The log is not enough for an identification: a sentence with the remedy."""


@dataclass(frozen=True, slots=True)
class Log:
    """One stretch in the air, all times on one clock [s], each increasing."""

    command_time_s: Array  # (n,)
    command_quaternion_wxyz: Array  # (n, 4): FLU to ENU, held until the next command
    thrust_frac: Array  # (n,)
    attitude_time_s: Array  # (m,)
    attitude_quaternion_wxyz: Array  # (m, 4): flown
    position_time_s: Array  # (k,)
    position_enu_m: Array  # (k, 3)
    # of an attitude at its time: an attitude over a link was measured earlier
    attitude_age_s: float = 0.0
    attitude_age_std_s: float = 0.002  # standard deviation of the same


@dataclass(frozen=True, slots=True)
class Fit:
    """Result of a least-squares fit."""

    theta: Array  # (p,)
    std: Array  # (p,)
    rms: float  # of the residuals
    clusters: int  # number of them


def tilt_vector_rad(quaternion_wxyz: Array) -> Array:
    """Return the tilt of the thrust (..., 2): angle from the vertical times its horizontal
    direction in ENU.
    """
    w, x, y, z = np.moveaxis(quaternion_wxyz, -1, 0)
    # horizontal part of the body's z axis
    up = np.stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x)], axis=-1)
    horizontal = np.hypot(up[..., 0], up[..., 1])
    angle = np.arctan2(horizontal, 1.0 - 2.0 * (x * x + y * y))
    return np.asarray(
        up * np.where(horizontal > 1e-9, angle / np.maximum(horizontal, 1e-9), 1.0)[..., None]
    )


def jackknife(jacobian: Array, residual: Array, cluster: IntArray) -> tuple[Array, int]:
    """Compute standard deviations (p,) by the jackknife over clusters (r,), and the number of
    clusters.

    Residuals may be correlated within a cluster, and between neighbours (numbers that differ by
    one), which enter with half their product. Leaving out whole clusters stays correct where few of
    them carry most of the information.
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
