"""Opens files that other people or programs wrote, within limits of size, kind and depth.

Shows, paths, pictures, fleet files, missions, parameters, keys and results come from others. Even a
small file can make its reader need gigabytes, take hours, wait forever or end with a traceback.
Therefore one table says how large each kind of file may be. Only regular files are opened: a pipe
has no end, and opening a device may have an effect. The nesting of TOML, JSON and Python is
limited, and their numbers must fit a float.

A file that breaks a limit raises a ConfigError with the name of the file and what to do. This
module only handles bytes and values. The readers of the files check the meaning.
"""

from __future__ import annotations

import ast
import json
import math
import os
import re
import stat
import tomllib
import warnings
from typing import Any, BinaryIO, NamedTuple

from onboard.config.config_error import ConfigError

_MB = 1_000_000


class FileKind(NamedTuple):
    """One kind of file."""

    words: str  # its name in a sentence
    most_bytes: int | None  # largest size; None: no limit, because it is read in parts
    remedy: str = "Give the path of an existing one."  # what to do if it cannot be read


# 255 vehicles take 100 kB. The TOML reader needs 10 s for a million numbers.
FLEET_FILE = FileKind("fleet file", 1 * _MB)
MISSION_FILE = FileKind("mission file", 1 * _MB)
SCRIPT = FileKind("script", 4 * _MB)
LAW_SOURCE = FileKind("source of a law", 16 * _MB, "Correct law.name or law.folder.")
# 400,000 lines of times and positions take 20 MB.
CSV_FILE = FileKind("file", 32 * _MB)
SHOW_FILE = FileKind("show", 64 * _MB)
PICTURE = FileKind("image", 64 * _MB, "Give a PNG.")
FONT = FileKind("font", 32 * _MB, "Name a .ttf or .otf.")
# Surveyors export fields with more corners than a fence may have; 100,000 take 4 MB.
FENCE_FILE = FileKind("file", 16 * _MB, "Give a .plan of QGroundControl or a GeoJSON.")
# PX4 has a thousand parameters; 255 vehicles take 12 MB.
PARAMETER_FILE = FileKind("file", 16 * _MB, "Give a file of covey px4 params --dump.")
# Certificates and keys take 1 kB.
KEY_FILE = FileKind("file", 64_000, "Copy it again, or issue it anew.")
# A base sends a kilobyte a second: an hour takes 4 MB.
RTCM_FILE = FileKind("recording of RTCM", 64 * _MB, "Correct corrections.address.")
PASSWORD_FILE = FileKind("file with a password", 4_000, "Correct corrections.password_file.")
# A tile of 256 pixels takes 20 to 120 kB.
MAP_TILE = FileKind("tile", 1 * _MB, "Export the tiles again.")
TILE_ATTRIBUTION = FileKind("attribution of tiles", 4_000, "Write who made them in a line.")
# A scene of 250 vehicles and 500 obstacles takes 60 kB.
SCENE_FILE = FileKind("scene", 1 * _MB, "Give one in JSON: docs/open-benchmark.md.")
# A map of 10,000 cells takes 5 MB.
RESULTS_FILE = FileKind("file", 64 * _MB, "Name a file of covey simulate --map.")
# a flight takes 1 kB
EVIDENCE_FILE = FileKind("file", 64 * _MB, "Name a folder of covey evidence.")
SIMULATION_FILE = FileKind("file", 1 * _MB, "Fly the mission anew.")
# Twenty minutes take 100 MB; the file is read into memory, and only the shown values are kept.
ULOG = FileKind("log of PX4", 1_000 * _MB, "Fetch it with covey log fetch.")
OUTPUT_FILE = FileKind("file", None, "Name another with --out.")
RECORD = FileKind("record", None, "Give the folder of a recorded flight.")

DEEPEST = 32  # largest nesting depth of tables and lists; missions use at most 23
MAX_KEY_PARTS = 24  # largest number of parts of a TOML key with dots; each part makes a table
_MAX_WHOLE = 2**63  # whole numbers must be smaller, as TOML requires
_LONGEST_KEY = 80  # characters of a key that a message shows
_CONTAINERS = (dict, list, tuple, set)

# A JSON text is limited by the memory that its values take. A value of a list takes up to 64 bytes,
# and a table takes as much as four values. 6 million values take 480 MB at most.
MAX_JSON_VALUES = 6_000_000
_TABLE_VALUES = 4

# kinds of files that are never opened: a test of the file's mode, and a name for people
_NO_REGULAR_FILE = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)

# One part of a name in TOML, bare or in quotation marks. The possessive quantifiers and the
# look-behind keep the search linear in the length of the text.
_KEY_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?<![\w-]){_KEY_PART}(?:[ \t]*+\.[ \t]*+{_KEY_PART}){{{MAX_KEY_PARTS},}}")
# tomllib's message about a second table of one name, for the names of lists of tables
_REPEATED_TABLE = re.compile(r"Cannot declare \('(?P<name>step|obstacles|fences)',\) twice")


