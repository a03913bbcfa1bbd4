"""Folders of CSVs, one for each drone, as show tools export them: times, positions, and colours
where there are any.
"""

from __future__ import annotations

import re
from pathlib import Path as FilePath

from groundstation.paths.files import load_path, read_columns
from groundstation.paths.lights import Light
from groundstation.shows.show import MOST_DRONES, Drone, Show
from onboard.config.fleet import ConfigError
from onboard.control.path import point_at

_COLOURS = "red", "green", "blue"


def read_folder(folder: FilePath) -> Show:
    """Read a show from a folder.

    Args:
        folder: with one CSV for each drone.

    Returns:
        Its drones, in the order of the files' names.

    Raises:
        ConfigError: there is none, or too many, or a file is no path.
    """
    files = sorted((one for one in folder.glob("*.csv")), key=lambda one: _natural(one.stem))
    if not 1 <= len(files) <= MOST_DRONES:
        raise ConfigError(
            f"{folder}: it has {len(files)} CSVs; a show has 1 to {MOST_DRONES}, one for each drone."
        )
    return Show(folder.resolve().name, tuple(_drone(file) for file in files))


def _natural(text: str) -> list[tuple[int, str]]:
    """Return a key that sorts drone10 after drone9."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", text)]


def _drone(file: FilePath) -> Drone:
    path = load_path(file)
    x, y, z = point_at(path, 0.0).position_enu_m
    return Drone(file.stem, (x, y, min(z, 0.0)), path, 0.0, _lights(file))


def _lights(file: FilePath) -> tuple[Light, ...]:
    columns, numbers = read_columns(str(file))
    if columns[0] != "t" or not set(_COLOURS) <= set(columns):
        return ()
    at = [columns.index(one) for one in _COLOURS]
    begin_s = numbers[0, 0]
    rows = [
        (float(row[0] - begin_s), int(row[at[0]]), int(row[at[1]]), int(row[at[2]]))
        for row in numbers
    ]
    return tuple(
        row for k, row in enumerate(rows) if k in (0, len(rows) - 1) or row[1:] != rows[k - 1][1:]
    )
