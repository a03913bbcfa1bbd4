"""An index of a record: the time span of each chunk, and messages in the order of their stamps.

The index has one row for each chunk, read from the heads of the file's records. So a record that
was cut off can be read as far as it goes, and memory does not grow with the messages. The ``mcap``
library decodes the chunks. Its seeking reader is not used, because it needs the summary at the end
of the file, which a record cut off by SIGKILL lacks, and it stops at the first damaged chunk. Where
there is a summary, it tells from which chunk on the reading goes on behind a damaged head.

Each computer stamps messages by its own clock. If the stamps of a sender are far from all others,
they are shifted onto the common clock: that of the sender with messages in most chunks.
"""

from __future__ import annotations

import bisect
import contextlib
import heapq
import io
import math
import struct
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Metadata, Schema

from groundstation.recording.channels import KINDS, MAX_STAMP_NS, REPLY, from_json
from groundstation.recording.reader import (
    DAMAGED,
    Sample,
    chunk_messages,
    chunk_records,
    json_object,
    record_path,
)
from groundstation.recording.summary import MAGIC, read_summary
from groundstation.recording.writer import MADE_BY
from onboard.bus.schema import Event, Message
from onboard.config.file_reading import RECORD, opened
from onboard.config.fleet import ConfigError
from onboard.plain_text import natural_sort_key

MAX_MINOR_EVENTS = 20_000  # most debug and info events that are kept
MAX_ALARMS = 100_000  # most warnings and critical events that are kept
# Messages of a chunk were written within seconds; stamps further apart than this come from two
# clocks.
CLOCK_APART_NS = 5_000_000_000
# A stamp further from the others of its chunk than this does not extend the chunk's time span.
MAX_LATE_NS = 60_000_000_000
DAMAGED_PIECE = "A piece of the record is damaged; the flight jumps over it."
_DAMAGED_REST = "A piece of the record is damaged, and what came after it cannot be found."
_ZIP_MAGIC = b"PK\x03\x04"
_GROUND = "ground"
_MAX_METADATA_BYTES = 64 * 1024
_Part = TypeVar("_Part")  # part of a chunk

# Parts of an MCAP file, little-endian: the head of a record (opcode, length), the first two fields
# of a chunk (first and last stamp), the head of a message index (channel, length of its entries),
# and a stamp in it. An entry is a stamp and an offset, each of eight bytes.
_HEAD = struct.Struct("<BQ")
_CHUNK_TIMES = struct.Struct("<QQ")
_INDEX_HEAD = struct.Struct("<HI")
_STAMP = struct.Struct("<Q")
_INDEX_ENTRY_BYTES = 16

# plain numbers, because access to members of an enumeration is slow
_OPCODES = frozenset(map(int, Opcode))
_DATA_END = int(Opcode.DATA_END)
_CHUNK = int(Opcode.CHUNK)
_METADATA = int(Opcode.METADATA)
_MESSAGE_INDEX = int(Opcode.MESSAGE_INDEX)
# fewest bytes of a record that is read here
_LEAST_BYTES = {_CHUNK: _CHUNK_TIMES.size, _MESSAGE_INDEX: _INDEX_HEAD.size}


class RecordedMessage(NamedTuple):
    """One message of the record."""

    stamp_ns: int  # on the record's common clock
    topic: str
    name: str
    message: Message


class RawMessage(NamedTuple):
    """One message of the record, still as JSON."""

    stamp_ns: int  # on the record's common clock
    topic: str
    name: str
    kind: type[Message]
    data: bytes  # JSON


class RawChannel(NamedTuple):
    """Messages of one channel in one chunk, still as JSON."""

    topic: str
    name: str
    kind: type[Message]
    stamps_ns: list[int]  # on the record's common clock
    datas: list[bytes]  # JSON texts


@dataclass(slots=True)
class _Chunk:
    """One chunk of the file."""

    offset: int  # offset of its content in the file
    size: int
    begin_ns: int = 0
    end_ns: int = 0
    shifts_ns: dict[str, int] = field(default_factory=dict)  # clock -> its time minus common time


