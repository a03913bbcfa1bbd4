"""Reads a whole record into a :class:`~groundstation.recording.recorded_flight.Flight`.

The index of the record (:mod:`groundstation.recording.timeline`) finds its chunks, shifts the
stamps of all computers onto one clock, and skips damaged chunks. Here the messages of a vehicle
become rows of numbers. JSON is decoded into the kept fields only, which is much faster than
decoding the whole message. Each field may be missing.

Records may come from anybody. A message that is not JSON, or has a text in place of a number, is
left out and counted. Absurd numbers become NaN, stamps far from all others are left out, and the
numbers of vehicles and events are limited.
"""

from __future__ import annotations

import contextlib
import gc
import itertools
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec
import numpy as np

from groundstation.recording.audit import TOPICS as ORDER_TOPICS
from groundstation.recording.audit import trail_of
from groundstation.recording.channels import MAX_STAMP_NS, from_json, undecoded_words
from groundstation.recording.people_reading import PeopleTracks
from groundstation.recording.reader import MAX_FLIGHT_NS
from groundstation.recording.recorded_flight import (
    Flight,
    StateRows,
    TelemetryRows,
    Ticks,
    TruthRows,
    VehicleFlight,
)
from groundstation.recording.timeline import RawChannel, RecordedMessage, Timeline
from onboard.arrays import Array, IntArray
from onboard.bus.schema import Event, PreflightReport
from onboard.config.file_reading import (
    MISSION_FILE,
    RESULTS_FILE,
    json_values,
    read_bytes,
    read_text,
)
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.plain_text import plain_line

MAX_VEHICLES = 256
MAX_ORDER_MESSAGES = 50_000  # orders, replies and events
# messages of one vehicle and kind that are decoded at once; this many stay in the processor's cache
_DECODED_AT_ONCE = 64
MAX_MADE = 20  # kept entries about the program that wrote the record
MAX_NAME = 60  # letters of a flight's title
LARGEST = 1e9  # a number with a larger magnitude is absurd and becomes NaN
# A longer pause between stamps separates the flight from another one of the same record, or from
# stamps that do not belong to it.
MAX_PAUSE_S = 600.0
TOPICS = frozenset(("tick", "telemetry", "truth", "state", "preflight")) | ORDER_TOPICS

_Number = float | None
_Flag = bool | None
_Vec2 = tuple[_Number, _Number] | None
_Vec3 = tuple[_Number, _Number, _Number] | None
_Vec4 = tuple[_Number, _Number, _Number, _Number] | None


# -- the kept fields, with their names on the bus: vectors, single numbers, then texts ------------


class _TickRow(msgspec.Struct, gc=False):
    position_enu_m: _Vec3 = None
    velocity_enu_m_s: _Vec3 = None
    setpoint_position_enu_m: _Vec3 = None
    thrust_baseline_enu_m_s2: _Vec3 = None
    thrust_safe_enu_m_s2: _Vec3 = None
    setpoint_quaternion_enu_flu_wxyz: _Vec4 = None
    attitude_quaternion_enu_flu_wxyz: _Vec4 = None
    predicted_position_enu_m: _Vec3 = None
    predicted_velocity_enu_m_s: _Vec3 = None
    commanded_acceleration_enu_m_s2: _Vec3 = None
    period_s: _Number = None
    intervention_m_s2: _Number = None
    slack_m_s2: _Number = None
    setpoint_thrust_frac: _Number = None
    attitude_age_s: _Number = None
    active_neighbour: str = ""
    neighbour_ages_s: dict[str, _Number] = {}


class _TelemetryRow(msgspec.Struct, gc=False):
    position_enu_m: _Vec3 = None
    goal_position_enu_m: _Vec3 = None
    wind_enu_m_s: _Vec2 = None
    battery_frac: _Number = None
    battery_voltage_v: _Number = None
    gust_m_s: _Number = None
    max_wind_m_s: _Number = None
    corrections_age_s: _Number = None
    state_age_s: _Number = None
    autopilot_age_s: _Number = None
    neighbour_age_s: _Number = None
    loop_period_p99_ms: _Number = None
    loop_lateness_p99_ms: _Number = None
    mocap_delay_s: _Number = None
    hover_thrust_frac: _Number = None
    late_ticks: _Number = None
    missed_ticks: _Number = None
    malformed_messages: _Number = None
    refused_messages: _Number = None
    dropped_messages: _Number = None
    late_messages: _Number = None
    is_airborne: _Flag = None
    state: str = ""
    mode: str = ""
    order_kind: str = ""
    fix: str = ""
    law: str = ""
    config_hash: str = ""


