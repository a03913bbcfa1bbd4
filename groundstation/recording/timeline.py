"""Index of a record: which chunk holds which time, and the messages in the order of their stamps.

The index has a row per chunk, read from the heads of the file's records. So a record that was cut
off opens as far as it goes, and memory does not grow with the messages. The ``mcap`` library
decodes the chunks; its seeking reader takes the summary at the end, which a record cut by SIGKILL
does not have, and ends at the first damaged chunk.

Hosts have clocks of their own: a sender whose stamps are far from the others' is shifted onto the
common clock.
"""

from __future__ import annotations

import bisect
import contextlib
import heapq
import math
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from io import BytesIO
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema

from groundstation.recording.channels import KINDS, REPLY, from_json
from groundstation.recording.reader import (
    DAMAGED,
    chunk_messages,
    chunk_records,
    record_path,
)
from groundstation.recording.writer import MADE_BY
from onboard.bus.schema import Event, Message
from onboard.config.file_reading import RECORD, opened
from onboard.config.fleet import ConfigError

MAX_EVENTS = 20_000
# Stamps further apart than this within one second of writing are of two clocks.
CLOCK_APART_NS = 5_000_000_000
# A chunk is written within seconds: a stamp further away from the others' does not make it longer.
MAX_LATE_NS = 60_000_000_000
_MAGIC = b"\x89MCAP0\r\n"
_GROUND = "ground"
_MAX_METADATA_BYTES = 64 * 1024
_Part = TypeVar("_Part")  # of a chunk

# Parts of an MCAP file, little-endian: the head of a record (opcode, length), the first two fields
# of a chunk (first and last stamp), the head of a message index (channel, length of its entries),
# and a stamp in it. An entry is a stamp and an offset of eight bytes each.
_HEAD = struct.Struct("<BQ")
_CHUNK_TIMES = struct.Struct("<QQ")
_INDEX_HEAD = struct.Struct("<HI")
_STAMP = struct.Struct("<Q")
_INDEX_ENTRY_BYTES = 16

# plain numbers, since members of an enumeration are looked up by name each time
_DATA_END = int(Opcode.DATA_END)
_CHUNK = int(Opcode.CHUNK)
_METADATA = int(Opcode.METADATA)
_MESSAGE_INDEX = int(Opcode.MESSAGE_INDEX)


class RecordedMessage(NamedTuple):
    """One message of the record."""

    stamp_ns: int  # on the record's common clock
    topic: str
    name: str
    message: Message


class RawMessage(NamedTuple):
    """One message of the record, not decoded."""

    stamp_ns: int  # on the record's common clock
    topic: str
    name: str
    kind: type[Message]
    data: bytes  # JSON


class RawChannel(NamedTuple):
    """Messages of one channel in one chunk, not decoded."""

    topic: str
    name: str
    kind: type[Message]
    stamps_ns: list[int]  # on the record's common clock
    datas: list[bytes]  # JSON each


@dataclass(slots=True)
class _Chunk:
    """One chunk of the file."""

    offset: int  # of its content in the file
    size: int
    begin_ns: int = 0
    end_ns: int = 0
    shifts_ns: dict[str, int] = field(default_factory=dict)  # of each clock from the common one


@dataclass(frozen=True, slots=True)
class _RecordChannel:
    """One channel of the file."""

    topic: str
    name: str
    kind: type[Message]
    clock: str  # of its stamps


def _clock_of(topic: str, name: str) -> str:
    """Return whose clock a channel's stamps are of: a vehicle, ground, emulator or mocap."""
    if topic in ("truth", "mocap"):
        return topic
    if topic in ("order", REPLY):
        return _GROUND
    return name


