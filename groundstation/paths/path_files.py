"""Files of paths: time-stamped positions, polynomial pieces, or waypoints with speeds, as CSV.

The first line names the columns, which show the kind of the file:

* ``t,x,y,z[,yaw]``: positions at times; also with a unit as in ``Time [msec],x [m]``
* ``duration,x^0,...,yaw^7``: Crazyswarm's 33 columns, a piece of seventh order in each line
* ``x,y,z,speed[,yaw]``: points that are flown through at these speeds, from rest to rest, with a
  stop at corners that a smooth curve would leave far

Lines that begin with ``#`` are comments. Lengths are metres in the fleet's frame, times seconds,
yaw degrees.
"""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import NamedTuple

import numpy as np

from groundstation.paths.pieces import fitted, turns_far, waypoint_times_s, would_swing
from onboard.arrays import Array
from onboard.config.file_reading import CSV_FILE, read_text
from onboard.config.fleet import ConfigError
from onboard.control.path import LONGEST_S, Path, path_of
from onboard.plain_text import plain_line

MAX_LINES = 400_000
LONGEST_LINE = 4096  # letters; Crazyswarm's 33 columns take 500
_AXES = ("x", "y", "z", "yaw")
_PIECE_COLUMNS = ("duration", *(f"{axis}^{k}" for axis in _AXES for k in range(8)))
# other names of columns
_NAMES = {
    "time": "t",
    "timestamp": "t",
    "yaw_deg": "yaw",
    "yaw_rad": "yaw",
    "v": "speed",
    "velocity": "speed",
}
# columns of a heading by other names, and all that begin with yaw_ and are no derivative of it
_HEADINGS = ("heading", "hdg", "psi", "course", "azimuth", "bearing", "rot_z", "qw")
_DERIVATIVES = ("rate", "speed", "dot", "vel", "acc")  # part of a name
COLOURS = ("red", "green", "blue")  # read by an import
_READ = {"yaw", *COLOURS}  # after the first four columns
# units in a column's name -> factor to s, m, m/s or deg
_TIMES = {"": 1.0, "s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3}
_LENGTHS = {"": 1.0, "m": 1.0, "cm": 0.01, "mm": 1e-3}
_SPEEDS = {"": 1.0, "m/s": 1.0}
_ANGLES = {"": 1.0, "deg": 1.0, "rad": math.degrees(1.0)}
_COEFFICIENTS_OF_YAW = {"": 1.0, "rad": 1.0}  # Crazyswarm's are radians
_UNITS = {
    **dict.fromkeys(("t", "duration"), _TIMES),
    **dict.fromkeys(("x", "y", "z"), _LENGTHS),
    **{f"{axis}^{power}": _LENGTHS for axis in "xyz" for power in range(8)},
    "speed": _SPEEDS,
    "yaw": _ANGLES,
    **{f"yaw^{power}": _COEFFICIENTS_OF_YAW for power in range(8)},
}
_ANY_UNITS = {**_TIMES, **_LENGTHS, **_SPEEDS, **_ANGLES}  # of columns with other names


class PathFile(NamedTuple):
    """What a file of a path gives."""

    path: Path
    # whether its positions are joined by another curve than a spline, which would swing (pieces.py)
    would_swing: bool = False
    # whether its heading turns by more than half a circle from one line to the next
    turns_far: bool = False
    unread: tuple[str, ...] = ()  # names of columns that mean nothing here


def load_path(file: str | os.PathLike[str]) -> Path:
    """Read the path of one vehicle.

    Args:
        file: a CSV of one of the module's three kinds.

    Returns:
        The path as polynomial pieces.

    Raises:
        ConfigError: there is no such file, or it is none of the three kinds.
    """
    return read_path(file).path


def read_path(file: str | os.PathLike[str]) -> PathFile:
    """Read the path of one vehicle, and how its file was understood.

    Args:
        file: a CSV of one of the module's three kinds.

    Raises:
        ConfigError: there is no such file, or it is none of the three kinds.
    """
    name = os.fspath(file)
    columns, numbers = read_columns(name)
    try:
        if columns == _PIECE_COLUMNS:
            return PathFile(path_of(numbers.tolist()))
        if columns[:4] == ("t", "x", "y", "z"):
            return _timed(columns, numbers)
        if columns[:4] == ("x", "y", "z", "speed"):
            return _waypoints(columns, numbers)
    except ValueError as error:
        raise ConfigError(f"{name}: {error}") from None
    raise ConfigError(
        f"{name}: the columns {', '.join(columns[:6])} are no path. Name them t,x,y,z[,yaw] or "
        f"x,y,z,speed[,yaw] in the first line, or write Crazyswarm's {len(_PIECE_COLUMNS)} columns "
        "duration,x^0,...,yaw^7."
    )


def write_path(file: str | os.PathLike[str], path: Path, comments: Sequence[str] = ()) -> None:
    """Write the pieces of a path, below comments of one line each.

    Args:
        file: file to write.
        path: path of one vehicle.
        comments: lines for people.
    """
    lines = [f"# {plain_line(line)}" for line in comments]
    lines.append(",".join(_PIECE_COLUMNS))
    for piece in path.pieces:
        lines.append(",".join(f"{number:.9g}" for number in piece))
    FilePath(file).write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_columns(name: str) -> tuple[tuple[str, ...], Array]:
    """Read the named columns of a CSV, in seconds and metres.

    Args:
        name: name of the file.

    Returns:
        Names of the columns, and numbers (lines, columns).

    Raises:
        ConfigError: there is no such file, a unit is not that of its column, two columns have one
            name, or a line is not a list of numbers.
    """
    lines = _lines_of(name)
    if not 2 <= len(lines) <= MAX_LINES:
        raise ConfigError(
            f"{name}: {len(lines)} lines are no path; it has a line of names and 1 to "
            f"{MAX_LINES} more."
        )

    (first_number, first_line), *further_lines = lines
    delimiter = next((mark for mark in (";", "\t") if mark in first_line), ",")
    names = _cells(name, first_number, first_line, delimiter)
    # Files of Crazyswarm end their line of names with a comma, and may end every line with one.
    has_last_delimiter = len(names) > 1 and not names[-1].strip()
    if has_last_delimiter:
        names = names[:-1]
    columns, factors = zip(*(_column(name, text) for text in names), strict=True)
    _refuse_repeated(name, columns)

    numbers = []
    for line_number, line in further_lines:
        cells = _cells(name, line_number, line, delimiter)
        if has_last_delimiter and not cells[-1].strip():
            cells = cells[:-1]
        values = _numbers_of(name, line_number, cells)
        if len(values) != len(columns) or not all(map(math.isfinite, values)):
            raise ConfigError(
                f"{name}, line {line_number}: it must have {len(columns)} finite numbers, as the "
                "first line says."
            )
        numbers.append(values)
    return columns, np.array(numbers) * np.array(factors)


def _lines_of(name: str) -> list[tuple[int, str]]:
    """Return the number and the text of each line, without empty lines and comments."""
    text = read_text(name, CSV_FILE)
    lines = []
    for number, line in enumerate(text.split("\n"), 1):
        if line.startswith("#") or not line.strip():
            continue
        if len(line) > LONGEST_LINE:
            raise ConfigError(
                f"{name}, line {number}: it has {len(line)} letters; {LONGEST_LINE} are the most "
                "that is read. Write one line for each time, piece or point."
            )
        lines.append((number, line))
    return lines


def _cells(name: str, line_number: int, line: str, delimiter: str) -> list[str]:
    """Return the cells of one line."""
    try:
        (cells,) = csv.reader([line], delimiter=delimiter)
    except (csv.Error, ValueError) as error:
        raise ConfigError(
            f"{name}, line {line_number}: it is no line of a CSV ({error}). Correct it."
        ) from None
    return cells


def _numbers_of(name: str, line_number: int, row: Sequence[str]) -> list[float]:
    try:
        return [float(text) for text in row]
    except ValueError:
        raise ConfigError(
            f"{name}, line {line_number}: '{','.join(row)[:60]}' is no list of numbers."
        ) from None


def _column(name: str, text: str) -> tuple[str, float]:
    """Return the name of a column, and the factor that turns its numbers into s, m or deg."""
    match = re.fullmatch(r"\s*([A-Za-z][\w^]*)\s*(?:[\[(]\s*([\w/]*)\s*[\])])?\s*", text)
    if match is None:
        raise ConfigError(
            f"{name}: the first line must name the columns, as t,x,y,z; '{text[:40]}' is no name."
        )

    written = match[1].lower()
    unit = (match[2] or "").lower()
    if written == "yaw_rad" and not unit:
        unit = "rad"

    column = _NAMES.get(written, written)
    units = _UNITS.get(column, _ANY_UNITS)
    if unit not in units:
        raise ConfigError(
            f"{name}: '{text.strip()[:40]}' is in a unit that is not known for this column. Use "
            f"{' or '.join(filter(None, units))}."
        )
    return column, units[unit]


def _refuse_repeated(name: str, columns: Sequence[str]) -> None:
    """Refuse two columns of one name.

    Raises:
        ConfigError: there are two.
    """
    seen: set[str] = set()
    for column in columns:
        if column in seen:
            raise ConfigError(
                f"{name}: more than one column is '{column[:40]}', perhaps by another name for it. "
                "Keep one."
            )
        seen.add(column)


def _timed(columns: Sequence[str], numbers: Array) -> PathFile:
    times_s = numbers[:, 0]
    if len(times_s) < 2:
        raise ValueError("one position is no path: give at least two times.")

    not_rising = np.flatnonzero(np.diff(times_s) <= 0.0)
    if len(not_rising):
        raise ValueError(
            f"time does not rise after {times_s[not_rising[0]]:g} s: sort the lines, keep one for "
            "each time."
        )

    duration_s = float(times_s[-1] - times_s[0])
    if duration_s > LONGEST_S:
        raise ValueError(
            f"it lasts {duration_s:g} s; {LONGEST_S:.0f} s are the longest that a path lasts. Cut "
            "it, or correct the unit of its times."
        )
    return _joined(columns, times_s - times_s[0], _values(columns, numbers[:, 1:4], numbers))


def _waypoints(columns: Sequence[str], numbers: Array) -> PathFile:
    values = _values(columns, numbers[:, :3], numbers)
    return _joined(columns, waypoint_times_s(values, speeds_m_s=numbers[:, 3]), values)


def _joined(columns: Sequence[str], times_s: Array, values: Array) -> PathFile:
    return PathFile(
        path=fitted(times_s, values),
        would_swing=would_swing(times_s, values),
        turns_far=turns_far(times_s, values[:, 3]),
        unread=tuple(name for name in columns[4:] if name not in _READ),
    )


def _values(columns: Sequence[str], points: Array, numbers: Array) -> Array:
    """Return x, y, z [m] and yaw [rad] (T, 4); yaw is 0 if the file has none.

    Raises:
        ValueError: it has a heading instead, which may be counted in another way.
    """
    headings = [name for name in columns if _is_heading(name)]
    if headings and "yaw" not in columns:
        raise ValueError(
            f"a column '{headings[0][:40]}' is not read, because headings often count clockwise "
            "from north. Give degrees counterclockwise from east, and name the column yaw, or "
            "leave it out."
        )

    yaw_rad = np.zeros(len(numbers))
    if "yaw" in columns:
        yaw_rad = np.radians(numbers[:, columns.index("yaw")])
    return np.column_stack([points, yaw_rad])


def _is_heading(column: str) -> bool:
    if column in _HEADINGS:
        return True
    is_derivative = any(word in column for word in _DERIVATIVES)
    return column.startswith("yaw_") and not is_derivative
