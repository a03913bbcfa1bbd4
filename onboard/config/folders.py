"""Folders that a fleet file names: its keys, and a law of somebody's own.

A fleet file may come from somebody else, and ``covey agent deploy`` makes the folder of keys on the
companions, in a remote shell. So a folder is relative to the fleet file, stays below it, and is
written in characters that no shell gives a meaning to.

Covey itself writes copies of fleet files into other folders: for a simulated flight, for a show
that was imported. A copy names the folder of its original by an absolute path. Such a path is
accepted where it is that of a folder on this computer which holds already what is looked for; on
any other computer, or for making something new, it is refused.
"""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterator

_PATTERN = re.compile(r"[A-Za-z0-9_./-]+")


def keys_problems(folder: str) -> Iterator[str]:
    """Yield a sentence where ``fleet.keys`` is no folder for keys."""
    has_certificates = os.path.isfile(os.path.join(folder, "ca.pem"))
    has_mavlink_keys = bool(glob.glob(os.path.join(glob.escape(folder), "*.mavlink.key")))
    holds_keys = has_certificates or has_mavlink_keys
    yield from _problems("fleet.keys", folder, is_there=holds_keys, example="keys")


def law_problems(folder: str) -> Iterator[str]:
    """Yield a sentence where ``law.folder`` is no folder for a law."""
    yield from _problems("law.folder", folder, is_there=os.path.isdir(folder), example="laws")


def _problems(key: str, folder: str, *, is_there: bool, example: str) -> Iterator[str]:
    if os.path.isabs(folder) and is_there and ".." not in folder.split("/"):
        return

    faults: list[str] = []
    if os.path.isabs(folder):
        faults.append("is no path relative to the fleet file")
    if not _PATTERN.fullmatch(folder):
        faults.append("has other characters than A-Z a-z 0-9 _ . / -")
    if ".." in folder.split("/"):
        faults.append("leaves the folder of the fleet file with '..'")
    if folder.startswith("-"):
        faults.append("begins like an option of a command")
    if faults:
        yield (
            f"'{key}' is {folder!r}, which {' and '.join(faults)}. Name a folder beside the fleet "
            f'file or below it, for instance {key.partition(".")[2]} = "{example}".'
        )