@dataclass(frozen=True, slots=True)
class _RecordChannel:
    """One channel of the file."""

    topic: str
    name: str
    kind: type[Message]
    clock: str  # the clock of its stamps


def _clock_of(topic: str, name: str) -> str:
    """Return the name of the clock of a channel's stamps: a vehicle's, or that of another node."""
    if topic in ("truth", "mocap"):
        return topic
    if topic in ("order", REPLY):
        return _GROUND
    return name


class Timeline:
    """An index of a record, and its messages.

    Args:
        folder: flight folder, or the MCAP file itself.

    Raises:
        ConfigError: the file is not a record, or no part of it can be read.
    """

    def __init__(self, folder: Path) -> None:
        self.path = record_path(folder)
        self.broken = ""  # sentence about damage of the record; empty if it is whole
        self.made_by: dict[str, str] = {}  # program, version and start; empty in older records
        self.malformed = 0  # messages that could not be decoded
        self.events: list[tuple[int, Event]] = []  # (stamp, event), sorted, up to the limits above
        self.left_out_events = 0  # number of later events that are beyond the limits
        self._alarms = 0  # number of warnings and critical events among the events
        self._channels: dict[int, _RecordChannel] = {}
        self._schemas: dict[int, str] = {}
        self._chunks: list[_Chunk] = []
        self._set_back: _SetBack | None = None

        self._stream = opened(self.path, RECORD)
        try:
            self._scan()
        except ConfigError:
            self._stream.close()
            raise
        if not self._chunks:
            self._stream.close()
            reason = self.broken or "The record is empty."
            raise ConfigError(f"{self.path}: nothing of a flight can be read. {reason}".strip())

        self.events.sort(key=lambda pair: pair[0])
        begins_ns = [chunk.begin_ns for chunk in self._chunks]
        ends_ns = [chunk.end_ns for chunk in self._chunks]
        self.begin_ns = min(begins_ns)
        self.end_ns = max(ends_ns)

        # For each chunk: the latest stamp up to this chunk, and the earliest stamp from it on.
        self._latest = list(accumulate(ends_ns, max))
        self._earliest = list(accumulate(reversed(begins_ns), min))
        self._earliest.reverse()

    @property
    def length_s(self) -> float:
        """Seconds from the first stamp to the last."""
        return (self.end_ns - self.begin_ns) * 1e-9

    @property
    def damage(self) -> list[str]:
        """Sentences about what is damaged in the record; empty if it is whole."""
        damage = []
        if self.broken:
            damage.append(self.broken)
        if self._set_back is not None:
            at_s = (self._set_back.at_ns - self._chunks[0].begin_ns) * 1e-9
            by_s = self._set_back.by_ns * 1e-9
            damage.append(
                f"The clock was set back by about {by_s:.0f} s after {at_s:.0f} s of the record:"
                " what came then is mixed with what was before. Do not trust its times, distances"
                " and figures."
            )
        return damage

    @property
    def notes(self) -> list[str]:
        """Sentences about what is missing in the record or in its events; empty if all is there."""
        notes = self.damage
        if self.left_out_events:
            notes.append(
                f"{self.left_out_events} events are left out: of debug and info events the first"
                f" {MAX_MINOR_EVENTS} are kept, of warnings and critical events the first"
                f" {MAX_ALARMS}."
            )
        return notes

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def read(self, after_ns: int, topics: frozenset[str]) -> Reading:
        """Return a reading of messages in the order of their stamps.

        Args:
            after_ns: only messages with later stamps are read.
            topics: topics that are read, for instance ``telemetry``.

        Returns:
            A reading that goes forward.
        """
        return Reading(self, after_ns, topics)

    # -- the index ---------------------------------------------------------------------------------

    def _scan(self) -> None:
        """Index the file from its start to its end, or as far as it can be read."""
        stamps = _Stamps()
        try:
            self._scan_records(stamps)
        except (OSError, struct.error) as error:
            self.broken = f"{self.path.name} cannot be read further ({error})."
        self._apply_shifts(stamps)

    def _require_record(self) -> None:
        """Raise ConfigError if the file does not begin as a record."""
        self._stream.seek(0)
        begin = self._stream.read(len(MAGIC))
        if begin.startswith(_ZIP_MAGIC):
            raise ConfigError(
                f"{self.path}: this is a ZIP file. Unpack it, and give the folder of a recorded"
                " flight."
            )
        if begin != MAGIC:
            raise ConfigError(
                f"{self.path}: this is no MCAP file. Give the folder of a recorded flight."
            )

    def _scan_records(self, stamps: _Stamps) -> None:
        """Read the heads of the file's records, and the indexes of its chunks."""
        self._require_record()
        stream = self._stream
        size = stream.seek(0, io.SEEK_END)
        summary = read_summary(stream)
        for record in summary.channels:
            self._add_channel(record)

        next_chunks = deque(summary.chunk_starts)  # of the chunks that the summary knows
        offset = len(MAGIC)
        stream.seek(offset)
        while True:
            head = stream.read(_HEAD.size)
            if len(head) < _HEAD.size:
                self.broken = "The record was cut off: it ends without its end mark."
                break
            opcode, length = _HEAD.unpack(head)

            is_wrong = opcode not in _OPCODES
            if next_chunks and offset == next_chunks[0]:
                next_chunks.popleft()
                is_wrong = opcode != _CHUNK
            offset += _HEAD.size
            if next_chunks and (opcode == _DATA_END or offset + length > next_chunks[0]):
                is_wrong = True
            if length < _LEAST_BYTES.get(opcode, 0):
                is_wrong = True

            if is_wrong:
                self.broken = DAMAGED_PIECE
                if next_chunks:
                    offset = next_chunks[0]
                    stream.seek(offset)
                    continue

            if opcode == _DATA_END:
                if not self._has_end_mark():
                    self.broken = self._cut_off("in its closing part", "what was flown is whole")
                break
            if offset + length > size:
                self.broken = self._past_the_end(bool(summary.chunk_starts))
                break

            # nearly all records are message indexes; reading one moves the file to the next record
            if opcode == _MESSAGE_INDEX and self._chunks:
                self._read_message_index(stream.read(length), stamps)
                offset += length
                continue

            if opcode == _CHUNK:
                begin_ns, end_ns = _CHUNK_TIMES.unpack(stream.read(_CHUNK_TIMES.size))
                self._chunks.append(_Chunk(offset, length, begin_ns, end_ns))
                stamps.begin()
            elif opcode == _METADATA and length <= _MAX_METADATA_BYTES:
                self._read_made_by(stream.read(length))

            offset += length
            stream.seek(offset)

    def _past_the_end(self, knows_chunks: bool) -> str:
        """Return a sentence about a piece that would end beyond the file.

        Args:
            knows_chunks: whether the summary has named all chunks, so none comes after this piece.
        """
        if not self._has_end_mark():
            return self._cut_off("in the middle of a piece", "what was before it is shown")
        if knows_chunks:
            return DAMAGED_PIECE
        return _DAMAGED_REST

    def _has_end_mark(self) -> bool:
        """Return whether the file ends as a closed record does; the file's position changes."""
        size = self._stream.seek(0, io.SEEK_END)
        self._stream.seek(max(0, size - len(MAGIC)))
        return self._stream.read() == MAGIC

    def _cut_off(self, where: str, rest: str) -> str:
        """Return a sentence about a cut, and about the rest of the flight, if there is any."""
        if not self._chunks:
            return f"The record was cut off {where}."
        return f"The record was cut off {where}; {rest}."

    def _read_made_by(self, data: bytes) -> None:
        """Read the metadata about the program that wrote the record; skip it if it is damaged."""
        with contextlib.suppress(*DAMAGED):
            metadata = Metadata.read(ReadDataStream(io.BytesIO(data)))
            if metadata.name == MADE_BY:
                self.made_by.update(metadata.metadata)

    def _apply_shifts(self, stamps: _Stamps) -> None:
        """Shift the times of all chunks onto the common clock, and read the events."""
        if self.broken and self._chunks:
            self._read_channels(self._chunks[-1])  # a part of its index may be cut off

        settled_chunks = list(stamps.settled())
        self._set_back = stamps.set_back
        for number, (chunk, settled) in enumerate(zip(self._chunks, settled_chunks, strict=True)):
            if settled.end_ns >= settled.begin_ns:
                chunk.begin_ns = settled.begin_ns
                chunk.end_ns = settled.end_ns
            else:
                self._read_channels(chunk)  # it has no index, so its channels may be unknown

            chunk.shifts_ns = settled.shifts_ns
            if settled.has_events:
                self._read_events(number)

    def _read_message_index(self, data: bytes, stamps: _Stamps) -> None:
        """Read first, middle and last stamp from a message index of the newest chunk."""
        channel_id, length = _INDEX_HEAD.unpack_from(data)
        if length < _INDEX_ENTRY_BYTES or len(data) < _INDEX_HEAD.size + length:
            return

        if channel_id not in self._channels:
            self._read_channels(self._chunks[-1])
        channel = self._channels.get(channel_id)
        if channel is None:
            return

        # A record has very many message indexes, so only three entries of each are read.
        count = length // _INDEX_ENTRY_BYTES
        unpack = _STAMP.unpack_from
        middle = _INDEX_HEAD.size + (count - 1) // 2 * _INDEX_ENTRY_BYTES
        last = _INDEX_HEAD.size + (count - 1) * _INDEX_ENTRY_BYTES
        (first_ns,) = unpack(data, _INDEX_HEAD.size)
        (middle_ns,) = unpack(data, middle)
        (last_ns,) = unpack(data, last)
        stamps.add(
            channel.clock,
            (first_ns, middle_ns, last_ns),
            count,
            is_event=channel.topic == "event",
        )

    def _read_channels(self, chunk: _Chunk) -> None:
        """Read the channels that begin in a chunk; the file's position is restored."""
        position = self._stream.tell()
        for record in self._unpacked(chunk, chunk_records):
            self._add_channel(record)
        self._stream.seek(position)

    def _add_channel(self, record: McapRecord) -> None:
        """Keep a channel, or a schema, which comes before its channels; leave out all else."""
        if isinstance(record, Schema):
            self._schemas[record.id] = record.name
        elif isinstance(record, Channel):
            topic, _, name = record.topic.partition("/")
            schema = self._schemas.get(record.schema_id, "")
            kind = KINDS.get(schema.removeprefix("covey."))
            if kind is not None:
                self._channels[record.id] = _RecordChannel(
                    topic=topic, name=name, kind=kind, clock=_clock_of(topic, name)
                )

    def _read_events(self, number: int) -> None:
        # those that cannot be decoded are counted by whoever reads the messages
        for raw in self.raw_messages(number, frozenset(("event",))):
            event = from_json(raw.kind, raw.data)
            if isinstance(event, Event):
                self._keep_event(raw.stamp_ns, event)

    def _keep_event(self, stamp_ns: int, event: Event) -> None:
        """Keep an event, or count it if there are too many; few are warnings or critical."""
        is_alarm = event.severity in ("warning", "critical")
        if is_alarm:
            is_kept = self._alarms < MAX_ALARMS
        else:
            is_kept = len(self.events) - self._alarms < MAX_MINOR_EVENTS

        if not is_kept:
            self.left_out_events += 1
            return
        self.events.append((stamp_ns, event))
        self._alarms += is_alarm

    # -- the messages ------------------------------------------------------------------------------

    def first_chunk(self, after_ns: int) -> int:
        """Return the index of the first chunk that may hold a later stamp."""
        return bisect.bisect_right(self._latest, after_ns)

    def earliest_from_ns(self, number: int) -> float:
        """Return the earliest stamp in this chunk and all after it; infinite after the last one."""
        if number >= len(self._chunks):
            return math.inf
        return self._earliest[number]

    def messages(self, number: int, topics: frozenset[str]) -> Iterator[RecordedMessage]:
        """Yield the decoded messages of one chunk; those that cannot be decoded are counted.

        Args:
            number: index of the chunk.
            topics: topics that are read, for instance ``telemetry``.

        Yields:
            Messages in the order of the file.
        """
        for raw in self.raw_messages(number, topics):
            message = from_json(raw.kind, raw.data)
            if message is None:
                self.malformed += 1
                continue
            yield RecordedMessage(raw.stamp_ns, raw.topic, raw.name, message)

    def raw_messages(self, number: int, topics: frozenset[str]) -> Iterator[RawMessage]:
        """Yield the messages of one chunk, still as JSON.

        Args:
            number: index of the chunk.
            topics: topics that are read, for instance ``telemetry``.

        Yields:
            Messages in the order of the file.
        """
        chunk = self._chunks[number]
        channels = self._channels_of(topics)
        unpack = partial(chunk_messages, channel_ids=channels)
        for channel_id, log_time_ns, data in self._unpacked(chunk, unpack):
            channel = channels[channel_id]
            stamp_ns = log_time_ns - chunk.shifts_ns.get(channel.clock, 0)
            yield RawMessage(
                stamp_ns=stamp_ns,
                topic=channel.topic,
                name=channel.name,
                kind=channel.kind,
                data=data,
            )

    def samples(self, topics: Collection[str]) -> Iterator[Sample]:
        """Yield all messages of some topics as JSON mappings.

        Messages that are not JSON, and those whose stamp has no 63 bits, are left out.

        Args:
            topics: topics that are read, for instance ``telemetry``.

        Yields:
            Samples in the order of the file, stamped on the record's common clock.
        """
        read_topics = frozenset(topics)
        for number in range(self.chunk_count):
            for raw in self.raw_messages(number, read_topics):
                values = json_object(raw.data)
                if values is not None and 0 <= raw.stamp_ns <= MAX_STAMP_NS:
                    yield Sample(f"{raw.topic}/{raw.name}", raw.stamp_ns, values)

    def raw_channels(self, number: int, topics: frozenset[str]) -> list[RawChannel]:
        """Return the messages of one chunk by channel, still as JSON.

        Args:
            number: index of the chunk.
            topics: topics that are read, for instance ``telemetry``.
        """
        chunk = self._chunks[number]
        channels = self._channels_of(topics)
        # id of a channel -> stamps [ns] and JSON texts of its messages
        contents: dict[int, tuple[list[int], list[bytes]]] = {}
        unpack = partial(chunk_messages, channel_ids=channels)
        for channel_id, log_time_ns, data in self._unpacked(chunk, unpack):
            if channel_id not in contents:
                contents[channel_id] = ([], [])
            log_times_ns, datas = contents[channel_id]
            log_times_ns.append(log_time_ns)
            datas.append(data)

        raw_channels = []
        for channel_id, (log_times_ns, datas) in contents.items():
            channel = channels[channel_id]
            shift_ns = chunk.shifts_ns.get(channel.clock, 0)
            stamps_ns = log_times_ns
            if shift_ns:
                stamps_ns = [log_time_ns - shift_ns for log_time_ns in log_times_ns]
            raw_channels.append(
                RawChannel(
                    topic=channel.topic,
                    name=channel.name,
                    kind=channel.kind,
                    stamps_ns=stamps_ns,
                    datas=datas,
                )
            )
        return raw_channels

    def _channels_of(self, topics: frozenset[str]) -> dict[int, _RecordChannel]:
        return {
            channel_id: channel
            for channel_id, channel in self._channels.items()
            if channel.topic in topics
        }

    def rising_spans_ns(self) -> list[list[tuple[int, int]]]:
        """Return the time spans of the chunks in the order of the file, as start and end [ns].

        A new list begins where the common clock was set back.
        """
        rising: list[list[tuple[int, int]]] = []
        before_ns = 0
        for chunk in self._chunks:
            # both begins may differ from the times of their chunks
            if not rising or chunk.begin_ns < before_ns - 2 * MAX_LATE_NS:
                rising.append([])
            rising[-1].append((chunk.begin_ns, chunk.end_ns))
            before_ns = chunk.begin_ns
        return rising

    @property
    def topics(self) -> frozenset[str]:
        """Topics of all channels whose kind of message is known to this version of Covey."""
        return frozenset(channel.topic for channel in self._channels.values())

    @property
    def vehicles(self) -> tuple[str, ...]:
        """Names of the vehicles with telemetry, ticks or ground truth in the record."""
        topics = ("telemetry", "tick", "truth")
        names = {channel.name for channel in self._channels.values() if channel.topic in topics}
        return tuple(sorted(names, key=natural_sort_key))

    def count_messages(self) -> int:
        """Return how many messages of the record can be read."""
        count = 0
        for number in range(self.chunk_count):
            for channel in self.raw_channels(number, self.topics):
                count += len(channel.datas)
        return count

    @property
    def chunk_count(self) -> int:
        """Number of chunks in the file."""
        return len(self._chunks)

    def _unpacked(
        self, chunk: _Chunk, unpack: Callable[[Chunk], list[_Part] | None]
    ) -> list[_Part]:
        """Return the parts of a chunk; an empty list, and a note in ``broken``, if it is damaged.

        Args:
            chunk: the chunk.
            unpack: returns the parts of a chunk, or None if it is damaged.
        """
        self._stream.seek(chunk.offset)
        try:
            data = self._stream.read(chunk.size)
            parts = unpack(Chunk.read(ReadDataStream(io.BytesIO(data))))
        except (OSError, *DAMAGED):  # OSError: the disk cannot read it
            parts = None

        if parts is None:
            if not self.broken:
                self.broken = DAMAGED_PIECE
            return []
        return parts


