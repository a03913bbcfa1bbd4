"""A vector turned by a quaternion: what the product nowhere needs, since it turns no vector but the
body's own axes.
"""

from __future__ import annotations

from onboard.frames import Quaternion, Triple
from onboard.vectors import Vec3


def rotate(quaternion: Quaternion, vector: Triple) -> Vec3:
    """Return v_a = R_a_b v_b for a unit quaternion q_a_b and a vector of any unit.

    Written as v + 2 w (r x v) + 2 r x (r x v): 18 products, no matrix.
    """
    w, x, y, z = quaternion
    a, b, c = vector
    t_x, t_y, t_z = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return Vec3(
        a + w * t_x + y * t_z - z * t_y,
        b + w * t_y + z * t_x - x * t_z,
        c + w * t_z + x * t_y - y * t_x,
    )
