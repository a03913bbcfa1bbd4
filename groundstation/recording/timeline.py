"""A record to walk about in: where which second lies, and its messages in the order of their time. Light on memory.

Only an index is held: a row per chunk of the file, read from the chunks' heads, so that a record that was cut off opens
as well, as far as it goes. Hosts have clocks of their own: a sender whose stamps are far from the others' is moved.
"""

from __future__ import annotations

import bisect
import heapq
import math
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from typing import IO, NamedTuple

import zstandard

from groundstation.recording.channels import KINDS, REPLY, from_json
from groundstation.recording.reader import record_path
from onboard.bus.schema import Event, Message
from onboard.config.fleet import ConfigError

MAX_EVENTS = 20_000
MAX_CHUNK_BYTES = 256 * 1024 * 1024
CLOCK_APART_NS = 5_000_000_000  # stamps further apart than that within one second of writing are of two clocks
MAX_CHUNK_NS = 3_600_000_000_000  # a chunk is written within seconds; a stamp beyond that is a lie
_MAGIC = b"\x89MCAP0\r\n"
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _DATA_END = 3, 4, 5, 6, 7, 0x0F
_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_GROUND = "ground"


class Told(NamedTuple):
    """A message of the record: when (on the record's one clock), where it was said, and what."""

    stamp_ns: int
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
class _Channel:
    topic: str
    name: str
    kind: type[Message]

    @property
    def clock(self) -> str:
        """Whose clock its stamps are of."""
        if self.topic in ("truth", "mocap"):
            return self.topic
        return _GROUND if self.topic in ("order", REPLY) else self.name


class Timeline:
    """The index of a record; ConfigError when the file is no record at all.

    Attributes:
        begin_ns, end_ns: first and last stamp. events: (stamp, event), sorted, at most MAX_EVENTS.
        broken: empty, or a sentence about where and how the record breaks off. malformed: messages that were none.
    """

    def __init__(self, folder: Path) -> None:
        self.path = record_path(folder)
        self.broken = ""
        self.malformed = 0
        self.events: list[tuple[int, Event]] = []
        self._channels: dict[int, _Channel] = {}
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
        # where a stamp may begin to be found, and until where all later chunks are younger
        self._latest = list(accumulate((chunk.end_ns for chunk in self._chunks), max))
        self._earliest = list(accumulate((chunk.begin_ns for chunk in reversed(self._chunks)), min))[::-1]
        self.events.sort(key=lambda pair: pair[0])

    @property
    def length_s(self) -> float:
        """From the first stamp to the last."""
        return (self.end_ns - self.begin_ns) * 1e-9

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def told(self, after_ns: int, topics: frozenset[str]) -> Reading:
        """Messages with stamps above ``after_ns`` of channels of these ``topics``, in order; see :class:`Reading`."""
        return Reading(self, after_ns, topics)

    # -- the index -------------------------------------------------------------------------------------------------

    def _scan(self) -> None:
        stream = self._stream
        size = stream.seek(0, 2)
        stream.seek(0)
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise ConfigError(f"{self.path}: this is no MCAP file. Give the folder of a recorded flight.")
        offset, stamps = len(_MAGIC), _Stamps()
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
                    self.broken = "The record was cut off in its closing part; what was flown is whole."
                break
            if offset + length > size:
                self.broken = "The record was cut off in the middle of a piece; what was before it is shown."
                break
            if opcode == _CHUNK:
                self._chunks.append(_Chunk(offset, length))
                begin_ns, end_ns, _, _ = _CHUNK_HEAD.unpack(stream.read(_CHUNK_HEAD.size))
                self._chunks[-1].begin_ns, self._chunks[-1].end_ns = begin_ns, end_ns
                stamps.begin()
            elif opcode == _MESSAGE_INDEX and self._chunks:
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
        first_ns, last_ns = struct.unpack_from("<Q", data, 6)[0], struct.unpack_from("<Q", data, length - 10)[0]
        stamps.add(channel.clock, min(first_ns, last_ns), max(first_ns, last_ns), is_event=channel.topic == "event")

    def _learn(self, chunk: _Chunk) -> None:
        place = self._stream.tell()
        for opcode, start, end, data in self._records(chunk):
            if opcode == _SCHEMA:
                number = struct.unpack_from("<H", data, start)[0]
                self._schemas[number] = _text(data, start + 2)[0]
            elif opcode == _CHANNEL and end - start > 8:
                number, schema = struct.unpack_from("<HH", data, start)
                topic, _, name = _text(data, start + 4)[0].partition("/")
                kind = KINDS.get(self._schemas.get(schema, "").removeprefix("covey."))
                if kind is not None:
                    self._channels[number] = _Channel(topic, name, kind)
        self._stream.seek(place)

    def _read_events(self, number: int) -> None:
        for told in self.messages(number, frozenset(("event",))):
            if isinstance(told.message, Event) and len(self.events) < MAX_EVENTS:
                self.events.append((told.stamp_ns, told.message))

    # -- the messages ----------------------------------------------------------------------------------------------

    def first_chunk(self, after_ns: int) -> int:
        """The first chunk that may hold a stamp above this one."""
        return bisect.bisect_right(self._latest, after_ns)

    def may_begin_ns(self, number: int) -> float:
        """No message of this chunk or a later one is older than that; infinite after the last."""
        return self._earliest[number] if number < len(self._chunks) else math.inf

    def messages(self, number: int, topics: frozenset[str]) -> Iterator[Told]:
        """Messages of one chunk as they stand in it."""
        chunk = self._chunks[number]
        for opcode, start, end, data in self._records(chunk):
            if opcode != _MESSAGE or end - start < _MESSAGE_HEAD.size:
                continue
            channel_id, _, stamp_ns, _ = _MESSAGE_HEAD.unpack_from(data, start)
            channel = self._channels.get(channel_id)
            if channel is None or channel.topic not in topics:
                continue
            message = from_json(channel.kind, data[start + _MESSAGE_HEAD.size : end])
            if message is None:
                self.malformed += 1
                continue
            yield Told(stamp_ns - chunk.shifts_ns.get(channel.clock, 0), channel.topic, channel.name, message)

    def _records(self, chunk: _Chunk) -> Iterator[tuple[int, int, int, bytes]]:
        """Opcode, begin and end of each record within the chunk's bytes; nothing of a damaged chunk."""
        data = _unpacked(self._stream, chunk)
        if data is None:
            self.broken = self.broken or "A piece of the record is damaged; the flight jumps over it."
            return
        place = 0
        while place + _HEAD.size <= len(data):
            opcode, length = _HEAD.unpack_from(data, place)
            place += _HEAD.size
            if place + length > len(data):
                return
            yield opcode, place, place + length, data
            place += length


