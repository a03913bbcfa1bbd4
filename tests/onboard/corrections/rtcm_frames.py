"""Frames of RTCM 3, made from the standard's text, for tests: nothing of it comes from a recording.

The observations are of the right form and hold noise: nobody here computes with them.
"""

from __future__ import annotations

import functools
import math
import random
from collections.abc import Iterator

STATION = 1234
ZURICH_DEG = (47.397742, 8.545594)
ZURICH_HEIGHT_M = 536.9  # above the ellipsoid


def crc24q(data: bytes) -> int:
    crc = 0
    for byte in data:
        crc ^= byte << 16
        for _ in range(8):
            crc <<= 1
            if crc & 0x1000000:
                crc ^= 0x1864CFB
    return crc


@functools.cache
def framed(message: bytes) -> bytes:
    head = bytes((0xD3, len(message) >> 8, len(message) & 0xFF))
    return head + message + crc24q(head + message).to_bytes(3, "big")


def _packed(*fields: tuple[int, int]) -> bytes:
    """Numbers and their widths in bits, one behind the other, filled up with zeros."""
    text = "".join(f"{value & ((1 << width) - 1):0{width}b}" for value, width in fields)
    text += "0" * (-len(text) % 8)
    return int(text, 2).to_bytes(len(text) // 8, "big")


def ecef_m(latitude_deg: float, longitude_deg: float, height_m: float) -> tuple[float, ...]:
    semi_major_m = 6_378_137.0
    eccentricity_2 = 0.00669437999014
    latitude = math.radians(latitude_deg)
    longitude = math.radians(longitude_deg)
    normal_m = semi_major_m / math.sqrt(1.0 - eccentricity_2 * math.sin(latitude) ** 2)
    from_axis_m = (normal_m + height_m) * math.cos(latitude)
    return (
        from_axis_m * math.cos(longitude),
        from_axis_m * math.sin(longitude),
        (normal_m * (1.0 - eccentricity_2) + height_m) * math.sin(latitude),
    )


def base_frame(
    place_deg: tuple[float, float] = ZURICH_DEG,
    height_m: float = ZURICH_HEIGHT_M,
    *,
    station: int = STATION,
    east_m: float = 0.0,
    number: int = 1005,
) -> bytes:
    """Message 1005 or 1006 of a base, moved to the east."""
    latitude_deg, longitude_deg = place_deg
    x, y, z = ecef_m(latitude_deg, longitude_deg, height_m)
    longitude = math.radians(longitude_deg)
    x -= east_m * math.sin(longitude)
    y += east_m * math.cos(longitude)
    return ecef_frame((x, y, z), station=station, number=number)


def ecef_frame(
    position_m: tuple[float, ...], *, station: int = STATION, number: int = 1005
) -> bytes:
    x, y, z = (round(value * 1e4) for value in position_m)
    fields = [(number, 12), (station, 12), (0, 6), (1, 1), (1, 1), (1, 1), (0, 1)]
    fields += [(x, 38), (0, 1), (0, 1), (y, 38), (0, 2), (z, 38)]
    if number == 1006:
        fields.append((15000, 16))
    return framed(_packed(*fields))


def observations(
    number: int = 1077,
    *,
    station: int = STATION,
    size: int = 300,
    time_ms: int = 0,
    has_more: bool = False,
    seed: int = 0,
) -> bytes:
    """Observations of one system of satellites: a message of a size, its head as MSM has it."""
    head = _packed((number, 12), (station, 12), (time_ms, 30), (has_more, 1), (0, 1))
    return framed(head + random.Random(seed + time_ms).randbytes(size - len(head)))


def epoch(second: int, *, station: int = STATION, size: int = 300) -> list[bytes]:
    """What a base measures at one second: three systems."""
    time_ms = 1000 * second
    return [
        observations(1077, station=station, size=size, time_ms=time_ms, has_more=True),
        observations(1087, station=station, size=size // 2, time_ms=time_ms, has_more=True),
        observations(1097, station=station, size=size // 3, time_ms=time_ms),
    ]


def recording(seconds: int, *, base_every_s: int = 5) -> bytes:
    """What a base sends for a while."""
    return b"".join(_frames(seconds, base_every_s))


def _frames(seconds: int, base_every_s: int) -> Iterator[bytes]:
    for second in range(seconds):
        if second % base_every_s == 0:
            yield base_frame()
        yield from epoch(second)
