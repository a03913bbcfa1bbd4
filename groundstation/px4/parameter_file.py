"""Files of parameters, as QGroundControl writes and reads them: rows of vehicle id, component id,
name, value and type.

One file holds all parameters of one vehicle or of several, which their MAVLink ids tell apart.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path

from onboard.config.fleet import ConfigError, FleetConfig
from onboard.px4.required_params import Value

_INT32, _REAL32 = 6, 9
_AUTOPILOT = 1
# of one vehicle by nature: its id, its calibration, its statistics
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


def is_one_of(name: str, patterns: tuple[str, ...]) -> bool:
    """Whether a parameter's name fits one of the patterns."""
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def default_backup(fleet: FleetConfig) -> Path:
    """Return the name of a new backup."""
    return Path(time.strftime(f"px4-{fleet.fleet.name}-%Y%m%d-%H%M%S.params"))


def write_file(path: Path, vehicles: Mapping[int, tuple[str, Mapping[str, Value]]]) -> None:
    """Write the parameters of vehicles to a new file.

    Args:
        path: of the file.
        vehicles: MAVLink id -> a remark, and its parameters.

    Raises:
        ConfigError: it exists, or cannot be written.
    """
    lines = [
        "# Parameters of PX4: covey px4 params --restore writes them back, QGroundControl reads them",
        "#",
    ]
    for system_id, (remark, values) in vehicles.items():
        lines += [
            f"# Vehicle {system_id}: {remark}",
            "# Vehicle-Id\tComponent-Id\tName\tValue\tType",
        ]
        for name, value in sorted(values.items()):
            kind, text = (
                (_INT32, f"{value}") if isinstance(value, int) else (_REAL32, f"{value:.9g}")
            )
            lines.append(f"{system_id}\t{_AUTOPILOT}\t{name}\t{text}\t{kind}")
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write("\n".join(lines) + "\n")
    except FileExistsError:
        raise ConfigError(f"{path} exists already. Give another name, or remove it.") from None
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be written ({error.strerror}). Give another name."
        ) from None


def read_file(path: Path) -> dict[int, dict[str, Value]]:
    """Read a file of parameters.

    Args:
        path: of the file.

    Returns:
        MAVLink id -> parameter -> value.

    Raises:
        ConfigError: it cannot be read, or holds something else; with the line.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"{path} cannot be read ({error}). Give a file of covey px4 params --dump."
        ) from None
    vehicles: dict[int, dict[str, Value]] = {}
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        row = _row(line)
        if row is None:
            raise ConfigError(
                f"{path}: line {number}: {line[:60]!r} is no parameter. It has vehicle id, component id, name, "
                f"value and type ({_INT32} whole number, {_REAL32} number), with tabs between them."
            )
        system_id, name, value = row
        if vehicles.setdefault(system_id, {}).setdefault(name, value) != value:
            raise ConfigError(
                f"{path}: line {number}: {name} of vehicle {system_id} has two values. Remove one."
            )
    if not vehicles:
        raise ConfigError(f"{path} holds no parameters. Give a file of covey px4 params --dump.")
    return vehicles


def _row(line: str) -> tuple[int, str, Value] | None:
    fields = line.split("\t")
    if (
        len(fields) != 5
        or not re.fullmatch(r"\d{1,3}", fields[0])
        or not re.fullmatch(r"[A-Z0-9_]{1,16}", fields[2])
    ):
        return None
    try:
        value = int(fields[3]) if fields[4].strip() == str(_INT32) else float(fields[3])
    except ValueError:
        return None
    is_known = fields[4].strip() in (str(_INT32), str(_REAL32))
    return (int(fields[0]), fields[2], value) if is_known and math.isfinite(value) else None
