"""Changes the text of a fleet file without changing its comments and its formatting."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Mapping, MutableMapping
from pathlib import Path
from typing import Any

import tomlkit

from onboard.config.file_reading import FLEET_FILE, read_bytes, read_text, toml_values
from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping


def edited(text: str, changes: Mapping[str, Any]) -> str:
    """Return a TOML text with some values changed or added.

    Args:
        text: text of a fleet file.
        changes: nested tables that contain only the changed values.

    Returns:
        The new text; all other lines are unchanged.
    """
    document = tomlkit.parse(text)
    _merge(document, changes)
    changed: str = tomlkit.dumps(document)
    return changed


def write_changes(path: Path, changes: Mapping[str, Any]) -> None:
    """Change values of a fleet file.

    Args:
        path: path of the file.
        changes: changes as in :func:`edited`.

    Raises:
        ConfigError: the file would be wrong with them, or cannot be written; it is unchanged.
    """
    write_text(path, checked_edit(path, changes))


def checked_edit(path: Path, changes: Mapping[str, Any]) -> str:
    """Return the text of a fleet file with changed values, after a check of the whole file.

    Args:
        path: path of the file.
        changes: changes as in :func:`edited`.

    Raises:
        ConfigError: the file would be wrong with the changes.
    """
    text = edited(read_text(path, FLEET_FILE), changes)
    fleet_from_mapping(tomllib.loads(text), path=str(path))
    return text


def checked_text(path: Path, more: str) -> str:
    """Return the text of a fleet file with more tables at its end, after a check of the whole.

    Args:
        path: path of the file.
        more: the tables as TOML.

    Raises:
        ConfigError: the file would be wrong with the tables.
    """
    text = read_text(path, FLEET_FILE).rstrip() + "\n\n" + more
    fleet_of_text(path, text)
    return text


def fleet_of_text(path: Path, text: str) -> FleetConfig:
    """Return the fleet of a text; the law, a user's own, may be missing on this computer.

    Args:
        path: path of the fleet file.
        text: its text.

    Raises:
        ConfigError: the text is wrong.
    """
    return fleet_from_mapping(toml_values(text, str(path)), path=str(path), needs_folders=False)


def write_text(path: Path, text: str) -> None:
    """Replace the text of a file, wholly or not at all; its permissions and line endings stay.

    Args:
        path: path of the file, or of a symbolic link to it.
        text: the new text, which has been checked.

    Raises:
        ConfigError: the file cannot be read or written; it is unchanged.
    """
    target = path.resolve()
    first_line, _, _ = read_bytes(target, FLEET_FILE).partition(b"\n")
    line_ending = "\n"
    if first_line.endswith(b"\r"):
        line_ending = "\r\n"

    new_path = target.with_name(f".{target.name}.new")
    try:
        new_path.write_text(text, encoding="utf-8", newline=line_ending)
        shutil.copymode(target, new_path)
        new_path.replace(target)
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be written ({error.strerror}). Add the tables by hand."
        ) from None


def _merge(table: MutableMapping[str, Any], changes: Mapping[str, Any]) -> None:
    for key, value in changes.items():
        if isinstance(value, Mapping):
            if key not in table:
                table[key] = tomlkit.table()
            _merge(table[key], value)
        else:
            table[key] = value
