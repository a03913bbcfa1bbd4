"""Frames and rotations: the fleet's ENU with FLU bodies, PX4's NED with FRD bodies, and quaternions between them.

Fleet, configuration, bus and control speak ENU/FLU only; NED/FRD appears in the link to PX4 and nowhere else.
Quaternions are Hamilton, ordered (w, x, y, z) as on MAVLink; ``q_enu_flu`` rotates FLU components into ENU components.
All functions broadcast over leading axes: vectors (..., 3), quaternions (..., 4), angles (...).
"""

from __future__ import annotations

import math
from typing import NewType

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PositionEnu = NewType("PositionEnu", NDArray[np.float64])
"""Metres in the fleet frame, shared origin (..., 3)."""
PositionLocalNed = NewType("PositionLocalNed", NDArray[np.float64])
"""Metres in one vehicle's own local frame (..., 3): its origin is where that vehicle's estimator started."""

_SQRT_HALF = math.sqrt(0.5)


def vector(x: Array | float, y: Array | float, z: Array | float) -> Array:
    """Components (...) assembled to vectors (..., 3); cheaper than ``np.stack`` for a single vehicle."""
    out = np.empty((*np.shape(x + y + z), 3))
    out[..., 0], out[..., 1], out[..., 2] = x, y, z
    return out


def enu_from_ned(vector_ned: Array) -> Array:
    """East, north, up from north, east, down; (..., 3) in any unit. The map is its own inverse."""
    return vector(vector_ned[..., 1], vector_ned[..., 0], -vector_ned[..., 2])


def ned_from_enu(vector_enu: Array) -> Array:
    """North, east, down from east, north, up; (..., 3) in any unit."""
    return enu_from_ned(vector_enu)


def quaternion_enu_flu_from_ned_frd(q_ned_frd: Array) -> Array:
    """PX4's attitude (FRD to NED) as the fleet's (FLU to ENU).

    R_enu_flu = R_enu_ned R_ned_frd R_frd_flu with R_enu_ned the half turn about (1, 1, 0)/sqrt(2) and R_frd_flu the
    half turn about x; multiplied out it is a permutation of the components, so only sqrt(1/2) is rounded.

    Args:
        q_ned_frd: (..., 4) wxyz.
    Returns:
        (..., 4) wxyz, level and nose north gives a quarter turn about up.
    """
    w, x, y, z = (
        q_ned_frd[..., 0],
        q_ned_frd[..., 1],
        q_ned_frd[..., 2],
        q_ned_frd[..., 3],
    )
    return _quaternion(
        _SQRT_HALF * (w + z),
        _SQRT_HALF * (x + y),
        _SQRT_HALF * (x - y),
        _SQRT_HALF * (w - z),
    )


def quaternion_ned_frd_from_enu_flu(q_enu_flu: Array) -> Array:
    """The fleet's attitude (FLU to ENU) as PX4's (FRD to NED); (..., 4) wxyz. The same permutation, its own inverse."""
    return quaternion_enu_flu_from_ned_frd(q_enu_flu)


def changed_frame_wxyz(quaternion: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """The same permutation, in either direction, of four plain numbers: for one vehicle ten times as fast."""
    w, x, y, z = quaternion
    return _SQRT_HALF * (w + z), _SQRT_HALF * (x + y), _SQRT_HALF * (x - y), _SQRT_HALF * (w - z)


def yaw_enu_from_ned_rad(yaw_ned_rad: Array | float) -> Array:
    """Counterclockwise-from-east heading from PX4's clockwise-from-north heading (...), wrapped; its own inverse."""
    return wrap_rad(0.5 * math.pi - np.asarray(yaw_ned_rad, dtype=np.float64))


def wrap_rad(angle_rad: Array | float) -> Array:
    """Angle (...) in [-pi, pi)."""
    return np.asarray((np.asarray(angle_rad) + math.pi) % (2.0 * math.pi) - math.pi, dtype=np.float64)


def quaternion_multiply(first: Array, second: Array) -> Array:
    """Hamilton product first * second, (..., 4) each: q_a_c = quaternion_multiply(q_a_b, q_b_c)."""
    w1, x1, y1, z1 = first[..., 0], first[..., 1], first[..., 2], first[..., 3]
    w2, x2, y2, z2 = second[..., 0], second[..., 1], second[..., 2], second[..., 3]
    return _quaternion(
        w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
        w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
        w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
        w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
    )


def quaternion_conjugate(quaternion: Array) -> Array:
    """The inverse of a unit quaternion (..., 4)."""
    return _quaternion(
        quaternion[..., 0],
        -quaternion[..., 1],
        -quaternion[..., 2],
        -quaternion[..., 3],
    )


def rotate(quaternion: Array, vector_in: Array) -> Array:
    """v_a = R_a_b v_b for unit quaternions (..., 4) and vectors (..., 3) of any unit.

    Written as v + 2 w (r x v) + 2 r x (r x v): 18 products, no matrix.
    """
    w, x, y, z = (
        quaternion[..., 0],
        quaternion[..., 1],
        quaternion[..., 2],
        quaternion[..., 3],
    )
    a, b, c = vector_in[..., 0], vector_in[..., 1], vector_in[..., 2]
    tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return vector(
        a + w * tx + y * tz - z * ty,
        b + w * ty + z * tx - x * tz,
        c + w * tz + x * ty - y * tx,
    )


def body_up(quaternion: Array) -> Array:
    """The body's z axis in the outer frame, (..., 3): the direction of thrust for q_enu_flu."""
    w, x, y, z = (
        quaternion[..., 0],
        quaternion[..., 1],
        quaternion[..., 2],
        quaternion[..., 3],
    )
    return vector(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))


def quaternion_from_yaw(yaw_rad: Array | float) -> Array:
    """A turn about z: yaw (...) to (..., 4) wxyz."""
    half = 0.5 * np.asarray(yaw_rad, dtype=np.float64)
    zero = 0.0 * half
    return _quaternion(np.cos(half), zero, zero, np.sin(half))


def yaw_from_quaternion(quaternion: Array) -> Array:
    """Heading (...) of the body's x axis, counterclockwise from the outer x axis (ZYX yaw), in (-pi, pi]."""
    w, x, y, z = (
        quaternion[..., 0],
        quaternion[..., 1],
        quaternion[..., 2],
        quaternion[..., 3],
    )
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)), dtype=np.float64)


def _quaternion(w: Array, x: Array, y: Array, z: Array) -> Array:
    out = np.empty((*np.shape(w), 4))
    out[..., 0], out[..., 1], out[..., 2], out[..., 3] = w, x, y, z
    return out
