"""Parameter files in the format of QGroundControl.

A row holds vehicle id, component id, name, value and type, separated by tabs. A file holds all
parameters of one vehicle, or of several, which differ in their MAVLink ids. QGroundControl also
saves parameters of other components, such as a gimbal; they are left out.
"""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

from onboard.config.file_reading import PARAMETER_FILE, read_text
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.px4.required_params import Value

# the two types of MAV_PARAM_TYPE that PX4 uses
_INT32 = 6
_REAL32 = 9
_INT32_LIMIT = 2**31  # the first number that is too large
_LARGEST_REAL32 = (2.0 - 2.0**-23) * 2.0**127  # largest number of IEEE 754's binary32

_AUTOPILOT = 1  # component id of the autopilot
_COLUMNS = 5

# Parameters that belong to one vehicle by nature: its id, its calibration, its statistics.
OWN = (
    "MAV_SYS_ID",
    "UXRCE_DDS_KEY",
    "CAL_*",
    "TC_*",
    "COM_FLIGHT_UUID",
    "LND_FLIGHT_T_*",
    "SENS_BOARD_?_OFF",
)
STATISTICS = ("COM_FLIGHT_UUID", "LND_FLIGHT_T_*")  # PX4 counts them itself


class _Row(NamedTuple):
    """One parameter of a file."""

    system_id: int
    name: str
    value: Value


def is_one_of(name: str, patterns: tuple[str, ...]) -> bool:
    """Return whether a parameter's name matches one of the patterns."""
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def default_backup(fleet: FleetConfig) -> Path:
    """Return the path of a new backup, named after the fleet and the time."""
    return Path(time.strftime(f"px4-{fleet.fleet.name}-%Y%m%d-%H%M%S.params"))


def write_file(path: Path, vehicles: Mapping[int, tuple[str, Mapping[str, Value]]]) -> None:
    """Write the parameters of vehicles to a new file.

    Args:
        path: path of the file.
        vehicles: MAVLink id -> a remark about the vehicle, and its parameters.

    Raises:
        ConfigError: the file exists already, or cannot be written.
    """
    lines = [
        "# Parameters of PX4: covey px4 params --restore writes them back,"
        " QGroundControl reads them",
        "#",
    ]
    for system_id, (remark, values) in vehicles.items():
        lines.append(f"# Vehicle {system_id}: {remark}")
        lines.append("# Vehicle-Id\tComponent-Id\tName\tValue\tType")
        for name, value in sorted(values.items()):
            lines.append(f"{system_id}\t{_AUTOPILOT}\t{name}\t{_value_and_type(value)}")

    try:
        with path.open("x", encoding="utf-8") as file:
            file.write("\n".join(lines) + "\n")
    except FileExistsError:
        raise ConfigError(f"{path} exists already. Give another name, or remove it.") from None
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be written ({error.strerror}). Give another name."
        ) from None


def _value_and_type(value: Value) -> str:
    if isinstance(value, int):
        return f"{value}\t{_INT32}"
    return f"{value:.9g}\t{_REAL32}"


def read_file(path: Path) -> dict[int, dict[str, Value]]:
    """Read a file of parameters.

    Args:
        path: path of the file.

    Returns:
        MAVLink id -> parameter -> value.

    Raises:
        ConfigError: the file cannot be read, or a line of it is not a parameter.
    """
    text = read_text(path, PARAMETER_FILE)
    vehicles: dict[int, dict[str, Value]] = {}
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.startswith("#") or _is_of_another_component(line):
            continue

        row = _row(line)
        if row is None:
            raise ConfigError(
                f"{path}: line {number}: {line[:60]!r} is no parameter. It has vehicle id,"
                f" component id, name, value and type ({_INT32} whole number, {_REAL32} number),"
                " with tabs between them."
            )

        values = vehicles.setdefault(row.system_id, {})
        if values.setdefault(row.name, row.value) != row.value:
            raise ConfigError(
                f"{path}: line {number}: {row.name} of vehicle {row.system_id} has two values."
                " Remove one."
            )

    if not vehicles:
        raise ConfigError(f"{path} holds no parameters. Give a file of covey px4 params --dump.")
    return vehicles


def _is_of_another_component(line: str) -> bool:
    """Return whether a row belongs to a component other than the autopilot."""
    columns = line.split("\t")
    return len(columns) == _COLUMNS and columns[1].isdecimal() and int(columns[1]) != _AUTOPILOT


def _row(line: str) -> _Row | None:
    """Return the parameter in a line; None if the line has another form."""
    columns = line.split("\t")
    if len(columns) != _COLUMNS:
        return None

    system_id, _, name, value_text, kind = columns
    kind = kind.strip()
    if not re.fullmatch(r"\d{1,3}", system_id) or not re.fullmatch(r"[A-Z0-9_]{1,16}", name):
        return None
    if kind not in (str(_INT32), str(_REAL32)):
        return None

    value = _value(value_text, is_whole=kind == str(_INT32))
    if value is None:
        return None
    return _Row(int(system_id), name, value)


def _value(text: str, *, is_whole: bool) -> Value | None:
    """Return a parameter's value; None if it is not a number that PX4 can store."""
    try:
        value: Value = int(text) if is_whole else float(text)
    except ValueError:
        return None

    # these comparisons are false for NaN, too
    if is_whole and -_INT32_LIMIT <= value < _INT32_LIMIT:
        return value
    if not is_whole and -_LARGEST_REAL32 <= value <= _LARGEST_REAL32:
        return value
    return None
