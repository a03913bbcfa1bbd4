"""Vectors of plain floats, and the few operations on them that the control code needs.

Python interprets these functions on a drone, and numba compiles them for batches of simulated
flights. Therefore they take their arguments by position and use only floats and tuples.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Vec2(NamedTuple):
    """A horizontal vector; the name of a variable or field contains its frame and unit."""

    x: float
    y: float


class Vec3(NamedTuple):
    """A vector in space; the name of a variable or field contains its frame and unit."""

    x: float
    y: float
    z: float


ZERO_XY = Vec2(0.0, 0.0)
ZERO_3 = Vec3(0.0, 0.0, 0.0)


def add(a: Vec3, b: Vec3) -> Vec3:
    """Return a + b."""
    return Vec3(a.x + b.x, a.y + b.y, a.z + b.z)


def subtract(a: Vec3, b: Vec3) -> Vec3:
    """Return a - b."""
    return Vec3(a.x - b.x, a.y - b.y, a.z - b.z)


def scaled(factor: float, a: Vec3) -> Vec3:
    """Return the vector times a number."""
    return Vec3(factor * a.x, factor * a.y, factor * a.z)


def add_scaled(a: Vec3, factor: float, b: Vec3) -> Vec3:
    """Return a + factor * b."""
    return Vec3(a.x + factor * b.x, a.y + factor * b.y, a.z + factor * b.z)


def horizontal(a: Vec3) -> Vec2:
    """Return the horizontal part."""
    return Vec2(a.x, a.y)


def bounded(a: Vec3, bound: float) -> Vec3:
    """Return the vector with each component clipped to [-bound, bound]."""
    x = min(max(a.x, -bound), bound)
    y = min(max(a.y, -bound), bound)
    z = min(max(a.z, -bound), bound)
    return Vec3(x, y, z)


def within(value: float, bound: float) -> float:
    """Return the value clipped to [-bound, bound]; 0 for NaN."""
    if math.isnan(value):
        return 0.0
    return min(max(value, -bound), bound)


def horizontal_within(a: Vec3, bound: float) -> Vec2:
    """Return the horizontal part with both components clipped to [-bound, bound]; 0 for NaN."""
    if abs(a.x) + abs(a.y) < bound:  # quick test for the usual case; False for NaN
        return Vec2(a.x, a.y)
    return Vec2(within(a.x, bound), within(a.y, bound))


def finite_or(a: Vec3, other: Vec3) -> Vec3:
    """Return vector ``a``, with components of ``other`` in place of those that are not finite."""
    if is_finite(a):
        return a
    return Vec3(
        a.x if math.isfinite(a.x) else other.x,
        a.y if math.isfinite(a.y) else other.y,
        a.z if math.isfinite(a.z) else other.z,
    )


def length(a: Vec3) -> float:
    """Return the Euclidean length."""
    return math.sqrt(a.x * a.x + a.y * a.y + a.z * a.z)


def is_finite(a: Vec3) -> bool:
    """Whether all three components are finite."""
    return math.isfinite(a.x) and math.isfinite(a.y) and math.isfinite(a.z)


def is_within(a: Vec3, bound: float) -> bool:
    """Whether each component is a number between minus and plus a bound."""
    return abs(a.x) < bound and abs(a.y) < bound and abs(a.z) < bound


def dot_xy(a: Vec2, b: Vec2) -> float:
    """Return the scalar product."""
    return a.x * b.x + a.y * b.y


def cross_xy(a: Vec2, b: Vec2) -> float:
    """Return the vertical component of the vector product."""
    return a.x * b.y - a.y * b.x


def length_xy(a: Vec2) -> float:
    """Return the Euclidean length."""
    return math.sqrt(a.x * a.x + a.y * a.y)