class _TruthRow(msgspec.Struct, gc=False):
    position_enu_m: _Vec3 = None
    velocity_enu_m_s: _Vec3 = None
    quaternion_enu_flu_wxyz: _Vec4 = None
    is_on_ground: bool = False
    is_collided: bool = False


class _StateRow(msgspec.Struct, gc=False):
    position_std_m: _Number = None
    velocity_std_m_s: _Number = None
    is_cooperative: bool = True


_SIZES = {_Number: 1, _Flag: 1, _Vec2: 2, _Vec3: 3, _Vec4: 4, bool: 1}


def _number_fields(row: type[msgspec.Struct]) -> dict[str, int]:
    """Return the number fields of a row, each with its count of numbers."""
    fields = msgspec.structs.fields(row)
    return {field.name: _SIZES[field.type] for field in fields if field.type in _SIZES}


_TICK_FIELDS = _number_fields(_TickRow)
_TELEMETRY_FIELDS = _number_fields(_TelemetryRow)
_TRUTH_FIELDS = _number_fields(_TruthRow)
_STATE_FIELDS = _number_fields(_StateRow)

_Row = TypeVar("_Row", bound=msgspec.Struct)
_TICK_DECODER = msgspec.json.Decoder(_TickRow)
_TELEMETRY_DECODER = msgspec.json.Decoder(_TelemetryRow)
_TRUTH_DECODER = msgspec.json.Decoder(_TruthRow)
_STATE_DECODER = msgspec.json.Decoder(_StateRow)
_UNDECODABLE = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)


def _decoded(
    decoder: msgspec.json.Decoder[_Row], stamps_ns: list[int], datas: list[bytes]
) -> tuple[list[int], list[_Row]]:
    """Return stamps and rows of JSON texts; texts that cannot be decoded are left out."""
    try:
        return stamps_ns, list(map(decoder.decode, datas))
    except _UNDECODABLE:
        pass

    # at least one cannot be decoded: try them one by one
    kept_ns: list[int] = []
    rows: list[_Row] = []
    for stamp_ns, data in zip(stamps_ns, datas, strict=True):
        with contextlib.suppress(*_UNDECODABLE):
            rows.append(decoder.decode(data))
            kept_ns.append(stamp_ns)
    return kept_ns, rows


# -- collecting ------------------------------------------------------------------------------------


class _Rows:
    """A growing table of numbers: one row for each message, one column for each number."""

    def __init__(self, fields: dict[str, int]) -> None:
        self._fields = fields
        self._width = sum(fields.values())
        self._stamps_ns = array("q")
        self._blocks: list[Array] = []  # each of shape (rows, width)

    def add(self, stamps_ns: list[int], rows: Sequence[msgspec.Struct]) -> None:
        """Add rows, whose first fields are the number fields, in the same order."""
        if not rows:
            return
        block = np.empty((len(rows), self._width))
        begin = 0
        values_of_fields = zip(*map(msgspec.structs.astuple, rows), strict=True)
        # not strict: the texts of a row come after its numbers and are left out here
        for values, size in zip(values_of_fields, self._fields.values(), strict=False):
            block[:, begin : begin + size] = _numbers(values, size)
            begin += size
        self._stamps_ns.extend(stamps_ns)
        self._blocks.append(block)

    @property
    def stamps_ns(self) -> IntArray:
        """Stamps (n,) in the order of the file."""
        return np.array(self._stamps_ns, np.int64)

    def columns(self, kept: IntArray) -> dict[str, Array]:
        """Return each field's values in the rows with these indexes."""
        values = np.concatenate([np.empty((0, self._width)), *self._blocks])[kept]
        is_plausible = np.abs(values) <= LARGEST  # False for NaN and infinity, too
        values[~is_plausible] = np.nan

        columns = {}
        begin = 0
        for name, size in self._fields.items():
            part = values[:, begin : begin + size]
            columns[name] = part[:, 0] if size == 1 else part
            begin += size
        return columns


