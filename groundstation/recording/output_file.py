"""Writes files whole or not at all, and refuses to write over those that somebody else wrote."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from onboard.config.file_reading import OUTPUT_FILE, opened
from onboard.config.fleet import ConfigError

_BEGIN_BYTES = 65_536  # what is read of the file


def refuse_other_file(
    out: Path, is_own: Callable[[bytes], bool], *, other: str, option: str = "--out"
) -> None:
    """Refuse to write over a file that is not of the kind to be written.

    A new file and an empty one are never refused. A pipe or a device is always refused, because it
    would be replaced by a file.

    Args:
        out: file to write.
        is_own: whether a file that begins with these bytes is of that kind.
        other: what is said of a file that is not: "is no page of a flight".
        option: the option that names another place.

    Raises:
        ConfigError: the file is not of that kind, is not a regular one, or cannot be read.
    """
    if not out.exists() or out.is_dir():  # what writes the file says what is wrong with a folder
        return
    if not out.is_file():
        raise ConfigError(
            f"{out}: this is a pipe, a socket or a device, which would be replaced by a file. "
            f"Name a file with {option}."
        )
    if out.stat().st_size == 0:
        return
    with opened(out, OUTPUT_FILE) as stream:
        begin = stream.read(_BEGIN_BYTES)
    if not is_own(begin):
        raise ConfigError(
            f"{out}: this file is there already and {other}, so it is not overwritten. "
            f"Name another with {option}."
        )


@contextlib.contextmanager
def written_beside(path: Path) -> Iterator[Path]:
    """Yield the path of a new file beside a file; at the end it replaces that file in one step.

    So a reader never gets half a file, and after an error the former file is still there.

    Args:
        path: the file to replace, which need not exist. A symbolic link stays, and the file to
            which it leads is replaced.

    Raises:
        OSError: the file cannot be replaced. It names the folder, or the file, and never the new
            file beside it, of which the user knows nothing.
    """
    target = path
    if path.is_symlink():
        target = Path(os.path.realpath(path))

    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        yield part
        part.replace(target)
    except OSError as error:
        if str(error.filename) != str(part):
            raise
        named = target.parent
        if error.filename2 is not None:  # the new file is whole, but cannot replace the file
            named = target
        raise OSError(error.errno, error.strerror, str(named)) from None
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def write_together(contents: Mapping[Path, bytes]) -> None:
    """Write files all or none, for instance on a full disk; folders are made where they lack.

    Args:
        contents: bytes of each file, which may be there already.

    Raises:
        OSError: a file cannot be written. No file has changed, and no new folder is left.
    """
    new_folders: list[Path] = []
    try:
        with contextlib.ExitStack() as parts:
            for path, data in contents.items():
                missing = [folder for folder in path.parents if not folder.is_dir()]
                for folder in reversed(missing):
                    folder.mkdir(exist_ok=True)
                    new_folders.append(folder)
                parts.enter_context(written_beside(path)).write_bytes(data)
    except OSError:
        for folder in reversed(new_folders):
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise
