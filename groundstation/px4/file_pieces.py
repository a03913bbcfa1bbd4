"""A file whose pieces arrive in any order, twice, or not at all. Pure.

Only what is whole from the first byte on is given back, to be written: so a file on disk never has
a hole, however its transfer ends. Pieces from behind a hole wait in memory until it is filled.
"""

from __future__ import annotations

import heapq

_MOST_WAITING_BYTES = 4_000_000


class Pieces:
    """The parts of one file.

    Args:
        size: of the whole file.
        count: bytes from the first one on that are there already.
    """

    def __init__(self, size: int, count: int = 0) -> None:
        self.size = size
        self.count = count  # bytes from the first one on
        self._waiting: list[tuple[int, bytes]] = []  # offset and data, the first on top
        self._waiting_bytes = 0

    @property
    def is_whole(self) -> bool:
        """Whether nothing is missing."""
        return self.count >= self.size

    @property
    def is_full(self) -> bool:
        """Whether so much waits that nothing more is taken from behind a hole."""
        return self._waiting_bytes >= _MOST_WAITING_BYTES

    @property
    def gap(self) -> tuple[int, int]:
        """Offset of the first missing byte, and where the missing part ends."""
        if self._waiting:
            return self.count, min(self.size, self._waiting[0][0])
        return self.count, self.size

    def add(self, offset: int, data: bytes) -> bytes:
        """Take in a piece.

        Args:
            offset: in the file.
            data: of the piece.

        Returns:
            What follows the bytes that were given back before; empty while those are missing.
        """
        data = data[: max(0, self.size - offset)]
        if offset > self.count:
            if data and not self.is_full:
                heapq.heappush(self._waiting, (offset, data))
                self._waiting_bytes += len(data)
            return b""

        following = [self._cut(offset, data)]
        while self._waiting and self._waiting[0][0] <= self.count:
            waiting_offset, waiting = heapq.heappop(self._waiting)
            self._waiting_bytes -= len(waiting)
            following.append(self._cut(waiting_offset, waiting))
        return b"".join(following)

    def _cut(self, offset: int, data: bytes) -> bytes:
        """Return the part of a piece that is new, and count it."""
        new = data[self.count - offset :]
        self.count += len(new)
        return new
