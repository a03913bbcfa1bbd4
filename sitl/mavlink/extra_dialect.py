"""Messages that PX4 sends or reads and pymavlink's common dialect does not know, declared by their fields.

The checksum seed follows from the declaration, as MAVLink's generators compute it.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from fastcrc.crc16 import mcrf4xx


@dataclass(frozen=True, slots=True)
class Layout:
    """Encoding of one message: struct, checksum seed, and (name, count) of each field in the order of the encoding."""

    message_id: int
    name: str
    packer: struct.Struct
    crc_extra: int
    fields: tuple[tuple[str, int], ...]


_CODES = {"uint64_t": "Q", "uint32_t": "I", "int32_t": "i", "uint16_t": "H", "uint8_t": "B"}


def declare(message_id: int, name: str, *fields: str) -> Layout:
    """Layout of a message from its fields in wire order (largest first): ``type name`` or ``type name[count]``."""
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
    return Layout(message_id, name, struct.Struct("<" + codes), (seed & 0xFF) ^ (seed >> 8), named)


EXTRA: tuple[Layout, ...] = (
    declare(
        8,
        "LINK_NODE_STATUS",
        "uint64_t timestamp",
        "uint32_t tx_rate",
        "uint32_t rx_rate",
        "uint32_t messages_sent",
        "uint32_t messages_received",
        "uint32_t messages_lost",
        "uint16_t rx_parse_err",
        "uint16_t tx_overflows",
        "uint16_t rx_overflows",
        "uint8_t tx_buf",
        "uint8_t rx_buf",
    ),
    declare(
        300,
        "PROTOCOL_VERSION",
        "uint16_t version",
        "uint16_t min_version",
        "uint16_t max_version",
        "uint8_t spec_version_hash[8]",
        "uint8_t library_version_hash[8]",
    ),
    declare(
        380,
        "TIME_ESTIMATE_TO_TARGET",
        "int32_t safe_return",
        "int32_t land",
        "int32_t mission_next_item",
        "int32_t mission_end",
        "int32_t commanded_action",
    ),
    declare(
        410,
        "EVENT",
        "uint32_t id",
        "uint32_t event_time_boot_ms",
        "uint16_t sequence",
        "uint8_t destination_component",
        "uint8_t destination_system",
        "uint8_t log_levels",
        "uint8_t arguments[40]",
    ),
    declare(411, "CURRENT_EVENT_SEQUENCE", "uint16_t sequence", "uint8_t flags"),
    declare(
        412,
        "REQUEST_EVENT",
        "uint16_t first_sequence",
        "uint16_t last_sequence",
        "uint8_t target_system",
        "uint8_t target_component",
    ),
    declare(
        413,
        "RESPONSE_EVENT_ERROR",
        "uint16_t sequence",
        "uint16_t sequence_oldest_available",
        "uint8_t target_system",
        "uint8_t target_component",
        "uint8_t reason",
    ),
    declare(436, "CURRENT_MODE", "uint32_t custom_mode", "uint32_t intended_custom_mode", "uint8_t standard_mode"),
)
