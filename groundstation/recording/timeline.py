"""Index of a record: which chunk holds which time, and the messages in the order of their stamps.

The index has a row per chunk, read from the heads of the file's records. So a record that was cut
off opens as far as it goes, and memory does not grow with the messages. The ``mcap`` library
decodes the chunks; its seeking reader needs the summary at the end, which a record cut by SIGKILL
does not have, and ends at the first damaged chunk.

Hosts have clocks of their own: a sender whose stamps are far from the others' is shifted onto the
common clock.
"""

from __future__ import annotations

import bisect
import heapq
import math
import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Schema
from mcap.records import Message as McapMessage

from groundstation.recording.channels import KINDS, REPLY, from_json
from groundstation.recording.reader import DAMAGED, chunk_records, record_path
from onboard.bus.schema import Event, Message
from onboard.config.fleet import ConfigError

MAX_EVENTS = 20_000
# stamps further apart than that within one second of writing are of two clocks
CLOCK_APART_NS = 5_000_000_000
MAX_CHUNK_NS = 3_600_000_000_000  # a chunk is written within seconds; a stamp further away is wrong
_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_CHUNK_TIMES = struct.Struct("<QQ")
_GROUND = "ground"


class RecordedMessage(NamedTuple):
    """One message of the record."""

    stamp_ns: int  # on the record's common clock
    topic: str
    name: str
    message: Message


@dataclass(slots=True)
class _Chunk:
    offset: int
    size: int
    begin_ns: int = 0
    end_ns: int = 0
    shifts_ns: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _RecordChannel:
    topic: str
    name: str
    kind: type[Message]

    @property
    def clock(self) -> str:
        """The clock of its stamps: of a vehicle, the ground, the emulator or the mocap."""
        if self.topic in ("truth", "mocap"):
            return self.topic
        return _GROUND if self.topic in ("order", REPLY) else self.name


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
        self.malformed = 0  # messages that could not be decoded
        self.events: list[tuple[int, Event]] = []  # (stamp, event), sorted, at most MAX_EVENTS
        self._channels: dict[int, _RecordChannel] = {}
        self._schemas: dict[int, str] = {}
        self._chunks: list[_Chunk] = []
        self._stream = self.path.open("rb")
        try:
            self._scan()
        except (OSError, struct.error) as error:
            self.broken = f"{self.path.name} cannot be read further ({error})."
        if not self._chunks:
            self._stream.close()
            raise ConfigError(
                f"{self.path}: nothing of a flight can be read. {self.broken or 'The record is empty.'}".strip()
            )
        self.begin_ns = min(chunk.begin_ns for chunk in self._chunks)
        self.end_ns = max(chunk.end_ns for chunk in self._chunks)
        # the latest stamp up to each chunk, and the earliest from each chunk on
        self._latest = list(accumulate((chunk.end_ns for chunk in self._chunks), max))
        self._earliest = list(
            accumulate((chunk.begin_ns for chunk in reversed(self._chunks)), min)
        )[::-1]
        self.events.sort(key=lambda pair: pair[0])

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
        stream = self._stream
        size = stream.seek(0, 2)
        stream.seek(0)
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise ConfigError(
                f"{self.path}: this is no MCAP file. Give the folder of a recorded flight."
            )
        offset, stamps = len(_MAGIC), _Stamps()
        while True:
            head = stream.read(_HEAD.size)
            if len(head) < _HEAD.size:
                self.broken = "The record was cut off: it ends without its end mark."
                break
            opcode, length = _HEAD.unpack(head)
            offset += _HEAD.size
            if opcode == Opcode.DATA_END:
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
            if opcode == Opcode.CHUNK:
                self._chunks.append(_Chunk(offset, length))
                times = _CHUNK_TIMES.unpack(stream.read(_CHUNK_TIMES.size))
                self._chunks[-1].begin_ns, self._chunks[-1].end_ns = times
                stamps.begin()
            elif opcode == Opcode.MESSAGE_INDEX and self._chunks:
                self._index(stream.read(length), stamps)
            offset += length
            stream.seek(offset)
        self._settle(stamps)

    def _settle(self, stamps: _Stamps) -> None:
        """Put all chunks on one clock, and read the events."""
        for number, (chunk, settled) in enumerate(zip(self._chunks, stamps.settled(), strict=True)):
            if settled.end_ns >= settled.begin_ns:
                chunk.begin_ns, chunk.end_ns = settled.begin_ns, settled.end_ns
            elif not self._channels:
                self._learn(chunk)
            chunk.shifts_ns = settled.shifts_ns
            if settled.has_events:
                self._read_events(number)

    def _index(self, data: bytes, stamps: _Stamps) -> None:
        channel_id, length = struct.unpack_from("<HI", data)
        if length < 16 or len(data) < 6 + length:
            return
        if channel_id not in self._channels:
            self._learn(self._chunks[-1])
        channel = self._channels.get(channel_id)
        if channel is None:
            return
        first_ns, last_ns = (
            struct.unpack_from("<Q", data, 6)[0],
            struct.unpack_from("<Q", data, length - 10)[0],
        )
        stamps.add(
            channel.clock,
            min(first_ns, last_ns),
            max(first_ns, last_ns),
            is_event=channel.topic == "event",
        )

    def _learn(self, chunk: _Chunk) -> None:
        position = self._stream.tell()
        for record in self._records(chunk):
            if isinstance(record, Schema):
                self._schemas[record.id] = record.name
            elif isinstance(record, Channel):
                topic, _, name = record.topic.partition("/")
                kind = KINDS.get(self._schemas.get(record.schema_id, "").removeprefix("covey."))
                if kind is not None:
                    self._channels[record.id] = _RecordChannel(topic, name, kind)
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
        return self._earliest[number] if number < len(self._chunks) else math.inf

    def messages(self, number: int, topics: frozenset[str]) -> Iterator[RecordedMessage]:
        """Decode one chunk.

        Args:
            number: of the chunk.
            topics: first parts of the channels' names, as ``telemetry``.

        Yields:
            Messages in the order of the file.
        """
        chunk = self._chunks[number]
        for record in self._records(chunk):
            if not isinstance(record, McapMessage):
                continue
            channel = self._channels.get(record.channel_id)
            if channel is None or channel.topic not in topics:
                continue
            message = from_json(channel.kind, record.data)
            if message is None:
                self.malformed += 1
                continue
            stamp_ns = record.log_time - chunk.shifts_ns.get(channel.clock, 0)
            yield RecordedMessage(stamp_ns, channel.topic, channel.name, message)

    def _records(self, chunk: _Chunk) -> list[McapRecord]:
        """The chunk's records; none of a damaged chunk."""
        self._stream.seek(chunk.offset)
        try:
            records = chunk_records(
                Chunk.read(ReadDataStream(BytesIO(self._stream.read(chunk.size))))
            )
        except DAMAGED:
            records = None
        if records is None:
            self.broken = (
                self.broken or "A piece of the record is damaged; the flight jumps over it."
            )
        return records or []


