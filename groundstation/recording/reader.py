"""Read a flight folder: its messages as they stand in the file.

A record that was cut off is read as far as it goes.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message
from mcap.stream_reader import StreamReader, breakup_chunk, get_chunk_data_stream
from zstandard import ZstdError, frame_content_size

from groundstation.recording.writer import RECORD_NAME
from onboard.config.file_reading import RECORD, opened
from onboard.config.fleet import ConfigError

# Unpacked; the writer makes chunks of half a megabyte. The smallest messages become objects of ten
# times their size.
MAX_CHUNK_BYTES = 16 * 1024 * 1024
MAX_FLIGHT_NS = 86_400_000_000_000  # a day: stamps further from the others are of no flight
# Exceptions of mcap on damaged bytes.
DAMAGED = (McapError, ZstdError, EOFError, ValueError, struct.error)
_MAX_NUMBER = 1e300
_MAX_STAMP_NS = (1 << 63) - 1

# Parts of a chunk, little-endian: the head of a record (opcode, length), and of a message channel,
# sequence (left out here) and log time, which the publish time follows.
_HEAD = struct.Struct("<BQ")
_MESSAGE_RECORD_HEAD = struct.Struct("<BQH4xQ8x")


@dataclass(frozen=True, slots=True)
class Sample:
    """One message of a record."""

    channel: str
    stamp_ns: int
    values: dict[str, Any]

    @property
    def topic(self) -> str:
        """First part of the channel's name, for instance ``truth``."""
        return self.channel.partition("/")[0]

    @property
    def name(self) -> str:
        """Second part, a vehicle or a body."""
        return self.channel.partition("/")[2]


def record_path(folder: Path) -> Path:
    """Return the MCAP file of a flight folder, or the path itself when it is a file.

    Raises:
        ConfigError: there is none.
    """
    path = folder / RECORD_NAME if folder.is_dir() else folder
    if not path.is_file():
        raise ConfigError(
            f"{folder}: there is no {RECORD_NAME}. Give the folder of a recorded flight."
        )
    return path


def read(folder: Path, topics: Sequence[str] = ()) -> Iterator[Sample]:
    """Read a record from its beginning.

    A record that breaks off ends there, and what is damaged is left out.

    Args:
        folder: flight folder, or the MCAP file itself.
        topics: only channels of these first parts, for instance ``truth``; empty for all.

    Yields:
        Samples in the order of the file.

    Raises:
        ConfigError: there is no record.
    """
    channels: dict[int, str] = {}
    with opened(record_path(folder), RECORD) as stream:
        for record in _records(stream):
            if isinstance(record, Channel):
                channels[record.id] = record.topic
            elif isinstance(record, Message):
                sample = _sample(record, channels.get(record.channel_id, ""), topics)
                if sample is not None:
                    yield sample


def count_messages(folder: Path) -> int:
    """Return how many messages of a record can be read.

    Args:
        folder: flight folder, or the MCAP file itself.

    Raises:
        ConfigError: there is no record.
    """
    with record_path(folder).open("rb") as stream:
        return sum(1 for record in _records(stream) if isinstance(record, Message))


def _sample(message: Message, channel: str, topics: Sequence[str]) -> Sample | None:
    """Return a message of the file; None when it is damaged or of none of the topics."""
    is_wanted = not topics or channel.partition("/")[0] in topics
    if not channel or not is_wanted or message.log_time > _MAX_STAMP_NS:
        return None

    values = _values(message.data)
    if values is None:
        return None
    return Sample(channel, message.log_time, values)


