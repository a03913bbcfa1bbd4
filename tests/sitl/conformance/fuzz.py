"""Datagrams no client should send: random bytes, broken MAVLink, and sound MAVLink with senseless
content. Seeded.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Iterator

from fastcrc.crc16 import mcrf4xx
from pymavlink.dialects.v20 import common

_KINDS = [(number, kind) for number, kind in common.mavlink_map.items() if number < 1 << 24]
_IDS = {kind.msgname: number for number, kind in _KINDS}
# Addressed to nobody, and acted upon all the same: external positions.
_HEARD_BY_ALL = {
    "VISION_POSITION_ESTIMATE",
    "ODOMETRY",
    "ATT_POS_MOCAP",
    "GLOBAL_VISION_POSITION_ESTIMATE",
}
_UNTARGETED = [
    (number, kind)
    for number, kind in _KINDS
    if "target_system" not in kind.fieldnames and kind.msgname not in _HEARD_BY_ALL
]
_TARGETED = [(number, kind) for number, kind in _KINDS if "target_system" in kind.fieldnames]
# Commands that an autopilot knows; others come by chance.
_COMMANDS = (
    16, 17, 20, 21, 22, 84, 85, 92, 115, 176, 178, 179, 183, 185, 187, 189, 191, 192, 193, 195, 201,
    203, 205, 209, 211, 223, 241, 242, 243, 245, 246, 252, 300, 310, 400, 401, 410, 420, 500, 510,
    511, 512, 519, 520, 521, 522, 525, 527, 528, 2000, 2001, 2500, 2501, 3000, 4501, 42600, 43001,
)  # fmt: skip
_MODES = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 12.0, 255.0)
_ODD_FLOATS = (
    0.0, -0.0, 1.0, -1.0, 21196.0, 1e38, -1e38, 1e-40, float("nan"), float("inf"), float("-inf"),
    2**24 + 1.0, 65535.0,
    4294967296.0, -2147483649.0,
)  # fmt: skip
_ODD_NAMES = (
    b"COM_OF_LOSS_T",
    b"COM_OBL_RC_ACT",
    b"SIM_BAT_DRAIN",
    b"EKF2_EV_DELAY",
    b"MPC_THR_HOVER",
    b"",
    b"\xff" * 16,
)


def frame(
    message_id: int, payload: bytes, sequence: int, *, system_id: int = 245, is_v1: bool = False
) -> bytes:
    """A frame with a right checksum around any payload."""
    kind = common.mavlink_map.get(message_id)
    extra = kind.crc_extra if kind is not None else 0
    if is_v1:
        body = bytes((len(payload), sequence & 0xFF, system_id, 190, message_id & 0xFF)) + payload
        return b"\xfe" + body + mcrf4xx(body + bytes((extra,))).to_bytes(2, "little")
    head = bytes((len(payload), 0, 0, sequence & 0xFF, system_id, 190)) + message_id.to_bytes(
        3, "little"
    )
    body = head + payload
    return b"\xfd" + body + mcrf4xx(body + bytes((extra,))).to_bytes(2, "little")


def _payload(r: random.Random, kind: object) -> bytes:
    size: int = kind.unpacker.size  # type: ignore[attr-defined]
    return r.randbytes(
        r.choice((size, size, size, r.randint(1, size), min(255, size + r.randint(0, 8))))
    )


def _random_bytes(r: random.Random, sequence: int) -> bytes:
    return r.choice((b"", b"\xfd", b"\xfe")) + r.randbytes(r.randint(0, 300))


def _sound(r: random.Random, sequence: int) -> bytes:
    number, kind = r.choice(_KINDS)
    return frame(number, _payload(r, kind), sequence)


def _mutated(r: random.Random, sequence: int) -> bytes:
    broken = bytearray(_sound(r, sequence))
    for _ in range(r.randint(1, 4)):
        broken[r.randrange(len(broken))] ^= 1 << r.randrange(8)
    return bytes(broken)


def _truncated(r: random.Random, sequence: int) -> bytes:
    whole = _sound(r, sequence)
    return whole[: r.randrange(len(whole))]


def _wrong_checksum(r: random.Random, sequence: int) -> bytes:
    whole = _sound(r, sequence)
    return whole[:-1] + bytes((whole[-1] ^ r.randint(1, 255),))


def _signed(r: random.Random, sequence: int) -> bytes:
    # Signed by nobody: incompat flag, right checksum or not, and thirteen bytes more or fewer.
    number, kind = r.choice(_UNTARGETED)
    payload = _payload(r, kind)
    body = (
        bytes((len(payload), 1, 0, sequence & 0xFF, 245, 190))
        + number.to_bytes(3, "little")
        + payload
    )
    checksum = mcrf4xx(body + bytes((kind.crc_extra,))).to_bytes(2, "little")
    return b"\xfd" + body + checksum + r.randbytes(r.choice((13, 13, r.randint(0, 20))))


def _version_one(r: random.Random, sequence: int) -> bytes:
    number, kind = r.choice([pair for pair in _UNTARGETED if pair[0] < 256])
    return frame(number, _payload(r, kind), sequence, is_v1=True)


def _for_others(r: random.Random, sequence: int) -> bytes:
    number, kind = r.choice(_TARGETED)
    payload = bytearray(kind.unpacker.size)
    payload[:] = r.randbytes(len(payload))
    payload[_offset(kind, "target_system")] = r.randint(50, 250)
    payload[-1] = payload[-1] or 1  # nothing is cut off, the target neither
    return frame(number, bytes(payload), sequence)


def _many_in_one(r: random.Random, sequence: int) -> bytes:
    return b"".join(
        r.choice((_mutated, _truncated, _wrong_checksum))(r, sequence)
        for _ in range(r.randint(2, 5))
    )


def _offset(kind: object, field: str) -> int:
    names = kind.ordered_fieldnames  # type: ignore[attr-defined]
    counts = kind.array_lengths  # type: ignore[attr-defined]
    kinds = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))  # type: ignore[attr-defined]
    sizes = {
        "char": 1,
        "uint8_t": 1,
        "int8_t": 1,
        "uint16_t": 2,
        "int16_t": 2,
        "uint64_t": 8,
        "int64_t": 8,
        "double": 8,
    }
    offset = 0
    for name, count in zip(names, counts, strict=True):
        if name == field:
            return offset
        offset += sizes.get(kinds[name], 4) * max(1, count)
    raise KeyError(field)


def _command(r: random.Random, sequence: int) -> bytes:
    numbers = [
        r.choice(_ODD_FLOATS) if r.random() < 0.5 else r.uniform(-300.0, 300.0) for _ in range(7)
    ]
    command = r.choice(_COMMANDS)
    if command == 176:
        numbers[:3] = [r.choice((1.0, 0.0, 209.0)), r.choice(_MODES), r.choice(_MODES)]
    return frame(
        _IDS["COMMAND_LONG"],
        struct.pack("<7fHBBB", *numbers, command, r.choice((0, 1)), 1, 1),
        sequence,
    )


def _command_int(r: random.Random, sequence: int) -> bytes:
    numbers = [r.choice(_ODD_FLOATS) for _ in range(4)]
    place = (r.randint(-(2**31), 2**31 - 1), r.randint(-(2**31), 2**31 - 1), r.choice(_ODD_FLOATS))
    tail = (r.choice(_COMMANDS), r.choice((0, 1)), 1, r.randint(0, 21), 0, 1)
    return frame(
        _IDS["COMMAND_INT"], struct.pack("<4fiifHBBBBB", *numbers, *place, *tail), sequence
    )


def _attitude(r: random.Random, sequence: int) -> bytes:
    numbers = [r.choice(_ODD_FLOATS) for _ in range(8)]
    payload = struct.pack(
        "<I8fBBB",
        r.getrandbits(32),
        *numbers,
        1,
        1,
        r.choice((0, 7, 64, 128, 255, r.getrandbits(8))),
    )
    return frame(_IDS["SET_ATTITUDE_TARGET"], payload, sequence)


def _position(r: random.Random, sequence: int) -> bytes:
    numbers = [r.choice(_ODD_FLOATS) for _ in range(11)]
    tail = (r.getrandbits(16), 1, 1, r.choice((1, 7, 8, 9, r.getrandbits(8))))
    return frame(
        _IDS["SET_POSITION_TARGET_LOCAL_NED"],
        struct.pack("<I11fHBBB", r.getrandbits(32), *numbers, *tail),
        sequence,
    )


def _parameter(r: random.Random, sequence: int) -> bytes:
    name = r.choice(_ODD_NAMES).ljust(16, b"\0")
    if r.random() < 0.5:
        return frame(
            _IDS["PARAM_SET"],
            struct.pack("<fBB16sB", r.choice(_ODD_FLOATS), 1, 1, name, r.getrandbits(8)),
            sequence,
        )
    return frame(
        _IDS["PARAM_REQUEST_READ"],
        struct.pack("<hBB16s", r.randint(-32768, 32767), 1, 1, name),
        sequence,
    )


def _vision(r: random.Random, sequence: int) -> bytes:
    numbers = [r.choice(_ODD_FLOATS) for _ in range(6)]
    payload = struct.pack("<Q6f", r.getrandbits(64), *numbers) + r.randbytes(r.choice((0, 85)))
    return frame(_IDS["VISION_POSITION_ESTIMATE"], payload, sequence)


def _for_us(r: random.Random, sequence: int) -> bytes:
    number, kind = r.choice(_TARGETED)
    payload = bytearray(r.randbytes(kind.unpacker.size))
    payload[_offset(kind, "target_system")] = r.choice((0, 1))
    payload[-1] = payload[-1] or 1
    return frame(number, bytes(payload), sequence)


Source = Callable[[random.Random, int], bytes]
# What is broken, foreign or untargeted: nothing of it may change a flight.
NOISE: tuple[Source, ...] = (
    _random_bytes, _mutated, _truncated, _wrong_checksum, _signed, _version_one, _for_others,
    _many_in_one,
)  # fmt: skip
# What is well formed and meant for the vehicle: it may do as it is told, but not fail.
HOSTILE: tuple[Source, ...] = (
    _sound, _for_us, _command, _command_int, _attitude, _position, _parameter, _vision,
    _version_one,
)  # fmt: skip


def datagrams(count: int, sources: tuple[Source, ...], seed: int) -> Iterator[bytes]:
    """That many, the same for the same seed."""
    r = random.Random(seed)
    for sequence in range(count):
        yield r.choice(sources)(r, sequence)
