"""MAVLink packets of somebody who plays a vehicle's PX4, packed by hand: no library is asked
whether they are right.
"""

from __future__ import annotations

import struct

HEARTBEAT, SETUP_SIGNING = 0, 256
_CHECKSUM_SEEDS = {HEARTBEAT: 50, SETUP_SIGNING: 71}
_QUADROTOR, _PX4, _STANDBY, _VERSION = 2, 12, 3, 3


def packet(
    message_id: int, payload: bytes, system_id: int, sequence: int, component_id: int = 1
) -> bytes:
    """Return an unsigned packet of MAVLink 2."""
    payload = payload.rstrip(b"\0") or b"\0"
    ids = bytes((system_id & 255, component_id)) + message_id.to_bytes(3, "little")
    body = bytes((len(payload), 0, 0, sequence & 255)) + ids + payload
    return (
        b"\xfd" + body + struct.pack("<H", _checksum(body + bytes((_CHECKSUM_SEEDS[message_id],))))
    )


def disarmed() -> bytes:
    """Return the payload of a heartbeat of a PX4 that is disarmed."""
    return struct.pack("<IBBBBB", 0, _QUADROTOR, _PX4, 0, _STANDBY, _VERSION)


def signing_key(system_id: int) -> bytes:
    """Return the payload that gives a PX4 a key."""
    return struct.pack("<QBB", 1, system_id, 1) + bytes(range(32))


def _checksum(data: bytes) -> int:
    """CRC-16/MCRF4XX, the checksum of MAVLink."""
    crc = 0xFFFF
    for byte in data:
        mixed = (byte ^ crc) & 0xFF
        mixed = (mixed ^ (mixed << 4)) & 0xFF
        crc = (crc >> 8) ^ (mixed << 8) ^ (mixed << 3) ^ (mixed >> 4)
    return crc
