"""The conversion of bus messages into JSON rows of the record, and back.

A channel of the record is named ``topic/name`` as on the bus, and fields have their names on the
bus. Each kind of message has a JSON schema.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, get_type_hints

import msgspec

from onboard.bus import schema as schema_
from onboard.bus.schema import Message, OrderReply, TickBatch
from onboard.bus.topics import Topic
from onboard.plain_text import numbered

MAX_STAMP_NS = (1 << 63) - 1
REPLY = "reply"  # topic of replies to orders in the record; on the bus they answer queries
RECORDED = (Topic.STATE, Topic.TICK, Topic.MOCAP)  # topics that a ground needs only for a record
_encode = msgspec.json.Encoder().encode
_decode = msgspec.json.Decoder(dict[str, Any]).decode


class ChannelRow(NamedTuple):
    """One message of the record."""

    channel: str
    kind: type[Message]
    stamp_ns: int  # log time
    data: bytes  # JSON


def rows(topic: Topic, name: str, message: Message, received_ns: int) -> list[ChannelRow]:
    """Convert one message of the bus into rows of the record.

    A batch of ticks becomes one row for each tick; any other message becomes one row.

    The log time is the stamp of the message itself. For a message without a stamp, or with an
    impossible one, it is the time of reception.

    Args:
        topic: topic of the message.
        name: vehicle, body or node that it is about.
        message: the message.
        received_ns: time of its reception [ns].

    Returns:
        Rows of the record.
    """
    if isinstance(message, TickBatch):
        return [_row(f"{topic.value}/{name}", tick, received_ns) for tick in message.ticks]
    recorded_topic: str = topic.value
    if isinstance(message, OrderReply):
        recorded_topic = REPLY
    return [_row(f"{recorded_topic}/{name}", message, received_ns)]


def as_mapping(message: Message) -> dict[str, Any]:
    """Return a message as a mapping from field names to values."""
    return msgspec.structs.asdict(message)


class _Field(NamedTuple):
    """One field of a message."""

    name: str
    default: Any  # msgspec.NODEFAULT if it has none
    is_number: bool  # whether null in JSON stands for NaN


# name of a kind of message -> its class
KINDS: dict[str, type[Message]] = {
    name: kind
    for name, kind in vars(schema_).items()
    if isinstance(kind, type) and issubclass(kind, Message)
}
# Fields of each kind, filled when they are first used.
_FIELDS: dict[type[Message], tuple[_Field, ...]] = {}
# Kind -> a class of the same fields that is encoded as an object with the names of its fields. The
# messages themselves are encoded as arrays, as they travel on the bus.
_NAMED: dict[type[Message], type[msgspec.Struct]] = {}


def from_json(kind: type[Message], data: bytes) -> Message | None:
    """Decode a row of a record. JSON has no NaN, so null stands for it.

    The record may be of another version of Covey: unknown fields are dropped, and missing fields
    get their defaults.

    Args:
        kind: kind of the message.
        data: the JSON text.

    Returns:
        The message; None if the data are not a message of this kind.
    """
    try:
        values = _decode(data)
        # a message is converted from the array of its values, as on the bus
        values_in_order = [_value(values, field) for field in _fields(kind)]
        return msgspec.convert(values_in_order, kind)
    except (
        msgspec.DecodeError,
        msgspec.ValidationError,
        UnicodeDecodeError,
        RecursionError,
        KeyError,
    ):
        return None


def undecoded_words(count: int) -> str:
    """Return a sentence about the messages of a record that :func:`from_json` could not decode."""
    verb = "is" if count == 1 else "are"
    return f"{numbered(count, 'message')} could not be decoded and {verb} left out."


def _fields(kind: type[Message]) -> tuple[_Field, ...]:
    if kind not in _FIELDS:
        fields = []
        for field in msgspec.structs.fields(kind):
            default = field.default
            if field.default_factory is not msgspec.NODEFAULT:
                default = field.default_factory()  # from_json gives each message a copy
            is_number = "float" in str(field.type) and "None" not in str(field.type)
            fields.append(_Field(field.name, default, is_number))
        _FIELDS[kind] = tuple(fields)
    return _FIELDS[kind]


def _value(values: dict[str, Any], field: _Field) -> Any:
    """Return the value of one field.

    Raises:
        KeyError: the field is missing and has no default.
    """
    if field.default is msgspec.NODEFAULT:
        value = values[field.name]
    else:
        value = values.get(field.name, field.default)

    if not field.is_number:
        return value
    if isinstance(value, list):
        return [_nan_for_null(part) for part in value]
    if isinstance(value, dict):
        return {key: _nan_for_null(part) for key, part in value.items()}
    return _nan_for_null(value)


def _nan_for_null(value: Any) -> Any:
    return math.nan if value is None else value


def json_schema(kind: type[Message]) -> bytes:
    """Return the JSON schema of a kind, as an object with named fields.

    Viewers know few words of JSON schema: one type for each field, and one for the items of an
    array. One other word makes them refuse the whole channel. So a field that these words cannot
    describe is left out of the schema, but not out of the messages; JSON schema allows that. The
    schema also does not say that a value may be null.
    """
    hints = get_type_hints(kind)
    properties: dict[str, Any] = {}
    for field in kind.__struct_fields__:
        described = _in_plain_words(msgspec.json.schema(hints[field]))
        if described is not None:
            properties[field] = described
    schema = {"title": f"covey.{kind.__name__}", "type": "object", "properties": properties}
    return msgspec.json.encode(schema)


def _row(channel: str, message: Message, received_ns: int) -> ChannelRow:
    stamp_ns = getattr(message, "stamp_ns", received_ns)
    if not 0 <= stamp_ns <= MAX_STAMP_NS:
        stamp_ns = received_ns

    kind = type(message)
    if kind not in _NAMED:
        _NAMED[kind] = msgspec.defstruct(kind.__name__, kind.__struct_fields__, gc=False)
    named = _NAMED[kind](*msgspec.structs.astuple(message))
    return ChannelRow(channel, kind, stamp_ns, _encode(named))


def _in_plain_words(schema: dict[str, Any]) -> dict[str, Any] | None:
    """Return the schema of a value in the words that viewers know; None if that is impossible."""
    if "anyOf" in schema:
        return _common(schema["anyOf"])
    if "enum" in schema:
        return {"type": "string", "enum": schema["enum"]}
    if schema.get("type") == "array":
        parts = schema.get("prefixItems") or [schema["items"]]
        items = _common(parts)
        if items is None or items["type"] == "array":
            return None
        return {"type": "array", "items": items}
    if "type" in schema:
        return schema
    return None  # a reference


def _common(schemas: list[dict[str, Any]]) -> dict[str, Any] | None:
    """Return one schema, in the words that viewers know, that fits all of these; null is ignored.

    Returns None if their types differ.
    """
    plain = [_in_plain_words(schema) for schema in schemas if schema.get("type") != "null"]
    first = plain[0]
    if first is None:
        return None
    for schema in plain:
        if schema is None or schema["type"] != first["type"]:
            return None

    if all(schema == first for schema in plain):
        return first
    return {"type": first["type"]}
