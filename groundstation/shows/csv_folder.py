"""Reads shows that are folders or zips of CSVs, one for each drone: times, positions, colours."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np

from groundstation.paths.lights import TimedColour, whole_colours
from groundstation.paths.path_files import COLOURS, PathFile, read_columns, read_path
from groundstation.shows.geographic import GeographicTrack, origin_of, path_of_track, read_track
from groundstation.shows.show import (
    MAX_DRONES,
    Drone,
    Show,
    begin_of_path_s,
    check_light_count,
    smooth,
)
from groundstation.shows.zip_members import unpack
from onboard.arrays import Array
from onboard.config.file_reading import CSV_FILE, read_text
from onboard.config.fleet import ConfigError
from onboard.control.path import LONGEST_S, Path, point_at
from onboard.plain_text import listed, natural_sort_key

_MIB = 2**20
_MAX_BYTES = 256 * _MIB  # all CSVs together: 200 drones, 10 minutes, 40 lines in a second


def read_csv_zip(file: FilePath) -> Show:
    """Read a show from a zip of CSVs.

    Args:
        file: a zip with one CSV for each drone, in any of its folders.

    Raises:
        ConfigError: it is not such a zip, or :func:`read_folder` refuses its CSVs.
    """
    with tempfile.TemporaryDirectory(prefix="covey-csvs-") as name:
        folder = FilePath(name) / file.stem
        folder.mkdir()
        unpack(file, folder, ending=".csv", most_members=MAX_DRONES, most_bytes=_MAX_BYTES)
        try:
            return read_folder(folder)
        except ConfigError as error:
            raise ConfigError(str(error).replace(str(folder), str(file))) from None


def read_folder(folder: FilePath) -> Show:
    """Read a show from a folder.

    Args:
        folder: a folder with one CSV for each drone.

    Returns:
        The show; its drones are in the order of the files' names.

    Raises:
        ConfigError: there are no CSVs or too many, or one of them is not a path.
    """
    # hidden files are left out: macOS adds one to each file, with the same ending
    csvs = [
        file
        for file in folder.iterdir()
        if file.suffix.lower() == ".csv" and not file.name.startswith(".")
    ]
    files = sorted(csvs, key=lambda file: natural_sort_key(file.stem))
    if not 1 <= len(files) <= MAX_DRONES:
        raise ConfigError(
            f"{folder}: it has {len(files)} CSVs; a show has 1 to {MAX_DRONES}, one for each drone."
        )

    tracks = {file: read_track(file) for file in files}
    if any(tracks.values()):
        return _geographic_show(folder, tracks)

    if sum(file.stat().st_size for file in files) > _MAX_BYTES:
        raise ConfigError(
            f"{folder}: its CSVs have more than {_MAX_BYTES // _MIB} MB together. Export the show "
            "with fewer lines a second."
        )

    drones: list[Drone] = []
    first_times_s: list[float] = []
    read: dict[str, PathFile] = {}  # by name of the file
    for file in files:
        read[file.name] = read_path(file)
        first_s, drone = _drone(file, _smooth(file, read[file.name].path))
        first_times_s.append(first_s)
        drones.append(drone)
        check_light_count(str(folder), drones)
    return Show(
        title=folder.resolve().name,
        drones=_from_the_first_on(folder, drones, first_times_s),
        notes=_notes(read),
    )


def _geographic_show(folder: FilePath, tracks: Mapping[FilePath, GeographicTrack | None]) -> Show:
    """Return a show whose CSVs have latitudes and longitudes.

    Raises:
        ConfigError: some CSVs have none.
    """
    geographic = {file: track for file, track in tracks.items() if track is not None}
    if len(geographic) < len(tracks):
        others = ", ".join(file.name for file in tracks if file not in geographic)
        raise ConfigError(
            f"{folder}: {others} have no latitude and longitude, and the others have. Export all "
            "drones alike."
        )

    origin = origin_of(list(geographic.values()))
    drones: list[Drone] = []
    first_times_s: list[float] = []
    read: dict[str, PathFile] = {}  # by name of the file
    for file, track in geographic.items():
        read[file.name] = path_of_track(track, origin)
        span_s = (track.first_s, track.first_s + float(track.times_s[-1]))
        first_s, drone = _drone(file, read[file.name].path, span_s)
        first_times_s.append(first_s)
        # altitudes also tell how high a home lies above the lowest one
        drones.append(replace(drone, home_enu_m=point_at(drone.path, 0.0).position_enu_m))
    notes = [
        "latitudes and longitudes became metres from the first place of the show "
        f"({origin.latitude_deg:.6f}, {origin.longitude_deg:.6f}); heights count from its lowest "
        f"altitude, {origin.altitude_m:.1f} m",
        *_notes(read),
    ]
    without_lights = [
        file.name
        for file, drone in zip(geographic, drones, strict=True)
        if not drone.lights and _names_colours(file)
    ]
    if without_lights:
        notes.append(
            f"the colours of {listed(without_lights)} could not be read and are left out: name the "
            "first column t, and let all columns have numbers"
        )
    return Show(
        title=folder.resolve().name,
        drones=_from_the_first_on(folder, drones, first_times_s),
        is_outdoors=True,
        origin=origin,
        notes=tuple(notes),
    )


def _notes(read: Mapping[str, PathFile]) -> tuple[str, ...]:
    """Return notes about how files were understood.

    Args:
        read: what was read, by name of the file.
    """
    notes = []
    swinging = [name for name, path_file in read.items() if path_file.would_swing]
    if swinging:
        notes.append(
            f"a spline through the few positions of {listed(swinging)} would swing off the lines "
            "between them: so each coordinate stays between two positions, and the vehicle slows "
            "down or stops at corners. Give more positions where it shall fly a curve"
        )
    turning = [name for name, path_file in read.items() if path_file.turns_far]
    if turning:
        notes.append(
            f"the yaw of {listed(turning)} turns by more than half a circle between two lines: it "
            "is flown as written, unless it would turn quicker than 38 degrees a second and so is "
            "taken for numbers that wrap"
        )
    unread = {column: None for path_file in read.values() for column in path_file.unread}
    if unread:
        notes.append(f"columns that are not read: {listed(list(unread))}")
    return tuple(notes)


def _smooth(file: FilePath, path: Path) -> Path:
    """Return the path of a CSV without kinks between its pieces.

    Raises:
        ConfigError: its position jumps.
    """
    try:
        return smooth(path)
    except ValueError as error:
        raise ConfigError(f"{file}: {error}") from None


def _drone(
    file: FilePath, path: Path, span_s: tuple[float, float] | None = None
) -> tuple[float, Drone]:
    """Return the time of the first position, and a drone whose times are those of its file.

    Args:
        file: the CSV.
        path: its path.
        span_s: times of its first and its last position; None: read from its columns.
    """
    columns: tuple[str, ...] = ()
    numbers = np.zeros((1, 1))
    # a CSV of latitudes may have other columns, with text in them
    with contextlib.suppress(ConfigError):
        columns, numbers = read_columns(str(file))
    has_times = columns[:1] == ("t",)
    if span_s is None:
        span_s = _span_s(columns, numbers, path)
    first_s, last_s = span_s

    lights: tuple[TimedColour, ...] = ()
    if has_times and set(COLOURS) <= set(columns):
        lights = _lights(file, columns, numbers)

    x, y, z = point_at(path, 0.0).position_enu_m
    return first_s, Drone(
        name=file.stem,
        home_enu_m=(x, y, min(z, 0.0)),
        path=path,
        begin_s=begin_of_path_s(path, first_s, last_s),
        lights=lights,
    )


def _span_s(columns: Sequence[str], numbers: Array, path: Path) -> tuple[float, float]:
    """Return the times of the first and the last position of a CSV."""
    if columns[:1] == ("t",):
        return float(numbers[0, 0]), float(numbers[-1, 0])
    if columns[:1] == ("duration",):
        return 0.0, float(numbers[:, 0].sum())
    return 0.0, path.duration_s  # waypoints have no times


def _names_colours(file: FilePath) -> bool:
    """Whether the first line of a CSV names columns of colours."""
    for line in read_text(str(file), CSV_FILE).splitlines():
        if line.strip() and not line.startswith("#"):
            return all(colour in line.lower() for colour in COLOURS)
    return False


def _from_the_first_on(
    folder: FilePath, drones: Sequence[Drone], first_times_s: Sequence[float]
) -> tuple[Drone, ...]:
    """Return the drones with times from the first of all positions on: their files share one clock.

    Raises:
        ConfigError: their times are too far apart for one show.
    """
    zero_s = min(first_times_s)
    last = max(drones, key=lambda drone: drone.begin_s)
    if last.begin_s - zero_s > LONGEST_S:
        raise ConfigError(
            f"{folder}: {last.name}.csv begins {last.begin_s - zero_s:.0f} s after the first "
            f"drone; {LONGEST_S:.0f} s are the longest. Give all files the same zero of time."
        )

    aligned = []
    for drone in drones:
        lights = tuple(
            (time_s - zero_s, red, green, blue) for time_s, red, green, blue in drone.lights
        )
        aligned.append(replace(drone, begin_s=drone.begin_s - zero_s, lights=lights))
    return tuple(aligned)


def _lights(file: FilePath, columns: Sequence[str], numbers: Array) -> tuple[TimedColour, ...]:
    """Return the colours of a CSV, without repetitions, at the times of the file.

    Raises:
        ConfigError: a colour is no whole number from 0 to 255.
    """
    times_s = numbers[:, 0]
    colour_columns = [columns.index(colour) for colour in COLOURS]
    colours = whole_colours(str(file), numbers[:, colour_columns])

    # A line is left out if the lines before and after it have its colour. The last line of a colour
    # is kept, because colours change evenly from one time to the next.
    is_repeated = (colours[1:] == colours[:-1]).all(axis=1)
    is_kept = np.ones(len(numbers), dtype=bool)
    is_kept[1:-1] = ~(is_repeated[:-1] & is_repeated[1:])

    lights: list[TimedColour] = []
    for index in np.flatnonzero(is_kept).tolist():
        red, green, blue = colours[index].tolist()
        lights.append((float(times_s[index]), red, green, blue))
    return tuple(lights)
