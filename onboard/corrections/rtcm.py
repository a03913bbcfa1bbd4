"""RTCM 3 frames, as far as somebody who passes them on has to look into them. Pure.

A frame is a preamble (0xD3), six bits that are zero, ten bits of length, the message and a checksum
of three bytes (CRC-24Q). A message begins with its number, 12 bits. Those of a base then have the
number of its station, 12 bits; orbits of satellites have none.

Only three things are read out of a message: its number, its station, and in 1005 and 1006 where the
base is. What the observations mean is the receiver's matter.

The format: RTCM 10403.3.
"""

from __future__ import annotations

import math
from typing import NamedTuple

PREAMBLE = 0xD3
HEADER_BYTES = 3
CHECKSUM_BYTES = 3
MOST_MESSAGE_BYTES = 1023
MOST_FRAME_BYTES = HEADER_BYTES + MOST_MESSAGE_BYTES + CHECKSUM_BYTES

_RESERVED_BITS = 0xFC  # of the second byte; they are zero

# Numbers of the standard's messages for a receiver. Those of makers, from 4001 on, mean something
# to receivers of that maker only, such as the heading of a moving base.
_NUMBERS = range(1001, 1231)
_OBSERVATIONS = (range(1001, 1005), range(1009, 1013), range(1071, 1138))
_WITH_STATION = (range(1001, 1014), range(1033, 1034), range(1071, 1138), range(1230, 1231))
_BASE_POSITION = (1005, 1006)

# Bits of a message: where its parts begin.
_STATION_BIT = 12
_STATION_BYTES = 3  # that a message has at least if it has a station
_AXIS_BITS = (34, 74, 114)  # X, Y and Z of the base
_AXIS_WIDTH = 38
_AXIS_UNIT_M = 1e-4
_BASE_BYTES = 19  # of message 1005

# Whether more observations of the same moment follow: one bit, behind the time.
_GLONASS = (range(1009, 1013),)
_MORE_BIT = 54
_MORE_BIT_GLONASS = 51

# The ellipsoid of WGS 84.
_SEMI_MAJOR_M = 6_378_137.0
_FLATTENING = 1.0 / 298.257223563
_ECCENTRICITY_2 = _FLATTENING * (2.0 - _FLATTENING)
_LEAST_RADIUS_M = 6.2e6  # of a place on Earth, from its centre
_MOST_RADIUS_M = 6.5e6


class BasePosition(NamedTuple):
    """Place of a base's antenna, as the base says it."""

    station: int
    ecef_m: tuple[float, float, float]  # from the centre of the Earth, WGS 84

    @property
    def is_on_earth(self) -> bool:
        """Whether a base can stand there: a base that does not know its place yet says 0, 0, 0."""
        return _LEAST_RADIUS_M < math.hypot(*self.ecef_m) < _MOST_RADIUS_M

    @property
    def latitude_longitude_height(self) -> tuple[float, float, float]:
        """Latitude [deg], longitude [deg], and height above the ellipsoid [m]."""
        x, y, z = self.ecef_m
        from_axis_m = math.hypot(x, y)
        latitude = math.atan2(z, from_axis_m * (1.0 - _ECCENTRICITY_2))
        height_m = 0.0
        for _ in range(5):  # each brings three more digits
            normal_m = _normal_m(latitude)
            height_m = from_axis_m * math.cos(latitude) + z * math.sin(latitude)
            height_m -= _SEMI_MAJOR_M**2 / normal_m
            stretch = 1.0 - _ECCENTRICITY_2 * normal_m / (normal_m + height_m)
            latitude = math.atan2(z, from_axis_m * stretch)
        return math.degrees(latitude), math.degrees(math.atan2(y, x)), height_m


def _normal_m(latitude: float) -> float:
    """Return the ellipsoid's radius of curvature across the meridian [m]."""
    return _SEMI_MAJOR_M / math.sqrt(1.0 - _ECCENTRICITY_2 * math.sin(latitude) ** 2)


def frame_bytes(header: bytes | bytearray) -> int:
    """Return the length that the first three bytes of a frame say; 0 for those of no frame.

    Args:
        header: three bytes or more.
    """
    if header[0] != PREAMBLE or header[1] & _RESERVED_BITS:
        return 0
    message_bytes = (header[1] << 8) | header[2]
    if message_bytes < 2:  # shorter than a number
        return 0
    return HEADER_BYTES + message_bytes + CHECKSUM_BYTES


def is_frame(data: bytes) -> bool:
    """Whether bytes are one whole frame; its checksum is not looked at.

    Args:
        data: any bytes.
    """
    return len(data) > HEADER_BYTES and frame_bytes(data) == len(data)


def number_of(frame: bytes) -> int:
    """Return the number of a frame's message.

    Args:
        frame: a whole one.
    """
    return frame[3] << 4 | frame[4] >> 4


def is_for_receivers(number: int) -> bool:
    """Whether a message is one of the standard's, which every receiver may be given.

    Args:
        number: of the message.
    """
    return number in _NUMBERS


def is_observation(number: int) -> bool:
    """Whether a message is what a base measures at one moment.

    Args:
        number: of the message.
    """
    return _is_in(number, _OBSERVATIONS)


def station_of(frame: bytes) -> int | None:
    """Return the station that a message is of; None for messages without one.

    Args:
        frame: a whole one.
    """
    is_long_enough = len(frame) >= HEADER_BYTES + _STATION_BYTES + CHECKSUM_BYTES
    if not is_long_enough or not _is_in(number_of(frame), _WITH_STATION):
        return None
    return _bits(frame, _STATION_BIT, 12)


def base_of(frame: bytes) -> BasePosition | None:
    """Return where a base is, by a message that says so.

    Args:
        frame: a whole one.
    Returns:
        the position; None for all other messages, and for one that is too short.
    """
    is_long_enough = len(frame) >= HEADER_BYTES + _BASE_BYTES + CHECKSUM_BYTES
    if number_of(frame) not in _BASE_POSITION or not is_long_enough:
        return None

    x, y, z = (_AXIS_UNIT_M * _signed_bits(frame, bit, _AXIS_WIDTH) for bit in _AXIS_BITS)
    return BasePosition(station=_bits(frame, _STATION_BIT, 12), ecef_m=(x, y, z))


def ends_epoch(frame: bytes) -> bool:
    """Whether an observation is the last one of its moment.

    Args:
        frame: a whole one.
    """
    number = number_of(frame)
    if not is_observation(number) or len(frame) < HEADER_BYTES + CHECKSUM_BYTES + 8:
        return False
    more_bit = _MORE_BIT_GLONASS if _is_in(number, _GLONASS) else _MORE_BIT
    return _bits(frame, more_bit, 1) == 0


def _is_in(number: int, spans: tuple[range, ...]) -> bool:
    return any(number in span for span in spans)


def _bits(frame: bytes, first: int, width: int) -> int:
    """Return some bits of a frame's message as a number without a sign."""
    message = frame[HEADER_BYTES:-CHECKSUM_BYTES]
    begin = first // 8
    end = -(-(first + width) // 8)
    value = int.from_bytes(message[begin:end], "big")
    behind = 8 * end - first - width
    return value >> behind & ((1 << width) - 1)


def _signed_bits(frame: bytes, first: int, width: int) -> int:
    """Return some bits of a frame's message as a number with a sign, in two's complement."""
    value = _bits(frame, first, width)
    if value >> (width - 1):
        return value - (1 << width)
    return value