def _numbers(values: Sequence[Any], size: int) -> Array:
    """Return one field of several rows as (rows, size); a missing number is NaN."""
    if size == 1:
        return np.array(values, np.float64).reshape(-1, 1)  # None becomes NaN

    try:
        # fast path: almost always all rows are complete
        numbers = itertools.chain.from_iterable(values)
        return np.fromiter(numbers, np.float64, size * len(values)).reshape(len(values), size)
    except TypeError:
        missing = (None,) * size
        parts = [missing if value is None else value for value in values]
        return np.array(parts, np.float64)


class _AgeBlock(NamedTuple):
    """Ages of the same neighbours at consecutive ticks."""

    neighbours: tuple[str, ...]
    first_tick: int  # index
    parts_s: list[Array]  # each of shape (ticks, neighbours)


class _Ages:
    """Ages of the neighbours' states at each tick.

    From tick to tick the neighbours are mostly the same. So the ages are kept in blocks of ticks,
    and each block has the names of its neighbours once.
    """

    def __init__(self) -> None:
        self._blocks: list[_AgeBlock] = []

    def add(self, first_tick: int, ages_of_ticks_s: list[dict[str, _Number]]) -> None:
        """Add the ages at consecutive ticks."""
        tick = first_tick
        # tuple() of a mapping has its keys, here the names of the neighbours
        for names, group in itertools.groupby(ages_of_ticks_s, key=tuple):
            if not self._blocks or self._blocks[-1].neighbours != names:
                self._blocks.append(_AgeBlock(names, tick, []))
            rows_s = [tuple(ages_s.values()) for ages_s in group]
            self._blocks[-1].parts_s.append(_numbers(rows_s, len(names)))
            tick += len(rows_s)

    def by_neighbour(self, ticks: int) -> dict[str, Array]:
        """Return the age of each neighbour's state (ticks,); NaN at ticks without it."""
        by_name: dict[str, Array] = {}
        for block in self._blocks:
            ages_s = np.concatenate(block.parts_s)
            end_tick = block.first_tick + len(ages_s)
            for column, name in enumerate(block.neighbours):
                if name not in by_name:
                    if len(by_name) >= MAX_VEHICLES:
                        continue
                    by_name[name] = np.full(ticks, np.nan)
                by_name[name][block.first_tick : end_tick] = ages_s[:, column]
        for neighbour_ages_s in by_name.values():
            is_plausible = np.abs(neighbour_ages_s) <= LARGEST
            neighbour_ages_s[~is_plausible] = np.nan
        return by_name


class _TelemetryTexts(NamedTuple):
    """The texts of one telemetry message."""

    state: str
    mode: str
    order_kind: str
    fix: str