def opened(path: str | os.PathLike[str], kind: FileKind) -> BinaryIO:
    """Return a regular file, opened for reading.

    Args:
        path: path of the file.
        kind: kind of the file, with its largest size.
    Raises:
        ConfigError: The file does not exist, is not a regular file, is too large, or cannot be
            read.
    """
    name = os.fspath(path)
    try:
        # checked before it is opened, because opening a device may have an effect
        _check_status(name, os.stat(name), kind)
        descriptor = os.open(name, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except (OSError, ValueError) as error:
        raise _cannot_be_read(name, kind, error) from None

    file = os.fdopen(descriptor, "rb")
    try:
        # checked again, because the path may now lead to another file
        _check_status(name, os.fstat(descriptor), kind)
        # fails for kernel files that look regular but cannot be read at a position
        os.pread(descriptor, 1, 0)
    except OSError as error:
        file.close()
        raise _cannot_be_read(name, kind, error) from None
    except BaseException:
        file.close()
        raise
    return file


def read_bytes(path: str | os.PathLike[str], kind: FileKind) -> bytes:
    """Return the content of a file.

    Args:
        path: path of the file.
        kind: kind of the file, with its largest size.
    Raises:
        ConfigError: as :func:`opened`.
    """
    name = os.fspath(path)
    assert kind.most_bytes is not None
    with opened(name, kind) as file:
        try:
            # reads one byte more than allowed, because the size may be unknown or may grow
            data = file.read(kind.most_bytes + 1)
        except OSError as error:
            raise _cannot_be_read(name, kind, error) from None
    if len(data) > kind.most_bytes:
        raise _too_large(name, kind, None)
    return data


def read_text(path: str | os.PathLike[str], kind: FileKind) -> str:
    """Return the content of a UTF-8 text file, with every line ending as a newline.

    Args:
        path: path of the file.
        kind: kind of the file, with its largest size.
    Raises:
        ConfigError: As for :func:`opened`; or the file is not UTF-8 text.
    """
    name = os.fspath(path)
    try:
        text = read_bytes(name, kind).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{name}: this {kind.words} cannot be read as text ({error}). Save it as UTF-8."
        ) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def toml_values(text: str, name: str) -> dict[str, Any]:
    """Return the values of a TOML text.

    Args:
        text: content of a file.
        name: name of the file, for messages.
    Raises:
        ConfigError: The text is not TOML, is nested too deeply, or has a value that is not
            plausible, see :func:`check_values`.
    """
    long_key = _LONG_KEY.search(text)
    if long_key is not None:
        line = text.count("\n", 0, long_key.start()) + 1
        raise ConfigError(
            f"{name}: line {line} has a name of more than {MAX_KEY_PARTS} parts with dots between "
            "them. Write a shorter one."
        )
    try:
        data = tomllib.loads(text)
    except RecursionError:
        raise _too_deep(name) from None
    except ValueError as error:
        raise ConfigError(
            f"{name}: not valid TOML: {error}.{_bracket_words(str(error))} Correct that line."
        ) from None
    check_values(data, name)
    return data


def _bracket_words(message: str) -> str:
    """Return how a table is written that comes several times, if a message of tomllib needs it."""
    repeated = _REPEATED_TABLE.match(message)
    if repeated is None:
        return ""
    return f" Where there are several, each begins with two brackets: [[{repeated['name']}]]."


def json_values(data: bytes | str, name: str) -> Any:
    """Return the value of a JSON text.

    Args:
        data: the text.
        name: name of its source, for messages.
    Raises:
        ConfigError: The text is not JSON, is nested too deeply, has too many values, or has a
            number that is not finite.
    """
    if json_size(data) > MAX_JSON_VALUES:
        raise ConfigError(f"{name} has more than {MAX_JSON_VALUES} values. Write a smaller one.")
    try:
        value = json.loads(
            data, parse_int=_whole_number, parse_float=_number, parse_constant=_number
        )
    except RecursionError:
        raise _too_deep(name) from None
    except ValueError as error:
        raise ConfigError(f"{name} is no JSON ({error}). Write it anew.") from None
    _check_depth(value, name)
    return value


def json_size(data: bytes | str) -> int:
    """Return an upper bound for the number of values in a JSON text; tables count more."""
    if isinstance(data, str):
        return data.count(",") + data.count("[") + _TABLE_VALUES * data.count("{")
    return data.count(b",") + data.count(b"[") + _TABLE_VALUES * data.count(b"{")


def python_tree(text: str, name: str) -> ast.Module:
    """Return the syntax tree of a Python text; the text is not executed.

    Args:
        text: content of a file.
        name: name of the file, for messages.
    Raises:
        ConfigError: The text is not Python, or is nested too deeply.
    """
    try:
        # The parser warns about numbers such as `1or`, but the text is not ours to correct.
        with warnings.catch_warnings(action="ignore", category=SyntaxWarning):
            return ast.parse(text, name)
    except (RecursionError, MemoryError):
        raise _too_deep(name) from None
    except (SyntaxError, ValueError) as error:
        raise ConfigError(f"{name}: not valid Python: {error}. Correct that line.") from None


