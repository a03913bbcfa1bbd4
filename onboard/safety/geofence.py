"""How far a vehicle is from the fence, and when it would cross it: plain geometry, batched.

The fence is a box in fleet ENU. Its floor does not count as a wall: that is where vehicles stand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onboard.types import Array, BoolArray

Vec3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Fence:
    """Box in fleet ENU [m]; floor_tolerance_m: how far below the lowest corner a landed vehicle may be measured."""

    low_enu_m: Vec3
    high_enu_m: Vec3
    floor_tolerance_m: float = 0.5


def distance_m(position_enu_m: Array, *, fence: Fence) -> Array:
    """Distance (...) from a position (..., 3) to the nearest wall or the ceiling; negative outside by how far.

    A position that is not finite is outside by infinity: nobody knows that it is inside.
    Properties: 0 on the wall; changes by at most the distance moved; batch equals loop.
    """
    low, high = np.asarray(fence.low_enu_m), np.asarray(fence.high_enu_m)
    position = np.asarray(position_enu_m, dtype=np.float64)
    known = np.asarray(np.isfinite(position).all(axis=-1))
    position = np.where(known[..., None], position, 0.0)
    below = position - low
    below[..., 2] += fence.floor_tolerance_m
    # the floor confines only from outside: standing on it is no closeness to a wall
    below[..., 2] = np.where(below[..., 2] >= 0.0, np.inf, below[..., 2])
    gap = np.minimum(below, high - position)
    inside = gap.min(axis=-1)
    outside = np.sqrt(np.square(np.minimum(gap, 0.0)).sum(axis=-1))
    return np.where(known, np.where(inside >= 0.0, inside, -outside), -np.inf)


def contains(position_enu_m: Array, *, fence: Fence, margin_m: float = 0.0) -> BoolArray:
    """Whether a position (..., 3) keeps at least ``margin_m`` from walls and ceiling, (...)."""
    return np.asarray(distance_m(position_enu_m, fence=fence) >= margin_m)


def crossing_time_s(position_enu_m: Array, velocity_enu_m_s: Array, *, fence: Fence) -> Array:
    """Time (...) until a wall or the ceiling is reached at constant velocity (..., 3); inf if never, 0 if outside."""
    low, high = np.asarray(fence.low_enu_m), np.asarray(fence.high_enu_m)
    position, velocity = np.asarray(position_enu_m, dtype=np.float64), np.asarray(velocity_enu_m_s, dtype=np.float64)
    wall = np.where(velocity > 0.0, high, low)
    moving = np.abs(velocity) > 1e-9
    moving[..., 2] &= velocity[..., 2] > 0.0  # sinking ends on the floor
    times = np.where(moving, (wall - position) / np.where(moving, velocity, 1.0), np.inf)
    inside = contains(position, fence=fence)
    return np.where(inside & np.isfinite(velocity).all(axis=-1), np.maximum(times.min(axis=-1), 0.0), 0.0)


def stopping_distance_m(speed_m_s: Array, *, deceleration_m_s2: float, reaction_s: float) -> Array:
    """Way (...) that a vehicle needs to stop: reaction (its attitude lag and the age of its state) and braking."""
    return np.asarray(speed_m_s * reaction_s + np.square(speed_m_s) / (2.0 * deceleration_m_s2))


def nearest_inside(position_enu_m: Array, *, fence: Fence, margin_m: float) -> Array:
    """The point (..., 3) inside the fence by ``margin_m`` that is nearest to a position (..., 3).

    A box too small for the margin gives its middle.
    """
    low, high = np.array(fence.low_enu_m), np.array(fence.high_enu_m)
    middle = 0.5 * (low + high)
    lowest = np.minimum(low + np.array([margin_m, margin_m, 0.0]), middle)
    return np.asarray(np.minimum(np.maximum(position_enu_m, lowest), np.maximum(high - margin_m, middle)))
