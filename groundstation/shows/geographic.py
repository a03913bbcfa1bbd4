"""Reads CSVs of a drone's positions on Earth: times, latitudes, longitudes, altitudes.

Other columns, which mission planners write in large numbers, are ignored; they may contain text.
Positions become metres east and north of the first position of the show, by the projection that
PX4 uses for its local positions. Heights count from the lowest altitude of the show.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path as FilePath
from typing import NamedTuple

import numpy as np

from groundstation.paths.path_files import LONGEST_LINE, MAX_LINES, PathFile
from groundstation.paths.pieces import fitted, would_swing
from onboard.arrays import Array
from onboard.config.earth import east_north_m
from onboard.config.file_reading import CSV_FILE, read_text
from onboard.config.fleet import ConfigError, Origin
from onboard.control.path import LONGEST_S

# content of a column -> its possible names, in small letters and without other signs
_KINDS = {
    "time": ("t", "time", "timestamp", "timefromstart", "seconds"),
    "latitude": ("lat", "latitude"),
    "longitude": ("lon", "lng", "long", "longitude"),
    "altitude": ("alt", "altitude", "altitudemsl", "height", "relativealtitude", "z"),
}
_UNIT_AT_END = re.compile(r"[\s_]*[\[(]?\s*(ms|msec|sec|s|m|deg)?\s*[\])]?\s*$", re.IGNORECASE)


class GeographicTrack(NamedTuple):
    """Positions of one drone over time."""

    first_s: float  # time of the first one in the file
    times_s: Array  # (T,), from 0 on
    latitudes_deg: Array  # (T,)
    longitudes_deg: Array  # (T,)
    altitudes_m: Array  # (T,)


def read_track(file: FilePath) -> GeographicTrack | None:
    """Return the positions in a CSV; None if it has no columns of latitude and longitude.

    Args:
        file: the CSV of one drone.

    Raises:
        ConfigError: it has such columns, but they are not positions at rising times.
    """
    text = read_text(str(file), CSV_FILE)
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.startswith("#")
    ]
    if not lines:
        return None

    (_, first_line), *further_lines = lines
    columns = _columns(first_line)
    if "latitude" not in columns or "longitude" not in columns:
        return None
    missing = [kind for kind in _KINDS if kind not in columns]
    if missing:
        raise ConfigError(
            f"{file}: it has latitude and longitude, but no column of {' and '.join(missing)}. "
            "Name one 'time' or 'altitude' in the first line."
        )
    if not 3 <= len(lines) <= MAX_LINES or max(len(line) for _, line in lines) > LONGEST_LINE:
        raise ConfigError(
            f"{file}: {len(lines) - 1} places are no path; it has 2 to {MAX_LINES} lines of at "
            f"most {LONGEST_LINE} letters below the line of names."
        )

    numbers = np.array([_numbers(file, number, line, columns) for number, line in further_lines])
    return _checked(file, numbers)


def origin_of(tracks: Sequence[GeographicTrack]) -> Origin:
    """Return the origin of a show: its first position, at its lowest altitude.

    Args:
        tracks: positions of all drones.
    """
    return Origin(
        latitude_deg=float(tracks[0].latitudes_deg[0]),
        longitude_deg=float(tracks[0].longitudes_deg[0]),
        altitude_m=float(min(drone.altitudes_m.min() for drone in tracks)),
    )


def path_of_track(track: GeographicTrack, origin: Origin) -> PathFile:
    """Return a drone's path in metres east, north and up.

    Args:
        track: positions of the drone.
        origin: origin of the show.
    """
    on_earth = zip(track.latitudes_deg, track.longitudes_deg, strict=True)
    east_north = [east_north_m(origin, latitude, longitude) for latitude, longitude in on_earth]
    up_m = track.altitudes_m - origin.altitude_m
    yaw_rad = np.zeros(len(track.times_s))
    values = np.column_stack([east_north, up_m, yaw_rad])
    return PathFile(
        path=fitted(track.times_s, values), would_swing=would_swing(track.times_s, values)
    )


def _columns(first_line: str) -> dict[str, tuple[int, float]]:
    """Return, by kind (a key of _KINDS), the index of its column and the factor of its numbers."""
    columns: dict[str, tuple[int, float]] = {}
    for index, name in enumerate(_cells(first_line)):
        stem, unit = _stem_and_unit(name.strip())
        factor = 1.0
        if unit in ("ms", "msec"):
            factor = 1e-3

        # the whole name may be known as well: "seconds" only seems to end in a unit
        for kind, known_names in _KINDS.items():
            is_known = _letters(stem) in known_names or _letters(name) in known_names
            if is_known and kind not in columns:
                columns[kind] = (index, factor)
    return columns


def _stem_and_unit(name: str) -> tuple[str, str]:
    """Split the name of a column, such as "Time [ms]"; the unit is empty if the name has none."""
    match = _UNIT_AT_END.search(name)
    if match is None:
        return name, ""

    unit = (match[1] or "").lower()
    if match.start() == 0:
        return name, unit
    return name[: match.start()], unit


def _letters(text: str) -> str:
    """Return the letters of a text, in small letters."""
    return re.sub(r"[^a-z]", "", text.lower())


def _cells(line: str) -> list[str]:
    delimiter = next((mark for mark in (";", "\t") if mark in line), ",")
    try:
        (cells,) = csv.reader([line], delimiter=delimiter)
    except (csv.Error, ValueError):
        return []
    return cells


def _numbers(
    file: FilePath, number: int, line: str, columns: Mapping[str, tuple[int, float]]
) -> list[float]:
    """Return time, latitude, longitude and altitude of one line."""
    cells = _cells(line)
    values = []
    for kind in _KINDS:
        index, factor = columns[kind]
        try:
            value = factor * float(cells[index])
        except (IndexError, ValueError):
            value = math.nan
        if not math.isfinite(value):
            raise ConfigError(f"{file}, line {number}: it has no number as its {kind}.")
        values.append(value)
    return values


def _checked(file: FilePath, numbers: Array) -> GeographicTrack:
    """Return the positions of rows (T, 4) after checks.

    Raises:
        ConfigError: they do not lie on Earth, or their times do not rise.
    """
    times_s, latitudes_deg, longitudes_deg, altitudes_m = numbers.T
    not_rising = np.flatnonzero(np.diff(times_s) <= 0.0)
    if len(not_rising):
        raise ConfigError(
            f"{file}: time does not rise after {times_s[not_rising[0]]:g} s: sort the lines, "
            "keep one for each time."
        )
    if times_s[-1] - times_s[0] > LONGEST_S:
        raise ConfigError(
            f"{file}: it lasts {times_s[-1] - times_s[0]:g} s; {LONGEST_S:.0f} s are the longest."
        )
    if np.abs(latitudes_deg).max() > 90.0 or np.abs(longitudes_deg).max() > 360.0:
        raise ConfigError(
            f"{file}: latitudes lie within -90 and 90, longitudes within -180 and 180 degrees. "
            "Give degrees with decimals."
        )
    return GeographicTrack(
        first_s=float(times_s[0]),
        times_s=times_s - times_s[0],
        latitudes_deg=latitudes_deg,
        longitudes_deg=longitudes_deg,
        altitudes_m=altitudes_m,
    )
