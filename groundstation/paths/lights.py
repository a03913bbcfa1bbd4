"""Colours of vehicles along their paths.

A file with the columns ``t,red,green,blue`` gives colours at some times. Between two of them the
colour changes evenly; at a time that occurs twice, it jumps.
"""

from __future__ import annotations

import os
from bisect import bisect_right
from collections.abc import Sequence

from groundstation.paths.path_files import read_columns
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
    colours = numbers[:, 1:]
    is_rising = (times_s[1:] >= times_s[:-1]).all()
    is_colour = colours.min() >= 0 and colours.max() <= 255
    if not (is_rising and is_colour):
        raise ConfigError(f"{name}: times must rise, and colours lie between 0 and 255.")

    return tuple((float(t), int(red), int(green), int(blue)) for t, red, green, blue in numbers)


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
