"""Read a flight folder: its messages as they stand in the file, also of a record that was cut off."""

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
    """Return the MCAP file of a flight folder, or the path itself when it is a file.

    Raises:
        ConfigError: there is none.
    """
    path = folder if folder.is_file() else folder / RECORD_NAME
    if not path.is_file():
        raise ConfigError(f"{folder}: there is no {RECORD_NAME}. Give the folder of a recorded flight.")
    return path


def read(folder: Path, topics: Sequence[str] = ()) -> Iterator[Sample]:
    """Read a record from its beginning. A record that breaks off ends there, without an error.

    Args:
        folder: flight folder, or the MCAP file itself.
        topics: only channels of these first parts, for instance ``truth``; empty for all.

    Yields:
        Samples in the order of the file.

    Raises:
        ConfigError: there is no record.
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
