"""The separation of two vehicles, for the law, checks, alarms, verdict and console. Pure.

Two vehicles are apart if their horizontal distance is at least ``safety_distance_m``, or if their
heights differ by at least ``vertical_separation_m``. The separation combines both in one number: it
is the larger of the horizontal distance and the scaled difference of the heights. The scale
``height_share`` makes the vertical separation equal to the safety distance. Without a vertical
separation the scale is 0, and the separation is the horizontal distance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def separation_m(
    one_enu_m: Sequence[float], other_enu_m: Sequence[float], height_share: float
) -> float:
    """Return the separation of two vehicles [m].

    Args:
        one_enu_m: position of one vehicle [m], ENU.
        other_enu_m: position of the other vehicle [m], ENU.
        height_share: metres that one metre of height counts as, ``FleetSection.height_share``.
    """
    x1, y1, z1 = one_enu_m
    x2, y2, z2 = other_enu_m
    horizontal_m = math.dist((x1, y1), (x2, y2))
    if height_share <= 0.0:
        return horizontal_m
    return max(horizontal_m, height_share * abs(z1 - z2))


def separations_m(offset_m: Array, height_share: float) -> Array:
    """Return the separations (...) of many pairs [m].

    Args:
        offset_m: differences of the two positions of each pair (..., 3) [m], ENU.
        height_share: metres that one metre of height counts as, ``FleetSection.height_share``.
    """
    horizontal_m = np.hypot(offset_m[..., 0], offset_m[..., 1])
    if height_share <= 0.0:
        return np.asarray(horizontal_m)
    return np.asarray(np.maximum(horizontal_m, height_share * np.abs(offset_m[..., 2])))
