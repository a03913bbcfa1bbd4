"""MAVLink 2 bytes to messages and back, on pymavlink's tables. The only file of the emulator that
imports pymavlink.

pymavlink's message objects cost several microseconds each; here a message is a tuple in wire order,
packed by the message's own struct, which gives the same bytes. What pymavlink's dialects lack
(events, link node status, ...) is declared in `extra_dialect.py`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fastcrc.crc16 import mcrf4xx
from pymavlink.dialects.v20 import common

from sitl.mavlink.extra_dialect import EXTRA, MessageLayout

_MAGIC_V2 = 0xFD
_MAGIC_V1 = 0xFE
_SIGNED = 0x01
_SIGNATURE_BYTES = 13


def _layout(message_id: int, entry: Any) -> MessageLayout:
    # Character arrays are one value of the struct; number arrays are as many values as they are
    # long.
    counts = [
        array if array and kind != "char" else 0
        for array, kind in zip(
            entry.array_lengths,
            (entry.fieldtypes[entry.fieldnames.index(name)] for name in entry.ordered_fieldnames),
            strict=True,
        )
    ]
    return MessageLayout(
        message_id,
        entry.msgname,
        struct.Struct(entry.unpacker.format),
        entry.crc_extra,
        tuple(zip(entry.ordered_fieldnames, counts, strict=True)),
    )


LAYOUTS: dict[int, MessageLayout] = {
    number: _layout(number, entry) for number, entry in common.mavlink_map.items()
} | {layout.message_id: layout for layout in EXTRA}


def _zero(layout: MessageLayout, field_name: str) -> int | bytes:
    kinds = common.mavlink_map.get(layout.message_id)
    if kinds is None:
        return 0
    return b"" if kinds.fieldtypes[kinds.fieldnames.index(field_name)] == "char" else 0


_ZEROS: dict[str, tuple[tuple[str, int, Any], ...]] = {
    layout.name: tuple(
        (name, count, [0] * count if count else _zero(layout, name))
        for name, count in layout.fields
    )
    for layout in LAYOUTS.values()
}
# What the encoder needs of each message: struct, id as two numbers, checksum seed.
_ENCODED: dict[int, tuple[struct.Struct, int, int, bytes]] = {
    number: (layout.packer, number & 0xFFFF, number >> 16, bytes((layout.crc_extra,)))
    for number, layout in LAYOUTS.items()
}
_HEAD = struct.Struct("<BHBBBHB")  # length, both flag bytes, sequence, system, component, id
_CHECKSUM = struct.Struct("<H")
ID_BY_NAME: dict[str, int] = {layout.name: number for number, layout in LAYOUTS.items()}


@dataclass(frozen=True, slots=True)
class MavlinkMessage:
    """One received message; `fields` holds numbers, lists of numbers, and bytes for texts."""

    name: str
    message_id: int
    system_id: int
    component_id: int
    fields: dict[str, Any]


@dataclass(slots=True)
class Decoder:
    """Datagrams to messages. What is not MAVLink is counted, never raised.

    takes: whether a message is listened to, by its bytes and whether it is signed; None: all are.
    """

    malformed: int = 0
    takes: Callable[[MavlinkMessage, bytes, bool], bool] | None = None

    def decode(self, datagram: bytes) -> list[MavlinkMessage]:
        """All messages of one datagram; the rest of a broken one is dropped and counted once."""
        messages: list[MavlinkMessage] = []
        start, end = 0, len(datagram)
        while start < end:
            frame = _frame(datagram, start)
            if frame is None:
                self.malformed += 1
                break
            begin, (message, start) = start, frame
            if message is not None and (
                self.takes is None or self._is_taken(message, datagram[begin:start])
            ):
                messages.append(message)
        return messages

    def _is_taken(self, message: MavlinkMessage, frame: bytes) -> bool:
        is_signed = frame[0] == _MAGIC_V2 and bool(frame[2] & _SIGNED)
        return self.takes is None or self.takes(message, frame, is_signed)


def _frame(data: bytes, start: int) -> tuple[MavlinkMessage | None, int] | None:
    """Message at `start` and where the next one begins; (None, next) for an unknown id; None for
    what is no frame.
    """
    magic, left = data[start], len(data) - start
    if magic == _MAGIC_V2 and left >= 12:
        length, incompat = data[start + 1], data[start + 2]
        system_id, component_id = data[start + 5], data[start + 6]
        message_id = data[start + 7] | data[start + 8] << 8 | data[start + 9] << 16
        header = 10
    elif magic == _MAGIC_V1 and left >= 8:
        length, incompat = data[start + 1], 0
        system_id, component_id, message_id = data[start + 3], data[start + 4], data[start + 5]
        header = 6
    else:
        return None
    if incompat & ~_SIGNED:
        return None
    body = start + header
    total = header + length + 2 + (_SIGNATURE_BYTES if incompat & _SIGNED else 0)
    if left < total:
        return None
    layout = LAYOUTS.get(message_id)
    if layout is None:
        return None, start + total
    payload = data[body : body + length]
    checksum = mcrf4xx(data[start + 1 : body + length] + bytes((layout.crc_extra,)))
    if checksum != data[body + length] | data[body + length + 1] << 8:
        return None
    size = layout.packer.size
    values = layout.packer.unpack(payload.ljust(size, b"\0")[:size])
    return MavlinkMessage(
        layout.name, message_id, system_id, component_id, _named(layout, values)
    ), start + total


def _named(layout: MessageLayout, values: tuple[Any, ...]) -> dict[str, Any]:
    named: dict[str, Any] = {}
    position = 0
    for name, count in layout.fields:
        if count:
            named[name] = list(values[position : position + count])
            position += count
        else:
            named[name] = values[position]
            position += 1
    return named


def text_of(raw: bytes) -> str:
    """A MAVLink character array as text."""
    return raw.split(b"\0", 1)[0].decode("ascii", "replace")


@dataclass(slots=True)
class Encoder:
    """Messages of one link: counts the sequence number."""

    system_id: int
    component_id: int = 1
    sequence: int = 0
    # the frames say that a signature follows, which is added when they leave
    is_signed: bool = False

    def encode(self, message_id: int, *values: Any) -> bytes:
        """Bytes of a message from its values in wire order (arrays flattened), trailing zeros cut
        as MAVLink 2 does.
        """
        packer, id_low, id_high, extra = _ENCODED[message_id]
        payload = packer.pack(*values).rstrip(b"\0") or b"\0"
        sequence = self.sequence
        self.sequence = (sequence + 1) & 0xFF
        flags = _SIGNED if self.is_signed else 0
        head = _HEAD.pack(
            len(payload), flags, sequence, self.system_id, self.component_id, id_low, id_high
        )
        # The magic byte is not part of the checksum; the seed of the message is, and is not sent.
        body = head + payload
        return b"\xfd" + body + _CHECKSUM.pack(mcrf4xx(body + extra))

    def encode_named(self, name: str, **fields: Any) -> bytes:
        """As :meth:`encode`, from names; fields that are left out are zero."""
        return self.encode(ID_BY_NAME[name], *self.values(name, **fields))

    @staticmethod
    def values(name: str, **fields: Any) -> tuple[Any, ...]:
        """Values in wire order from names; fields that are left out are zero."""
        values: list[Any] = []
        for field_name, count, zero in _ZEROS[name]:
            value = fields.pop(field_name, zero)
            if count:
                values.extend(value)
            else:
                values.append(value)
        if fields:
            raise KeyError(f"{name} has no field {', '.join(fields)}")
        return tuple(values)
