"""MAVLink 2 bytes to messages and back, on pymavlink's tables.

This is the only file of the emulator that imports pymavlink. The message objects of pymavlink take
several microseconds each. Here a message is a tuple in wire order, packed by the struct of the
message, which gives the same bytes. Messages that are missing in pymavlink's dialects (events, link
node status, ...) are declared in `extra_dialect.py`.

A frame of MAVLink 2 is: magic, length, two bytes of flags, sequence, system, component, three bytes
of message id, payload, two bytes of checksum, and 13 bytes of signature if the flags say so. In
MAVLink 1 the flags are missing and the message id has one byte.
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
_MAGIC_V2_BYTE = bytes((_MAGIC_V2,))
_MAGIC_V1 = 0xFE
_HEADER_V2_BYTES = 10
_HEADER_V1_BYTES = 6
_CHECKSUM_BYTES = 2
_SIGNATURE_BYTES = 13
_SIGNED = 0x01  # flag: a signature follows the checksum


def _field_type(entry: Any, field_name: str) -> str:
    return str(entry.fieldtypes[entry.fieldnames.index(field_name)])


def _layout(message_id: int, entry: Any) -> MessageLayout:
    """Return the layout of one of pymavlink's messages."""
    fields: list[tuple[str, int]] = []
    for name, array_length in zip(entry.ordered_fieldnames, entry.array_lengths, strict=True):
        # A struct has one value for an array of characters, and one for each number of an array.
        is_text = _field_type(entry, name) == "char"
        if is_text:
            fields.append((name, 0))
        else:
            fields.append((name, array_length))

    return MessageLayout(
        message_id=message_id,
        name=entry.msgname,
        packer=struct.Struct(entry.unpacker.format),
        crc_extra=entry.crc_extra,
        fields=tuple(fields),
    )


LAYOUTS: dict[int, MessageLayout] = {
    number: _layout(number, entry) for number, entry in common.mavlink_map.items()
} | {layout.message_id: layout for layout in EXTRA}


def _zero(layout: MessageLayout, field_name: str, count: int) -> Any:
    """Return the value of a field that is left out: 0, `count` zeros, or an empty text."""
    if count:
        return [0] * count
    entry = common.mavlink_map.get(layout.message_id)
    if entry is not None and _field_type(entry, field_name) == "char":
        return b""
    return 0


# Name of a message -> name, count and default value of each of its fields.
_ZEROS: dict[str, list[tuple[str, int, Any]]] = {}
for _message_layout in LAYOUTS.values():
    _ZEROS[_message_layout.name] = [
        (name, count, _zero(_message_layout, name, count)) for name, count in _message_layout.fields
    ]
# Data of each message for the encoder: struct, lower 16 and upper 8 bits of the id, checksum seed.
_ENCODER_DATA: dict[int, tuple[struct.Struct, int, int, bytes]] = {
    number: (layout.packer, number & 0xFFFF, number >> 16, bytes((layout.crc_extra,)))
    for number, layout in LAYOUTS.items()
}
# length, both flag bytes, sequence, system, component, lower and upper bits of the id
_HEAD = struct.Struct("<BHBBBHB")
_CHECKSUM = struct.Struct("<H")
ID_BY_NAME: dict[str, int] = {layout.name: number for number, layout in LAYOUTS.items()}


@dataclass(frozen=True, slots=True)
class MavlinkMessage:
    """One received message."""

    name: str
    message_id: int
    system_id: int  # system of the sender
    component_id: int  # component of the sender
    fields: dict[str, Any]  # numbers, lists of numbers, and bytes for texts


@dataclass(slots=True)
class Decoder:
    """Decoder of the datagrams of one link, which counts malformed ones and never raises."""

    malformed: int = 0
    # Whether a message is accepted, by its bytes and whether it is signed. None: all are accepted.
    takes: Callable[[MavlinkMessage, bytes, bool], bool] | None = None

    def decode(self, datagram: bytes) -> list[MavlinkMessage]:
        """Return all messages of a datagram.

        The rest of a datagram after a malformed frame is dropped and counted once.
        """
        messages: list[MavlinkMessage] = []
        start = 0
        while start < len(datagram):
            found = _frame(datagram, start)
            if found is None:
                self.malformed += 1
                break

            message, end = found
            if message is not None and self._is_taken(message, datagram[start:end]):
                messages.append(message)
            start = end
        return messages

    def _is_taken(self, message: MavlinkMessage, frame: bytes) -> bool:
        if self.takes is None:
            return True
        is_signed = frame[0] == _MAGIC_V2 and bool(frame[2] & _SIGNED)
        return self.takes(message, frame, is_signed)