def of_one_flight(samples: Sequence[Sample]) -> list[Sample]:
    """Return the samples without those whose stamp is impossible.

    Such a stamp is more than MAX_FLIGHT_NS from the middle one.

    Args:
        samples: of one channel.

    Returns:
        The same without them.
    """
    if not samples:
        return []
    stamps_ns = sorted(sample.stamp_ns for sample in samples)
    middle_ns = stamps_ns[(len(stamps_ns) - 1) // 2]
    return [sample for sample in samples if abs(sample.stamp_ns - middle_ns) <= MAX_FLIGHT_NS]


def is_vector(value: object, size: int) -> bool:
    """Whether a value of a record is a list of so many numbers that a float can hold."""
    if not isinstance(value, list) or len(value) != size:
        return False
    return all(is_number(entry) for entry in value)


def is_number(value: object) -> bool:
    """Whether a value of a record is a finite number that a float can hold."""
    return isinstance(value, int | float) and -_MAX_NUMBER < value < _MAX_NUMBER


def chunk_records(chunk: Chunk) -> list[McapRecord] | None:
    """Decode a chunk.

    Args:
        chunk: as it stands in the file.

    Returns:
        Its records; None when it is damaged or would not fit into memory.
    """
    try:
        if not _fits(chunk):
            return None
        return breakup_chunk(chunk, validate_crc=True)
    except DAMAGED:
        return None


def chunk_messages(
    chunk: Chunk, channel_ids: Container[int]
) -> list[tuple[int, int, bytes]] | None:
    """Return the messages of some channels of a chunk as they stand in it.

    A long record has millions of them: they become no objects here, which takes a fifth of the
    time of :func:`chunk_records`.

    Args:
        chunk: as it stands in the file.
        channel_ids: numbers of the channels.

    Returns:
        Number of the channel, log time [ns] and content of each; None as :func:`chunk_records`.
    """
    messages = []
    try:
        if not _fits(chunk):
            return None
        stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        data = stream.read(size)
        unpack = _MESSAGE_RECORD_HEAD.unpack_from
        message_opcode = int(Opcode.MESSAGE)
        head_size = _HEAD.size
        content_begin = _MESSAGE_RECORD_HEAD.size

        # a message begins no later than this: what is left behind it is too short for one
        last_begin = size - content_begin
        begin = 0
        while begin <= last_begin:
            opcode, length, channel_id, log_time_ns = unpack(data, begin)
            end = begin + head_size + length
            if end > size:
                return None
            if opcode == message_opcode and channel_id in channel_ids:
                messages.append((channel_id, log_time_ns, data[begin + content_begin : end]))
            begin = end
    except DAMAGED:
        return None
    return messages


def _fits(chunk: Chunk) -> bool:
    """Whether a chunk can be unpacked within memory.

    The chunk tells its size, and so does the compressed content: neither is trusted alone. Other
    packings than those of the writer do not tell it: they are not unpacked.
    """
    size_bytes = max(chunk.uncompressed_size, len(chunk.data))
    if chunk.compression == "zstd":
        size_bytes = max(size_bytes, frame_content_size(chunk.data))
    elif chunk.compression:
        return False
    return size_bytes <= MAX_CHUNK_BYTES


def _records(stream: IO[bytes]) -> Iterator[McapRecord]:
    """Yield the records of the file.

    A damaged chunk is left out, and a damaged frame of the file ends it.
    """
    bounded = cast("IO[bytes]", _BoundedStream(stream))
    records = StreamReader(bounded, emit_chunks=True, record_size_limit=MAX_CHUNK_BYTES).records
    while True:
        try:
            record = next(records, None)
        except DAMAGED:
            return
        if record is None:
            return
        if isinstance(record, Chunk):
            yield from chunk_records(record) or ()
        else:
            yield record


class _BoundedStream:
    """A stream that hands out no more at once than a chunk has: lengths in a file are not trusted.

    The library limits the length of a record, and trusts those within it.
    """

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream

    def read(self, size: int) -> bytes:
        """Return the next bytes; ValueError for more than a chunk."""
        if size > MAX_CHUNK_BYTES:
            raise ValueError(f"{size} bytes in one piece are no part of a record")
        return self._stream.read(size)


def _values(data: bytes) -> dict[str, Any] | None:
    try:
        values = json.loads(data)
    except (ValueError, RecursionError):
        return None
    return values if isinstance(values, dict) else None
