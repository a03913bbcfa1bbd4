"""Separation of a whole fleet at once. Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.config.pair_separation import separations_m


def closest_pair(
    position_enu_m: NDArray[np.float64],
    is_up: NDArray[np.bool_],
    is_updated: NDArray[np.bool_],
    below_m: float,
    height_share: float,
) -> tuple[int, int, float] | None:
    """Return the closest two vehicles, of which one flies and one was just updated.

    Only pairs with an updated vehicle are compared, because a large fleet has many pairs.

    Args:
        position_enu_m: positions (n, 3) [m].
        is_up: whether each flies (n,).
        is_updated: whether each position is new (n,).
        below_m: limit; only separations below it are returned [m].
        height_share: weight of a metre of height.

    Returns:
        Both indices and the separation [m]; None if no two vehicles are that close.
    """
    rows = np.flatnonzero(is_updated)
    if not len(rows) or not is_up.any():
        return None

    offsets = position_enu_m[rows, None] - position_enu_m[None]  # (updated, n, 3)
    distances_m = separations_m(offsets, height_share)
    distances_m[~(is_up[rows, None] | is_up[None])] = np.inf  # both stand on the ground
    distances_m[np.arange(len(rows)), rows] = np.inf  # a vehicle and itself

    # argmin counts through the matrix row by row; a row has one distance for each vehicle
    row, other = divmod(int(distances_m.argmin()), len(position_enu_m))
    smallest_m = float(distances_m[row, other])
    if smallest_m >= below_m:
        return None
    return int(rows[row]), other, smallest_m