class Reading:
    """Messages in the order of their stamps, up to a time that only moves forward."""

    def __init__(self, timeline: Timeline, after_ns: int, topics: frozenset[str]) -> None:
        self._timeline, self._after_ns, self._topics = timeline, after_ns, topics
        self._next = timeline.first_chunk(after_ns)
        self._heap: list[tuple[int, int, Told]] = []
        self._count = 0

    def until(self, until_ns: int) -> Iterator[Told]:
        """All that was not given yet, with stamps up to and including ``until_ns``."""
        while True:
            while self._timeline.may_begin_ns(self._next) <= until_ns and (
                not self._heap or self._timeline.may_begin_ns(self._next) <= self._heap[0][0]
            ):
                self._load()
            if not self._heap or self._heap[0][0] > until_ns:
                return
            yield heapq.heappop(self._heap)[2]

    def _load(self) -> None:
        for told in self._timeline.messages(self._next, self._topics):
            if told.stamp_ns > self._after_ns:
                self._count += 1
                heapq.heappush(self._heap, (told.stamp_ns, self._count, told))
        self._next += 1


class _Settled(NamedTuple):
    """A chunk on the common clock; ends before it begins when the file has no index of it."""

    begin_ns: int
    end_ns: int
    shifts_ns: dict[str, int]
    has_events: bool


class _Stamps:
    """First and last stamps of every clock in every chunk, and from them how far each clock is from the common one."""

    def __init__(self) -> None:
        self._chunks: list[dict[str, tuple[int, int]]] = []
        self._with_events: set[int] = set()

    def begin(self) -> None:
        """The next chunk."""
        self._chunks.append({})

    def add(self, clock: str, first_ns: int, last_ns: int, *, is_event: bool) -> None:
        """A channel of this clock in the present chunk."""
        if last_ns - first_ns > MAX_CHUNK_NS:
            last_ns = first_ns
        old = self._chunks[-1].get(clock, (first_ns, last_ns))
        self._chunks[-1][clock] = (min(old[0], first_ns), max(old[1], last_ns))
        if is_event:
            self._with_events.add(len(self._chunks) - 1)

    def settled(self) -> Iterator[_Settled]:
        """All chunks on the clock that is in most of them."""
        counts = Counter(clock for spans in self._chunks for clock in spans)
        common = max(counts, key=lambda clock: (counts[clock], clock == _GROUND), default=_GROUND)
        now_ns = next((spans[common][0] for spans in self._chunks if common in spans), 0)
        shifts: dict[str, int] = {}
        for number, spans in enumerate(self._chunks):
            now_ns = spans[common][0] if common in spans else now_ns
            for clock, (first_ns, _) in spans.items():
                if clock != common and abs(first_ns - shifts.get(clock, 0) - now_ns) > CLOCK_APART_NS:
                    apart_ns = first_ns - now_ns
                    shifts = {**shifts, clock: apart_ns if abs(apart_ns) > CLOCK_APART_NS else 0}
            begin_ns = min((span[0] - shifts.get(clock, 0) for clock, span in spans.items()), default=0)
            end_ns = max((span[1] - shifts.get(clock, 0) for clock, span in spans.items()), default=-1)
            yield _Settled(begin_ns, end_ns, shifts, not spans or number in self._with_events)


def _unpacked(stream: IO[bytes], chunk: _Chunk) -> bytes | None:
    """The chunk's records; None when they are damaged."""
    stream.seek(chunk.offset)
    data = stream.read(chunk.size)
    try:
        _, _, size, crc = _CHUNK_HEAD.unpack_from(data)
        compression, place = _text(data, _CHUNK_HEAD.size)
        packed = data[place + 8 :]
        if size > MAX_CHUNK_BYTES:
            return None
        if compression == "zstd":
            packed = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
        elif compression:
            return None
    except (struct.error, zstandard.ZstdError, UnicodeDecodeError):
        return None
    return packed if len(packed) == size and (crc == 0 or zlib.crc32(packed) == crc) else None


def _text(data: bytes, place: int) -> tuple[str, int]:
    length = struct.unpack_from("<I", data, place)[0]
    return data[place + 4 : place + 4 + length].decode("utf-8", "replace"), place + 4 + length
