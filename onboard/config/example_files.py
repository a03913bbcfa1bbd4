"""Finds the example fleets and missions of ``configs/``.

They are installed with the product, and commands accept their names instead of a path.
"""

from __future__ import annotations

import os

from onboard.config.config_error import ConfigError

# in the repository this is a link to configs/
EXAMPLES = os.path.join(os.path.dirname(os.path.realpath(__file__)), "examples")

# kind of file -> folders of the examples, in the order in which they are searched
_FOLDERS = {
    "fleet file": ("fleets",),
    "mission file": ("missions",),
    "fleet or mission file": ("missions", "fleets"),
}


_ENDINGS = (".toml", ".py")


def example_names(kind: str) -> list[str]:
    """Return the names of the examples.

    Args:
        kind: "fleet file", "mission file" or "fleet or mission file".
    Returns:
        The names without their endings, sorted.
    """
    names: set[str] = set()
    for folder in _FOLDERS[kind]:
        for file in os.listdir(os.path.join(EXAMPLES, folder)):
            stem, ending = os.path.splitext(file)
            if ending in _ENDINGS:
                names.add(stem)
    return sorted(names)


def existing_file(path: str | os.PathLike[str], kind: str) -> str:
    """Return the path of a file that exists, or of the example of that name.

    Args:
        path: path of a file; or the name of an example, for instance ``paper``; or the path of an
            example in the repository.
        kind: kind of the file, as in :func:`example_names`.
    Returns:
        A path that exists.
    Raises:
        ConfigError: There is no such file or example.
    """
    name = os.fspath(path)
    if os.path.isfile(name):
        return name

    parent, file = os.path.split(name)
    for folder in _FOLDERS[kind]:
        endings: tuple[str, ...] = ()
        if not parent:
            endings = ("", *_ENDINGS)  # a name, with or without its ending
        elif parent == os.path.join("configs", folder):
            endings = ("",)

        for ending in endings:
            example = os.path.join(EXAMPLES, folder, file + ending)
            if os.path.isfile(example):
                return example

    if os.path.exists(name):  # if this is a folder, the file's reader reports that
        return name
    raise ConfigError(
        f"{name}: there is no such {kind}. Give the path of an existing one, or the name of an "
        f"example: {', '.join(example_names(kind))}."
    )
