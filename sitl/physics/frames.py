"""Quaternions (Hamilton, wxyz) and the frame changes of the emulator, batched over leading axes.

The emulator computes in PX4's frames, NED world and FRD body; the fleet's ENU and FLU appear only
where poses leave (motion capture, ground truth) and where start positions come in. This is a
second, independent writing of what the agents do in their own frame code: a shared mistake would
cancel and stay unseen.
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
_SWAPPED, _SWAP_SIGNS = [1, 0, 2], np.array([1.0, 1.0, -1.0])


def multiply(a: Array, b: Array) -> Array:
    """Hamilton product of quaternions (..., 4)."""
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


# both half turns around each of the four units: what is linear is one product
_ENU_FLU_OF_NED_FRD = multiply(
    multiply(np.tile(_Q_ENU_NED, (4, 1)), np.eye(4)), np.tile(_Q_FRD_FLU, (4, 1))
)


def from_yaw_and_tilt(yaw_rad: Array, tilt_rad: Array) -> Array:
    """Attitude NED <- FRD that turns by a heading, then tilts about a horizontal body axis.

    Args:
        yaw_rad: heading (...,) [rad].
        tilt_rad: rotation vector of the tilt (..., 2) about body x (roll) and body y (pitch) [rad].
    Returns:
        quaternion (..., 4).
    """
    angle = np.hypot(tilt_rad[..., 0], tilt_rad[..., 1])
    # np.sinc(x) is sin(pi x) / (pi x): smooth through zero tilt.
    scale = 0.5 * np.sinc(angle / (2.0 * math.pi))
    w, x, y = np.cos(0.5 * angle), scale * tilt_rad[..., 0], scale * tilt_rad[..., 1]
    cy, sy = np.cos(0.5 * yaw_rad), np.sin(0.5 * yaw_rad)
    out = np.empty((*angle.shape, 4))
    out[..., 0], out[..., 1], out[..., 2], out[..., 3] = (
        cy * w,
        cy * x - sy * y,
        cy * y + sy * x,
        sy * w,
    )
    return out


def uprightness(q: Array) -> float:
    """Cosine of the tilt of one attitude (4,): 1 level, 0 on the side, -1 upside down."""
    _, x, y, _ = q.tolist()
    return 1.0 - 2.0 * float(x * x + y * y)


def tilt_from_down(down: Array) -> Array:
    """Shortest rotation, as (..., 2) rotation vector [rad], that takes (0, 0, 1) to `down` (...,
    3).
    """
    x, y = down[..., 0], down[..., 1]
    horizontal = np.hypot(x, y)
    angle = np.arctan2(horizontal, down[..., 2])
    scale = np.where(horizontal > 1e-9, angle / np.maximum(horizontal, 1e-9), 1.0)
    return np.stack([-y * scale, x * scale], axis=-1)


def wrap(angle_rad: Array) -> Array:
    """Angle to (-pi, pi]."""
    return math.pi - np.mod(math.pi - angle_rad, 2.0 * math.pi)


def yaw_quaternion(yaw_rad: Array) -> Array:
    """Rotation about world z by `yaw_rad` (...,) as quaternion (..., 4)."""
    zero = np.zeros_like(yaw_rad)
    return np.stack([np.cos(0.5 * yaw_rad), zero, zero, np.sin(0.5 * yaw_rad)], axis=-1)


def euler(q: tuple[float, float, float, float]) -> tuple[float, float, float]:
    """Roll, pitch, yaw [rad] of one quaternion, as MAVLink's ATTITUDE wants them."""
    w, x, y, z = q
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return roll, pitch, yaw


def turned(q: Quaternion, heading_rad: float) -> Quaternion:
    """One attitude turned about the vertical."""
    w, x, y, z = q
    c, s = math.cos(0.5 * heading_rad), math.sin(0.5 * heading_rad)
    return c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w


def tilted(q: Quaternion, north_rad: float, east_rad: float) -> Quaternion:
    """One attitude turned about north and east, by little."""
    w, x, y, z = q
    a, b = 0.5 * north_rad, 0.5 * east_rad
    size = math.sqrt(1.0 + a * a + b * b)
    return (
        (w - a * x - b * y) / size,
        (x + a * w + b * z) / size,
        (y + b * w - a * z) / size,
        (z + a * y - b * x) / size,
    )


def swap_enu_ned(vector: Array) -> Array:
    """ENU to NED or back, (..., 3): the exchange is its own inverse."""
    return np.asarray(vector[..., _SWAPPED] * _SWAP_SIGNS)


def enu_flu_from_ned_frd(q: Array) -> Array:
    """Attitude NED <- FRD (..., 4) as ENU <- FLU (..., 4), with w >= 0."""
    turned = q @ _ENU_FLU_OF_NED_FRD
    return np.asarray(np.where(turned[..., :1] < 0.0, -turned, turned))
