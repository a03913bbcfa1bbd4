"""The folder of a fleet's keys: for its owner alone, and kept out of repositories."""

from __future__ import annotations

from pathlib import Path

from onboard.config.fleet import ConfigError

_IGNORED = """\
# Private keys belong into no repository: git leaves this whole folder out.
*
"""


def make_key_folder(folder: Path) -> None:
    """Make a folder for keys that only its owner can enter, and that git leaves out.

    A folder that is there stays as it is, and gets what git reads.

    Args:
        folder: of the keys.

    Raises:
        ConfigError: it cannot be made.
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
