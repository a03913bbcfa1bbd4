"""Extracts RTCM 3 frames from a stream of bytes; the only file of the project that imports pyrtcm.

Pyrtcm calculates the checksum. Its stream reader is not used, because a preamble in noise, or a
lost byte on a cable, would make it skip a kilobyte of good frames. Here, after a candidate with a
wrong checksum, the search continues one byte after its preamble.

Each false preamble costs a checksum, and an attacker could send only preambles. So the number of
bytes for which checksums are calculated is limited to a few for each byte that arrives. Beyond this
limit the search skips whole candidates.
"""

from __future__ import annotations

from pyrtcm import calc_crc24q

from onboard.corrections import rtcm

_CHECKS_PER_BYTE = 4  # for each byte that arrives, this many bytes may go into checksums
_FIRST_BUDGET_BYTES = 4 * rtcm.MAX_FRAME_BYTES  # budget of such bytes at the start of a stream
_LARGEST_BUDGET_BYTES = 8 * rtcm.MAX_FRAME_BYTES  # a stream of good frames saves at most this
_PREAMBLE = bytes((rtcm.PREAMBLE,))


def checksum(data: bytes) -> bytes:
    """Return the checksum of a frame, three bytes.

    Args:
        data: the frame without its checksum: preamble, length and message.
    """
    return int(calc_crc24q(data)).to_bytes(3, "big")


class FrameCutter:
    """Cuts one stream of bytes into frames; pass all of its bytes to :meth:`feed`."""

    def __init__(self) -> None:
        self.bad_checksums = 0
        self.skipped_bytes = 0  # bytes that were not part of any frame
        self._buffer = bytearray()
        self._budget_bytes = _FIRST_BUDGET_BYTES  # bytes that may still go into checksums

    def feed(self, data: bytes) -> list[bytes]:
        """Return the frames that these bytes complete.

        Args:
            data: the next bytes of the stream, any number of them.
        """
        buffer = self._buffer
        buffer += data
        self._budget_bytes += _CHECKS_PER_BYTE * len(data)

        # Each round looks at the next preamble. The loop ends when the buffer has none, or holds
        # only the start of a frame.
        frames: list[bytes] = []
        while True:
            begin = buffer.find(_PREAMBLE)
            if begin < 0:
                self._skip(len(buffer))
                break
            self._skip(begin)
            if len(buffer) < rtcm.HEADER_BYTES:
                break

            size = rtcm.frame_bytes(buffer)
            if size == 0:
                self._skip(1)
                continue
            if len(buffer) < size:
                break

            frame = bytes(buffer[:size])
            self._budget_bytes -= size
            if calc_crc24q(frame) == 0:
                frames.append(frame)
                del buffer[:size]
                continue

            self.bad_checksums += 1
            if self._budget_bytes > 0:
                self._skip(1)
            else:
                self._skip(size)

        self._budget_bytes = min(self._budget_bytes, _LARGEST_BUDGET_BYTES)
        return frames

    def _skip(self, count: int) -> None:
        """Remove bytes that belong to no frame from the buffer."""
        self.skipped_bytes += count
        del self._buffer[:count]