class _VehicleRows:
    """The rows of one vehicle, while the record is read.

    Each method to add messages returns how many of them could be decoded.
    """

    def __init__(self) -> None:
        self.ticks = _Rows(_TICK_FIELDS)
        self.telemetry = _Rows(_TELEMETRY_FIELDS)
        self.truth = _Rows(_TRUTH_FIELDS)
        self.states = _Rows(_STATE_FIELDS)

        self.avoided: list[str] = []  # the avoided neighbour at each tick; empty: none
        self.ages = _Ages()
        self.texts: list[_TelemetryTexts] = []  # of each telemetry message
        self.law = ""
        self.config_hash = ""
        self.preflight: PreflightReport | None = None

    def add_ticks(self, stamps_ns: list[int], datas: list[bytes]) -> int:
        """Add ticks."""
        stamps_ns, rows = _decoded(_TICK_DECODER, stamps_ns, datas)
        self.ticks.add(stamps_ns, rows)
        self.ages.add(len(self.avoided), [row.neighbour_ages_s for row in rows])
        self.avoided += [row.active_neighbour for row in rows]
        return len(rows)

    def add_telemetry(self, stamps_ns: list[int], datas: list[bytes]) -> int:
        """Add telemetry."""
        stamps_ns, rows = _decoded(_TELEMETRY_DECODER, stamps_ns, datas)
        self.telemetry.add(stamps_ns, rows)
        for row in rows:
            texts = _TelemetryTexts(row.state, row.mode, row.order_kind, row.fix)
            # the same texts come ten times a second: use one object for all of them
            if self.texts and self.texts[-1] == texts:
                texts = self.texts[-1]
            self.texts.append(texts)
            if row.law:
                self.law = row.law
            if row.config_hash:
                self.config_hash = row.config_hash
        return len(rows)

    def add_truths(self, stamps_ns: list[int], datas: list[bytes]) -> int:
        """Add samples of the truth."""
        stamps_ns, rows = _decoded(_TRUTH_DECODER, stamps_ns, datas)
        self.truth.add(stamps_ns, rows)
        return len(rows)

    def add_states(self, stamps_ns: list[int], datas: list[bytes]) -> int:
        """Add states."""
        stamps_ns, rows = _decoded(_STATE_DECODER, stamps_ns, datas)
        self.states.add(stamps_ns, rows)
        return len(rows)

    def add_preflight(self, raw: RawChannel) -> int:
        """Keep the newest preflight report."""
        messages = [from_json(raw.kind, data) for data in raw.datas]
        reports = [message for message in messages if isinstance(message, PreflightReport)]
        if reports:
            self.preflight = reports[-1]
        return len(reports)


class _Collected:
    """Collects the rows of all vehicles and the orders and events, chunk by chunk."""

    def __init__(self) -> None:
        self.vehicles: dict[str, _VehicleRows] = {}
        self.messages: list[RecordedMessage] = []  # orders, replies and events
        self.malformed = 0
        self.left_out: set[str] = set()  # vehicles beyond MAX_VEHICLES
        self.is_full = False  # whether there are more orders and events than are kept
        # (topic, vehicle) -> stamps and JSON texts that wait to be decoded. A chunk has only a few
        # messages of each, and decoding many at once is faster.
        self._waiting: dict[tuple[str, str], tuple[list[int], list[bytes]]] = {}

    def add(self, raw: RawChannel) -> None:
        """Add the messages of one channel; those that cannot be decoded are counted."""
        possible = _with_possible_stamps(raw)
        self.malformed += len(raw.datas) - len(possible.datas)

        if possible.topic in ORDER_TOPICS:
            self._add_order_messages(possible)
            return
        rows = self._rows_of(possible.name)
        if rows is None:
            return
        if possible.topic == "preflight":
            self.malformed += len(possible.datas) - rows.add_preflight(possible)
            return

        key = (possible.topic, possible.name)
        stamps_ns, datas = self._waiting.setdefault(key, ([], []))
        if possible.topic == "state":
            # the kept fields change slowly, so one message of each chunk is enough
            stamps_ns += possible.stamps_ns[:1]
            datas += possible.datas[:1]
        else:
            stamps_ns += possible.stamps_ns
            datas += possible.datas
        if len(datas) >= _DECODED_AT_ONCE:
            self._decode(key)

    def finish(self) -> None:
        """Decode the messages that still wait."""
        for key in list(self._waiting):
            self._decode(key)

    def _decode(self, key: tuple[str, str]) -> None:
        topic, name = key
        stamps_ns, datas = self._waiting.pop(key)
        rows = self.vehicles[name]
        if topic == "tick":
            count = rows.add_ticks(stamps_ns, datas)
        elif topic == "telemetry":
            count = rows.add_telemetry(stamps_ns, datas)
        elif topic == "state":
            count = rows.add_states(stamps_ns, datas)
        else:
            count = rows.add_truths(stamps_ns, datas)
        self.malformed += len(datas) - count

    def _rows_of(self, name: str) -> _VehicleRows | None:
        if name not in self.vehicles:
            if len(self.vehicles) >= MAX_VEHICLES:
                self.left_out.add(name)
                return None
            self.vehicles[name] = _VehicleRows()
        return self.vehicles[name]

    def _add_order_messages(self, raw: RawChannel) -> None:
        for stamp_ns, data in zip(raw.stamps_ns, raw.datas, strict=True):
            if len(self.messages) >= MAX_ORDER_MESSAGES:
                self.is_full = True
                return
            message = from_json(raw.kind, data)
            if message is None:
                self.malformed += 1
                continue
            self.messages.append(RecordedMessage(stamp_ns, raw.topic, raw.name, message))


