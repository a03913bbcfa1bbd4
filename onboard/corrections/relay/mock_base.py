"""A made-up base, to try everything without a receiver: source "mock". Pure.

It reports a position. Its observations have the right form (MSM7 of GPS and GLONASS), but all
measurements in them are zero, so a real receiver cannot use them.
"""

from __future__ import annotations

import math

from onboard.config.fleet_config import FleetConfig
from onboard.corrections.relay.framing import checksum

STATION = 1
BASE_EVERY_S = 2  # time from one report of its position to the next
_SIMULATED_DEG = (47.397742, 8.545594)  # default position of simulated PX4s
_HEIGHT_M = 536.9  # height of that position above the ellipsoid

# (number of the message, number of satellites) of each system. The last message of each moment says
# that no other follows.
_SYSTEMS = ((1077, 10), (1087, 6))
_SIGNALS = 2  # of each satellite
_SATELLITE_BITS = 36  # for each satellite in a message MSM7
_CELL_BITS = 80  # for each signal of each satellite

_SEMI_MAJOR_M = 6_378_137.0
_FLATTENING = 1.0 / 298.257223563
_DAY_MS = 86_400_000

_Field = tuple[int, int]  # value, width in bits


class MockBase:
    """A base at a position on Earth.

    Args:
        position_deg: latitude and longitude.
        height_m: height above the ellipsoid.
    """

    def __init__(self, position_deg: tuple[float, float], height_m: float = _HEIGHT_M) -> None:
        self.ecef_m = _ecef_m(position_deg, height_m)
        self.position_deg = position_deg

    def moved(self, east_m: float) -> MockBase:
        """Return a base that reports a position to the east of this one.

        Args:
            east_m: distance of the two positions.
        """
        _, longitude_deg = self.position_deg
        longitude = math.radians(longitude_deg)
        other = MockBase(self.position_deg)
        x, y, z = self.ecef_m
        other.ecef_m = (x - east_m * math.sin(longitude), y + east_m * math.cos(longitude), z)
        return other

    def frames(self, second: int) -> list[bytes]:
        """Return the frames that the base sends in one second.

        Args:
            second: number of the second since the base's start.
        """
        frames: list[bytes] = []
        if second % BASE_EVERY_S == 0:
            frames.append(self._position())
        last_number, _ = _SYSTEMS[-1]
        for number, satellites in _SYSTEMS:
            has_more = number != last_number
            frames.append(_observations(number, satellites, second, has_more=has_more))
        return frames

    def _position(self) -> bytes:
        """Return a frame with message 1005, the base's position."""
        x, y, z = (round(value * 1e4) for value in self.ecef_m)  # in units of 0.1 mm
        # (0, 6): the realisation of the Earth's frame is not given. The four single bits: GPS,
        # GLONASS, no Galileo, a real station. The two bits before y and z describe the receiver and
        # its phases.
        head: list[_Field] = [(1005, 12), (STATION, 12), (0, 6), (1, 1), (1, 1), (0, 1), (0, 1)]
        return _frame([*head, (x, 38), (0, 2), (y, 38), (0, 2), (z, 38)])


def mock_base_of(fleet: FleetConfig) -> MockBase:
    """Return a base at the first known position: surveyed base, fleet's origin, simulated PX4s.

    Args:
        fleet: the fleet file.
    """
    corrections = fleet.corrections
    if corrections is not None and corrections.base_deg is not None:
        height_m = _HEIGHT_M
        if corrections.base_height_m is not None:
            height_m = corrections.base_height_m
        return MockBase(corrections.base_deg, height_m)

    origin = fleet.fleet.global_origin
    if origin is not None:
        return MockBase((origin.latitude_deg, origin.longitude_deg))
    return MockBase(_SIMULATED_DEG)


def _observations(number: int, satellites: int, second: int, *, has_more: bool) -> bytes:
    """Return a frame with one message MSM7 whose measurements are all zero."""
    satellite_mask = ((1 << satellites) - 1) << (64 - satellites)
    signal_mask = ((1 << _SIGNALS) - 1) << (32 - _SIGNALS)
    cells = satellites * _SIGNALS
    time_ms = 1000 * second % _DAY_MS

    # (0, 18): the issue of the data, the state of the receiver's clock and the smoothing are not
    # given
    head: list[_Field] = [(number, 12), (STATION, 12), (time_ms, 30), (has_more, 1), (0, 18)]
    masks: list[_Field] = [(satellite_mask, 64), (signal_mask, 32), ((1 << cells) - 1, cells)]
    zeros = satellites * _SATELLITE_BITS + cells * _CELL_BITS
    return _frame([*head, *masks, (0, zeros)])


def _frame(fields: list[_Field]) -> bytes:
    """Return the frame of a message that consists of these fields."""
    value = 0
    bits = 0
    for field, width in fields:
        value = (value << width) | (field & ((1 << width) - 1))
        bits += width
    padding = -bits % 8  # to whole bytes
    message = (value << padding).to_bytes((bits + padding) // 8, "big")

    head_and_message = b"\xd3" + len(message).to_bytes(2, "big") + message
    return head_and_message + checksum(head_and_message)


def _ecef_m(position_deg: tuple[float, float], height_m: float) -> tuple[float, float, float]:
    """Return a position as coordinates from the centre of the Earth, WGS 84."""
    latitude, longitude = map(math.radians, position_deg)
    eccentricity_2 = _FLATTENING * (2.0 - _FLATTENING)
    normal_m = _SEMI_MAJOR_M / math.sqrt(1.0 - eccentricity_2 * math.sin(latitude) ** 2)
    from_axis_m = (normal_m + height_m) * math.cos(latitude)
    return (
        from_axis_m * math.cos(longitude),
        from_axis_m * math.sin(longitude),
        (normal_m * (1.0 - eccentricity_2) + height_m) * math.sin(latitude),
    )
