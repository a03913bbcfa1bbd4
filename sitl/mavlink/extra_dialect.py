"""Messages that PX4 sends or reads and pymavlink's common dialect does not know, declared by their
fields in a table.

The checksum seed follows from the declaration, as MAVLink's generators compute it.
"""

from __future__ import annotations

import struct
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

from fastcrc.crc16 import mcrf4xx


@dataclass(frozen=True, slots=True)
class MessageLayout:
    """Encoding of one message: struct, checksum seed, and (name, count) of each field in the order
    of the encoding.
    """

    message_id: int
    name: str
    packer: struct.Struct
    crc_extra: int
    fields: tuple[tuple[str, int], ...]


_CODES = {
    "float": "f",
    "int16_t": "h",
    "uint64_t": "Q",
    "uint32_t": "I",
    "int32_t": "i",
    "uint16_t": "H",
    "uint8_t": "B",
}


def declare(message_id: int, name: str, fields: Sequence[str]) -> MessageLayout:
    """Layout of a message from its fields in wire order (largest first): ``type name`` or ``type
    name[count]``.
    """
    parsed: list[tuple[str, str, int]] = []
    for entry in fields:
        kind, _, rest = entry.partition(" ")
        label, _, count = rest.rstrip("]").partition("[")
        parsed.append((kind, label, int(count or 0)))
    seed = mcrf4xx(f"{name} ".encode())
    for kind, label, length in parsed:
        seed = mcrf4xx(f"{kind} {label} ".encode() + (bytes((length,)) if length else b""), seed)
    codes = "".join(f"{count or 1}{_CODES[kind]}" for kind, _, count in parsed)
    named = tuple((label, count) for _, label, count in parsed)
    return MessageLayout(
        message_id, name, struct.Struct("<" + codes), (seed & 0xFF) ^ (seed >> 8), named
    )


_DECLARED = tomllib.loads(files(__package__).joinpath("extra_dialect.toml").read_text())
EXTRA: tuple[MessageLayout, ...] = tuple(
    declare(entry["id"], name, entry["fields"]) for name, entry in _DECLARED.items()
)
