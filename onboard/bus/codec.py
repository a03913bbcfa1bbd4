"""Bytes <-> message. What comes from outside never raises: it decodes, or it is :class:`Malformed`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import msgspec

from onboard.bus.schema import SCHEMA_VERSION, Message

MessageT = TypeVar("MessageT", bound=Message)

MAX_BYTES = 65_536

_encoder = msgspec.msgpack.Encoder()
_decoders: dict[type[Message], msgspec.msgpack.Decoder[Message]] = {}


@dataclass(frozen=True, slots=True)
class Malformed:
    """Bytes that are no message of the wanted kind: counted by the receiver, otherwise ignored."""

    reason: str
    size: int


def encode(message: Message) -> bytes:
    """MessagePack bytes of a message."""
    return _encoder.encode(message)


def decode(data: bytes, kind: type[MessageT]) -> MessageT | Malformed:
    """The message in ``data``, or why there is none; whether its numbers are finite is for :func:`is_finite` to say.

    Never raises on input: garbage, truncation, another type and another schema version all become Malformed.
    """
    if len(data) > MAX_BYTES:
        return Malformed("too large", len(data))
    decoder = _decoders.get(kind)
    if decoder is None:
        decoder = _decoders[kind] = msgspec.msgpack.Decoder(kind)
    try:
        message = decoder.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        return Malformed(str(error), len(data))
    if message.schema != SCHEMA_VERSION:
        return Malformed(f"schema version {message.schema}, this side reads {SCHEMA_VERSION}", len(data))
    assert isinstance(message, kind)
    return message


def is_finite(*vectors: tuple[float, ...]) -> bool:
    """Whether every number of every vector is finite, and their sum too; for receivers that act on a message."""
    return math.isfinite(sum(map(sum, vectors)))  # whatever is not finite makes the sum so
