"""Messages of PX4 that are missing in pymavlink's common dialect.

`extra_dialect.toml` declares them by their fields. The checksum seed follows from the declaration,
as MAVLink's generators compute it.
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
    """Encoding of one message."""

    message_id: int
    name: str
    packer: struct.Struct
    crc_extra: int  # seed of the checksum
    # Name and count of each field in the order of the encoding. The count is 0 for a field that is
    # not an array.
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
    """Return the layout of a message.

    Args:
        message_id: identifier of the message.
        name: name of the message.
        fields: fields in wire order (largest first), as `type name` or `type name[count]`.
    """
    named: list[tuple[str, int]] = []
    codes = "<"
    seed = mcrf4xx(f"{name} ".encode())

    for entry in fields:
        kind, _, declarator = entry.partition(" ")
        label, is_array, count_text = declarator.rstrip("]").partition("[")
        count = 0
        code = _CODES[kind]
        if is_array:
            count = int(count_text)
            code = f"{count}{code}"

        named.append((label, count))
        codes += code
        seed = mcrf4xx(f"{kind} {label} ".encode(), seed)
        if count:
            seed = mcrf4xx(bytes((count,)), seed)

    return MessageLayout(
        message_id=message_id,
        name=name,
        packer=struct.Struct(codes),
        crc_extra=(seed & 0xFF) ^ (seed >> 8),
        fields=tuple(named),
    )


_DECLARED = tomllib.loads(files(__package__).joinpath("extra_dialect.toml").read_text())
EXTRA: tuple[MessageLayout, ...] = tuple(
    declare(entry["id"], name, entry["fields"]) for name, entry in _DECLARED.items()
)
