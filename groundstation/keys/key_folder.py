"""Creates the folder of a fleet's keys, which only its owner can enter and which git ignores."""

from __future__ import annotations

from pathlib import Path

from onboard.config.fleet import ConfigError

_IGNORED = """\
# Private keys belong into no repository: git leaves this whole folder out.
*
"""


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
