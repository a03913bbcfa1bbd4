"""Colours of vehicles along their paths.

A file with the columns ``t,red,green,blue`` gives colours at some times. Between two of them the
colour changes evenly; at a time that occurs twice, it jumps.
"""

from __future__ import annotations

import os
from bisect import bisect_right
from collections.abc import Sequence

import numpy as np

from groundstation.paths.path_files import read_columns
from onboard.arrays import Array, IntArray
from onboard.config.fleet import ConfigError

# time [s], and red, green and blue up to 255
TimedColour = tuple[float, int, int, int]
Colour = tuple[int, int, int]
_COLUMNS = "t", "red", "green", "blue"


def load_lights(file: str | os.PathLike[str]) -> tuple[TimedColour, ...]:
    """Read the colours of one vehicle.

    Args:
        file: a CSV with the columns t, red, green and blue.

    Returns:
        The colours at their times.

    Raises:
        ConfigError: there is no such file, or it does not have these columns.
    """
    name = os.fspath(file)
    columns, numbers = read_columns(name)
    if columns != _COLUMNS:
        raise ConfigError(
            f"{name}: lights have the columns {','.join(_COLUMNS)} in the first line."
        )

    times_s = numbers[:, 0]
    if (times_s[1:] < times_s[:-1]).any():
        raise ConfigError(f"{name}: the times of colours must rise. Sort the lines.")

    colours = whole_colours(name, numbers[:, 1:])
    return tuple(
        (time_s, red, green, blue)
        for time_s, (red, green, blue) in zip(times_s.tolist(), colours.tolist(), strict=True)
    )


def whole_colours(name: str, colours: Array) -> IntArray:
    """Return the colours of a file as whole numbers (lines, 3).

    Args:
        name: name of the file.
        colours: red, green and blue as they were read (lines, 3).

    Raises:
        ConfigError: one of them is no whole number from 0 to 255.
    """
    wrong = colours[(colours < 0) | (colours > 255) | (colours % 1 != 0)]
    if len(wrong):
        raise ConfigError(
            f"{name}: colours are whole numbers from 0 to 255, and {wrong[0]:g} is none. Multiply "
            "shares of 1 by 255, and round them."
        )
    return colours.astype(np.int64)


def colour_at(lights: Sequence[TimedColour], time_s: float) -> Colour:
    """Return the colour at a time.

    Before the first time it is the first colour, and after the last time the last one.
    """
    next_index = bisect_right(lights, time_s, key=lambda light: light[0])
    before_s, *before = lights[max(next_index - 1, 0)]
    after_s, *after = lights[min(next_index, len(lights) - 1)]

    share = 0.0
    if after_s > before_s:
        share = (time_s - before_s) / (after_s - before_s)

    red, green, blue = (round(a + share * (b - a)) for a, b in zip(before, after, strict=True))
    return red, green, blue