def _with_possible_stamps(raw: RawChannel) -> RawChannel:
    """Return the messages whose stamps fit into a signed number of 64 bits, as an array needs."""
    if not raw.stamps_ns or (min(raw.stamps_ns) >= 0 and max(raw.stamps_ns) <= MAX_STAMP_NS):
        return raw

    stamps_ns = []
    datas = []
    for stamp_ns, data in zip(raw.stamps_ns, raw.datas, strict=True):
        if 0 <= stamp_ns <= MAX_STAMP_NS:
            stamps_ns.append(stamp_ns)
            datas.append(data)
    return raw._replace(stamps_ns=stamps_ns, datas=datas)


# -- the flight ------------------------------------------------------------------------------------


def read_flight(folder: Path, fleet_path: str | None = None) -> Flight:
    """Read a flight folder.

    Args:
        folder: flight folder, or its MCAP file.
        fleet_path: fleet file; None for the one beside the record, if there is one.

    Returns:
        The flight; if the record was cut off, the part before the cut.

    Raises:
        ConfigError: there is no record, or no vehicle is in it.
    """
    timeline = Timeline(folder)
    record_folder = timeline.path.parent
    notes: list[str] = []
    fleet = _fleet(record_folder, fleet_path, notes)

    collected = _Collected()
    people = PeopleTracks(fleet)
    with contextlib.closing(timeline), _without_collection():
        for number in range(timeline.chunk_count):
            for raw in timeline.raw_channels(number, TOPICS | people.topics):
                if raw.topic in people.topics:
                    people.add(raw)
                else:
                    collected.add(raw)
        collected.finish()

    notes = [*timeline.damage, *notes]

    span = _span(collected, timeline)
    vehicles = _vehicles(collected, fleet, span)
    if not vehicles:
        raise ConfigError(
            f"{timeline.path}: no vehicle is in this record. It was cut off at its beginning, or no"
            " agent ran. Record a flight with `covey demo --record DIR`."
        )

    notes += _notes(collected, span)
    messages = [recorded for recorded in collected.messages if span.has(recorded.stamp_ns)]
    messages.sort(key=lambda recorded: recorded.stamp_ns)
    return Flight(
        title=plain_line(record_folder.resolve().name)[:MAX_NAME],
        begin_ns=span.begin_ns,
        length_s=span.length_s,
        vehicles=vehicles,
        events=[
            (span.seconds(recorded.stamp_ns), recorded.message)
            for recorded in messages
            if isinstance(recorded.message, Event)
        ],
        orders=trail_of(messages, span.begin_ns),
        fleet=fleet,
        people=people.tracks(span.seconds),
        verdict=_verdict(record_folder, notes),
        mission=_mission(record_folder),
        made=dict(list(timeline.made_by.items())[:MAX_MADE]),
        notes=tuple(notes),
    )


@contextlib.contextmanager
def _without_collection() -> Iterator[None]:
    """Switch Python's garbage collector off while the block runs.

    The collector would spend much time on the search for reference cycles among millions of small
    values, which have none.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


class _Span:
    """The time span of the flight, on the record's clock."""

    def __init__(self, begin_ns: int, end_ns: int, *, left_out: int = 0) -> None:
        self.begin_ns = begin_ns
        self.end_ns = end_ns
        self.left_out = left_out  # number of stamps before begin_ns or after end_ns

    @property
    def length_s(self) -> float:
        return (self.end_ns - self.begin_ns) * 1e-9

    def has(self, stamp_ns: int) -> bool:
        return self.begin_ns <= stamp_ns <= self.end_ns

    def seconds(self, stamp_ns: int) -> float:
        return (stamp_ns - self.begin_ns) * 1e-9