class Timeline:
    """Index of a record.

    Args:
        folder: flight folder, or the MCAP file itself.

    Raises:
        ConfigError: the file is no record, or nothing of it can be read.
    """

    def __init__(self, folder: Path) -> None:
        self.path = record_path(folder)
        self.broken = ""  # sentence about where the record breaks off; empty when it is whole
        self.made_by: dict[str, str] = {}  # program, version and begin; empty in older records
        self.malformed = 0  # messages that could not be decoded
        self.events: list[tuple[int, Event]] = []  # (stamp, event), sorted, at most MAX_EVENTS
        self._channels: dict[int, _RecordChannel] = {}
        self._schemas: dict[int, str] = {}
        self._chunks: list[_Chunk] = []

        self._stream = opened(self.path, RECORD)
        try:
            self._scan()
        except (OSError, struct.error) as error:
            self.broken = f"{self.path.name} cannot be read further ({error})."
        if not self._chunks:
            self._stream.close()
            reason = self.broken or "The record is empty."
            raise ConfigError(f"{self.path}: nothing of a flight can be read. {reason}".strip())

        self.events.sort(key=lambda pair: pair[0])
        begins_ns = [chunk.begin_ns for chunk in self._chunks]
        ends_ns = [chunk.end_ns for chunk in self._chunks]
        self.begin_ns = min(begins_ns)
        self.end_ns = max(ends_ns)

        # The latest stamp up to each chunk, and the earliest from each chunk on.
        self._latest = list(accumulate(ends_ns, max))
        self._earliest = list(accumulate(reversed(begins_ns), min))
        self._earliest.reverse()

    @property
    def length_s(self) -> float:
        """Seconds from the first stamp to the last."""
        return (self.end_ns - self.begin_ns) * 1e-9

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def read(self, after_ns: int, topics: frozenset[str]) -> Reading:
        """Begin to read messages in the order of their stamps.

        Args:
            after_ns: only stamps above this one.
            topics: first parts of the channels' names, as ``telemetry``.

        Returns:
            A reading that goes forward.
        """
        return Reading(self, after_ns, topics)

    # -- the index ---------------------------------------------------------------------------------

    def _scan(self) -> None:
        """Index the file from its begin to where it ends or breaks off."""
        stream = self._stream
        size = stream.seek(0, 2)
        stream.seek(0)
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise ConfigError(
                f"{self.path}: this is no MCAP file. Give the folder of a recorded flight."
            )

        stamps = _Stamps()
        offset = len(_MAGIC)
        while True:
            head = stream.read(_HEAD.size)
            if len(head) < _HEAD.size:
                self.broken = "The record was cut off: it ends without its end mark."
                break
            opcode, length = _HEAD.unpack(head)
            offset += _HEAD.size

            if opcode == _DATA_END:
                stream.seek(max(0, size - len(_MAGIC)))
                if stream.read() != _MAGIC:
                    self.broken = (
                        "The record was cut off in its closing part; what was flown is whole."
                    )
                break
            if offset + length > size:
                self.broken = (
                    "The record was cut off in the middle of a piece; what was before it is shown."
                )
                break

            # nearly all records are indexes, each of which leaves the file behind itself
            if opcode == _MESSAGE_INDEX and self._chunks:
                self._index(stream.read(length), stamps)
                offset += length
                continue

            if opcode == _CHUNK:
                chunk = _Chunk(offset, length)
                self._chunks.append(chunk)
                times = stream.read(_CHUNK_TIMES.size)
                chunk.begin_ns, chunk.end_ns = _CHUNK_TIMES.unpack(times)
                stamps.begin()
            elif opcode == _METADATA and length <= _MAX_METADATA_BYTES:
                self._learn_made(stream.read(length))

            offset += length
            stream.seek(offset)
        self._settle(stamps)

    def _learn_made(self, data: bytes) -> None:
        """Take in by what the record was written; what cannot be read is left out."""
        with contextlib.suppress(*DAMAGED):
            metadata = Metadata.read(ReadDataStream(BytesIO(data)))
            if metadata.name == MADE_BY:
                self.made_by.update(metadata.metadata)

    def _settle(self, stamps: _Stamps) -> None:
        """Put all chunks on one clock, and read the events."""
        if self.broken and self._chunks:
            self._learn(self._chunks[-1])  # the cut may have taken a part of its index

        settled_chunks = list(stamps.settled())
        for number, (chunk, settled) in enumerate(zip(self._chunks, settled_chunks, strict=True)):
            if settled.end_ns >= settled.begin_ns:
                chunk.begin_ns = settled.begin_ns
                chunk.end_ns = settled.end_ns
            else:
                self._learn(chunk)  # no index names its channels

            chunk.shifts_ns = settled.shifts_ns
            if settled.has_events:
                self._read_events(number)

    def _index(self, data: bytes, stamps: _Stamps) -> None:
        """Take first, middle and last stamp out of a channel's index of the newest chunk."""
        channel_id, length = _INDEX_HEAD.unpack_from(data)
        if length < _INDEX_ENTRY_BYTES or len(data) < _INDEX_HEAD.size + length:
            return

        if channel_id not in self._channels:
            self._learn(self._chunks[-1])
        channel = self._channels.get(channel_id)
        if channel is None:
            return

        # a record of ten minutes has 300,000 of these, so each is read in as few steps as it takes
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

    def _learn(self, chunk: _Chunk) -> None:
        """Read the channels that a chunk begins, and return to the present position of the file."""
        position = self._stream.tell()
        for record in self._unpacked(chunk, chunk_records):
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
        self._stream.seek(position)

    def _read_events(self, number: int) -> None:
        for one in self.messages(number, frozenset(("event",))):
            if isinstance(one.message, Event) and len(self.events) < MAX_EVENTS:
                self.events.append((one.stamp_ns, one.message))

    # -- the messages ------------------------------------------------------------------------------

    def first_chunk(self, after_ns: int) -> int:
        """Return the first chunk that may hold a stamp above this one."""
        return bisect.bisect_right(self._latest, after_ns)

    def may_begin_ns(self, number: int) -> float:
        """Return the earliest stamp of this chunk and all later ones; infinite after the last."""
        if number >= len(self._chunks):
            return math.inf
        return self._earliest[number]

    def messages(self, number: int, topics: frozenset[str]) -> Iterator[RecordedMessage]:
        """Decode one chunk.

        Args:
            number: of the chunk.
            topics: first parts of the channels' names, as ``telemetry``.

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
        """Yield the messages of one chunk as they stand there.

        Args:
            number: of the chunk.
            topics: first parts of the channels' names, as ``telemetry``.

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

    def raw_channels(self, number: int, topics: frozenset[str]) -> list[RawChannel]:
        """Return the messages of one chunk, channel by channel, as they stand there.

        Args:
            number: of the chunk.
            topics: first parts of the channels' names, as ``telemetry``.
        """
        chunk = self._chunks[number]
        channels = self._channels_of(topics)
        contents: dict[int, tuple[list[int], list[bytes]]] = {}
        unpack = partial(chunk_messages, channel_ids=channels)
        for channel_id, log_time_ns, data in self._unpacked(chunk, unpack):
            content = contents.get(channel_id)
            if content is None:
                content = contents[channel_id] = ([], [])
            content[0].append(log_time_ns)
            content[1].append(data)

        found = []
        for channel_id, (log_times_ns, datas) in contents.items():
            channel = channels[channel_id]
            shift_ns = chunk.shifts_ns.get(channel.clock, 0)
            stamps_ns = log_times_ns
            if shift_ns:
                stamps_ns = [log_time_ns - shift_ns for log_time_ns in log_times_ns]
            found.append(
                RawChannel(
                    topic=channel.topic,
                    name=channel.name,
                    kind=channel.kind,
                    stamps_ns=stamps_ns,
                    datas=datas,
                )
            )
        return found

    def _channels_of(self, topics: frozenset[str]) -> dict[int, _RecordChannel]:
        return {
            channel_id: channel
            for channel_id, channel in self._channels.items()
            if channel.topic in topics
        }

    @property
    def topics(self) -> frozenset[str]:
        """First parts of the names of all channels that this version knows."""
        return frozenset(channel.topic for channel in self._channels.values())

    @property
    def vehicles(self) -> tuple[str, ...]:
        """Names of the vehicles that tell of themselves, or whose true motion is known."""
        told = ("telemetry", "tick", "truth")
        names = {channel.name for channel in self._channels.values() if channel.topic in told}
        return tuple(sorted(names))

    @property
    def chunk_count(self) -> int:
        """Number of chunks in the file."""
        return len(self._chunks)

    def _unpacked(
        self, chunk: _Chunk, unpack: Callable[[Chunk], list[_Part] | None]
    ) -> list[_Part]:
        """Return the chunk's parts as ``unpack`` gives them; none of a damaged chunk."""
        self._stream.seek(chunk.offset)
        data = self._stream.read(chunk.size)
        try:
            parts = unpack(Chunk.read(ReadDataStream(BytesIO(data))))
        except DAMAGED:
            parts = None

        if parts is None:
            if not self.broken:
                self.broken = "A piece of the record is damaged; the flight jumps over it."
            return []
        return parts


