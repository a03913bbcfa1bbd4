"""Completes the names of missions: files of a folder, and the examples."""

from __future__ import annotations

import os

from onboard.config.example_files import example_names

_ENDINGS = (".toml", ".py")


def mission_names(start: str = "") -> list[str]:
    """Return the names of missions that begin with a text.

    Args:
        start: start of the name, with its folder.

    Returns:
        Names of files in the folder, sorted, then names of examples if `start` has no folder; all
        as :func:`load_mission` takes them.
    """
    folder, slash, name_start = start.rpartition("/")
    prefix = folder + slash  # empty if `start` has no folder
    try:
        entries = sorted(os.scandir(prefix or "."), key=_name_of)
    except OSError:
        entries = []

    names = []
    for entry in entries:
        is_mission = entry.name.endswith(_ENDINGS) and entry.name.startswith(name_start)
        # an order names a mission without quotes
        is_one_word = entry.name.isprintable() and " " not in entry.name
        if is_mission and is_one_word and entry.is_file():
            names.append(prefix + entry.name)
    if not prefix:
        names += [name for name in example_names("mission file") if name.startswith(name_start)]
    return names


def _name_of(entry: os.DirEntry[str]) -> str:
    return entry.name
