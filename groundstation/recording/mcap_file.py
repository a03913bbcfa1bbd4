"""An MCAP file, written: chunks of messages, compressed and indexed, and a summary at the end.

The library's own writer makes some ten calls of Python for each message, as much as all the rest of recording. Here a
message costs one; the layout is that of https://mcap.dev/spec, and the library's reader reads it in the tests.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from typing import IO

import zstandard

CHUNK_BYTES = 512 * 1024  # each has an index entry per channel: fewer of them for many vehicles
_MAGIC = b"\x89MCAP0\r\n"
_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX = range(1, 9)
_STATISTICS, _SUMMARY_OFFSET, _DATA_END = 0x0B, 0x0E, 0x0F
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_COMPRESSION = "zstd"


class McapFile:
    """Writes to a binary stream; every method may raise OSError.

    Args:
        stream: at its beginning.
        library: name of the program, for the header.
    """

    def __init__(self, stream: IO[bytes], library: str) -> None:
        self._stream, self._offset = stream, 0
        self._compressor = zstandard.ZstdCompressor(level=1)  # for numbers as small as the usual level, and faster
        self._chunk = bytearray()
        self._index: dict[int, list[int]] = {}  # channel -> time, offset, time, offset ...
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._chunk_indexes: list[bytes] = []
        self._counts: dict[int, int] = {}
        self._first_ns, self._last_ns = (1 << 64) - 1, 0
        self._write(_MAGIC)
        self._write(_record(_HEADER, _text("") + _text(library)))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """A schema; returns its id."""
        number = len(self._schemas) + 1
        content = struct.pack("<H", number) + _text(name) + _text(encoding) + struct.pack("<I", len(data)) + data
        self._schemas.append(_record(_SCHEMA, content))
        self._chunk += self._schemas[-1]
        return number

    def register_channel(self, topic: str, message_encoding: str, schema_id: int) -> int:
        """A channel; returns its id."""
        number = len(self._channels) + 1
        content = struct.pack("<HH", number, schema_id) + _text(topic) + _text(message_encoding) + _map(())
        self._channels.append(_record(_CHANNEL, content))
        self._chunk += self._channels[-1]
        return number

    def add_message(self, channel_id: int, stamp_ns: int, sequence: int, data: bytes) -> None:
        """One message; ``stamp_ns`` is its log and its publish time."""
        chunk = self._chunk
        self._index.setdefault(channel_id, []).extend((stamp_ns, len(chunk)))
        chunk += _MESSAGE_HEAD.pack(_MESSAGE, 22 + len(data), channel_id, sequence, stamp_ns, stamp_ns)
        chunk += data
        if len(chunk) >= CHUNK_BYTES:
            self.end_chunk()

    def end_chunk(self) -> None:
        """Write what has been added so far, so that a reader finds it even if nothing more comes."""
        if not self._chunk:
            return
        records, index = bytes(self._chunk), self._index
        self._chunk, self._index = bytearray(), {}
        times = [stamp for entries in index.values() for stamp in entries[::2]]
        begin_ns, end_ns = (min(times), max(times)) if times else (0, 0)
        compressed = self._compressor.compress(records)
        start = self._offset
        head = struct.pack("<QQQI", begin_ns, end_ns, len(records), zlib.crc32(records))
        content = head + _text(_COMPRESSION) + struct.pack("<Q", len(compressed)) + compressed
        self._write(_record(_CHUNK, content))
        length, offsets = self._offset - start, []
        for channel, entries in index.items():
            offsets.append((channel, self._offset))
            packed = struct.pack(f"<{len(entries)}Q", *entries)
            self._write(_record(_MESSAGE_INDEX, struct.pack("<HI", channel, len(packed)) + packed))
            self._counts[channel] = self._counts.get(channel, 0) + len(entries) // 2
        if times:
            self._first_ns, self._last_ns = min(self._first_ns, begin_ns), max(self._last_ns, end_ns)
        self._chunk_indexes.append(
            _record(
                _CHUNK_INDEX,
                struct.pack("<QQQQ", begin_ns, end_ns, start, length)
                + _map(offsets)
                + struct.pack("<Q", self._offset - start - length)
                + _text(_COMPRESSION)
                + struct.pack("<QQ", len(compressed), len(records)),
            )
        )

    def finish(self) -> None:
        """Write the summary; nothing can be added after it. The stream stays open."""
        self.end_chunk()
        self._write(_record(_DATA_END, struct.pack("<I", 0)))
        summary_start = self._offset
        total = sum(self._counts.values())
        statistics = struct.pack(
            "<QHIIIIQQ",
            total,
            len(self._schemas),
            len(self._channels),
            0,
            0,
            len(self._chunk_indexes),
            self._first_ns if total else 0,
            self._last_ns,
        ) + _map(self._counts.items())
        groups = (
            (_SCHEMA, self._schemas),
            (_CHANNEL, self._channels),
            (_STATISTICS, [_record(_STATISTICS, statistics)]),
            (_CHUNK_INDEX, self._chunk_indexes),
        )
        crc, offsets = 0, []
        for opcode, records in groups:
            group = b"".join(records)
            if group:
                offsets.append(_record(_SUMMARY_OFFSET, struct.pack("<BQQ", opcode, self._offset, len(group))))
            crc = zlib.crc32(group, crc)
            self._write(group)
        offset_start, table = self._offset, b"".join(offsets)
        self._write(table)
        # the checksum covers the footer too, up to itself
        head = struct.pack("<BQQQ", _FOOTER, 20, summary_start, offset_start)
        crc = zlib.crc32(head, zlib.crc32(table, crc))
        self._write(head + struct.pack("<I", crc) + _MAGIC)

    def _write(self, data: bytes) -> None:
        self._stream.write(data)
        self._offset += len(data)


def _record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def _map(entries: Iterable[tuple[int, int]]) -> bytes:
    """A map from channel ids to numbers."""
    packed = b"".join(struct.pack("<HQ", key, value) for key, value in entries)
    return struct.pack("<I", len(packed)) + packed
