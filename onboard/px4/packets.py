"""MAVLink packets as bytes: headers, checksums, and the messages that the agent reads and writes.
Pure.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections.abc import Iterator
from typing import Any, NamedTuple

_MAGIC_1, _MAGIC_2 = 0xFE, 0xFD
_SIGNED = 0x01
SIGNATURE_BYTES = 13
_HEADER_1, _HEADER_2, _CHECKSUM = 6, 10, 2
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
# magic, length, two bytes of flags, sequence, system, component, id in two parts
_HEAD = struct.Struct("<BBBBBBBHB")


class MessageLayout(NamedTuple):
    """One kind of message: its fields in the order of the wire, without extensions that are not
    used.
    """

    number: int
    checksum_seed: int
    layout: struct.Struct
    fields: tuple[tuple[str, int, int], ...]  # name, place of the first value, number of values


def _message(number: int, seed: int, layout: str, fields: str = "") -> MessageLayout:
    places: list[tuple[str, int, int]] = []
    place = 0
    for word in fields.split():
        name, _, count = word.partition("*")
        places.append((name, place, int(count or 1)))
        place += int(count or 1)
    return MessageLayout(number, seed, struct.Struct(f"<{layout}"), tuple(places))


READ = {
    "HEARTBEAT": _message(
        0, 50, "IBBBBB", "custom_mode type autopilot base_mode system_status mavlink_version"
    ),
    "SYS_STATUS": _message(
        1,
        124,
        "III",
        "onboard_control_sensors_present onboard_control_sensors_enabled onboard_control_sensors_health",
    ),
    "GPS_RAW_INT": _message(24, 24, "QiiiHHHHB", "time_usec lat lon alt eph epv vel cog fix_type"),
    "ATTITUDE_QUATERNION": _message(31, 246, "I4f", "time_boot_ms q1 q2 q3 q4"),
    "LOCAL_POSITION_NED": _message(32, 185, "I6f", "time_boot_ms x y z vx vy vz"),
    "GPS_GLOBAL_ORIGIN": _message(49, 39, "iii", "latitude longitude altitude"),
    "BATTERY_STATUS": _message(
        147,
        154,
        "iih10HhBBBb",
        "current_consumed energy_consumed temperature voltages*10 current_battery id battery_function type "
        "battery_remaining",
    ),
    "AUTOPILOT_VERSION": _message(148, 178, "QQI", "capabilities uid flight_sw_version"),
    "ESTIMATOR_STATUS": _message(
        230,
        163,
        "Q7f",
        "time_usec vel_ratio pos_horiz_ratio pos_vert_ratio mag_ratio hagl_ratio tas_ratio pos_horiz_accuracy",
    ),
    "EXTENDED_SYS_STATE": _message(245, 130, "BB", "vtol_state landed_state"),
    "STATUSTEXT": _message(253, 83, "B50s", "severity text"),
}
SENT = {
    # latitude, longitude, altitude, system, time
    "SET_GPS_GLOBAL_ORIGIN": _message(48, 41, "iiiBQ"),
    # parameters, command, system, component, confirmation
    "COMMAND_LONG": _message(76, 152, "7fHBBB"),
    # time, q, rates, thrust, system, component, mask
    "SET_ATTITUDE_TARGET": _message(82, 49, "I8fBBB"),
    "PLAY_TUNE": _message(258, 187, "BB30s"),  # system, component, tune
    # time, position, q, velocity, rates, two covariances, two frames, resets, estimator, quality
    "ODOMETRY": _message(331, 91, "Q55fBBBBb"),
}
# What MAVSDK needs besides, and what it may send: nothing else of it leaves.
# HEARTBEAT, PARAM_VALUE, COMMAND_ACK, AUTOPILOT_VERSION
MAVSDK_READS = {0: 50, 22: 220, 77: 143, 148: 178}
MAVSDK_SENDS = {
    0: 50,
    20: 214,
    21: 159,
    23: 168,
    76: 152,
}  # HEARTBEAT, PARAM_REQUEST_READ, _LIST, PARAM_SET, COMMAND_LONG
NAMES = {message.number: name for name, message in READ.items()}
_SEEDS = {message.number: message.checksum_seed for message in (*READ.values(), *SENT.values())}
_SEEDS |= MAVSDK_READS | MAVSDK_SENDS


class Packet(NamedTuple):
    """One packet: sender, kind, payload, and its bytes."""

    system_id: int
    component_id: int
    number: int
    payload: bytes
    is_signed: bool
    data: bytes

    @property
    def is_right(self) -> bool:
        """Whether the checksum is; never for a kind that nobody here reads or sends."""
        seed = _SEEDS.get(self.number)
        if seed is None:
            return False
        end = len(self.data) - (SIGNATURE_BYTES if self.is_signed else 0) - _CHECKSUM
        return checksum(self.data[1:end], seed) == self.data[end : end + _CHECKSUM]


def is_read(number: int) -> bool:
    """Whether the agent or its MAVSDK reads this kind of message."""
    return number in NAMES or number in MAVSDK_READS


def checksum(data: bytes, seed: int) -> bytes:
    """Return the two bytes of MAVLink's checksum: CRC-16/MCRF4XX, by the standard library's
    mirrored form.

    Args:
        data: packet without its first byte.
        seed: of the kind of message.
    """
    mirrored = crc_hqx((data + bytes((seed,))).translate(_REVERSED), 0xFFFF)
    return mirrored.to_bytes(2, "big").translate(_REVERSED)


def cut(data: bytes) -> Iterator[Packet | int]:
    """Cut bytes into packets.

    Args:
        data: a datagram, or what came over a cable, beginning anywhere.
    Yields:
        each packet; last the number of bytes at the end that are no whole packet, negative when
        they never become one.
    """
    start, end = 0, len(data)
    while start < end:
        magic, left = data[start], end - start
        if magic not in (_MAGIC_1, _MAGIC_2):
            yield start - end
            return
        is_2 = magic == _MAGIC_2
        header = _HEADER_2 if is_2 else _HEADER_1
        if left < header:
            break
        is_signed = is_2 and bool(data[start + 2] & _SIGNED)
        body = start + header
        length = data[start + 1]
        size = header + length + _CHECKSUM + (SIGNATURE_BYTES if is_signed else 0)
        if left < size:
            break
        ids = data[start + 5 : start + 10] if is_2 else data[start + 3 : start + 6]
        number = int.from_bytes(ids[2:], "little")
        yield Packet(
            ids[0],
            ids[1],
            number,
            data[body : body + length],
            is_signed,
            data[start : start + size],
        )
        start += size
    if start < end:
        yield end - start


def fields_of(name: str, payload: bytes) -> dict[str, Any]:
    """Return the fields of a message.

    Args:
        name: one of :data:`READ`.
        payload: as it came, with or without the zeros and the extensions at its end.
    """
    _, _, layout, places = READ[name]
    values = layout.unpack(payload.ljust(layout.size, b"\0")[: layout.size])
    return {
        name: values[place] if count == 1 else values[place : place + count]
        for name, place, count in places
    }


def packed(
    number: int,
    payload: bytes,
    sequence: int,
    system_id: int,
    component_id: int,
    *,
    is_signed: bool = False,
) -> bytes:
    """Return a packet of MAVLink 2, to which the signature is yet to be added.

    Args:
        number: of a message that is sent here.
        payload: zeros at its end are cut off.
        sequence: counts the packets of a sender, 0 to 255.
        system_id: of the sender.
        component_id: of the sender.
        is_signed: whether a signature follows.
    """
    payload = payload.rstrip(b"\0") or b"\0"
    flags = _SIGNED if is_signed else 0
    head = _HEAD.pack(
        _MAGIC_2,
        len(payload),
        flags,
        0,
        sequence,
        system_id,
        component_id,
        number & 0xFFFF,
        number >> 16,
    )
    return head + payload + checksum(head[1:] + payload, _SEEDS[number])
