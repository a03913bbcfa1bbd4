"""The folder of a fleet's keys, which only its owner can enter and which git ignores."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path

from onboard.config.fleet import ConfigError

_IGNORED = """\
# Private keys belong into no repository: git leaves this whole folder out.
*
"""
# permissions: only the owner reads the file, or everybody
_OF_THE_OWNER = 0o600
_READABLE = 0o644


def make_key_folder(folder: Path) -> None:
    """Create a folder for keys that only its owner can enter, and that git ignores.

    An existing folder is not changed, except that it gets a ``.gitignore``.

    Args:
        folder: folder of the keys.

    Raises:
        ConfigError: the folder cannot be created.
    """
    ignored = folder / ".gitignore"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not ignored.exists():
            ignored.write_text(_IGNORED, encoding="utf-8")
    except OSError as error:
        raise ConfigError(
            f"{folder} cannot be made ({error.strerror}). Correct fleet.keys, or its permissions."
        ) from None


def write_files(contents: Mapping[Path, bytes]) -> None:
    """Write keys and certificates; if there is no room for one of them, nothing changes.

    Other users cannot read a key at any moment.

    Args:
        contents: content of each file; the name of a key ends with ``.key``.

    Raises:
        ConfigError: a file cannot be written.
    """
    path = Path()  # the file that is written now, which the refusal names
    try:
        for path, content in contents.items():
            new_path = _new_path(path)
            new_path.unlink(missing_ok=True)
            mode = _READABLE
            if path.suffix == ".key":
                mode = _OF_THE_OWNER
            descriptor = os.open(new_path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
            with os.fdopen(descriptor, "wb") as file:
                file.write(content)
        for path in contents:
            _new_path(path).replace(path)
    except OSError as error:
        for written in contents:
            with contextlib.suppress(OSError):
                _new_path(written).unlink()
        raise ConfigError(
            f"{path} cannot be written ({error.strerror}). Correct its permissions, or make room."
        ) from None


def _new_path(path: Path) -> Path:
    return path.with_name(f".{path.name}.new")
