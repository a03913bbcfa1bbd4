"""The satellite receiver of an emulated PX4, limited to the effect of corrections on its fix.

Fragments of GPS_RTCM_DATA are assembled to frames as MAVLink's documentation describes. A frame
with a wrong checksum is ignored. With observations of a base whose position was received, the fix
improves from 3D over RTK float to RTK fixed. It degrades when observations stop. The position of a
receiver is relative to the base, so a base that reports a different position shifts it.

The times to a fix are shorter than those of real receivers under an open sky, so that simulated
flights do not have to wait a minute.
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

FLOAT_AFTER_S = 3.0  # time with corrections until RTK float
FIXED_AFTER_S = 8.0  # time with corrections until RTK fixed
FLOAT_WITHOUT_S = 5.0  # time without corrections until a fixed solution becomes a float one
LOST_WITHOUT_S = 15.0  # time without corrections until the fix is 3D
# Reported horizontal accuracy [m]. That of 3D is SIH's.
ACCURACIES_M = {NO_FIX: 0.0, FIX_3D: 0.9, RTK_FLOAT: 0.3, RTK_FIXED: 0.014}

_FRAGMENT_BYTES = 180
_FRAGMENTS = 4
_ASSEMBLY_S = 1.0  # largest time between two fragments of one frame
_CRC_POLYNOMIAL = 0x1864CFB
_MIN_FRAME_BYTES = 8
_MAX_FRAME_BYTES = 1029
_FRAME_OVERHEAD_BYTES = 6  # header and checksum
_PREAMBLE = 0xD3
_BASE_FRAME_BYTES = 25
_COORDINATE_BITS = 38  # size of a coordinate of the base [0.1 mm]
_BASE_RESOLUTION_M = 1e-4
# Numbers of RTCM messages.
_BASE_POSITION = (1005, 1006)
_OBSERVATIONS = (range(1001, 1005), range(1009, 1013), range(1071, 1138))


@dataclass(slots=True)
class Assembly:
    """Fragments of the frame that is being assembled."""

    sequence: int = -1
    pieces: dict[int, bytes] = field(default_factory=dict)  # number of the fragment -> its data
    newest_s: float = -math.inf

    def take(self, flags: int, data: bytes, time_s: float) -> bytes | None:
        """Add a fragment; return the frame if the fragment completes it.

        Args:
            flags: flags of the message.
            data: data of the message.
            time_s: time of its arrival.
        """
        # Bit 0 says whether the frame is cut into fragments. Bits 1 and 2 are the number of the
        # fragment, and bits 3 to 7 the number of the frame.
        is_cut = bool(flags & 1)
        number = flags >> 1 & 3
        sequence = flags >> 3 & 31
        if not is_cut:
            self.pieces.clear()
            return data

        is_another = sequence != self.sequence or time_s - self.newest_s > _ASSEMBLY_S
        # the fragment with this number has already arrived with other data
        is_in_contradiction = self.pieces.get(number, data) != data
        if is_another or is_in_contradiction:
            self.pieces.clear()
        self.sequence = sequence
        self.newest_s = time_s
        self.pieces[number] = data

        # A frame is complete with all four fragments, or with all fragments up to one that is not
        # full.
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
    """Satellite receiver of one vehicle.

    Attributes:
        is_deaf: whether a fault prevents the reception of corrections.
        is_garbled: whether a fault corrupts received corrections.
        is_obstructed: whether a fault prevents a better fix than 3D.
        frames: number of correct frames.
        bad_frames: number of frames with a wrong form or checksum.
    """

    def __init__(self) -> None:
        self.is_deaf = False
        self.is_garbled = False
        self.is_obstructed = False
        self.frames = 0
        self.bad_frames = 0
        self._assembly = Assembly()
        self._base_m: Array | None = None  # position of the base from the centre of the Earth
        self._first_base_m: Array | None = None
        self._corrected_from_s = math.inf  # start of the present corrections without a gap
        self._newest_s = -math.inf  # time of the newest observations

    def hear(self, flags: int, data: bytes, time_s: float) -> None:
        """Receive a fragment.

        Args:
            flags: flags of GPS_RTCM_DATA.
            data: bytes of the message, of the length in its length field.
            time_s: present time.
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
        number = frame[3] << 4 | frame[4] >> 4  # number of the message: 12 bits after the header
        if number in _BASE_POSITION and len(frame) >= _BASE_FRAME_BYTES:
            self._hear_base(frame)
        elif self._base_m is not None and any(number in span for span in _OBSERVATIONS):
            self._hear_observations(time_s)

    def _hear_base(self, frame: bytes) -> None:
        # The 19 bytes after the header end with the coordinates X, Y and Z, each in two's
        # complement. Two other bits precede Y, and two precede Z.
        bits = int.from_bytes(frame[3:22], "big")
        modulus = 1 << _COORDINATE_BITS
        coordinates: list[int] = []
        for shift in (80, 40, 0):
            value = bits >> shift & (modulus - 1)
            if 2 * value >= modulus:  # negative
                value -= modulus
            coordinates.append(value)
        self._base_m = np.array(coordinates, dtype=np.float64) * _BASE_RESOLUTION_M
        if self._first_base_m is None:
            self._first_base_m = self._base_m

    def _hear_observations(self, time_s: float) -> None:
        gap_s = time_s - self._newest_s
        if gap_s > LOST_WITHOUT_S:
            self._corrected_from_s = time_s
        elif gap_s > FLOAT_WITHOUT_S:
            # The receiver keeps RTK float: corrections count as if they had begun just long enough
            # ago for it.
            self._corrected_from_s = time_s - FLOAT_AFTER_S
        self._newest_s = time_s

    def fix_type(self, time_s: float, *, has_fix: bool) -> int:
        """Return GPS_RAW_INT.fix_type.

        Args:
            time_s: present time.
            has_fix: whether satellites are received at all.
        """
        if not has_fix:
            return NO_FIX
        silent_s = time_s - self._newest_s
        if silent_s > LOST_WITHOUT_S or self.is_obstructed:
            return FIX_3D
        corrected_s = self._newest_s - self._corrected_from_s
        if corrected_s < FLOAT_AFTER_S:
            return FIX_3D
        if corrected_s < FIXED_AFTER_S or silent_s > FLOAT_WITHOUT_S:
            return RTK_FLOAT
        return RTK_FIXED

    def shift_m(self, time_s: float) -> float:
        """Return the distance between the present and the first position of the base.

        It is 0 without corrections.

        Args:
            time_s: present time.
        """
        if self._base_m is None or time_s - self._newest_s > LOST_WITHOUT_S:
            return 0.0
        assert self._first_base_m is not None
        return float(np.linalg.norm(self._base_m - self._first_base_m))


def _is_right(frame: bytes) -> bool:
    """Return whether bytes are one frame with a correct checksum."""
    if not _MIN_FRAME_BYTES <= len(frame) <= _MAX_FRAME_BYTES:
        return False
    # preamble, then 6 reserved bits that are 0 and 10 bits of length
    if frame[0] != _PREAMBLE or frame[1] & 0xFC:
        return False
    content_bytes = frame[1] << 8 | frame[2]
    if content_bytes + _FRAME_OVERHEAD_BYTES != len(frame):
        return False
    # CRC-24Q; over a frame with its checksum it is 0
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
