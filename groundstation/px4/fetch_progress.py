"""The progress of several transfers, shown on a terminal or written as lines to a file."""

from __future__ import annotations

import threading
from typing import TextIO

_STEP_PERCENT = 10  # progress between two lines in a file


class FetchProgress:
    """Shows the progress of each vehicle's log.

    A terminal shows one line that is overwritten; any other stream gets a line at each tenth.

    Args:
        stream: the stream to which it writes.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._is_terminal = stream.isatty()
        self._percents: dict[str, int] = {}
        self._lock = threading.Lock()
        self._width = 0

    def show(self, vehicle: str, count: int, size: int) -> None:
        """Show the progress of a vehicle's log; several threads may call this.

        Args:
            vehicle: name of the vehicle.
            count: number of bytes received so far.
            size: number of bytes of the log.
        """
        percent = 100 * count // max(1, size)
        with self._lock:
            before = self._percents.get(vehicle, -1)
            self._percents[vehicle] = percent
            if self._is_terminal:
                self._write_line()
            # a smaller number than before: the next log of this vehicle has begun
            elif percent // _STEP_PERCENT > before // _STEP_PERCENT or percent < before:
                self._stream.write(f"{vehicle}: {percent} % of {size / 1e6:.2f} MB\n")
                self._stream.flush()

    def end(self) -> None:
        """End the line on the terminal."""
        if self._is_terminal and self._percents:
            self._stream.write("\n")
            self._stream.flush()

    def _write_line(self) -> None:
        line = "  ".join(f"{name} {percent} %" for name, percent in self._percents.items())
        self._stream.write("\r" + line.ljust(self._width))
        self._stream.flush()
        self._width = len(line)
