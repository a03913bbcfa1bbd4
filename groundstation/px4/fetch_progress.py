"""How far several transfers are, for a terminal or for a file that somebody reads later."""

from __future__ import annotations

import threading
from typing import TextIO

_STEPS = 10  # of a transfer that is written to a file


class FetchProgress:
    """Shows how far each vehicle's log is.

    A terminal shows one line that is written anew; anything else gets a line at each tenth.

    Args:
        stream: to write to.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._is_terminal = stream.isatty()
        self._percents: dict[str, int] = {}
        self._lock = threading.Lock()
        self._width = 0

    def show(self, vehicle: str, count: int, size: int) -> None:
        """Say how far a vehicle's log is; may be called from several threads.

        Args:
            vehicle: its name.
            count: bytes that have come.
            size: bytes in all.
        """
        percent = 100 * count // max(1, size)
        with self._lock:
            before = self._percents.get(vehicle, -1)
            self._percents[vehicle] = percent
            if self._is_terminal:
                self._write_line()
            elif percent // _STEPS > before // _STEPS or percent < before:
                self._stream.write(f"{vehicle}: {percent} % of {size / 1e6:.2f} MB\n")
                self._stream.flush()

    def end(self) -> None:
        """Leave the line of the terminal."""
        if self._is_terminal and self._percents:
            self._stream.write("\n")
            self._stream.flush()

    def _write_line(self) -> None:
        line = "  ".join(f"{name} {percent} %" for name, percent in self._percents.items())
        self._stream.write("\r" + line.ljust(self._width))
        self._stream.flush()
        self._width = len(line)
