"""MAVLink packets of somebody who plays a vehicle's PX4.

They are packed by hand, after https://mavlink.io/en/guide/serialization.html, so that no library
decides what an attacker can send.
"""

from __future__ import annotations

import struct

# Messages, and the seed of the checksum of each.
HEARTBEAT = 0
SETUP_SIGNING = 256
_CHECKSUM_SEEDS = {HEARTBEAT: 50, SETUP_SIGNING: 71}

_MAGIC = b"\xfd"  # a packet of MAVLink 2 begins with it

# Of a heartbeat: MAV_TYPE_QUADROTOR, MAV_AUTOPILOT_PX4, MAV_STATE_STANDBY, version of MAVLink.
_QUADROTOR = 2
_PX4 = 12
_STANDBY = 3
_VERSION = 3


def packet(
    message_id: int, payload: bytes, system_id: int, sequence: int, component_id: int = 1
) -> bytes:
    """Return an unsigned packet of MAVLink 2.

    Args:
        message_id: HEARTBEAT or SETUP_SIGNING.
        payload: of the message; zeros at its end are cut off, as MAVLink 2 wants it.
        system_id: of the sender; its lowest byte counts.
        sequence: number of the packet; its lowest byte counts.
        component_id: of the sender.
    """
    payload = payload.rstrip(b"\0") or b"\0"
    header = bytes((len(payload), 0, 0, sequence & 255))
    ids = bytes((system_id & 255, component_id)) + message_id.to_bytes(3, "little")
    body = header + ids + payload

    seed = bytes((_CHECKSUM_SEEDS[message_id],))
    return _MAGIC + body + struct.pack("<H", _checksum(body + seed))


def disarmed() -> bytes:
    """Return the payload of a heartbeat of a PX4 that is disarmed."""
    return struct.pack("<IBBBBB", 0, _QUADROTOR, _PX4, 0, _STANDBY, _VERSION)


def signing_key(system_id: int) -> bytes:
    """Return the payload that gives a PX4 a key."""
    return struct.pack("<QBB", 1, system_id, 1) + bytes(range(32))


def _checksum(data: bytes) -> int:
    """Return CRC-16/MCRF4XX, the checksum of MAVLink."""
    crc = 0xFFFF
    for byte in data:
        mixed = (byte ^ crc) & 0xFF
        mixed = (mixed ^ (mixed << 4)) & 0xFF
        crc = (crc >> 8) ^ (mixed << 8) ^ (mixed << 3) ^ (mixed >> 4)
    return crc
