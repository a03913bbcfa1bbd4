"""The separation of a pair, as everything in Covey judges it. Pure.

Law, checks, alarms, verdict and console use it.

Vehicles are apart when their horizontal distance is at least ``safety_distance_m``, or their
heights differ by ``vertical_separation_m``. One number says both: the larger of the horizontal
distance and of the height difference, which counts so much a metre that the vertical separation is
as good as the safety distance. Without a vertical separation a metre of height counts nothing, and
the number is the horizontal distance.
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
        one_enu_m: position of the one [m], ENU.
        other_enu_m: position of the other [m], ENU.
        height_share: what a metre of height counts, ``FleetSection.height_share``.
    """
    horizontal_m = math.dist(one_enu_m[:2], other_enu_m[:2])
    if height_share <= 0.0:
        return horizontal_m
    return max(horizontal_m, height_share * abs(one_enu_m[2] - other_enu_m[2]))


def separations_m(offset_m: Array, height_share: float) -> Array:
    """Return the separations (...) of many pairs [m].

    Args:
        offset_m: positions of the ones less those of the others (..., 3) [m], ENU.
        height_share: as above.
    """
    horizontal_m = np.hypot(offset_m[..., 0], offset_m[..., 1])
    if height_share <= 0.0:
        return np.asarray(horizontal_m)
    return np.asarray(np.maximum(horizontal_m, height_share * np.abs(offset_m[..., 2])))