def _span(collected: _Collected, timeline: Timeline) -> _Span:
    """Return the span of the flight, or of all flights of a record with long pauses between them.

    The stamps are divided into pieces at each long pause. The piece with the most stamps belongs to
    the flight. Another piece does if it is at most a day away, and if the chunks of the file are in
    the order of the stamps. Otherwise a clock that jumps, or one wrong stamp, would stretch the
    flight to years.
    """
    all_stamps_ns = [np.zeros(0, np.int64)]
    for vehicle in collected.vehicles.values():
        all_stamps_ns.append(vehicle.ticks.stamps_ns)
        all_stamps_ns.append(vehicle.telemetry.stamps_ns)
        all_stamps_ns.append(vehicle.truth.stamps_ns)
    stamps_ns = np.sort(np.concatenate(all_stamps_ns))
    if not stamps_ns.size:
        return _Span(timeline.begin_ns, timeline.begin_ns)

    begins_after_pause = np.flatnonzero(np.diff(stamps_ns) > MAX_PAUSE_S * 1e9) + 1
    firsts = [0, *begins_after_pause.tolist()]
    after_lasts = [*begins_after_pause.tolist(), stamps_ns.size]
    pieces = [
        _Piece(int(stamps_ns[first]), int(stamps_ns[after_last - 1]), after_last - first)
        for first, after_last in zip(firsts, after_lasts, strict=True)
    ]
    kept = _pieces_of_flight(pieces, timeline)

    begin_ns = min(piece.begin_ns for piece in kept)
    end_ns = max(piece.end_ns for piece in kept)
    # Events and orders may come before the first message of a vehicle.
    if 0 <= begin_ns - timeline.begin_ns <= MAX_PAUSE_S * 1e9:
        begin_ns = timeline.begin_ns
    inside = np.count_nonzero((stamps_ns >= begin_ns) & (stamps_ns <= end_ns))
    return _Span(begin_ns, end_ns, left_out=stamps_ns.size - int(inside))


class _Piece(NamedTuple):
    """Stamps without a long pause."""

    begin_ns: int  # the first stamp
    end_ns: int  # the last stamp
    size: int  # number of stamps

    def overlaps(self, begin_ns: int, end_ns: int) -> bool:
        """Whether it has a time in common with a span."""
        return self.begin_ns <= end_ns and begin_ns <= self.end_ns


def _pieces_of_flight(pieces: Sequence[_Piece], timeline: Timeline) -> list[_Piece]:
    """Return the pieces that belong to the flight."""
    largest = max(pieces, key=lambda piece: piece.size)
    first_ns = largest.begin_ns - MAX_FLIGHT_NS
    last_ns = largest.end_ns + MAX_FLIGHT_NS
    near = [piece for piece in pieces if piece.overlaps(first_ns, last_ns)]

    kept = [largest]
    for spans_ns in timeline.rising_spans_ns():
        if not any(largest.overlaps(*span_ns) for span_ns in spans_ns):
            continue
        for piece in near:
            # wrong stamps of single messages are outside the spans of all chunks
            if any(piece.overlaps(*span_ns) for span_ns in spans_ns):
                kept.append(piece)
    return kept


def _vehicles(
    collected: _Collected, fleet: FleetConfig | None, span: _Span
) -> dict[str, VehicleFlight]:
    """Return the vehicles, those of the fleet file first and in its order."""
    flown = {}
    for name, rows in collected.vehicles.items():
        has_values = rows.ticks.stamps_ns.size or rows.telemetry.stamps_ns.size
        if has_values or rows.truth.stamps_ns.size:
            flown[name] = rows
    in_file = []
    if fleet is not None:
        in_file = [name for name in fleet.vehicles if name in flown]
    ordered_names = [*in_file, *sorted(set(flown) - set(in_file))]

    numbers = {name: number for number, name in enumerate(ordered_names)}
    return {
        name: VehicleFlight(
            name=name,
            ticks=_ticks(flown[name], span, numbers),
            telemetry=_telemetry(flown[name], span),
            truth=_truth(flown[name], span),
            states=_states(flown[name], span),
            preflight=flown[name].preflight,
        )
        for name in ordered_names
    }


