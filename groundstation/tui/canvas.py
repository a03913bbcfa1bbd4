"""A drawing surface of braille dots on numpy: 2 x 4 dots and one colour per terminal cell, with text on top."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rich.segment import Segment

from groundstation.tui.look import style

FloatArray = NDArray[np.float64]
# Bit of each dot within a cell, by row and column (the Unicode braille block's own order).
_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], np.uint8)
_MAX_STEPS = 4000


class Canvas:
    """Dots and text on ``width`` x ``height`` cells. Dot coordinates: x right, y down, origin top left."""

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = max(1, width), max(1, height)
        self.cells = np.zeros((self.height, self.width), np.uint8)
        self.colours = np.zeros((self.height, self.width), np.int16)
        self._palette: list[str] = ["#000000"]
        self._text: dict[tuple[int, int], tuple[str, str, bool]] = {}

    def dots(self, x: FloatArray, y: FloatArray, colour: str) -> None:
        """Set dots (n,); what lies outside or is not finite is left out. The last colour of a cell wins."""
        fits = np.isfinite(x) & np.isfinite(y)
        fits &= (x >= 0) & (x < 2 * self.width) & (y >= 0) & (y < 4 * self.height)
        columns, rows = x[fits].astype(np.int64), y[fits].astype(np.int64)
        bits = _BITS[rows % 4, columns % 2]
        np.bitwise_or.at(self.cells, (rows // 4, columns // 2), bits)
        self.colours[rows // 4, columns // 2] = self._index(colour)

    def line(self, start: tuple[float, float], end: tuple[float, float], colour: str, gap: int = 1) -> None:
        """A straight line of dots; with ``gap`` n only every n-th dot is set."""
        if not np.isfinite([*start, *end]).all():
            return
        steps = int(min(_MAX_STEPS, max(abs(end[0] - start[0]), abs(end[1] - start[1]))))
        along = np.linspace(0.0, 1.0, steps + 1)[::gap]
        self.dots(start[0] + along * (end[0] - start[0]), start[1] + along * (end[1] - start[1]), colour)

    def circle(self, centre: tuple[float, float], radius: float, colour: str) -> None:
        """A circle of dots, radius in dots."""
        if not np.isfinite([*centre, radius]).all() or not 0.0 < radius < 1e4:
            return
        angle = np.linspace(0.0, 2.0 * np.pi, int(min(_MAX_STEPS, max(12, 5 * radius))), endpoint=False)
        self.dots(centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle), colour)

    def text(self, column: int, row: int, text: str, colour: str, bold: bool = False) -> None:
        """Text from a cell on, one cell per character; what lies outside is left out."""
        for offset, char in enumerate(text):
            if 0 <= column + offset < self.width and 0 <= row < self.height:
                self._text[(row, column + offset)] = (char, colour, bold)

    def segments(self, row: int) -> list[Segment]:
        """One line of the picture."""
        if not 0 <= row < self.height:
            return [Segment(" " * self.width)]
        found: list[Segment] = []
        run, key = "", ("#000000", False)
        for column in range(self.width):
            placed = self._text.get((row, column))
            if placed is not None:
                char, now = placed[0], (placed[1], placed[2])
            else:
                bits = int(self.cells[row, column])
                char = chr(0x2800 + bits) if bits else " "
                now = (self._palette[self.colours[row, column]], False) if bits else key
            if now != key and run:
                found.append(Segment(run, style(key[0], bold=key[1])))
                run = ""
            run, key = run + char, now
        found.append(Segment(run, style(key[0], bold=key[1])))
        return found

    def _index(self, colour: str) -> int:
        if colour not in self._palette:
            self._palette.append(colour)
        return self._palette.index(colour)
