"""The summary that closes a record: where its chunks begin, and its channels.

A record that was cut off has none, and is read without it. With it, a reading goes on behind a
damaged head of a piece, whose length cannot be trusted. The summary is not trusted either, unless
its checksum is right.
"""

from __future__ import annotations

import io
import struct
import zlib
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from groundstation.recording.reader import DAMAGED

MAGIC = b"\x89MCAP0\r\n"
_MAX_BYTES = 64 * 1024 * 1024  # of a summary; that of an hour with thirty vehicles has some 15 MB

# Parts of an MCAP file, little-endian: the head of a record (opcode, length), the first fields of a
# chunk index (first and last stamp, offset of the chunk), and the end of the file (the footer with
# its head, starts of the summary and of its offsets and the checksum, then the magic).
_HEAD = struct.Struct("<BQ")
_CHUNK_INDEX = struct.Struct("<QQQ")
_END = struct.Struct("<BQQQI8s")
_UNCHECKED_BYTES = 12  # the checksum and the magic


class Summary(NamedTuple):
    """Chunks and channels of a record, as its summary lists them."""

    chunk_starts: tuple[int, ...] = ()  # offsets of the chunks in the file, rising
    channels: tuple[Schema | Channel, ...] = ()  # each schema before its channels


def read_summary(stream: BinaryIO) -> Summary:
    """Return the summary of a record; an empty one if there is none that is whole.

    Args:
        stream: the record, which can be read at any place.
    """
    try:
        size = stream.seek(0, io.SEEK_END)
        stream.seek(max(0, size - _END.size))
        opcode, _, start, _, checksum, magic = _END.unpack(stream.read())
        if opcode != Opcode.FOOTER or magic != MAGIC:
            return Summary()
        if not len(MAGIC) <= start <= size - _END.size or size - start > _MAX_BYTES:
            return Summary()

        stream.seek(start)
        data = stream.read()
        if checksum and zlib.crc32(data[:-_UNCHECKED_BYTES]) != checksum:
            return Summary()
        return _parsed(data[: -_END.size])
    except (OSError, *DAMAGED):
        return Summary()


def _parsed(data: bytes) -> Summary:
    """Return the summary in the records between the start of the summary and the footer."""
    starts = []
    schemas = []
    channels = []
    begin = 0
    while begin < len(data):
        opcode, length = _HEAD.unpack_from(data, begin)
        begin += _HEAD.size
        if opcode == Opcode.CHUNK_INDEX:
            _, _, start = _CHUNK_INDEX.unpack_from(data, begin)
            starts.append(start)
        elif opcode == Opcode.SCHEMA:
            schemas.append(Schema.read(ReadDataStream(io.BytesIO(data[begin : begin + length]))))
        elif opcode == Opcode.CHANNEL:
            channels.append(Channel.read(ReadDataStream(io.BytesIO(data[begin : begin + length]))))
        begin += length
    return Summary(tuple(sorted(starts)), (*schemas, *channels))
