"""Assembles a file from pieces that arrive in any order, twice, or not at all. Pure.

Bytes are handed out, to be written, only when all bytes before them have arrived. So a file on disk
never has a hole, however its transfer ends. Pieces behind a hole wait in memory until it is filled.
"""

from __future__ import annotations

import heapq

_MAX_WAITING_BYTES = 4_000_000


class Pieces:
    """The parts of one file.

    Args:
        size: size of the whole file [byte].
        count: number of bytes at the start of the file that are on the disk already.
    """

    def __init__(self, size: int, count: int = 0) -> None:
        self.size = size
        self.bytes_in_order = count  # from the start of the file to the first hole
        self._waiting: list[tuple[int, bytes]] = []  # heap of pieces behind a hole: offset, data
        self._waiting_bytes = 0

    @property
    def is_whole(self) -> bool:
        """Whether no byte is missing."""
        return self.bytes_in_order >= self.size

    @property
    def drops_more(self) -> bool:
        """Whether too many bytes wait; further pieces behind a hole are then dropped."""
        return self._waiting_bytes >= _MAX_WAITING_BYTES

    @property
    def gap(self) -> tuple[int, int]:
        """Offset of the first missing byte, and offset at which the missing part ends."""
        end = self.size
        if self._waiting:
            first_offset, _ = self._waiting[0]
            end = min(end, first_offset)
        return self.bytes_in_order, end

    def add(self, offset: int, data: bytes) -> bytes:
        """Add a piece.

        Args:
            offset: offset of the piece in the file.
            data: bytes of the piece.

        Returns:
            The bytes that follow those returned before; empty while there is a hole.
        """
        inside = data[: max(0, self.size - offset)]  # the bytes before the end of the file
        if offset > self.bytes_in_order:
            if inside and not self.drops_more:
                heapq.heappush(self._waiting, (offset, inside))
                self._waiting_bytes += len(inside)
            return b""

        following = [self._cut(offset, inside)]
        while self._waiting and self._waiting[0][0] <= self.bytes_in_order:
            waiting_offset, waiting = heapq.heappop(self._waiting)
            self._waiting_bytes -= len(waiting)
            following.append(self._cut(waiting_offset, waiting))
        return b"".join(following)

    def _cut(self, offset: int, data: bytes) -> bytes:
        """Return the part of a piece that is new, and count it."""
        new = data[self.bytes_in_order - offset :]
        self.bytes_in_order += len(new)
        return new
