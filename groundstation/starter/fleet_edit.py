"""Changes of a fleet file's text that leave its comments and its formatting as they were."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, MutableMapping
from pathlib import Path
from typing import Any

import tomlkit

from onboard.config.file_reading import FLEET_FILE, read_text, toml_values
from onboard.config.fleet import ConfigError, fleet_from_mapping


def edited(text: str, changes: Mapping[str, Any]) -> str:
    """Return a TOML text with some values changed or added.

    Args:
        text: of a fleet file.
        changes: tables in tables, with only the values that change.

    Returns:
        the text; every other line is as it was.
    """
    document = tomlkit.parse(text)
    _merge(document, changes)
    changed: str = tomlkit.dumps(document)
    return changed


def write_changes(path: Path, changes: Mapping[str, Any]) -> None:
    """Change values of a fleet file.

    Args:
        path: of the file.
        changes: as in :func:`edited`.

    Raises:
        ConfigError: the file would be wrong with them, or cannot be written; it is as it was.
    """
    write_text(path, checked_edit(path, changes))


def checked_edit(path: Path, changes: Mapping[str, Any]) -> str:
    """Return the text of a fleet file with values changed.

    Args:
        path: of the file.
        changes: as in :func:`edited`.

    Raises:
        ConfigError: the file would be wrong with them.
    """
    text = edited(read_text(path, FLEET_FILE), changes)
    fleet_from_mapping(tomllib.loads(text), path=str(path))
    return text


def checked_text(path: Path, more: str) -> str:
    """Return the text of a fleet file with more tables at its end.

    Args:
        path: of the file.
        more: tables, as TOML.

    Raises:
        ConfigError: the file would be wrong with them.
    """
    text = read_text(path, FLEET_FILE).rstrip() + "\n\n" + more
    fleet_from_mapping(toml_values(text, str(path)), path=str(path), finds_law=False)
    return text


def write_text(path: Path, text: str) -> None:
    """Put a text in the place of a file's, at once.

    Args:
        path: of the file.
        text: checked.

    Raises:
        ConfigError: the file cannot be written; it is as it was.
    """
    whole = path.with_name(f".{path.name}.new")
    try:
        whole.write_text(text, encoding="utf-8")
        whole.replace(path)
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be written ({error.strerror}). Put in the values above by hand."
        ) from None


def _merge(table: MutableMapping[str, Any], changes: Mapping[str, Any]) -> None:
    for key, value in changes.items():
        if isinstance(value, Mapping):
            if key not in table:
                table[key] = tomlkit.table()
            _merge(table[key], value)
        else:
            table[key] = value
