"""The satellite receiver of an emulated PX4, as far as corrections change its fix.

Fragments of GPS_RTCM_DATA are assembled to frames as MAVLink's text says, and a frame whose
checksum is wrong is ignored. With observations of a base that has said where it is, the fix goes
from 3D over RTK float to RTK fixed, and back when they stay away. A receiver places itself by where
the base says it is: a base that says another place moves it.

The times are those of usual receivers under a free sky, made short: nobody wants to wait a minute
for a simulated fix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from sitl.physics.frames import Array

NO_FIX = 0
FIX_3D = 3
RTK_FLOAT = 5
RTK_FIXED = 6

FLOAT_AFTER_S = 3.0  # of corrections
FIXED_AFTER_S = 8.0
FLOAT_WITHOUT_S = 5.0  # without corrections a fixed receiver is a floating one
LOST_WITHOUT_S = 15.0  # and one without RTK
# The accuracy that it tells, horizontally [m]: 3D as SIH tells it.
ACCURACIES_M = {NO_FIX: 0.0, FIX_3D: 0.9, RTK_FLOAT: 0.3, RTK_FIXED: 0.014}

_FRAGMENT_BYTES = 180
_FRAGMENTS = 4
_ASSEMBLY_S = 1.0  # fragments that are further apart are not of one frame
_CRC_POLYNOMIAL = 0x1864CFB
_MOST_FRAME_BYTES = 1029
_BASE_POSITION = (1005, 1006)
_BASE_FRAME_BYTES = 25
_OBSERVATIONS = (range(1001, 1005), range(1009, 1013), range(1071, 1138))


@dataclass(slots=True)
class Assembly:
    """Fragments of the frame that is being assembled."""

    sequence: int = -1
    pieces: dict[int, bytes] = field(default_factory=dict)
    newest_s: float = -math.inf

    def take(self, flags: int, data: bytes, time_s: float) -> bytes | None:
        """Take a fragment; return the frame that is whole with it.

        Args:
            flags: flags of the message.
            data: data of the message.
            time_s: time of its arrival.
        """
        is_cut = bool(flags & 1)
        number = flags >> 1 & 3
        sequence = flags >> 3 & 31
        if not is_cut:
            self.pieces.clear()
            return data

        is_another = sequence != self.sequence or time_s - self.newest_s > _ASSEMBLY_S
        is_in_contradiction = self.pieces.get(number, data) != data
        if is_another or is_in_contradiction:
            self.pieces.clear()
        self.sequence = sequence
        self.newest_s = time_s
        self.pieces[number] = data

        # whole with all four, or with all before the first one that is not full
        frame = b""
        for index in range(_FRAGMENTS):
            piece = self.pieces.get(index)
            if piece is None:
                return None
            frame += piece
            if len(piece) < _FRAGMENT_BYTES:
                break
        self.pieces.clear()
        return frame


class SatelliteReceiver:
    """One vehicle's receiver.

    Attributes:
        is_deaf: it gets no corrections, whatever arrives (a fault).
        is_garbled: what it gets has wrong bits (a fault).
        is_obstructed: it finds no better fix than 3D (a fault).
        frames: whole frames with a right checksum.
        bad_frames: those that were none.
    """

    def __init__(self) -> None:
        self.is_deaf = False
        self.is_garbled = False
        self.is_obstructed = False
        self.frames = 0
        self.bad_frames = 0
        self._assembly = Assembly()
        self._base_m: Array | None = None  # where the base says it is, from the centre of the Earth
        self._first_base_m: Array | None = None
        self._since_s = math.inf  # corrections have come without a gap since then
        self._newest_s = -math.inf  # of observations

    def hear(self, flags: int, data: bytes, time_s: float) -> None:
        """Take a fragment.

        Args:
            flags: flags of GPS_RTCM_DATA.
            data: bytes of the message, as many as its length field says.
            time_s: the time.
        """
        if self.is_deaf:
            return
        if self.is_garbled and data:
            data = bytes((data[0] ^ 0x40, *data[1:]))
        frame = self._assembly.take(flags, data, time_s)
        if frame is None:
            return
        if not _is_right(frame):
            self.bad_frames += 1
            return

        self.frames += 1
        number = frame[3] << 4 | frame[4] >> 4
        if number in _BASE_POSITION and len(frame) >= _BASE_FRAME_BYTES:
            self._hear_base(frame)
        elif self._base_m is not None and any(number in span for span in _OBSERVATIONS):
            self._hear_observations(time_s)

    def _hear_base(self, frame: bytes) -> None:
        bits = int.from_bytes(frame[3:22], "big")  # 152 of them
        axes = [bits >> shift & ((1 << 38) - 1) for shift in (80, 40, 0)]
        signed = [axis - (1 << 38) if axis >> 37 else axis for axis in axes]
        self._base_m = np.array(signed, dtype=np.float64) * 1e-4
        if self._first_base_m is None:
            self._first_base_m = self._base_m

    def _hear_observations(self, time_s: float) -> None:
        gap_s = time_s - self._newest_s
        if gap_s > LOST_WITHOUT_S:
            self._since_s = time_s
        elif gap_s > FLOAT_WITHOUT_S:
            self._since_s = time_s - FLOAT_AFTER_S
        self._newest_s = time_s

    def fix_type(self, time_s: float, *, has_fix: bool) -> int:
        """Return GPS_RAW_INT.fix_type.

        Args:
            time_s: the time.
            has_fix: whether satellites are received at all.
        """
        if not has_fix:
            return NO_FIX
        silent_s = time_s - self._newest_s
        if silent_s > LOST_WITHOUT_S or self.is_obstructed:
            return FIX_3D
        corrected_s = self._newest_s - self._since_s
        if corrected_s < FLOAT_AFTER_S:
            return FIX_3D
        if corrected_s < FIXED_AFTER_S or silent_s > FLOAT_WITHOUT_S:
            return RTK_FLOAT
        return RTK_FIXED

    def shift_m(self, time_s: float) -> float:
        """Return how far the base says it is from where it was at first; 0 without corrections.

        Args:
            time_s: the time.
        """
        if self._base_m is None or time_s - self._newest_s > LOST_WITHOUT_S:
            return 0.0
        assert self._first_base_m is not None
        return float(np.linalg.norm(self._base_m - self._first_base_m))


def _is_right(frame: bytes) -> bool:
    """Whether bytes are one frame with a right checksum."""
    if not 8 <= len(frame) <= _MOST_FRAME_BYTES or frame[0] != 0xD3 or frame[1] & 0xFC:
        return False
    if (frame[1] << 8 | frame[2]) + 6 != len(frame):
        return False
    crc = 0
    for byte in frame:
        crc = (crc << 8 ^ _CRC_TABLE[crc >> 16 ^ byte]) & 0xFFFFFF
    return crc == 0


def _crc_table() -> list[int]:
    table: list[int] = []
    for byte in range(256):
        crc = byte << 16
        for _ in range(8):
            crc <<= 1
            if crc & 0x1000000:
                crc ^= _CRC_POLYNOMIAL
        table.append(crc)
    return table


_CRC_TABLE = _crc_table()
