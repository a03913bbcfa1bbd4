"""Encoding and decoding of messages.

Bytes from outside never raise an error. They decode to a message or to :class:`Malformed`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import msgspec

from onboard.bus.schema import SCHEMA_VERSION, Message

MessageT = TypeVar("MessageT", bound=Message)

MAX_BYTES = 65_536  # largest size of one message

_encoder = msgspec.msgpack.Encoder()
# type of message -> its decoder, which is made when it is first needed
_decoders: dict[type[Message], msgspec.msgpack.Decoder[Message]] = {}


@dataclass(frozen=True, slots=True)
class Malformed:
    """Bytes that are not a message of the expected type. The receiver counts and ignores them."""

    reason: str
    size: int  # bytes


def encode(message: Message) -> bytes:
    """Encode a message.

    Args:
        message: any message of the schema.
    Returns:
        its MessagePack bytes.
    """
    return _encoder.encode(message)


def decode(data: bytes, kind: type[MessageT]) -> MessageT | Malformed:
    """Decode a message. Its numbers may not be finite, see :func:`is_finite`.

    Args:
        data: bytes as received.
        kind: type of the message.
    Returns:
        the message; Malformed, with the reason, for garbage, truncation, another type or another
        schema version.
    """
    if len(data) > MAX_BYTES:
        return Malformed("too large", len(data))

    decoder = _decoders.get(kind)
    if decoder is None:
        decoder = msgspec.msgpack.Decoder(kind)
        _decoders[kind] = decoder

    try:
        message = decoder.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        return Malformed(str(error), len(data))

    if message.schema != SCHEMA_VERSION:
        return Malformed(
            f"schema version {message.schema}, this side reads {SCHEMA_VERSION}", len(data)
        )
    assert isinstance(message, kind)
    return message


def is_finite(*vectors: tuple[float, ...]) -> bool:
    """Whether every number of every vector is finite, for receivers that calculate with a message.

    Args:
        vectors: any number of tuples of floats.
    Returns:
        True if all numbers and their sum are finite.
    """
    # a sum is not finite as soon as one of its numbers is not
    return math.isfinite(sum(map(sum, vectors)))
