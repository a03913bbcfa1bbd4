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
    """Return the closest pair in which one vehicle flies and one was just updated.

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
    updated = np.flatnonzero(is_updated)  # indices of the updated vehicles (u,)
    if not len(updated) or not is_up.any():
        return None

    offsets = position_enu_m[updated, None] - position_enu_m[None]  # (u, n, 3)
    distances_m = separations_m(offsets, height_share)  # (u, n)
    distances_m[~(is_up[updated, None] | is_up[None])] = np.inf  # both stand on the ground
    distances_m[np.arange(len(updated)), updated] = np.inf  # a vehicle and itself

    row, other = np.unravel_index(distances_m.argmin(), distances_m.shape)
    smallest_m = float(distances_m[row, other])
    if smallest_m >= below_m:
        return None
    return int(updated[row]), int(other), smallest_m