class Reading:
    """Reads messages in the order of their stamps, up to a time that only moves forward.

    A chunk is decoded when it may contain the next message. A heap sorts the messages of the
    decoded chunks.

    Args:
        timeline: the record.
        after_ns: only messages with later stamps are read.
        topics: topics that are read, for instance ``telemetry``.
    """

    def __init__(self, timeline: Timeline, after_ns: int, topics: frozenset[str]) -> None:
        self._timeline = timeline
        self._after_ns = after_ns
        self._topics = topics
        self._next_chunk = timeline.first_chunk(after_ns)
        # stamp, number in the order of the file (which sorts equal stamps), message
        self._heap: list[tuple[int, int, RecordedMessage]] = []
        self._count = 0  # number of messages that were put on the heap

    @property
    def pending(self) -> int:
        """Number of messages that are decoded but not yet yielded."""
        return len(self._heap)

    def until(self, until_ns: int) -> Iterator[RecordedMessage]:
        """Yield the next messages, with stamps up to and including ``until_ns``."""
        while True:
            while self._must_decode_next_chunk(until_ns):
                self._load()

            if not self._heap or self._next_stamp_ns > until_ns:
                return
            _, _, message = heapq.heappop(self._heap)
            yield message

    @property
    def _next_stamp_ns(self) -> int:
        stamp_ns, _, _ = self._heap[0]
        return stamp_ns

    def _must_decode_next_chunk(self, until_ns: int) -> bool:
        """Whether a chunk that is not decoded may hold the next message."""
        latest_ns = until_ns
        if self._heap:
            latest_ns = min(until_ns, self._next_stamp_ns)
        return self._timeline.earliest_from_ns(self._next_chunk) <= latest_ns

    def _load(self) -> None:
        for recorded in self._timeline.messages(self._next_chunk, self._topics):
            if recorded.stamp_ns > self._after_ns:
                self._count += 1
                heapq.heappush(self._heap, (recorded.stamp_ns, self._count, recorded))
        self._next_chunk += 1