def _frame(data: bytes, start: int) -> tuple[MavlinkMessage | None, int] | None:
    """Return the message of the frame at an index, and the index after the frame.

    The message is None when its id is unknown. The result is None when there is no frame, or when
    the frame is incomplete or has a wrong checksum.
    """
    magic = data[start]
    left_bytes = len(data) - start
    if magic == _MAGIC_V2 and left_bytes >= _HEADER_V2_BYTES + _CHECKSUM_BYTES:
        length = data[start + 1]
        incompat_flags = data[start + 2]
        system_id = data[start + 5]
        component_id = data[start + 6]
        message_id = data[start + 7] | data[start + 8] << 8 | data[start + 9] << 16
        body = start + _HEADER_V2_BYTES
    elif magic == _MAGIC_V1 and left_bytes >= _HEADER_V1_BYTES + _CHECKSUM_BYTES:
        length = data[start + 1]
        incompat_flags = 0
        system_id = data[start + 3]
        component_id = data[start + 4]
        message_id = data[start + 5]
        body = start + _HEADER_V1_BYTES
    else:
        return None

    if incompat_flags & ~_SIGNED:
        return None
    end = body + length + _CHECKSUM_BYTES
    if incompat_flags & _SIGNED:
        end += _SIGNATURE_BYTES
    if end > len(data):
        return None

    layout = LAYOUTS.get(message_id)
    if layout is None:
        return None, end

    # The checksum covers all bytes but the magic, and a seed of the message that is not sent.
    checksum = mcrf4xx(data[start + 1 : body + length] + bytes((layout.crc_extra,)))
    if checksum != data[body + length] | data[body + length + 1] << 8:
        return None

    # Zeros at the end of a payload are not sent.
    payload = data[body : body + length]
    size = layout.packer.size
    values = layout.packer.unpack(payload.ljust(size, b"\0")[:size])

    message = MavlinkMessage(
        name=layout.name,
        message_id=message_id,
        system_id=system_id,
        component_id=component_id,
        fields=_named(layout, values),
    )
    return message, end


def _named(layout: MessageLayout, values: tuple[Any, ...]) -> dict[str, Any]:
    """Return values in wire order by the names of their fields."""
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
    """Return a MAVLink character array as text."""
    text, _, _ = raw.partition(b"\0")
    return text.decode("ascii", "replace")


@dataclass(slots=True)
class Encoder:
    """Encoder of the messages of one link, with their sequence number."""

    system_id: int
    component_id: int = 1
    sequence: int = 0
    # Whether frames announce a signature. The signature is added when a frame is sent.
    is_signed: bool = False

    def encode(self, message_id: int, *values: Any) -> bytes:
        """Return the bytes of a message from its values in wire order, arrays flattened."""
        packer, id_low, id_high, crc_extra = _ENCODER_DATA[message_id]
        # MAVLink 2 removes zeros at the end, and leaves at least one byte.
        payload = packer.pack(*values).rstrip(b"\0")
        if not payload:
            payload = b"\0"

        sequence = self.sequence
        self.sequence = (sequence + 1) & 0xFF
        flags = 0
        if self.is_signed:
            flags = _SIGNED
        head = _HEAD.pack(
            len(payload), flags, sequence, self.system_id, self.component_id, id_low, id_high
        )

        # The checksum covers all bytes but the magic, and a seed of the message that is not sent.
        body = head + payload
        return _MAGIC_V2_BYTE + body + _CHECKSUM.pack(mcrf4xx(body + crc_extra))

    def encode_named(self, name: str, **fields: Any) -> bytes:
        """Return the bytes of a message from named fields; fields that are left out are zero."""
        return self.encode(ID_BY_NAME[name], *self.values(name, **fields))

    @staticmethod
    def values(name: str, **fields: Any) -> tuple[Any, ...]:
        """Return values in wire order from named fields; fields that are left out are zero."""
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
