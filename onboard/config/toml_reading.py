"""Reads TOML files as typed values.

A mistake in a file is a ConfigError that names the file, the key and the remedy.
"""

from __future__ import annotations

import math
import os
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from types import NoneType
from typing import Any, Literal, get_args, get_origin, get_type_hints

import msgspec

from onboard.config.config_error import ConfigError as ConfigError
from onboard.config.example_files import existing_file
from onboard.config.file_reading import FLEET_FILE, read_text, toml_values
from onboard.plain_text import meant_words

SCHEMA = 1  # version of the file format

# types as msgspec and Python name them, in words
_TYPE_WORDS = {
    "array": "a list",
    "bool": "true or false",
    "dict": "a table",
    "float": "a number",
    "int": "a whole number",
    "list": "a list",
    "null": "",  # a key that may be absent
    "object": "a table",
    "str": "a text",
}


def read_toml(path: str | os.PathLike[str], kind: str) -> tuple[dict[str, Any], str, str]:
    """Read a TOML file.

    Args:
        path: path of the file, or the name of an example.
        kind: "fleet file", "mission file" or "fleet or mission file".
    Returns:
        The tables of the file, its text and its path.
    Raises:
        ConfigError: The file is missing, not readable, too large, or not TOML.
    """
    name = existing_file(path, kind)
    text = read_text(name, FLEET_FILE._replace(words=kind))
    return toml_values(text, name), text, name


def package_table(package: str, name: str) -> dict[str, Any]:
    """Return the tables of a TOML file that is part of this software.

    Args:
        package: package that contains the file.
        name: name of the file.
    """
    return tomllib.loads(files(package).joinpath(name).read_text(encoding="utf-8"))


def check_schema(data: Mapping[str, Any], path: str) -> None:
    """Refuse files of another schema version.

    Args:
        data: tables of the file.
        path: path of the file, for the message.
    Raises:
        ConfigError: The file has another schema version, or none.
    """
    schema = data.get("schema", "missing")
    if isinstance(schema, bool) or schema != SCHEMA:  # True == 1
        advice = f"Put 'schema = {SCHEMA}' on the first line."
        if isinstance(schema, int) and schema > SCHEMA:
            advice = "The file is for a newer Covey: read it with that one."
        raise ConfigError(
            f"{path}: schema is {schema!r}, this version reads schema = {SCHEMA}. {advice}"
        )


def convert(value: Any, kind: Any, path: str, key: str) -> Any:
    """Convert a value of a file to a type.

    Args:
        value: value that TOML or JSON gives.
        kind: type of the result.
        path: path of the file, for the message.
        key: key path of the value, for the message.
    Returns:
        The value as ``kind``.
    Raises:
        ConfigError: The value has an unknown key or a wrong type.
    """
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise ConfigError(_sentence(str(error), kind, path, key)) from None
    except UnicodeEncodeError:  # JSON can contain half of a character, such as \ud800
        raise ConfigError(f"{path}: '{key}' has half of a character. Correct the value.") from None


def _sentence(text: str, kind: Any, path: str, key: str) -> str:
    """Return a sentence made of msgspec's message about a value.

    Such a message ends with the position in the value: "... - at `$.circle.radius_m`".
    """
    message, _, position = text.partition(" - at `")
    tail = position.rstrip("`").lstrip("$")

    inner = _kind_at(kind, tail)
    unknown = re.search(r"unknown field `(?P<field>.+?)`", message)
    if unknown is None:
        allowed = ""
        words = _words_of(inner)
        if message.startswith("Invalid enum value") and words:
            allowed = f" It may be {', '.join(words)}{_table_words(inner)}."
        return f"{path}: '{key}{tail}': {_plain(message)}.{allowed} Correct the value."

    field = unknown["field"]
    names = getattr(inner, "__struct_fields__", ())
    return str(unknown_key(path, f"{key}{tail}.{field}", field, names))


