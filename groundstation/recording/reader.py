"""Reads the pieces of a record: its chunks, and messages as JSON mappings.

A record may come from anybody, so lengths and sizes in the file are not trusted. The timeline of a
record (:mod:`groundstation.recording.timeline`) finds the chunks.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Container, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, McapRecord
from mcap.stream_reader import breakup_chunk, get_chunk_data_stream
from zstandard import ZstdError, frame_content_size

from groundstation.recording.writer import RECORD_NAME
from onboard.arrays import BoolArray, IntArray
from onboard.config.fleet import ConfigError

# Largest unpacked chunk; the writer's chunks have half a megabyte. In memory the smallest messages
# take ten times their size.
MAX_CHUNK_BYTES = 16 * 1024 * 1024
MAX_FLIGHT_NS = 86_400_000_000_000  # a day: stamps further from the others do not belong to it
# exceptions that mcap raises on damaged bytes
DAMAGED = (McapError, ZstdError, EOFError, ValueError, OverflowError, struct.error)
_MAX_NUMBER = 1e300

# Parts of a chunk, little-endian. The head of any record: opcode and length. The head of a message
# record: opcode, length, channel, sequence (skipped), log time, publish time (skipped).
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
        topic, _, _ = self.channel.partition("/")
        return topic

    @property
    def name(self) -> str:
        """Second part of the channel's name: a vehicle or a body."""
        _, _, name = self.channel.partition("/")
        return name


def record_path(folder: Path) -> Path:
    """Return the MCAP file of a flight folder, or the path itself when it is a file.

    Raises:
        ConfigError: there is no such file.
    """
    path = folder
    if folder.is_dir():
        path = folder / RECORD_NAME
    if not path.is_file():
        last = max(folder.glob(f"*/{RECORD_NAME}"), default=None)
        example = f", for instance {last.parent}" if last is not None else ""
        raise ConfigError(
            f"{folder}: there is no {RECORD_NAME}. Give the folder of a recorded flight{example}."
        )
    return path


def of_one_flight(samples: Sequence[Sample]) -> list[Sample]:
    """Return the samples of one channel without those whose stamp is impossible."""
    stamps_ns = np.array([sample.stamp_ns for sample in samples], np.int64)
    kept = zip(samples, are_possible(stamps_ns), strict=True)
    return [sample for sample, is_possible in kept if is_possible]


def indexes_by_time(stamps_ns: IntArray) -> IntArray:
    """Return the indexes of possible stamps of one channel, in the order of time."""
    possible = np.flatnonzero(are_possible(stamps_ns))
    by_time: IntArray = possible[np.argsort(stamps_ns[possible], kind="stable")]
    return by_time


def are_possible(stamps_ns: IntArray) -> BoolArray:
    """Return which stamps (n,) of one channel are possible.

    A stamp is impossible if it is more than MAX_FLIGHT_NS from the median.
    """
    if not stamps_ns.size:
        return np.zeros(0, np.bool_)
    middle_ns = np.sort(stamps_ns)[(stamps_ns.size - 1) // 2]
    is_possible: BoolArray = np.abs(stamps_ns - middle_ns) <= MAX_FLIGHT_NS
    return is_possible


def is_vector(value: object, size: int) -> bool:
    """Return whether a value of a record is a list of ``size`` finite numbers."""
    if not isinstance(value, list) or len(value) != size:
        return False
    return all(is_number(entry) for entry in value)


def is_number(value: object) -> bool:
    """Return whether a value of a record is a finite number that a float can hold."""
    return isinstance(value, int | float) and -_MAX_NUMBER < value < _MAX_NUMBER


def chunk_records(chunk: Chunk) -> list[McapRecord] | None:
    """Decode a chunk.

    Args:
        chunk: the chunk as it is in the file.

    Returns:
        Its records; None if it is damaged or too large for memory.
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
    """Return the messages of some channels of a chunk, not decoded.

    A long record has millions of messages. No objects are made of them here, so this is much faster
    than :func:`chunk_records`.

    Args:
        chunk: the chunk as it is in the file.
        channel_ids: ids of the channels.

    Returns:
        Channel id, log time [ns] and content of each message; None if the chunk is damaged or too
        large for memory.
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

        # after this offset there is no room for another message
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
    """Return whether a chunk is small enough to be unpacked in memory.

    Both the chunk and its compressed content state a size, and neither is trusted alone. Content
    states its size only with zstd, the writer's compression. Chunks with other compressions are not
    unpacked.
    """
    size_bytes = max(chunk.uncompressed_size, len(chunk.data))
    if chunk.compression == "zstd":
        size_bytes = max(size_bytes, frame_content_size(chunk.data))
    elif chunk.compression:
        return False
    return size_bytes <= MAX_CHUNK_BYTES


def json_object(data: bytes) -> dict[str, Any] | None:
    """Return a JSON object as a mapping; None if the data are not a JSON object."""
    try:
        values = json.loads(data)
    except (ValueError, RecursionError):
        return None
    return values if isinstance(values, dict) else None
