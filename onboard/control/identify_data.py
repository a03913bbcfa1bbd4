"""What the identification works on: one logged stretch in the air; least squares that admit correlated residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onboard.frames import body_up
from onboard.types import Array, IntArray

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
    up = body_up(quaternion_wxyz)
    horizontal = np.sqrt(up[..., 0] ** 2 + up[..., 1] ** 2)
    angle = np.arctan2(horizontal, up[..., 2])
    return np.asarray(up[..., :2] * np.where(horizontal > 1e-9, angle / np.maximum(horizontal, 1e-9), 1.0)[..., None])


def sandwich(jacobian: Array, residual: Array, cluster: IntArray) -> tuple[Array, int]:
    """Standard deviations (p,) that allow for residuals that are correlated within a cluster."""
    names, index = np.unique(cluster, return_inverse=True)
    scores = np.zeros((names.size, jacobian.shape[1]))
    np.add.at(scores, index, jacobian * residual[:, None])
    bread = np.linalg.pinv(jacobian.T @ jacobian)
    count, free = names.size, jacobian.shape[1]
    next_to = np.diff(names) == 1  # what is slower than a cluster: Bartlett's half of the products of neighbours
    between = scores[:-1][next_to].T @ scores[1:][next_to]
    meat = scores.T @ scores + 0.5 * (between + between.T)
    covariance = bread @ meat @ bread * (count / max(count - free, 1))
    plain = bread @ (scores.T @ scores) @ bread
    return np.sqrt(np.maximum(np.diag(covariance), np.diag(plain))), count
