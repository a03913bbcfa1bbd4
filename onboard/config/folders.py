"""Checks the folders that a fleet file names: the folder of its keys, and that of a user's own law.

A fleet file may come from another person, and ``covey agent deploy`` creates the folder of keys on
the companions, in a remote shell. Therefore a folder must be relative to the fleet file, must not
be above it, and its path must contain only characters without a special meaning in a shell.

Covey itself writes copies of fleet files into other folders, for instance for a simulated flight or
an imported show. A copy names the folder of its original by an absolute path. Such a path is
accepted only if the folder exists on this computer and already contains keys, or may contain a law.
Nobody flies with the file of a recorded flight that is only read, so its folders may be elsewhere.
"""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterator

_PATTERN = re.compile(r"[A-Za-z0-9_./-]+")


def keys_problems(folder: str, *, must_exist: bool) -> Iterator[str]:
    """Yield a sentence if ``fleet.keys`` cannot be the folder of the keys.

    Args:
        folder: value of the key.
        must_exist: whether an absolute path must be that of a folder with keys.
    """
    has_certificates = os.path.isfile(os.path.join(folder, "ca.pem"))
    has_mavlink_keys = bool(glob.glob(os.path.join(glob.escape(folder), "*.mavlink.key")))
    may_be_absolute = has_certificates or has_mavlink_keys or not must_exist
    yield from _problems("fleet.keys", folder, may_be_absolute=may_be_absolute, example="keys")


def law_problems(folder: str, *, must_exist: bool) -> Iterator[str]:
    """Yield a sentence if ``law.folder`` cannot be the folder of a law.

    Args:
        folder: value of the key.
        must_exist: whether an absolute path must be that of a folder.
    """
    may_be_absolute = os.path.isdir(folder) or not must_exist
    yield from _problems("law.folder", folder, may_be_absolute=may_be_absolute, example="laws")


def _problems(key: str, folder: str, *, may_be_absolute: bool, example: str) -> Iterator[str]:
    """Yield a sentence about a folder that a fleet file must not name.

    Args:
        key: key of the fleet file.
        folder: value of the key.
        may_be_absolute: whether an absolute path is accepted.
        example: a correct value, for the sentence.
    """
    if os.path.isabs(folder) and may_be_absolute and ".." not in folder.split("/"):
        return

    faults: list[str] = []
    if os.path.isabs(folder):
        fault = "is no path relative to the fleet file"
        if not os.path.isdir(folder):
            fault = "is not on this computer"
        faults.append(fault)
    if not _PATTERN.fullmatch(folder):
        faults.append("has other characters than A-Z a-z 0-9 _ . / -")
    if ".." in folder.split("/"):
        faults.append("leaves the folder of the fleet file with '..'")
    if folder.startswith("-"):
        faults.append("begins like an option of a command")
    if faults:
        _, _, name = key.partition(".")
        yield (
            f"'{key}' is {folder!r}, which {' and '.join(faults)}. Name a folder beside the fleet "
            f'file or below it, for instance {name} = "{example}".'
        )
