"""The input of the identification (one logged stretch in the air) and the tools that fits share.

Residuals are correlated (gusts, thrust noise, model error), so the usual standard deviations of
least squares would be too small: see :func:`jackknife`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onboard.arrays import Array, IntArray

MEMORY_S = 2.0  # a command that is older than this no longer affects the attitude


class TooLittleFlown(ValueError):
    """The log is not enough for an identification; the message says why, with the remedy."""


@dataclass(frozen=True, slots=True)
class Log:
    """One stretch in the air, all times on one clock [s], each increasing."""

    command_time_s: Array  # (n,)
    command_quaternion_wxyz: Array  # (n, 4): FLU to ENU, held until the next command
    thrust_frac: Array  # (n,)
    attitude_time_s: Array  # (m,)
    attitude_quaternion_wxyz: Array  # (m, 4): measured, FLU to ENU
    position_time_s: Array  # (k,)
    position_enu_m: Array  # (k, 3)
    # time from the measurement of an attitude to its stamp, which is not 0 over a link
    attitude_age_s: float = 0.0
    attitude_age_std_s: float = 0.002  # standard deviation of that age


@dataclass(frozen=True, slots=True)
class LeastSquares:
    """Result of a least-squares fit."""

    theta: Array  # (p,) parameters
    std: Array  # (p,) their standard deviations
    rms: float  # rms of the residuals
    clusters: int  # number of clusters of the jackknife


def tilt_vector_rad(quaternion_wxyz: Array) -> Array:
    """Return the thrust's tilt (..., 2): its angle [rad] times its horizontal direction, ENU."""
    w, x, y, z = np.moveaxis(quaternion_wxyz, -1, 0)

    # horizontal part of the body's z axis
    up = np.stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x)], axis=-1)
    horizontal = np.hypot(up[..., 0], up[..., 1])
    angle = np.arctan2(horizontal, 1.0 - 2.0 * (x * x + y * y))

    # The length of `up` is the sine of the tilt; it is stretched to the angle. Near the vertical
    # both are equal, and their quotient would be 0 / 0.
    stretch = np.where(horizontal > 1e-9, angle / np.maximum(horizontal, 1e-9), 1.0)
    return np.asarray(up * stretch[..., None])


def jackknife(jacobian: Array, residual: Array, cluster: IntArray) -> tuple[Array, int]:
    """Return standard deviations (p,) by the jackknife over clusters, and the number of clusters.

    Residuals may be correlated within a cluster, and between neighbouring clusters (whose numbers
    differ by one). The jackknife leaves out whole clusters, which stays correct if few of them
    carry most of the information.

    Args:
        jacobian: derivatives (r, p) of the residuals.
        residual: residuals (r,).
        cluster: number (r,) of the cluster of each residual.
    """
    names, index = np.unique(cluster, return_inverse=True)
    count = names.size
    size = jacobian.shape[1]

    # sums over the samples of each cluster
    scores = np.zeros((count, size))
    weights = np.zeros((count, size, size))
    np.add.at(scores, index, jacobian * residual[:, None])
    np.add.at(weights, index, jacobian[:, :, None] * jacobian[:, None, :])

    # change (clusters, p) of the result when a cluster is left out
    changes = (np.linalg.pinv(weights.sum(0) - weights) @ scores[..., None])[..., 0]

    # Sums (p,) of the squares, and of the products of neighbouring clusters. Each product occurs
    # twice in the square of a sum, and counts by half (Bartlett's weight). They could lower the
    # variance only by chance, so they are not allowed to.
    squares = np.einsum("ci,ci->i", changes, changes)
    is_next = np.diff(names) == 1
    products = np.einsum("ci,ci->i", changes[:-1][is_next], changes[1:][is_next])
    variance = (count - 1) / count * np.maximum(squares + products, squares)
    return np.sqrt(variance), count