def _plain(message: str) -> str:
    """Return msgspec's message in the words of the file's format, not of Python's types."""
    missing = re.fullmatch(r"Object missing required field `(?P<field>\w+)`", message)
    if missing is not None:
        return f"its key '{missing['field']}' is missing"
    if not message.startswith("Expected "):
        return message

    # such as "Expected `float | null`, got `str`" and "Expected `array` of length 3, got 2"
    plain = re.sub(r"`(?P<types>[a-z| ]+)`", _type_words, message)
    return plain.replace("Expected ", "it must be ").replace(", got ", ", not ")


def _type_words(types: re.Match[str]) -> str:
    """Return the names of types as words."""
    words = [_TYPE_WORDS.get(name, name) for name in types["types"].split(" | ")]
    return " or ".join(word for word in words if word) or "nothing"


def unknown_key(path: str, key: str, word: str, names: Sequence[str]) -> ConfigError:
    """Return the refusal of an unknown key.

    Args:
        path: path of the file.
        key: the key with the tables around it.
        word: the key alone.
        names: the known keys of its table; empty if several kinds of tables may stand there.
    """
    known = meant_words(word, names)
    if names:
        known += f" Known keys here: {', '.join(names)}."
    return ConfigError(f"{path}: unknown key '{key}'.{known} Remove or correct it.")


def _kind_at(kind: Any, tail: str) -> Any:
    """Return the type at a position in a value; None or a union where several kinds may stand.

    Args:
        kind: type of the value.
        tail: position as msgspec writes it, for instance ``.obstacles[0]``.
    """
    for step in re.findall(r"\.\w+|\[.*?\]", tail):
        kind = _kind_inside(kind, step)
    return _without_none(kind)


def _words_of(kind: Any) -> list[str]:
    """Return the words that a value may be; empty if its type is no choice of words."""
    for choice in (kind, *get_args(kind)):
        if get_origin(choice) is Literal:
            return [str(word) for word in get_args(choice)]
    return []


def _table_words(kind: Any) -> str:
    """Return the keys of the table that a value may be; empty if its type is no table."""
    for choice in get_args(kind):
        keys = getattr(choice, "__struct_fields__", ())
        if keys:
            return f", or a table with {', '.join(keys)}"
    return ""


def _kind_inside(kind: Any, step: str) -> Any:
    """Return the type of a struct's field, or of the items of a list or a table."""
    kind = _without_none(kind)
    if step.startswith("."):
        hints = get_type_hints(kind) if isinstance(kind, type) else {}
        return hints.get(step.removeprefix("."))

    kinds = [each for each in get_args(kind) if each is not Ellipsis]
    return kinds[-1] if kinds else None  # a table has the type of its keys first


def _without_none(kind: Any) -> Any:
    """Return the type of a value that may be absent."""
    kinds = get_args(kind)
    present = [each for each in kinds if each is not NoneType]
    return present[0] if NoneType in kinds and len(present) == 1 else kind


def table(value: Any, path: str, key: str) -> dict[str, Any]:
    """Return a value that must be a table.

    Raises:
        ConfigError: The value is not a table.
    """
    if not isinstance(value, dict):
        name = type(value).__name__
        raise ConfigError(f"{path}: '{key}' must be a table, not {_TYPE_WORDS.get(name, name)}.")
    return value


def tables(value: Any, path: str, key: str) -> dict[str, dict[str, Any]]:
    """Return a value that must be a table of tables.

    Raises:
        ConfigError: The value, or one of its values, is not a table.
    """
    return {
        name: table(inner, path, f"{key}.{name}") for name, inner in table(value, path, key).items()
    }


def bound_problems(key: str, value: float, low: float, high: float) -> Iterator[str]:
    """Yield a sentence if a number is not finite or not within its bounds."""
    if not (math.isfinite(value) and low <= value <= high):
        yield f"'{key}' is {value}; it must lie between {low:g} and {high:g}."
