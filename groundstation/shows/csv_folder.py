"""Folders of CSVs, one for each drone, as show tools export them: times, positions, colours."""

from __future__ import annotations

import re
from pathlib import Path as FilePath

from groundstation.paths.files import load_path, read_columns
from groundstation.paths.lights import Light
from groundstation.shows.show import MOST_DRONES, Drone, Show, check_light_count
from onboard.config.fleet import ConfigError
from onboard.control.path import point_at

_COLOURS = ("red", "green", "blue")
_MOST_BYTES = 268_435_456  # of all CSVs: 200 drones, 10 minutes, 40 lines a second


def read_folder(folder: FilePath) -> Show:
    """Read a show from a folder.

    Args:
        folder: with one CSV for each drone.

    Returns:
        Its drones, in the order of the files' names.

    Raises:
        ConfigError: there is none, or too many, or a file is no path.
    """
    files = sorted(folder.glob("*.csv"), key=lambda file: _natural(file.stem))
    if not 1 <= len(files) <= MOST_DRONES:
        raise ConfigError(
            f"{folder}: it has {len(files)} CSVs; a show has 1 to {MOST_DRONES}, one for each "
            "drone."
        )

    drones: list[Drone] = []
    bytes_left = _MOST_BYTES
    for file in files:
        drones.append(_drone(file))
        check_light_count(str(folder), drones)
        bytes_left -= file.stat().st_size
        if bytes_left < 0:
            raise ConfigError(
                f"{folder}: its CSVs have more than {_MOST_BYTES >> 20} MB together. Export the "
                "show with fewer lines a second."
            )
    return Show(folder.resolve().name, tuple(drones))


def _natural(text: str) -> list[tuple[int, str]]:
    """Return a key that sorts drone10 after drone9."""
    key = []
    for part in re.split(r"(\d+)", text):
        if part.isdigit():
            key.append((int(part), ""))
        else:
            key.append((-1, part))
    return key


def _drone(file: FilePath) -> Drone:
    path = load_path(file)
    x, y, z = point_at(path, 0.0).position_enu_m
    return Drone(
        name=file.stem,
        home_enu_m=(x, y, min(z, 0.0)),
        path=path,
        begin_s=0.0,
        lights=_lights(file),
    )


def _lights(file: FilePath) -> tuple[Light, ...]:
    """Return the colours of a CSV that has them, without those that only repeat the one before."""
    columns, numbers = read_columns(str(file))
    if columns[0] != "t" or not set(_COLOURS) <= set(columns):
        return ()

    times_s = numbers[:, 0] - numbers[0, 0]
    colours = numbers[:, [columns.index(colour) for colour in _COLOURS]].astype(int)

    lights: list[Light] = []
    last = len(numbers) - 1
    for k, (red, green, blue) in enumerate(colours.tolist()):
        is_repeated = k > 0 and (colours[k] == colours[k - 1]).all()
        if is_repeated and k != last:
            continue
        lights.append((float(times_s[k]), red, green, blue))
    return tuple(lights)