class _SetBack(NamedTuple):
    """A change of the common clock to an earlier time."""

    at_ns: int  # its time before
    by_ns: int


class _Settled(NamedTuple):
    """The time span of a chunk on the common clock."""

    begin_ns: int
    end_ns: int  # below begin_ns if the file has no index of this chunk
    shifts_ns: dict[str, int]  # clock -> its time minus common time
    has_events: bool


@dataclass(slots=True)
class _Span:
    """Stamps of one clock in one chunk, as they were written."""

    first_ns: int
    last_ns: int
    middle_ns: int  # stamp of the middle message of the channel with most messages
    channel_count: int  # number of messages of that channel
    message_count: int  # number of messages of all channels of this clock


def _bounds_ns(
    spans: Mapping[str, _Span], shifts_ns: Mapping[str, int], time_ns: int
) -> tuple[int, int]:
    """Return start and end [ns] of a chunk on the common clock; 0 and -1 if it is empty.

    Only stamps near the time of the chunk count, because its first or last stamp may be absurd.

    Args:
        spans: stamps of the chunk by clock.
        shifts_ns: shifts of the clocks.
        time_ns: time of the chunk on the common clock.
    """
    begins_ns = []
    ends_ns = []
    for clock, span in spans.items():
        stamps_ns = [
            stamp_ns - shifts_ns[clock]
            for stamp_ns in (span.first_ns, span.middle_ns, span.last_ns)
        ]
        near_ns = [stamp_ns for stamp_ns in stamps_ns if abs(stamp_ns - time_ns) <= MAX_LATE_NS]
        if near_ns:
            begins_ns.append(near_ns[0])
            ends_ns.append(near_ns[-1])
    return min(begins_ns, default=0), max(ends_ns, default=-1)


