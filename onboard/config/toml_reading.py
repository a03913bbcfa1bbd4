"""TOML files as typed values.

Everything wrong with one is a ConfigError that names file, key and remedy.
"""

from __future__ import annotations

import math
import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from importlib.resources import files
from typing import Any, get_args

import msgspec

from onboard.config.config_error import ConfigError as ConfigError
from onboard.config.example_files import existing_file
from onboard.config.file_reading import FLEET_FILE, read_text, toml_values

SCHEMA = 1  # version of the format that is read


def read_toml(path: str | os.PathLike[str], kind: str) -> tuple[dict[str, Any], str, str]:
    """Read a TOML file.

    Args:
        path: of the file, or the name of an example.
        kind: of file: "fleet file", "mission file" or "fleet or mission file".
    Returns:
        its data, its text and its path.
    Raises:
        ConfigError: file missing, not readable, too large, or not TOML.
    """
    name = existing_file(path, kind)
    text = read_text(name, FLEET_FILE._replace(words=kind))
    return toml_values(text, name), text, name


def package_table(package: str, name: str) -> dict[str, Any]:
    """Read a table that is part of this software.

    Args:
        package: that holds the file.
        name: of the file.
    Returns:
        its data.
    """
    return tomllib.loads(files(package).joinpath(name).read_text(encoding="utf-8"))


def check_schema(data: Mapping[str, Any], path: str) -> None:
    """Refuse files of another schema version.

    Args:
        data: of the file.
        path: of the file, for the sentence.
    Raises:
        ConfigError: another version, or none.
    """
    if data.get("schema") != SCHEMA:
        schema = data.get("schema", "missing")
        raise ConfigError(
            f"{path}: schema is {schema!r}, this version reads schema = {SCHEMA}. "
            f"Put 'schema = {SCHEMA}' on the first line."
        )


def convert(value: Any, kind: Any, path: str, key: str) -> Any:
    """Convert a value of a file to a type.

    Args:
        value: as TOML gives it.
        kind: type to convert to.
        path: of the file, for the sentence.
        key: key path of the value, for the sentence.
    Returns:
        the value as ``kind``.
    Raises:
        ConfigError: unknown key or wrong type.
    """
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise ConfigError(_sentence(str(error), kind, path, key)) from None


def _sentence(text: str, kind: Any, path: str, key: str) -> str:
    """Return a sentence about what msgspec says of a value.

    Its texts end with the position in the value: "... - at `$.circle.radius_m`".
    """
    message, _, position = text.partition(" - at `")
    tail = position.rstrip("`").lstrip("$")

    unknown = re.search(r"unknown field `(.+?)`", message)
    if unknown is None:
        return f"{path}: '{key}{tail}': {message}. Correct the value."

    names = ", ".join(_known_keys(kind, tail))
    known = f" Known keys here: {names}." if names else ""
    return f"{path}: unknown key '{key}{tail}.{unknown[1]}'.{known} Remove or correct it."


def _known_keys(kind: Any, tail: str) -> tuple[str, ...]:
    """Return the keys of a struct, or of the structs of a list; none for what lies deeper."""
    if not tail:
        struct = kind
    elif re.fullmatch(r"\[\d+\]", tail):
        struct = next(iter(get_args(kind)), None)
    else:
        return ()
    return getattr(struct, "__struct_fields__", ())


def table(value: Any, path: str, key: str) -> dict[str, Any]:
    """Return a value that must be a table.

    Raises:
        ConfigError: it is something else.
    """
    if not isinstance(value, dict):
        raise ConfigError(f"{path}: '{key}' must be a table, not {type(value).__name__}.")
    return value


def tables(value: Any, path: str, key: str) -> dict[str, dict[str, Any]]:
    """Return a value that must be a table of tables.

    Raises:
        ConfigError: it, or one of its values, is something else.
    """
    return {
        name: table(inner, path, f"{key}.{name}") for name, inner in table(value, path, key).items()
    }


def bound_problems(key: str, value: float, low: float, high: float) -> Iterator[str]:
    """Yield a sentence about a number outside of its bounds."""
    if not (math.isfinite(value) and low <= value <= high):
        yield f"'{key}' is {value}; it must lie between {low:g} and {high:g}."
