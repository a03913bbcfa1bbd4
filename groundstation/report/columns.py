"""Packs curves into two bytes a sample, as differences that compress well. Pure.

All curves of a report have the same grid of times. A curve is quantised to whole numbers of 16 bits
(value = offset + scale * number; the least 16-bit number stands for NaN). The differences of these
numbers from sample to sample are stored, first all low bytes and then all high bytes. A curve that
changes little then becomes runs of equal bytes, which deflate packs well. ``payload.js`` does the
reverse.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.arrays import Array

_MOST = 32_000  # a curve is quantised to numbers from -_MOST to _MOST
_NOT_KNOWN = -32_768  # the number that stands for NaN


class Column(NamedTuple):
    """One curve, packed."""

    key: str  # number of the vehicle and name of the quantity: 0/x
    scale: float
    offset: float
    data: bytes


def packed(key: str, values: Array, resolution: float) -> Column:
    """Return a curve, packed.

    Args:
        key: the curve's name, see :class:`Column`.
        values: the curve's values (n,); NaN where they are not known.
        resolution: the finest step between two values; a curve with a wide range gets a coarser
            one.
    """
    is_known = np.isfinite(values)
    if not is_known.any():
        numbers = np.full(values.size, _NOT_KNOWN, np.int16)
        return Column(key, scale=1.0, offset=0.0, data=_planes(numbers))

    least = float(values[is_known].min())
    most = float(values[is_known].max())
    offset = (least + most) / 2.0
    scale = max(resolution, (most - least) / 2.0 / _MOST)
    if (most - least) / 2.0 <= resolution * _MOST:
        # An offset that is a multiple of the resolution keeps zero exactly zero.
        offset = round(offset / resolution) * resolution

    numbers = np.full(values.size, _NOT_KNOWN, np.int16)
    quantised = np.rint((values[is_known] - offset) / scale)
    # the rounded offset may move a number to one beyond _MOST
    numbers[is_known] = np.clip(quantised, -_MOST - 1, _MOST + 1).astype(np.int16)
    return Column(key, scale=scale, offset=offset, data=_planes(numbers))


def unpacked(column: Column) -> Array:
    """Return the values (n,) of a packed curve, as ``payload.js`` does."""
    size = len(column.data) // 2
    low = np.frombuffer(column.data, np.uint8, size)
    high = np.frombuffer(column.data, np.uint8, size, offset=size)
    steps = (low.astype(np.uint16) | (high.astype(np.uint16) << 8)).astype(np.uint16)
    numbers = np.cumsum(steps, dtype=np.uint16).astype(np.int16)

    values = column.offset + column.scale * numbers.astype(np.float64)
    values[numbers == _NOT_KNOWN] = np.nan
    return values


def _planes(numbers: NDArray[np.int16]) -> bytes:
    """Return the differences of 16-bit numbers: all low bytes, then all high ones."""
    unsigned = numbers.view(np.uint16)
    # The differences wrap around at 16 bits; so does the sum that undoes them.
    steps = np.diff(unsigned, prepend=np.uint16(0)).astype(np.uint16)
    return (steps & 0xFF).astype(np.uint8).tobytes() + (steps >> 8).astype(np.uint8).tobytes()
