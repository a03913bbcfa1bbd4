"""Reads shows that are folders or zips of CSVs, one for each drone: times, positions, colours."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path as FilePath

from groundstation.paths.lights import TimedColour
from groundstation.paths.path_files import load_path, read_columns
from groundstation.shows.geographic import Places, origin_of, path_of_places, read_places
from groundstation.shows.show import MOST_DRONES, Drone, Show, check_light_count
from groundstation.shows.zip_members import unpack
from onboard.config.file_reading import CSV_FILE, read_text
from onboard.config.fleet import ConfigError
from onboard.control.path import LONGEST_S, Path, point_at
from onboard.plain_text import listed, natural_sort_key

_COLOURS = ("red", "green", "blue")
_MIB = 2**20
_MOST_BYTES = 256 * _MIB  # all CSVs together: 200 drones, 10 minutes, 40 lines in a second


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
        unpack(file, folder, ending=".csv", most_members=MOST_DRONES, most_bytes=_MOST_BYTES)
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
    csvs = [file for file in folder.iterdir() if file.suffix.lower() == ".csv"]
    files = sorted(csvs, key=lambda file: natural_sort_key(file.stem))
    if not 1 <= len(files) <= MOST_DRONES:
        raise ConfigError(
            f"{folder}: it has {len(files)} CSVs; a show has 1 to {MOST_DRONES}, one for each "
            "drone."
        )

    places = {file: read_places(file) for file in files}
    if any(places.values()):
        return _geographic_show(folder, places)

    if sum(file.stat().st_size for file in files) > _MOST_BYTES:
        raise ConfigError(
            f"{folder}: its CSVs have more than {_MOST_BYTES // _MIB} MB together. Export the show "
            "with fewer lines a second."
        )

    begins_s = _begins_s(folder, {file: _first_time_s(file) for file in files})
    drones: list[Drone] = []
    for file in files:
        drones.append(_drone(file, load_path(file), begins_s[file]))
        check_light_count(str(folder), drones)
    return Show(folder.resolve().name, tuple(drones))


def _geographic_show(folder: FilePath, places: Mapping[FilePath, Places | None]) -> Show:
    """Return a show whose CSVs have latitudes and longitudes.

    Raises:
        ConfigError: some CSVs have none.
    """
    geographic = {
        file: drone_places for file, drone_places in places.items() if drone_places is not None
    }
    if len(geographic) < len(places):
        others = ", ".join(file.name for file in places if file not in geographic)
        raise ConfigError(
            f"{folder}: {others} have no latitude and longitude, and the others have. Export all "
            "drones alike."
        )

    origin = origin_of(list(geographic.values()))
    begins_s = _begins_s(folder, {file: found.first_s for file, found in geographic.items()})
    drones = [
        _drone(file, path_of_places(found, origin), begins_s[file])
        for file, found in geographic.items()
    ]
    notes = [
        "latitudes and longitudes became metres from the first place of the show "
        f"({origin.latitude_deg:.6f}, {origin.longitude_deg:.6f}); heights count from its lowest "
        f"altitude, {origin.altitude_m:.1f} m"
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
        drones=tuple(drones),
        is_outdoors=True,
        origin=origin,
        notes=tuple(notes),
    )


def _drone(file: FilePath, path: Path, begin_s: float) -> Drone:
    """Return a drone whose path begins at this time of the show."""
    x, y, z = point_at(path, 0.0).position_enu_m
    return Drone(
        name=file.stem,
        home_enu_m=(x, y, min(z, 0.0)),
        path=path,
        begin_s=begin_s,
        lights=_lights(file, begin_s),
    )


def _names_colours(file: FilePath) -> bool:
    """Whether the first line of a CSV names columns of colours."""
    for line in read_text(str(file), CSV_FILE).splitlines():
        if line.strip() and not line.startswith("#"):
            return all(colour in line.lower() for colour in _COLOURS)
    return False


def _begins_s(folder: FilePath, first_s: Mapping[FilePath, float]) -> dict[FilePath, float]:
    """Return the time of the show at which each drone begins: the files share one clock.

    Raises:
        ConfigError: their times are too far apart for one show.
    """
    zero_s = min(first_s.values())
    last = max(first_s, key=lambda file: first_s[file])
    if first_s[last] - zero_s > LONGEST_S:
        raise ConfigError(
            f"{folder}: {last.name} begins {first_s[last] - zero_s:.0f} s after the first drone; "
            f"{LONGEST_S:.0f} s are the longest. Give all files the same zero of time."
        )
    return {file: time_s - zero_s for file, time_s in first_s.items()}


def _first_time_s(file: FilePath) -> float:
    """Return the time of the first line of a CSV; 0 if its lines have durations or no times."""
    columns, numbers = read_columns(str(file))
    return float(numbers[0, 0]) if columns[0] == "t" else 0.0


def _lights(file: FilePath, begin_s: float) -> tuple[TimedColour, ...]:
    """Return the colours of a CSV, without repetitions; an empty tuple if it has none.

    Args:
        file: the CSV.
        begin_s: time of the show at which its first line counts.

    Raises:
        ConfigError: a colour is not between 0 and 255.
    """
    try:
        columns, numbers = read_columns(str(file))
    except ConfigError:
        return ()  # a CSV of latitudes may have other columns, with text in them
    if columns[0] != "t" or not set(_COLOURS) <= set(columns):
        return ()

    times_s = begin_s + numbers[:, 0] - numbers[0, 0]
    colours = numbers[:, [columns.index(colour) for colour in _COLOURS]]
    if colours.min() < 0 or colours.max() > 255:
        raise ConfigError(f"{file}: colours lie between 0 and 255.")
    colours = colours.astype(int)

    lights: list[TimedColour] = []
    last = len(numbers) - 1
    for index, (red, green, blue) in enumerate(colours.tolist()):
        is_repeated = index > 0 and (colours[index] == colours[index - 1]).all()
        # the last colour is kept, as the end of the lights
        if is_repeated and index != last:
            continue
        lights.append((float(times_s[index]), red, green, blue))
    return tuple(lights)