class Reading:
    """Messages in the order of their stamps, up to a time that only moves forward.

    Args:
        timeline: the record.
        after_ns: only stamps above this one.
        topics: first parts of the channels' names.
    """

    def __init__(self, timeline: Timeline, after_ns: int, topics: frozenset[str]) -> None:
        self._timeline, self._after_ns, self._topics = timeline, after_ns, topics
        self._next = timeline.first_chunk(after_ns)
        self._heap: list[tuple[int, int, RecordedMessage]] = []
        self._count = 0

    @property
    def pending(self) -> int:
        """Number of messages that are decoded and not yet yielded."""
        return len(self._heap)

    def until(self, until_ns: int) -> Iterator[RecordedMessage]:
        """Yield the messages not yet yielded, with stamps up to and including ``until_ns``."""
        while True:
            while self._timeline.may_begin_ns(self._next) <= until_ns and (
                not self._heap or self._timeline.may_begin_ns(self._next) <= self._heap[0][0]
            ):
                self._load()
            if not self._heap or self._heap[0][0] > until_ns:
                return
            yield heapq.heappop(self._heap)[2]

    def _load(self) -> None:
        for one in self._timeline.messages(self._next, self._topics):
            if one.stamp_ns > self._after_ns:
                self._count += 1
                heapq.heappush(self._heap, (one.stamp_ns, self._count, one))
        self._next += 1


class _Settled(NamedTuple):
    """A chunk on the common clock."""

    begin_ns: int
    end_ns: int  # below begin_ns when the file has no index of this chunk
    shifts_ns: dict[str, int]
    has_events: bool


class _Stamps:
    """First and last stamps of every clock in every chunk, and the shift of each clock from the
    common one.
    """

    def __init__(self) -> None:
        self._chunks: list[dict[str, tuple[int, int]]] = []
        self._with_events: set[int] = set()

    def begin(self) -> None:
        """Begin the next chunk."""
        self._chunks.append({})

    def add(self, clock: str, first_ns: int, last_ns: int, *, is_event: bool) -> None:
        """Add the stamps of one channel of the present chunk."""
        if last_ns - first_ns > MAX_CHUNK_NS:
            last_ns = first_ns
        old = self._chunks[-1].get(clock, (first_ns, last_ns))
        self._chunks[-1][clock] = (min(old[0], first_ns), max(old[1], last_ns))
        if is_event:
            self._with_events.add(len(self._chunks) - 1)

    def settled(self) -> Iterator[_Settled]:
        """Yield all chunks, put on the clock that is in most of them."""
        counts = Counter(clock for spans in self._chunks for clock in spans)
        common = max(counts, key=lambda clock: (counts[clock], clock == _GROUND), default=_GROUND)
        now_ns = next((spans[common][0] for spans in self._chunks if common in spans), 0)
        shifts: dict[str, int] = {}
        for number, spans in enumerate(self._chunks):
            now_ns = spans[common][0] if common in spans else now_ns
            for clock, (first_ns, _) in spans.items():
                if (
                    clock != common
                    and abs(first_ns - shifts.get(clock, 0) - now_ns) > CLOCK_APART_NS
                ):
                    apart_ns = first_ns - now_ns
                    shifts = {**shifts, clock: apart_ns if abs(apart_ns) > CLOCK_APART_NS else 0}
            begin_ns = min(
                (span[0] - shifts.get(clock, 0) for clock, span in spans.items()), default=0
            )
            end_ns = max(
                (span[1] - shifts.get(clock, 0) for clock, span in spans.items()), default=-1
            )
            yield _Settled(begin_ns, end_ns, shifts, not spans or number in self._with_events)
