"""Writes a record again in a form that third-party viewers show: one file to open or to mail.

The file begins with the fleet file, the mission and the verdict as attachments. Then come the
record's own messages unchanged, on its common clock, together with channels of Foxglove's schemas:
``/tf``, ``/scene/static``, ``/scene``, ``/scene/law``, ``/positions``, ``/log``, where persons were
seen ``/scene/people`` and, outdoors, ``/fix/NAME``. The file is made after a flight, so that it
costs the flight nothing.
"""

from __future__ import annotations

import contextlib
import heapq
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from mcap.writer import MCAP0_MAGIC
from mcap.writer import Writer as McapWriter
from mcap_protobuf.schema import register_schema

from groundstation.recording.channels import json_schema
from groundstation.recording.flight_reading import read_flight
from groundstation.recording.output_file import refuse_other_file, written_beside
from groundstation.recording.recorded_flight import Flight
from groundstation.recording.timeline import Timeline
from groundstation.viewers import scene_messages
from groundstation.viewers.scene_messages import (
    FleetMotion,
    LawScenes,
    PeopleScenes,
    VehicleScenes,
)
from onboard.config.file_reading import (
    FLEET_FILE,
    MISSION_FILE,
    RESULTS_FILE,
    FileKind,
    read_bytes,
)
from onboard.config.fleet import ConfigError

VIEWER_NAME = "flight.foxglove.mcap"
TICK_S = 0.02  # period of the transforms
SCENE_S = 0.1  # period of the scenes
MAX_LENGTH_S = 6 * 3600.0  # longest flight that is written
_CHUNK_BYTES = 512 * 1024
_LIBRARY = "covey for viewers"  # in the header; that of a record says "covey"
_HEADER_BYTES = 256
_ATTACHED: tuple[tuple[str, str, FileKind], ...] = (
    ("fleet.toml", "application/toml", FLEET_FILE),
    ("mission.toml", "application/toml", MISSION_FILE),
    ("mission.py", "text/x-python", MISSION_FILE),
    ("verdict.json", "application/json", RESULTS_FILE),
)


class _Message(NamedTuple):
    """One message of Foxglove's schemas."""

    stamp_ns: int
    topic: str
    content: Any  # message of protobuf


def write_viewer_record(folder: Path, out: Path | None = None) -> tuple[Path, list[str]]:
    """Write a record for third-party viewers.

    Args:
        folder: the flight folder, or the MCAP file in it.
        out: the file to write; None writes ``flight.foxglove.mcap`` in the flight folder.

    Returns:
        The file, and sentences about what is damaged or missing in the flight folder.

    Raises:
        ConfigError: there is no record, it has no vehicle, or it is too long; or ``out`` is a
            record, or a file that is no MCAP.
        OSError: the file cannot be written.
    """
    if out is not None:
        refuse_other_file(out, _is_for_viewers, other="was not written for viewers")
    flight = read_flight(folder)
    if flight.length_s > MAX_LENGTH_S:
        raise ConfigError(
            f"{folder}: this flight has {flight.length_s / 3600.0:.1f} hours; at most"
            f" {MAX_LENGTH_S / 3600.0:g} are written for viewers."
        )

    flight_folder = folder
    if not folder.is_dir():
        flight_folder = folder.parent
    path = flight_folder / VIEWER_NAME
    if out is not None:
        path = out
    with (
        written_beside(path) as part,
        contextlib.closing(Timeline(folder)) as timeline,
        part.open("wb") as stream,
    ):
        _Output(stream).write(flight, timeline, flight_folder)
    return path, list(flight.notes)


def _is_for_viewers(begin: bytes) -> bool:
    """Return whether a file that begins with these bytes was written here, and is no record."""
    return begin.startswith(MCAP0_MAGIC) and _LIBRARY.encode() in begin[:_HEADER_BYTES]


