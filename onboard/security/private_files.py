"""Refuses private key files that other users can access."""

from __future__ import annotations

import os
import stat

from onboard.config.config_error import ConfigError

_OPEN_TO_OTHERS = 0o077  # bits of a file's mode that allow access to its group and to all others


def refuse_open_to_others(path: str | os.PathLike[str]) -> None:
    """Refuse a private key that other users of this computer can read or change.

    Args:
        path: path of the key's file.
    Raises:
        ConfigError: the file's mode allows access to other users.
        OSError: there is no such file.
    """
    mode = stat.S_IMODE(os.stat(path).st_mode)
    if mode & _OPEN_TO_OTHERS:
        raise ConfigError(
            f"{path} can be read by other users of this computer (mode {mode:o}). "
            f"Run: chmod 600 {path}"
        )
