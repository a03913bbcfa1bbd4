"""Reads the parts of RTCM 3 frames that a program needs to pass them on. Pure.

A frame is a preamble (0xD3), six bits that are zero, ten bits of length, the message and a checksum
of three bytes (CRC-24Q). A message begins with its number, 12 bits. In messages about a base, the
number of its station follows, 12 bits. Messages with satellite orbits have no station.

This module reads a message's number, its station, the position of the base (in 1005 and 1006), and
whether more observations of the same moment follow. Only the receiver reads the observations.

The format: RTCM 10403.3.
"""

from __future__ import annotations

import math
from typing import NamedTuple

PREAMBLE = 0xD3
HEADER_BYTES = 3
CHECKSUM_BYTES = 3
MAX_MESSAGE_BYTES = 1023
MAX_FRAME_BYTES = HEADER_BYTES + MAX_MESSAGE_BYTES + CHECKSUM_BYTES

_RESERVED_BITS = 0xFC  # the bits of the second byte that are zero

# Numbers of the messages of the standard. Numbers from 4001 belong to receiver makers, and only
# receivers of the same maker understand them. An example is the heading of a moving base.
_STANDARD_NUMBERS = range(1001, 1231)
_OBSERVATIONS = (range(1001, 1005), range(1009, 1013), range(1071, 1138))
_WITH_STATION = (range(1001, 1014), range(1033, 1034), range(1071, 1138), range(1230, 1231))
_BASE_POSITION = (1005, 1006)

# Positions of parts of a message: first bits, and lengths.
_STATION_BIT = 12
_STATION_WIDTH = 12
_STATION_BYTES = 3  # least length of a message with a station
_AXIS_BITS = (34, 74, 114)  # X, Y and Z of the base
_AXIS_WIDTH = 38  # bits of each
_AXIS_UNIT_M = 1e-4
_BASE_BYTES = 19  # length of message 1005

# The bit after the time of observations says whether more observations of the same moment follow.
# The time field is shorter in these GLONASS messages.
_GLONASS = (range(1009, 1013),)
_MORE_BIT = 54
_MORE_BIT_GLONASS = 51
_OBSERVATION_BYTES = 8  # least length of a message with such a bit

# The ellipsoid of WGS 84.
_SEMI_MAJOR_M = 6_378_137.0
_FLATTENING = 1.0 / 298.257223563
_ECCENTRICITY_2 = _FLATTENING * (2.0 - _FLATTENING)
# All positions on Earth are between these distances from the Earth's centre.
_MIN_RADIUS_M = 6.2e6
_MAX_RADIUS_M = 6.5e6


class BasePosition(NamedTuple):
    """Position of a base's antenna, as the base reports it."""

    station: int
    ecef_m: tuple[float, float, float]  # from the centre of the Earth, WGS 84

    @property
    def is_on_earth(self) -> bool:
        """Whether the position is on Earth; a base that does not know it yet reports 0, 0, 0."""
        return _MIN_RADIUS_M < math.hypot(*self.ecef_m) < _MAX_RADIUS_M

    @property
    def latitude_longitude_height(self) -> tuple[float, float, float]:
        """Latitude [deg], longitude [deg], and height above the ellipsoid [m]."""
        x, y, z = self.ecef_m
        from_axis_m = math.hypot(x, y)
        latitude = math.atan2(z, from_axis_m * (1.0 - _ECCENTRICITY_2))
        height_m = 0.0
        for _ in range(5):  # each iteration adds about three digits
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
    """Return a frame's length from its first three bytes; 0 if they cannot start a frame.

    Args:
        header: three bytes or more.
    """
    preamble, high_byte, low_byte = header[:HEADER_BYTES]
    if preamble != PREAMBLE or high_byte & _RESERVED_BITS:
        return 0
    message_bytes = (high_byte << 8) | low_byte
    if message_bytes < 2:  # shorter than a message number
        return 0
    return HEADER_BYTES + message_bytes + CHECKSUM_BYTES


def is_frame(data: bytes) -> bool:
    """Whether bytes are one whole frame, judged by header and length. The checksum is not checked.

    Args:
        data: any bytes.
    """
    return len(data) > HEADER_BYTES and frame_bytes(data) == len(data)


def number_of(frame: bytes) -> int:
    """Return the number of a frame's message.

    Args:
        frame: whole frame.
    """
    return _bits(frame, 0, 12)


def is_for_receivers(number: int) -> bool:
    """Whether a message belongs to the standard, which every receiver understands.

    Args:
        number: number of the message.
    """
    return number in _STANDARD_NUMBERS


def is_observation(number: int) -> bool:
    """Whether a message contains a base's observations of one moment.

    Args:
        number: number of the message.
    """
    return _is_in(number, _OBSERVATIONS)


def station_of(frame: bytes) -> int | None:
    """Return the number of the station that has sent a message; None if it contains none.

    Args:
        frame: whole frame.
    """
    is_long_enough = len(frame) >= HEADER_BYTES + _STATION_BYTES + CHECKSUM_BYTES
    if not is_long_enough or not _is_in(number_of(frame), _WITH_STATION):
        return None
    return _bits(frame, _STATION_BIT, _STATION_WIDTH)


def base_of(frame: bytes) -> BasePosition | None:
    """Return a base's position from a message that contains it.

    Args:
        frame: whole frame.
    Returns:
        the position; None for all other messages, and for a message that is too short.
    """
    is_long_enough = len(frame) >= HEADER_BYTES + _BASE_BYTES + CHECKSUM_BYTES
    if number_of(frame) not in _BASE_POSITION or not is_long_enough:
        return None

    x, y, z = (_AXIS_UNIT_M * _signed_bits(frame, bit, _AXIS_WIDTH) for bit in _AXIS_BITS)
    return BasePosition(station=_bits(frame, _STATION_BIT, _STATION_WIDTH), ecef_m=(x, y, z))


def ends_epoch(frame: bytes) -> bool:
    """Whether a message has the last observations of its moment.

    Args:
        frame: whole frame.
    """
    number = number_of(frame)
    is_long_enough = len(frame) >= HEADER_BYTES + _OBSERVATION_BYTES + CHECKSUM_BYTES
    if not is_observation(number) or not is_long_enough:
        return False
    more_bit = _MORE_BIT
    if _is_in(number, _GLONASS):
        more_bit = _MORE_BIT_GLONASS
    return _bits(frame, more_bit, 1) == 0


def _is_in(number: int, spans: tuple[range, ...]) -> bool:
    return any(number in span for span in spans)


def _bits(frame: bytes, first: int, width: int) -> int:
    """Return ``width`` bits of a frame's message, from bit ``first``, as an unsigned number."""
    message = frame[HEADER_BYTES:-CHECKSUM_BYTES]
    begin = first // 8
    end = (first + width + 7) // 8  # rounded up to whole bytes
    value = int.from_bytes(message[begin:end], "big")
    bits_after = 8 * end - first - width
    return (value >> bits_after) & ((1 << width) - 1)


def _signed_bits(frame: bytes, first: int, width: int) -> int:
    """Return bits of a frame's message as a signed number in two's complement."""
    value = _bits(frame, first, width)
    if value >> (width - 1):
        return value - (1 << width)
    return value