class Reading:
    """Messages in the order of their stamps, up to a time that only moves forward.

    A chunk is decoded as soon as it may hold the next message, and a heap puts the messages of the
    decoded chunks in order.

    Args:
        timeline: the record.
        after_ns: only stamps above this one.
        topics: first parts of the channels' names.
    """

    def __init__(self, timeline: Timeline, after_ns: int, topics: frozenset[str]) -> None:
        self._timeline = timeline
        self._after_ns = after_ns
        self._topics = topics
        self._next_chunk = timeline.first_chunk(after_ns)
        # stamp, order in the file among equal stamps, message
        self._heap: list[tuple[int, int, RecordedMessage]] = []
        self._count = 0

    @property
    def pending(self) -> int:
        """Number of messages that are decoded and not yet yielded."""
        return len(self._heap)

    def until(self, until_ns: int) -> Iterator[RecordedMessage]:
        """Yield the messages not yet yielded, with stamps up to and including ``until_ns``."""
        while True:
            while self._timeline.may_begin_ns(self._next_chunk) <= self._next_stamp_ns(until_ns):
                self._load()

            if not self._heap or self._heap[0][0] > until_ns:
                return
            _, _, message = heapq.heappop(self._heap)
            yield message

    def _next_stamp_ns(self, until_ns: int) -> int:
        """Return the stamp of the next decoded message, or ``until_ns`` if that is earlier."""
        if not self._heap:
            return until_ns
        return min(until_ns, self._heap[0][0])

    def _load(self) -> None:
        for one in self._timeline.messages(self._next_chunk, self._topics):
            if one.stamp_ns > self._after_ns:
                self._count += 1
                heapq.heappush(self._heap, (one.stamp_ns, self._count, one))
        self._next_chunk += 1