def _kept(stamps_ns: IntArray, span: _Span) -> tuple[IntArray, Array]:
    """Return the indexes of the rows within the flight, by rising time, and their times [s].

    If several rows have the same stamp, the first one is kept.
    """
    stamps_ns, first = np.unique(stamps_ns, return_index=True)
    is_inside = (stamps_ns >= span.begin_ns) & (stamps_ns <= span.end_ns)
    times_s: Array = (stamps_ns[is_inside] - span.begin_ns).astype(np.float64) * 1e-9
    return first[is_inside], times_s


def _ticks(rows: _VehicleRows, span: _Span, numbers: dict[str, int]) -> Ticks:
    """Return the ticks of a vehicle; ``numbers`` has the index of each vehicle in the flight."""
    kept, time_s = _kept(rows.ticks.stamps_ns, span)

    avoided = np.array([numbers.get(name, -1) for name in rows.avoided], np.float64)
    all_ages_s = rows.ages.by_neighbour(avoided.size)
    ages_s = {name: neighbour_ages_s[kept] for name, neighbour_ages_s in all_ages_s.items()}
    return Ticks(time_s=time_s, avoided=avoided[kept], ages_s=ages_s, **rows.ticks.columns(kept))


def _telemetry(rows: _VehicleRows, span: _Span) -> TelemetryRows:
    kept, time_s = _kept(rows.telemetry.stamps_ns, span)
    texts = [rows.texts[index] for index in kept]
    return TelemetryRows(
        time_s=time_s,
        states=[text.state for text in texts],
        modes=[text.mode for text in texts],
        orders=[text.order_kind for text in texts],
        fixes=[text.fix for text in texts],
        law=rows.law,
        config_hash=rows.config_hash,
        **rows.telemetry.columns(kept),
    )


def _truth(rows: _VehicleRows, span: _Span) -> TruthRows:
    kept, time_s = _kept(rows.truth.stamps_ns, span)
    return TruthRows(time_s=time_s, **rows.truth.columns(kept))


def _states(rows: _VehicleRows, span: _Span) -> StateRows:
    kept, time_s = _kept(rows.states.stamps_ns, span)
    return StateRows(time_s=time_s, **rows.states.columns(kept))


# -- the files beside the record, and notes about missing things -----------------------------------


def _fleet(folder: Path, path: str | None, notes: list[str]) -> FleetConfig | None:
    """Return the fleet file; if it is missing or wrong, return None and add a note."""
    if path is not None:
        return load_fleet(path, needs_folders=False)
    beside = folder / "fleet.toml"
    if not beside.is_file():
        notes.append("There is no fleet.toml beside the record: no promised distance is drawn.")
        return None
    try:
        # A record may come from anybody, so code that its fleet file names (a law) is not run.
        return load_fleet(str(beside), needs_folders=False)
    except ConfigError as error:
        notes.append(f"The fleet file cannot be used: {plain_line(str(error))[:300]}")
        return None


def _verdict(folder: Path, notes: list[str]) -> dict[str, Any]:
    path = folder / "verdict.json"
    if not path.is_file():
        notes.append(
            "There is no verdict.json beside the record: nothing was declared, or the flight did"
            " not end by itself."
        )
        return {}
    try:
        value = json_values(read_bytes(path, RESULTS_FILE), path.name)
    except ConfigError as error:
        notes.append(f"The verdict cannot be read: {plain_line(str(error))[:300]}")
        return {}
    return value if isinstance(value, dict) else {}


def _mission(folder: Path) -> str:
    for name in ("mission.toml", "mission.py"):
        with contextlib.suppress(ConfigError):
            if (folder / name).is_file():
                return read_text(folder / name, MISSION_FILE)
    return ""


def _notes(collected: _Collected, span: _Span) -> list[str]:
    """Return sentences about what was left out of a record."""
    notes = []
    if collected.malformed:
        notes.append(undecoded_words(collected.malformed))
    if span.left_out:
        notes.append(
            f"{span.left_out} messages have stamps far from the flight's and are left out."
        )
    if collected.left_out:
        notes.append(
            f"The record names more than {MAX_VEHICLES} vehicles; {len(collected.left_out)} are"
            " left out."
        )
    if collected.is_full:
        notes.append(f"Only the first {MAX_ORDER_MESSAGES} orders and events are shown.")
    return notes
