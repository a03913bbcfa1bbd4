"""Rotations in general, which the product nowhere needs: it turns no vector but the body's own
axes, and no attitude but about the vertical.
"""

from __future__ import annotations

import math

from onboard.frames import Quaternion, Triple
from onboard.vectors import Vec3


def rotate(quaternion: Quaternion, vector: Triple) -> Vec3:
    """Return v_a = R_a_b v_b for a unit quaternion q_a_b and a vector of any unit.

    Written as v + 2 w (r x v) + 2 r x (r x v): 18 products, no matrix.
    """
    w, x, y, z = quaternion
    a, b, c = vector
    t_x = 2.0 * (y * c - z * b)
    t_y = 2.0 * (z * a - x * c)
    t_z = 2.0 * (x * b - y * a)
    return Vec3(
        a + w * t_x + y * t_z - z * t_y,
        b + w * t_y + z * t_x - x * t_z,
        c + w * t_z + x * t_y - y * t_x,
    )


def quaternion_multiply(first: Quaternion, second: Quaternion) -> Quaternion:
    """Return the Hamilton product: q_a_c of q_a_b and q_b_c."""
    w1, x1, y1, z1 = first
    w2, x2, y2, z2 = second
    return (
        w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
        w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
        w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
        w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
    )


def quaternion_from_yaw(yaw_rad: float) -> Quaternion:
    """Return a turn about z."""
    return math.cos(0.5 * yaw_rad), 0.0, 0.0, math.sin(0.5 * yaw_rad)