class _Settled(NamedTuple):
    """A chunk on the common clock."""

    begin_ns: int
    end_ns: int  # below begin_ns when the file has no index of this chunk
    shifts_ns: dict[str, int]
    has_events: bool


@dataclass(slots=True)
class _Span:
    """Stamps of one clock in one chunk, as they were written."""

    first_ns: int
    last_ns: int
    middle_ns: int  # of the channel that has most messages
    channel_count: int  # messages of that channel
    message_count: int  # of all channels


class _Stamps:
    """Stamps of every clock in every chunk: from them follow its shifts from the common clock.

    A clock is read off the middle message of the channel that has most of them, so that a message
    that was late on its way, and bears an old stamp, shifts nothing. A clock that is known is not
    shifted by a single message of a chunk either, unless the next such chunk agrees with it.
    """

    def __init__(self) -> None:
        self._chunks: list[dict[str, _Span]] = []  # by clock
        self._with_events: set[int] = set()  # numbers of chunks
        self._lone_offs_ns: dict[str, int] = {}  # clock -> how far off its last lone message was

    def begin(self) -> None:
        """Begin the next chunk."""
        self._chunks.append({})

    def add(
        self, clock: str, stamps_ns: tuple[int, int, int], count: int, *, is_event: bool
    ) -> None:
        """Add the stamps of one channel of the present chunk.

        Args:
            clock: of the channel's sender.
            stamps_ns: of its first, its middle and its last message.
            count: of its messages.
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
        """Yield all chunks, put on the clock that is in most of them."""
        common = self._common_clock()
        now_ns = next((spans[common].middle_ns for spans in self._chunks if common in spans), 0)

        shifts_ns: dict[str, int] = {}
        for number, spans in enumerate(self._chunks):
            earliest_ns = latest_ns = now_ns
            if common in spans:
                now_ns = self._now_ns(spans[common], now_ns)
                earliest_ns = spans[common].first_ns
                latest_ns = spans[common].last_ns

            for clock, span in spans.items():
                apart_ns = span.middle_ns - now_ns
                stamp_ns = span.middle_ns - shifts_ns.get(clock, 0)
                off_ns = max(earliest_ns - stamp_ns, stamp_ns - latest_ns)
                if clock == common or off_ns <= CLOCK_APART_NS:
                    continue
                if clock in shifts_ns and not self._is_confirmed(clock, span, apart_ns):
                    continue

                is_apart = abs(apart_ns) > CLOCK_APART_NS
                # a new mapping: earlier chunks keep the shifts of their time
                shifts_ns = {**shifts_ns, clock: apart_ns if is_apart else 0}

            for clock in spans:
                if clock not in shifts_ns:
                    shifts_ns = {**shifts_ns, clock: 0}

            begins_ns = []
            ends_ns = []
            for clock, span in spans.items():
                # of a clock with an absurd stamp the middle one counts
                stamps_ns = [
                    stamp_ns - shifts_ns[clock]
                    for stamp_ns in (span.first_ns, span.middle_ns, span.last_ns)
                ]
                near_ns = [one for one in stamps_ns if abs(one - now_ns) <= MAX_LATE_NS]
                begins_ns += near_ns[:1]
                ends_ns += near_ns[-1:]

            yield _Settled(
                begin_ns=min(begins_ns, default=0),
                end_ns=max(ends_ns, default=-1),
                shifts_ns=shifts_ns,
                # a chunk without an index may hold events
                has_events=not spans or number in self._with_events,
            )

    def _now_ns(self, span: _Span, before_ns: int) -> int:
        """Return the time of a chunk on the common clock.

        Args:
            span: of that clock in the chunk.
            before_ns: the time of the chunk before.
        """
        is_lone = span.message_count == 1
        is_late = span.middle_ns < before_ns
        return before_ns if is_lone and is_late else span.middle_ns

    def _is_confirmed(self, clock: str, span: _Span, apart_ns: int) -> bool:
        """Whether a clock that is known has been set: one message of a chunk may just be late."""
        if span.message_count > 1:
            self._lone_offs_ns.pop(clock, None)
            return True

        before_ns = self._lone_offs_ns.get(clock)
        self._lone_offs_ns[clock] = apart_ns
        return before_ns is not None and abs(apart_ns - before_ns) <= CLOCK_APART_NS

    def _common_clock(self) -> str:
        """Return the clock that is in most chunks; of several the ground's."""
        counts = Counter(clock for spans in self._chunks for clock in spans)
        return max(counts, key=lambda clock: (counts[clock], clock == _GROUND), default=_GROUND)
