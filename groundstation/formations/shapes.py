"""Slots of shapes that a few numbers describe: lines, circles, grids and so on. Pure.

North is ahead. Each function takes the number of slots and returns positions (N, 3) in arbitrary
units. The caller stretches and turns them later.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from onboard.arrays import Array

_GOLDEN_RAD = math.pi * (3.0 - math.sqrt(5.0))  # golden angle, which spreads points evenly
_ROUNDING = 1e-9  # allowance for rounding errors of a number of sides


def line(count: int) -> Array:
    """Return slots side by side, the first in the west."""
    return _flat([(float(index), 0.0) for index in range(count)])


def column(count: int) -> Array:
    """Return slots one behind the other, the first ahead."""
    return _flat([(0.0, -float(index)) for index in range(count)])


def v(count: int, opening_deg: float) -> Array:
    """Return two arms behind the first slot; the slots are on its right and left in turn."""
    half_rad = math.radians(0.5 * opening_deg)
    slots = []
    for index in range(count):
        row = (index + 1) // 2
        side = (-1.0) ** index
        slots.append((side * math.sin(half_rad) * row, -math.cos(half_rad) * row))
    return _flat(slots)


def wedge(count: int, opening_deg: float) -> Array:
    """Return a filled triangle: rows of 1, 2, 3 ... slots behind the first."""
    half_rad = math.radians(0.5 * opening_deg)
    spacing = 2.0 * math.sin(half_rad)
    slots: list[tuple[float, float]] = []

    row = 0
    while len(slots) < count:
        in_row = min(row + 1, count - len(slots))
        for index_in_row in range(in_row):
            from_middle = index_in_row - 0.5 * (in_row - 1)
            slots.append((spacing * from_middle, -math.cos(half_rad) * row))
        row += 1
    return _flat(slots)


def circle(count: int) -> Array:
    """Return a ring, the first slot in the north, clockwise."""
    angles = 2.0 * math.pi * np.arange(count) / count
    return np.column_stack([np.sin(angles), np.cos(angles), np.zeros(count)])


def grid(count: int, columns: int | None) -> Array:
    """Return rows from north to south, each from west to east; the last row is centred."""
    width = math.ceil(math.sqrt(count))
    if columns is not None:
        width = columns
    slots = []
    for index in range(count):
        row, index_in_row = divmod(index, width)
        in_row = min(width, count - row * width)
        slots.append((index_in_row - 0.5 * (in_row - 1), -float(row)))
    return _flat(slots)


def polygon(count: int, sides: int) -> Array:
    """Return slots evenly along a regular polygon's sides, the first on its northern corner."""
    corners = circle(sides)

    # the number of sides before each slot: whole sides, and a share of the slot's own side
    sides_before = sides * np.arange(count) / count
    whole = np.floor(sides_before + _ROUNDING)
    side = whole.astype(np.int64) % sides
    share = (sides_before - whole)[:, None]
    return np.asarray((1.0 - share) * corners[side] + share * corners[(side + 1) % sides])


def sphere(count: int) -> Array:
    """Return slots on the upper and lower half of a sphere in turn, none above another one."""
    numbers = np.arange(count)
    radius = np.sqrt((numbers + 0.5) / count)
    angles = _GOLDEN_RAD * numbers
    heights = (-1.0) ** numbers * np.sqrt(1.0 - radius**2)
    return np.column_stack([radius * np.sin(angles), radius * np.cos(angles), heights])


def nearest_m(slots: Array, apart_m: float = 0.0) -> float:
    """Return the horizontal distance of the two nearest slots; infinite if there are no two.

    Args:
        slots: slots (N, 3) [m].
        apart_m: two slots that are nearer than this [m] do not count: they are above each other.
    """
    offsets = slots[:, None] - slots[None]  # (N, N, 3)
    gaps = np.hypot(offsets[..., 0], offsets[..., 1])
    is_counted = (gaps >= apart_m) & ~np.eye(len(slots), dtype=bool)
    return float(gaps[is_counted].min(initial=math.inf))


def layered(shape: Array, layers: int, height_m: float, *, is_stacked: bool, count: int) -> Array:
    """Return slots in several layers.

    Args:
        shape: slots (N, 3) of the whole shape [m], or of one layer if it is stacked.
        layers: number of layers.
        height_m: difference of height from one layer to the next [m].
        is_stacked: whether every layer is the whole shape; otherwise the slots of one shape are on
            the layers in turn.
        count: number of all slots.
    """
    numbers = np.arange(count)
    if is_stacked:
        slots = shape[numbers % len(shape)]
        layer = numbers // len(shape)
    else:
        slots = shape.copy()
        layer = numbers % layers
    slots[:, 2] += height_m * layer
    return slots


def turned(slots: Array, rotation_deg: float) -> Array:
    """Return slots (..., 3) turned about the vertical, counterclockwise seen from above."""
    cosine = math.cos(math.radians(rotation_deg))
    sine = math.sin(math.radians(rotation_deg))
    rotation = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(slots @ rotation)  # row vectors, so the matrix is the transposed one


def centred(slots: Array) -> Array:
    """Return slots around the middle of their outline, with the lowest slot at height 0."""
    middle = 0.5 * (slots.min(0) + slots.max(0))
    middle[2] = slots[:, 2].min()
    return np.asarray(slots - middle)


def _flat(points: Sequence[tuple[float, float]]) -> Array:
    return np.array([(x, y, 0.0) for x, y in points])
