"""Opens zips from outside, with limits of the number of members, of size, and of compression."""

from __future__ import annotations

import os
import struct
import zipfile
import zlib
from pathlib import Path as FilePath
from pathlib import PurePosixPath
from typing import BinaryIO

from onboard.config.file_reading import SHOW_FILE, opened
from onboard.config.fleet import ConfigError

PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # others may need gigabytes of memory
_MAX_MEMBERS = 20_000
# What zipfile raises for a file that is no zip or is damaged; a name in it that is no UTF-8 is a
# ValueError.
DAMAGES = (
    OSError,
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    NotImplementedError,
    RuntimeError,
    ValueError,
    struct.error,
)

# The end of a zip states the length of its list of members, from which zipfile makes objects.
# Fields: signature, numbers of disks and members, length and offset of the list, length of a
# comment.
_ZIP_END = struct.Struct("<4s4H2LH")
_ZIP_END_SIGNATURE = b"PK\x05\x06"
_LONGEST_COMMENT = 65_535
_MEMBER_BYTES = 46  # least size of a member in the list


def refuse_many_members(name: str, stream: BinaryIO) -> None:
    """Refuse a zip that lists more members than a show has, before the list is read.

    Raises:
        ConfigError: it lists more.
    """
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(0, size - _ZIP_END.size - _LONGEST_COMMENT))
    tail = stream.read()
    stream.seek(0)

    begin = tail.rfind(_ZIP_END_SIGNATURE)
    if begin < 0 or len(tail) < begin + _ZIP_END.size:
        return  # not a zip; zipfile will refuse it
    # The stated number may be false, so the length of the list is limited, too. A name and further
    # fields make a member up to four times as long as the least.
    *_, count, list_bytes, _, _ = _ZIP_END.unpack_from(tail, begin)
    if count > _MAX_MEMBERS or list_bytes > 4 * _MEMBER_BYTES * _MAX_MEMBERS:
        raise ConfigError(
            f"{name}: it is a zip of more than {_MAX_MEMBERS} members: that is no show. Export it "
            "again."
        )


def unpack(
    file: FilePath, folder: FilePath, *, ending: str, most_members: int, most_bytes: int
) -> None:
    """Write the members with an ending into a folder, under their names without folders.

    Hidden files are left out.

    Args:
        file: the zip.
        folder: an empty folder for the members.
        ending: ending of the members' names, in small letters.
        most_members: largest number of such members.
        most_bytes: largest size of all of them together, unpacked.

    Raises:
        ConfigError: the file is not a zip, is truncated, exceeds these limits, or has no such
            members.
    """
    name = str(file)
    try:
        with opened(name, SHOW_FILE) as stream:
            refuse_many_members(name, stream)
            with zipfile.ZipFile(stream) as archive:
                _unpack(
                    name,
                    archive,
                    folder,
                    ending=ending,
                    most_members=most_members,
                    most_bytes=most_bytes,
                )
    except ConfigError:
        raise
    except DAMAGES as error:
        raise ConfigError(
            f"{name}: this is no zip, or it is truncated ({error}). Export it again."
        ) from None


def _unpack(
    name: str,
    archive: zipfile.ZipFile,
    folder: FilePath,
    *,
    ending: str,
    most_members: int,
    most_bytes: int,
) -> None:
    members = [
        member
        for member in archive.infolist()
        if member.filename.lower().endswith(ending)
        and "__MACOSX" not in member.filename
        and not _last_name(member).startswith(".")  # hidden files, as macOS adds to each file
    ]
    if not 1 <= len(members) <= most_members:
        raise ConfigError(
            f"{name}: it has {len(members)} members that end in {ending}; 1 to {most_members} are "
            "read, one for each drone. Export the show again."
        )

    bytes_left = most_bytes
    for member in members:
        last_name = _last_name(member)
        target = folder / last_name
        if target.exists():
            raise ConfigError(f"{name}: two of its members are named {last_name}. Rename one.")
        if member.compress_type not in PACKINGS:
            raise ConfigError(f"{name}: '{last_name}' is packed in a way that is not read.")

        with archive.open(member) as stream:
            data = stream.read(bytes_left + 1)
        bytes_left -= len(data)
        if bytes_left < 0:
            raise ConfigError(
                f"{name}: its members have more than {most_bytes // 2**20} MB together. Export the "
                "show with fewer lines a second."
            )
        target.write_bytes(data)


def _last_name(member: zipfile.ZipInfo) -> str:
    """Return a member's name without folders."""
    return PurePosixPath(member.filename.replace("\\", "/")).name