class _Output:
    """Writes the file: attachments, the record's messages and those of Foxglove's schemas."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._writer = McapWriter(stream, chunk_size=_CHUNK_BYTES)
        self._writer.start(library=_LIBRARY)
        self._schemas: dict[type, int] = {}
        self._channels: dict[str, int] = {}
        self._sequences: Counter[int] = Counter()

    def write(self, flight: Flight, timeline: Timeline, folder: Path) -> None:
        """Write everything: attachments first, then all messages.

        Args:
            flight: the flight.
            timeline: the record's messages.
            folder: the flight folder, from which files are attached.
        """
        begin_ns = min(flight.begin_ns, timeline.begin_ns)
        for name, media_type, kind in _ATTACHED:
            with contextlib.suppress(ConfigError):
                if (folder / name).is_file():
                    data = read_bytes(folder / name, kind)
                    self._writer.add_attachment(
                        create_time=0,
                        log_time=begin_ns,
                        name=name,
                        media_type=media_type,
                        data=data,
                    )

        # The scenes are exactly in order of time, and the record is roughly. Their merged sequence
        # is therefore roughly in order as well.
        scenes = _messages(flight, begin_ns)
        next_scene = next(scenes, None)
        for number in range(timeline.chunk_count):
            for raw in timeline.raw_messages(number, timeline.topics):
                while next_scene is not None and next_scene.stamp_ns <= raw.stamp_ns:
                    self._put(next_scene)
                    next_scene = next(scenes, None)

                channel = f"{raw.topic}/{raw.name}"
                if channel not in self._channels:
                    self._register_json(channel, raw.kind)
                self._add(self._channels[channel], raw.stamp_ns, raw.data)
        while next_scene is not None:
            self._put(next_scene)
            next_scene = next(scenes, None)
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _put(self, message: _Message) -> None:
        kind = type(message.content)
        if message.topic not in self._channels:
            if kind not in self._schemas:
                self._schemas[kind] = register_schema(self._writer, kind)
            self._channels[message.topic] = self._writer.register_channel(
                message.topic, "protobuf", self._schemas[kind]
            )
        data = message.content.SerializeToString()
        self._add(self._channels[message.topic], message.stamp_ns, data)

    def _register_json(self, channel: str, kind: type[Any]) -> None:
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_schema(
                f"covey.{kind.__name__}", "jsonschema", json_schema(kind)
            )
        self._channels[channel] = self._writer.register_channel(
            channel, "json", self._schemas[kind]
        )

    def _add(self, channel_id: int, stamp_ns: int, data: bytes) -> None:
        self._writer.add_message(channel_id, stamp_ns, data, stamp_ns, self._sequences[channel_id])
        self._sequences[channel_id] += 1


def _messages(flight: Flight, begin_ns: int) -> Iterator[_Message]:
    """Yield the messages of Foxglove's schemas in the order of their stamps."""
    yield _Message(begin_ns, "/tf", scene_messages.first_transforms(flight, begin_ns))
    if flight.fleet is not None:
        scene = scene_messages.static_scene(flight.fleet, begin_ns)
        yield _Message(begin_ns, "/scene/static", scene)
    yield from heapq.merge(
        _transforms(flight), _scenes(flight), _log(flight), key=lambda message: message.stamp_ns
    )


def _transforms(flight: Flight) -> Iterator[_Message]:
    motion = _motion(flight, TICK_S)
    for index, stamp_ns in enumerate(_stamps_ns(flight, motion)):
        transforms = scene_messages.frame_transforms(motion, index, stamp_ns)
        if transforms.transforms:
            yield _Message(stamp_ns, "/tf", transforms)


def _scenes(flight: Flight) -> Iterator[_Message]:
    motion = _motion(flight, SCENE_S)
    scenes = VehicleScenes(flight, motion)
    law = LawScenes(flight, motion)
    people = PeopleScenes(flight, motion.times_s)
    origin = None
    if flight.fleet is not None:
        origin = flight.fleet.fleet.global_origin

    for index, stamp_ns in enumerate(_stamps_ns(flight, motion)):
        yield _Message(stamp_ns, "/scene", scenes.at(index, stamp_ns))
        yield _Message(stamp_ns, "/scene/law", law.at(index, stamp_ns))
        if people.has_people:
            yield _Message(stamp_ns, "/scene/people", people.at(index, stamp_ns))
        yield _Message(stamp_ns, "/positions", scene_messages.positions(motion, index, stamp_ns))
        if origin is None:
            continue
        for name in flight.vehicles:
            position = motion.position(name, index)
            if position is not None:
                fix = scene_messages.location_fix(position, origin, stamp_ns)
                yield _Message(stamp_ns, f"/fix/{name}", fix)


def _log(flight: Flight) -> Iterator[_Message]:
    lines = sorted(scene_messages.log_lines(flight), key=lambda pair: pair[0])
    for time_s, line in lines:
        stamp_ns = flight.begin_ns + round(time_s * 1e9)
        line.timestamp.CopyFrom(scene_messages.timestamp(stamp_ns))
        yield _Message(stamp_ns, "/log", line)


def _motion(flight: Flight, step_s: float) -> FleetMotion:
    # The times count from flight.begin_ns. The first message of a vehicle is at flight.begin_s,
    # which may be negative.
    times_s = np.arange(flight.begin_s, flight.length_s + step_s / 2.0, step_s)
    return FleetMotion(flight, times_s)


def _stamps_ns(flight: Flight, motion: FleetMotion) -> list[int]:
    return [flight.begin_ns + round(time_s * 1e9) for time_s in motion.times_s.tolist()]
