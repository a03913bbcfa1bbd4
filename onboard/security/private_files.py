"""Private keys belong to their owner: a file that others may read is refused."""

from __future__ import annotations

import os
import stat

from onboard.config.config_error import ConfigError

_OPEN_TO_OTHERS = 0o077  # the bits of a file's mode for its group and for everybody


def refuse_open_to_others(path: str | os.PathLike[str]) -> None:
    """Refuse a private key that other users of this computer can read or change.

    Args:
        path: of its file, which exists.
    Raises:
        ConfigError: its mode lets others in.
        OSError: there is no such file.
    """
    mode = stat.S_IMODE(os.stat(path).st_mode)
    if mode & _OPEN_TO_OTHERS:
        raise ConfigError(
            f"{path} can be read by other users of this computer (mode {mode:o}). "
            f"Run: chmod 600 {path}"
        )
