"""Names of missions that may be meant, for completion: files of a folder, and the examples."""

from __future__ import annotations

import os

from onboard.config.example_files import example_names

_ENDINGS = (".toml", ".py")


def mission_names(start: str = "") -> list[str]:
    """Return mission files that may be meant: those below a folder, and the examples.

    Args:
        start: what was written of the name so far, with its folder.

    Returns:
        Names that begin with it, as :func:`load_mission` takes them, sorted.
    """
    folder, _, begun = start.rpartition("/")
    try:
        entries = sorted(os.scandir(f"{folder}/" if "/" in start else "."), key=_name_of)
    except OSError:
        entries = []

    names = []
    for entry in entries:
        is_mission = entry.name.endswith(_ENDINGS) and entry.name.startswith(begun)
        if is_mission and entry.name.isprintable() and " " not in entry.name and entry.is_file():
            names.append(f"{folder}/{entry.name}" if "/" in start else entry.name)
    if "/" not in start:
        names += [name for name in example_names("mission file") if name.startswith(begun)]
    return names


def _name_of(entry: os.DirEntry[str]) -> str:
    return entry.name
