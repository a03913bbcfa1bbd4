"""Quaternions (Hamilton, wxyz) and the frame changes of the emulator, batched over leading axes.

The emulator computes in PX4's frames, NED world and FRD body. The fleet's ENU and FLU appear only
in poses that leave the emulator (motion capture, ground truth) and in start positions. This module
is independent of the frame code of the agents, because a mistake in shared code would cancel out
unseen.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Quaternion = tuple[float, float, float, float]

# ENU <- NED is half a turn about the horizontal diagonal; FRD <- FLU is half a turn about the nose.
_Q_ENU_NED = np.array([0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0])
_Q_FRD_FLU = np.array([0.0, 1.0, 0.0, 0.0])
# A vector changes between ENU and NED by this order of its axes and these signs.
_SWAPPED = [1, 0, 2]
_SWAP_SIGNS = np.array([1.0, 1.0, -1.0])
_MIN_SINE = 1e-9  # below this sine of a tilt the angle is taken to equal its sine


def multiply(a: Array, b: Array) -> Array:
    """Return the Hamilton product of quaternions (..., 4)."""
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


# The product of both half turns is linear in the quaternion between them, so it is one matrix. Each
# row of the matrix is the product for one of the units 1, i, j, k.
_ENU_FLU_OF_NED_FRD = multiply(
    multiply(np.tile(_Q_ENU_NED, (4, 1)), np.eye(4)), np.tile(_Q_FRD_FLU, (4, 1))
)


def from_yaw_and_tilt(yaw_rad: Array, tilt_rad: Array) -> Array:
    """Return the attitude NED <- FRD that turns by a heading, then tilts about a horizontal axis.

    Args:
        yaw_rad: heading (...,) [rad].
        tilt_rad: rotation vector of the tilt (..., 2) about body x (roll) and body y (pitch) [rad].
    Returns:
        quaternion (..., 4).
    """
    angle = np.hypot(tilt_rad[..., 0], tilt_rad[..., 1])

    # Quaternion of the tilt. np.sinc(x) is sin(pi x) / (pi x), which is smooth through zero.
    scale = 0.5 * np.sinc(angle / (2.0 * math.pi))
    w = np.cos(0.5 * angle)
    x = scale * tilt_rad[..., 0]
    y = scale * tilt_rad[..., 1]

    # Product of the heading and the tilt.
    cy = np.cos(0.5 * yaw_rad)
    sy = np.sin(0.5 * yaw_rad)
    attitude = np.empty((*angle.shape, 4))
    attitude[..., 0] = cy * w
    attitude[..., 1] = cy * x - sy * y
    attitude[..., 2] = cy * y + sy * x
    attitude[..., 3] = sy * w
    return attitude


def uprightness(q: Array) -> float:
    """Return the cosine of an attitude's tilt: 1 level, 0 on the side, -1 upside down."""
    _, x, y, _ = q.tolist()
    return 1.0 - 2.0 * float(x * x + y * y)


def tilt_from_down(down: Array) -> Array:
    """Return the shortest rotation that takes (0, 0, 1) to `down`.

    Args:
        down: unit vectors (..., 3).

    Returns:
        rotation vectors (..., 2) about x and y [rad].
    """
    x = down[..., 0]
    y = down[..., 1]
    horizontal = np.hypot(x, y)
    angle = np.arctan2(horizontal, down[..., 2])
    divisor = np.maximum(horizontal, _MIN_SINE)
    scale = np.where(horizontal > _MIN_SINE, angle / divisor, 1.0)
    return np.stack([-y * scale, x * scale], axis=-1)


def wrap(angle_rad: Array) -> Array:
    """Return an angle in (-pi, pi]."""
    return math.pi - np.mod(math.pi - angle_rad, 2.0 * math.pi)


def yaw_quaternion(yaw_rad: Array) -> Array:
    """Return the rotation about world z by `yaw_rad` (...,) as quaternion (..., 4)."""
    zero = np.zeros_like(yaw_rad)
    return np.stack([np.cos(0.5 * yaw_rad), zero, zero, np.sin(0.5 * yaw_rad)], axis=-1)


def euler(q: tuple[float, float, float, float]) -> tuple[float, float, float]:
    """Return roll, pitch, yaw [rad] of one quaternion, as MAVLink's ATTITUDE has them."""
    w, x, y, z = q
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return roll, pitch, yaw


def turned(q: Quaternion, heading_rad: float) -> Quaternion:
    """Return an attitude turned about the vertical."""
    w, x, y, z = q
    c = math.cos(0.5 * heading_rad)
    s = math.sin(0.5 * heading_rad)
    return c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w


def tilted(q: Quaternion, north_rad: float, east_rad: float) -> Quaternion:
    """Return an attitude turned about north and east by small angles."""
    # Product of the small turn (1, a, b, 0) and the attitude.
    w, x, y, z = q
    a = 0.5 * north_rad
    b = 0.5 * east_rad
    size = math.sqrt(1.0 + a * a + b * b)
    return (
        (w - a * x - b * y) / size,
        (x + a * w + b * z) / size,
        (y + b * w - a * z) / size,
        (z + a * y - b * x) / size,
    )


def swap_enu_ned(vector: Array) -> Array:
    """Return vectors (..., 3) of ENU in NED, or vectors of NED in ENU."""
    return np.asarray(vector[..., _SWAPPED] * _SWAP_SIGNS)


def enu_flu_from_ned_frd(q: Array) -> Array:
    """Return attitudes NED <- FRD (..., 4) as ENU <- FLU (..., 4), with w >= 0."""
    turned = q @ _ENU_FLU_OF_NED_FRD
    return np.asarray(np.where(turned[..., :1] < 0.0, -turned, turned))