def _agrees(span: _Span, shift_ns: int, common_span: _Span) -> bool:
    """Return whether the stamps of a clock are within the time of a chunk on the common clock.

    Args:
        span: stamps of the clock in the chunk.
        shift_ns: shift of the clock.
        common_span: stamps of the common clock in the chunk.
    """
    stamp_ns = span.middle_ns - shift_ns
    outside_ns = max(common_span.first_ns - stamp_ns, stamp_ns - common_span.last_ns)
    return outside_ns <= CLOCK_APART_NS


def _shift_ns(span: _Span, time_ns: int) -> int:
    """Return the shift of a clock from its stamps in a chunk, and the time of the chunk."""
    apart_ns = span.middle_ns - time_ns
    if abs(apart_ns) <= CLOCK_APART_NS:
        return 0
    return apart_ns


def _time_of_most_messages_ns(spans: Mapping[str, _Span], shifts_ns: Mapping[str, int]) -> int:
    """Return the time of a chunk without the common clock, by the clock with most messages in it.

    Returns 0 for an empty chunk.
    """
    if not spans:
        return 0
    clock = max(spans, key=lambda clock: spans[clock].message_count)
    return spans[clock].middle_ns - shifts_ns[clock]


class _Stamps:
    """Stamps of every clock in every chunk, from which the shifts of the clocks follow.

    The time of a clock in a chunk is the stamp of the middle message of the channel with most
    messages. So a message that came late, with an old stamp, shifts no clock. A single message of a
    known clock in a chunk shifts that clock only if the single message of a later chunk agrees.
    """

    def __init__(self) -> None:
        self.set_back: _SetBack | None = None  # the first one, after settled()
        self._chunks: list[dict[str, _Span]] = []  # of each chunk: clock -> its stamps
        self._with_events: set[int] = set()  # indexes of chunks with events
        # clock -> difference of its last single message from the common clock
        self._single_apart_ns: dict[str, int] = {}

    def begin(self) -> None:
        """Begin the next chunk."""
        self._chunks.append({})

    def add(
        self, clock: str, stamps_ns: tuple[int, int, int], count: int, *, is_event: bool
    ) -> None:
        """Add the stamps of one channel of the present chunk.

        Args:
            clock: clock of the channel's sender.
            stamps_ns: stamps of the channel's first, middle and last message.
            count: number of its messages.
            is_event: whether they are events.
        """
        _, middle_ns, _ = stamps_ns
        first_ns = min(stamps_ns)
        last_ns = max(stamps_ns)

        if is_event:
            self._with_events.add(len(self._chunks) - 1)

        spans = self._chunks[-1]
        span = spans.get(clock)
        if span is None:
            spans[clock] = _Span(
                first_ns=first_ns,
                last_ns=last_ns,
                middle_ns=middle_ns,
                channel_count=count,
                message_count=count,
            )
            return

        if first_ns < span.first_ns:
            span.first_ns = first_ns
        if last_ns > span.last_ns:
            span.last_ns = last_ns
        span.message_count += count
        if count > span.channel_count:
            span.channel_count = count
            span.middle_ns = middle_ns

    def settled(self) -> Iterator[_Settled]:
        """Yield the start and end of each chunk, and the shift of each of its clocks.

        The common clock is the one that most chunks contain. Another clock may be hours away from
        it, for instance in a computer without a battery. The shift [ns] of a clock is subtracted
        from its stamps, so that they are times on the common clock. A clock gets a new shift in a
        chunk in which its stamps are outside the time of the chunk on the common clock. Earlier
        chunks keep their shifts. A chunk without the common clock changes no shift: a ground
        station that waited for its vehicles is not on another clock.
        """
        common = self._common_clock()
        shifts_ns = self._first_shifts_ns(common)  # clock -> its shift so far
        common_ns = 0  # newest time of the common clock
        for number, spans in enumerate(self._chunks):
            if common in spans:
                time_ns = self._chunk_time_ns(spans[common], common_ns)
                if self.set_back is None and common_ns - time_ns > CLOCK_APART_NS:
                    self.set_back = _SetBack(at_ns=common_ns, by_ns=common_ns - time_ns)
                common_ns = time_ns
                changes = self._changed_shifts_ns(spans, common, time_ns, shifts_ns)
                # Changes make a new mapping, because earlier chunks keep the shifts of their time.
                if changes:
                    shifts_ns = {**shifts_ns, **changes}
            else:
                time_ns = _time_of_most_messages_ns(spans, shifts_ns)

            begin_ns, end_ns = _bounds_ns(spans, shifts_ns, time_ns)
            yield _Settled(
                begin_ns=begin_ns,
                end_ns=end_ns,
                shifts_ns=shifts_ns,
                # a chunk without an index may hold events
                has_events=not spans or number in self._with_events,
            )

    def _first_shifts_ns(self, common: str) -> dict[str, int]:
        """Return the shift [ns] of each clock in the first chunk that also holds the common one.

        A clock that shares no chunk with the common one is not shifted.
        """
        shifts_ns: dict[str, int] = {}
        time_ns = 0
        for spans in self._chunks:
            if common in spans:
                time_ns = self._chunk_time_ns(spans[common], time_ns)
                for clock in spans.keys() - shifts_ns.keys():
                    shifts_ns[clock] = 0
                    if not _agrees(spans[clock], 0, spans[common]):
                        shifts_ns[clock] = _shift_ns(spans[clock], time_ns)

        clocks = {clock for spans in self._chunks for clock in spans}
        return dict.fromkeys(clocks, 0) | shifts_ns

    def _changed_shifts_ns(
        self,
        spans: Mapping[str, _Span],
        common: str,
        time_ns: int,
        shifts_ns: Mapping[str, int],
    ) -> dict[str, int]:
        """Return the new shifts [ns] of the clocks that no longer agree with the common clock.

        Args:
            spans: stamps of a chunk by clock.
            common: name of the common clock, which the chunk contains.
            time_ns: time of the chunk on the common clock.
            shifts_ns: shifts of the clocks so far.
        """
        changes = {}
        for clock, span in spans.items():
            if clock == common or _agrees(span, shifts_ns[clock], spans[common]):
                continue
            if self._is_confirmed(clock, span, span.middle_ns - time_ns):
                changes[clock] = _shift_ns(span, time_ns)
        return changes

    def _chunk_time_ns(self, span: _Span, before_ns: int) -> int:
        """Return the time of a chunk on the common clock.

        A single message that came late does not turn the time back.

        Args:
            span: stamps of the common clock in the chunk.
            before_ns: time of the chunk before.
        """
        is_single = span.message_count == 1
        is_late = span.middle_ns < before_ns
        if is_single and is_late:
            return before_ns
        return span.middle_ns

    def _is_confirmed(self, clock: str, span: _Span, apart_ns: int) -> bool:
        """Return whether a known clock was really changed.

        A single message of the clock in a chunk does not prove a change, because it may just be
        late. A single message in a later chunk with the same difference proves it.
        """
        if span.message_count > 1:
            self._single_apart_ns.pop(clock, None)
            return True

        before_ns = self._single_apart_ns.get(clock)
        self._single_apart_ns[clock] = apart_ns
        return before_ns is not None and abs(apart_ns - before_ns) <= CLOCK_APART_NS

    def _common_clock(self) -> str:
        """Return the clock that most chunks contain; among equals the ground's."""
        counts = Counter(clock for spans in self._chunks for clock in spans)
        return max(counts, key=lambda clock: (counts[clock], clock == _GROUND), default=_GROUND)
