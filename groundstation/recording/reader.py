"""Read a flight folder back: messages in the order of their log time, also of a record that was cut off."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from zstandard import ZstdError

from groundstation.recording.writer import RECORD_NAME
from onboard.config.fleet import ConfigError


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
    """The MCAP file of a flight folder, or of its own path; ConfigError when there is none."""
    path = folder if folder.is_file() else folder / RECORD_NAME
    if not path.is_file():
        raise ConfigError(f"{folder}: there is no {RECORD_NAME}. Give the folder of a recorded flight.")
    return path


def read(folder: Path, topics: Sequence[str] = ()) -> Iterator[Sample]:
    """Samples as they stand in the file; ``topics`` limits to channels of these first parts, for instance ``truth``.

    A record that breaks off in the middle ends there, without an error.
    """
    channels: dict[int, str] = {}
    with record_path(folder).open("rb") as stream:
        records = StreamReader(stream).records
        while True:
            try:
                record = next(records, None)
            except (McapError, ZstdError, EOFError, ValueError, struct.error):
                return
            if record is None:
                return
            if isinstance(record, Channel):
                channels[record.id] = record.topic
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                if not topics or channel.partition("/")[0] in topics:
                    yield Sample(channel, record.log_time, json.loads(record.data))