def check_values(value: Any, name: str) -> None:
    """Refuse values that are nested too deeply, and numbers and texts that are not plausible.

    Args:
        value: tables, lists, texts and numbers, as a parser returns them.
        name: name of the file, for messages.
    Raises:
        ConfigError: The value is nested too deeply, a number is not finite or has more than 64
            bits, or a text has a NUL character.
    """
    _check_depth(value, name)
    for part in _numbers_and_texts(value):
        if isinstance(part, str):
            if "\0" in part:
                raise ConfigError(
                    f"{name}: a text has the character U+0000{_place_of(part, value)}. No name and "
                    "no path has it: remove it."
                )
            continue

        is_too_large = isinstance(part, int) and not -_MAX_WHOLE <= part < _MAX_WHOLE
        if is_too_large or not math.isfinite(part):
            raise ConfigError(
                f"{name}: {_shown(part)} stands where a finite number of at most 64 bits is "
                f"needed{_place_of(part, value)}. Correct the value."
            )


def _numbers_and_texts(value: Any) -> list[int | float | str]:
    """Return all numbers and texts of a value that is not nested too deeply."""
    found: list[int | float | str] = []
    level = [value]  # all parts at one depth
    while level:
        next_level: list[Any] = []
        for part in level:
            if isinstance(part, dict):
                next_level += part.values()
            elif isinstance(part, _CONTAINERS):
                next_level += part
            elif isinstance(part, int | float | str):
                found.append(part)
        level = next_level
    return found


def _place_of(wanted: float | str, value: Any) -> str:
    """Return the key of a number or text in a value, in words after a space; empty if none."""
    level = [("", value)]  # all parts at one depth, with their keys
    while level:
        next_level: list[tuple[str, Any]] = []
        for key, part in level:
            if part is wanted and key:
                return f" at '{key[:_LONGEST_KEY]}'"
            if isinstance(part, dict):
                next_level += [(f"{key}.{name}".lstrip("."), part[name]) for name in part]
            elif isinstance(part, _CONTAINERS):
                next_level += [(f"{key}[{index}]", item) for index, item in enumerate(part)]
        level = next_level
    return ""


def _check_depth(value: Any, name: str) -> None:
    """Refuse a value with more than DEEPEST tables or lists nested in each other."""
    level = [value]  # all tables and lists at one depth
    for _ in range(DEEPEST + 1):
        next_level = []
        for part in level:
            if isinstance(part, dict):
                next_level += [child for child in part.values() if isinstance(child, _CONTAINERS)]
            elif isinstance(part, _CONTAINERS):
                next_level += [child for child in part if isinstance(child, _CONTAINERS)]
        if not next_level:
            return
        level = next_level
    raise _too_deep(name)


def _whole_number(text: str) -> int:
    # a number of 64 bits has at most 19 digits and a sign
    if len(text) > 20 or not -_MAX_WHOLE <= int(text) < _MAX_WHOLE:
        raise ValueError(f"{text[:20]}... has more than 64 bits")
    return int(text)


def _number(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text[:20]} is no finite number")
    return number


def _shown(number: int | float) -> str:
    """Return a number as text; Python refuses to print the digits of a very large one."""
    if isinstance(number, int):
        return f"a whole number of {number.bit_length()} bits"
    return str(number)


def _check_status(name: str, status: os.stat_result, kind: FileKind) -> None:
    """Refuse a file that is not regular or is too large."""
    for is_of_kind, words in _NO_REGULAR_FILE:
        if is_of_kind(status.st_mode):
            raise ConfigError(
                f"{name}: this {kind.words} cannot be read: it is {words}, no regular file. "
                f"{kind.remedy}"
            )
    if kind.most_bytes is not None and status.st_size > kind.most_bytes:
        raise _too_large(name, kind, status.st_size)


def _too_large(name: str, kind: FileKind, size: int | None) -> ConfigError:
    assert kind.most_bytes is not None
    most = _size_words(kind.most_bytes)
    has = f"more than {most}"
    if size is not None:
        has = _size_words(size)
    return ConfigError(
        f"{name}: this {kind.words} has {has}; {most} is the most that is read. Give a smaller one."
    )


def _size_words(size: int) -> str:
    if size < _MB:
        return f"{size / 1000:g} kB"
    return f"{size / _MB:.0f} MB"


def _too_deep(name: str) -> ConfigError:
    return ConfigError(
        f"{name}: it is nested too deeply: more than {DEEPEST} tables or lists within each other. "
        "Write it flatter."
    )


def _cannot_be_read(name: str, kind: FileKind, error: OSError | ValueError) -> ConfigError:
    if isinstance(error, ConfigError):
        return error
    if isinstance(error, FileNotFoundError):
        return ConfigError(f"{name}: there is no such {kind.words}. {kind.remedy}")
    reason = str(error)
    if isinstance(error, OSError) and error.strerror:
        reason = error.strerror
    return ConfigError(
        f"{name}: this {kind.words} cannot be read ({reason}). Check the path and its permissions."
    )
