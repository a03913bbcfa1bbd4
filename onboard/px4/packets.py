"""MAVLink packets as bytes: headers, checksums, and the messages that the agent reads. Pure.

https://mavlink.io/en/guide/serialization.html describes the format. Fields are listed in wire
order, with the largest types first. MAVLink's XML files use a different order.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections.abc import Iterator
from typing import Any, NamedTuple

_MAGIC_1 = 0xFE  # first byte of a packet of MAVLink 1
_MAGIC_2 = 0xFD  # first byte of a packet of MAVLink 2
_MAGICS = (_MAGIC_1, _MAGIC_2)
_SIGNED = 0x01  # flag of a packet with a signature

_HEADER_1_BYTES = 6
_HEADER_2_BYTES = 10
_CHECKSUM_BYTES = 2
SIGNATURE_BYTES = 13

_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))  # bits of each byte mirrored

# magic, length, two bytes of flags, sequence, system, component, id in two parts
_HEAD = struct.Struct("<BBBBBBBHB")


class MessageLayout(NamedTuple):
    """One kind of message, without the extensions that are not used."""

    number: int  # id of the kind
    checksum_seed: int  # CRC_EXTRA of the kind
    layout: struct.Struct  # layout of its values, in wire order
    # name of each field, index of its first value, number of its values
    fields: tuple[tuple[str, int, int], ...]


def _message(number: int, seed: int, layout: str, fields: str = "") -> MessageLayout:
    """Return a kind of message from its row.

    Args:
        number: id of the kind.
        seed: CRC_EXTRA of the kind.
        layout: layout of its values, in the notation of :mod:`struct`.
        fields: names of the fields in wire order; ``NAME*10`` is an array of ten values.
    """
    indexed: list[tuple[str, int, int]] = []
    index = 0
    for word in fields.split():
        name, star, written_count = word.partition("*")
        count = 1
        if star:
            count = int(written_count)
        indexed.append((name, index, count))
        index += count
    return MessageLayout(number, seed, struct.Struct(f"<{layout}"), tuple(indexed))


# Messages that the agent reads.
READ = {
    "HEARTBEAT": _message(
        0, 50, "IBBBBB", "custom_mode type autopilot base_mode system_status mavlink_version"
    ),
    "SYS_STATUS": _message(
        1,
        124,
        "III",
        "onboard_control_sensors_present onboard_control_sensors_enabled "
        "onboard_control_sensors_health",
    ),
    "GPS_RAW_INT": _message(
        24,
        24,
        "QiiiHHHHBBiI",
        "time_usec lat lon alt eph epv vel cog fix_type satellites_visible alt_ellipsoid h_acc",
    ),
    "ATTITUDE_QUATERNION": _message(31, 246, "I4f", "time_boot_ms q1 q2 q3 q4"),
    "LOCAL_POSITION_NED": _message(32, 185, "I6f", "time_boot_ms x y z vx vy vz"),
    "GPS_GLOBAL_ORIGIN": _message(49, 39, "iii", "latitude longitude altitude"),
    "BATTERY_STATUS": _message(
        147,
        154,
        "iih10HhBBBb",
        "current_consumed energy_consumed temperature voltages*10 current_battery id "
        "battery_function type battery_remaining",
    ),
    # further fields on the wire, which are not read: buttons, target
    "MANUAL_CONTROL": _message(69, 243, "4h", "x y z r"),
    "AUTOPILOT_VERSION": _message(148, 178, "QQI", "capabilities uid flight_sw_version"),
    "ESTIMATOR_STATUS": _message(
        230,
        163,
        "Q8fH",
        "time_usec vel_ratio pos_horiz_ratio pos_vert_ratio mag_ratio hagl_ratio tas_ratio "
        "pos_horiz_accuracy pos_vert_accuracy flags",
    ),
    "EXTENDED_SYS_STATE": _message(245, 130, "BB", "vtol_state landed_state"),
    "STATUSTEXT": _message(253, 83, "B50sHB", "severity text id chunk_seq"),
}

# Messages that the agent writes. The comment above each lists its values.
SENT = {
    # latitude, longitude, altitude, system, time
    "SET_GPS_GLOBAL_ORIGIN": _message(48, 41, "iiiBQ"),
    # parameters, command, system, component, confirmation
    "COMMAND_LONG": _message(76, 152, "7fHBBB"),
    # time, q, rates, thrust, system, component, mask
    "SET_ATTITUDE_TARGET": _message(82, 49, "I8fBBB"),
    # flags, length, data
    "GPS_RTCM_DATA": _message(233, 35, "BB180s"),
    "PLAY_TUNE": _message(258, 187, "BB30s"),  # system, component, tune
    # time, position, q, velocity, rates, two covariances, two frames, resets, estimator, quality
    "ODOMETRY": _message(331, 91, "Q55fBBBBb"),
}

# Messages that are passed to MAVSDK, and messages from MAVSDK that are sent: number -> CRC_EXTRA.
# All other messages from MAVSDK are dropped.
MAVSDK_READS = {
    0: 50,  # HEARTBEAT
    22: 220,  # PARAM_VALUE
    77: 143,  # COMMAND_ACK
    148: 178,  # AUTOPILOT_VERSION
    345: 209,  # PARAM_ERROR, from v1.18 on
}
MAVSDK_SENDS = {
    0: 50,  # HEARTBEAT
    20: 214,  # PARAM_REQUEST_READ
    21: 159,  # PARAM_REQUEST_LIST
    23: 168,  # PARAM_SET
    76: 152,  # COMMAND_LONG
}

# Messages that request PX4's own logs, and messages that contain them: number -> CRC_EXTRA. They
# are passed on without being read.
FILE_TRANSFER = 110  # FILE_TRANSFER_PROTOCOL
LOG_REQUESTS = {
    FILE_TRANSFER: 84,
    117: 128,  # LOG_REQUEST_LIST
    119: 116,  # LOG_REQUEST_DATA
    122: 203,  # LOG_REQUEST_END
}
LOG_ANSWERS = {
    FILE_TRANSFER: 84,
    118: 56,  # LOG_ENTRY
    120: 134,  # LOG_DATA
}

NAMES = {message.number: name for name, message in READ.items()}
_SEEDS = {message.number: message.checksum_seed for message in (*READ.values(), *SENT.values())}
_SEEDS |= MAVSDK_READS | MAVSDK_SENDS | LOG_REQUESTS | LOG_ANSWERS


class Packet(NamedTuple):
    """One packet: sender, kind, payload, and its bytes."""

    system_id: int  # of the sender
    component_id: int  # of the sender
    number: int  # kind of the message
    payload: bytes
    is_signed: bool
    data: bytes  # the whole packet

    @property
    def has_right_checksum(self) -> bool:
        """Whether the checksum is correct; False for a kind that is neither read nor sent here."""
        seed = _SEEDS.get(self.number)
        if seed is None:
            return False

        end = len(self.data) - _CHECKSUM_BYTES  # end of the bytes that the checksum covers
        if self.is_signed:
            end -= SIGNATURE_BYTES
        return checksum(self.data[1:end], seed) == self.data[end : end + _CHECKSUM_BYTES]


class Remainder(NamedTuple):
    """Bytes after the last whole packet."""

    data: bytes
    is_junk: bool  # True: they cannot be the start of a packet


def is_read(number: int) -> bool:
    """Whether the agent or its MAVSDK reads this kind of message, or the agent passes it on."""
    return number in NAMES or number in MAVSDK_READS or number in LOG_ANSWERS


def checksum(data: bytes, seed: int) -> bytes:
    """Return the two bytes of MAVLink's checksum.

    The checksum is CRC-16/MCRF4XX. The standard library's CRC has mirrored bits, so bytes are
    mirrored before and after.

    Args:
        data: bytes of a packet, without its first byte and its checksum.
        seed: CRC_EXTRA of the kind of message.
    """
    mirrored = crc_hqx((data + bytes((seed,))).translate(_REVERSED), 0xFFFF)
    return mirrored.to_bytes(2, "big").translate(_REVERSED)


def cut(data: bytes) -> Iterator[Packet | Remainder]:
    """Cut a datagram into packets.

    Yields:
        Each packet, and finally any bytes after the last packet.
    """
    start = 0
    while start < len(data):
        piece = _piece_at(data, start)
        yield piece
        if isinstance(piece, Remainder):
            return
        start += len(piece.data)


def cut_stream(data: bytes) -> Iterator[Packet | Remainder]:
    """Cut the bytes of a serial device, which may begin anywhere, into packets.

    Any byte may look like the start of a packet. In the timestamps of signed packets, one does so
    for minutes. What looks like a packet but is none takes no other bytes with it.

    Yields:
        Each packet, what is junk between packets, and finally the start of a packet, if any.
    """
    start = 0
    while start < len(data):
        piece = _piece_at(data, start)
        if isinstance(piece, Packet):
            end = start + len(piece.data)
            piece = _judged(piece, data[end : end + 1])
        if isinstance(piece, Remainder) and piece.is_junk:
            piece = Remainder(data[start : _next_magic(data, start + 1)], is_junk=True)

        yield piece
        start += len(piece.data)


def _piece_at(data: bytes, start: int) -> Packet | Remainder:
    """Return the packet that begins at an index, or all bytes from there on if none does."""
    magic = data[start]
    if magic == _MAGIC_1:
        header_bytes = _HEADER_1_BYTES
    elif magic == _MAGIC_2:
        header_bytes = _HEADER_2_BYTES
    else:
        return Remainder(data[start:], is_junk=True)

    header = data[start : start + header_bytes]
    if len(header) < header_bytes:
        return Remainder(data[start:], is_junk=False)

    _, payload_bytes, flags = header[:3]
    is_signed = magic == _MAGIC_2 and bool(flags & _SIGNED)
    if magic == _MAGIC_2 and flags & ~_SIGNED:  # flags that nobody knows: it cannot be read
        return Remainder(data[start:], is_junk=True)

    size = header_bytes + payload_bytes + _CHECKSUM_BYTES
    if is_signed:
        size += SIGNATURE_BYTES

    whole = data[start : start + size]
    if len(whole) < size:
        return Remainder(data[start:], is_junk=False)

    ids = header[3:]  # system, component, number
    if magic == _MAGIC_2:
        ids = header[5:]
    system_id, component_id, *number = ids
    return Packet(
        system_id=system_id,
        component_id=component_id,
        number=int.from_bytes(number, "little"),
        payload=whole[header_bytes : header_bytes + payload_bytes],
        is_signed=is_signed,
        data=whole,
    )


def _judged(packet: Packet, following: bytes) -> Packet | Remainder:
    """Return what looks like a packet of a stream, if it is one; otherwise its bytes.

    The checksum of a kind that is not known here cannot be checked; after a packet of such a kind,
    another packet must begin.

    Args:
        packet: what looks like a packet.
        following: the next byte of the stream; empty if it has not arrived.
    """
    if packet.number in _SEEDS:
        is_real = packet.has_right_checksum
    elif following:
        is_real = following[0] in _MAGICS
    else:  # the next bytes will show it
        return Remainder(packet.data, is_junk=False)

    if is_real:
        return packet
    return Remainder(packet.data, is_junk=True)


def _next_magic(data: bytes, start: int) -> int:
    """Return the index of the next byte that may begin a packet; the length if there is none."""
    for index in range(start, len(data)):
        if data[index] in _MAGICS:
            return index
    return len(data)


def fields_of(name: str, payload: bytes) -> dict[str, Any]:
    """Return the fields of a message.

    Args:
        name: name of a message in :data:`READ`.
        payload: received payload, with or without the zeros and the extensions at its end.
    """
    layout = READ[name].layout
    values = layout.unpack(payload.ljust(layout.size, b"\0")[: layout.size])

    fields: dict[str, Any] = {}
    for field, index, count in READ[name].fields:
        if count == 1:
            fields[field] = values[index]
        else:
            fields[field] = values[index : index + count]
    return fields


def packed(
    number: int,
    payload: bytes,
    sequence: int,
    system_id: int,
    component_id: int,
    *,
    is_signed: bool = False,
) -> bytes:
    """Return a packet of MAVLink 2; the caller appends the signature, if any.

    Args:
        number: id of the message's kind.
        payload: payload; zeros at its end are removed.
        sequence: sequence number of the sender's packets, 0 to 255.
        system_id: system id of the sender.
        component_id: component id of the sender.
        is_signed: whether the caller appends a signature.
    """
    payload = payload.rstrip(b"\0")
    if not payload:  # MAVLink 2 keeps at least one byte
        payload = b"\0"
    incompatible_flags = 0
    if is_signed:
        incompatible_flags = _SIGNED
    compatible_flags = 0
    head = _HEAD.pack(
        _MAGIC_2,
        len(payload),
        incompatible_flags,
        compatible_flags,
        sequence,
        system_id,
        component_id,
        number & 0xFFFF,
        number >> 16,
    )
    return head + payload + checksum(head[1:] + payload, _SEEDS[number])
