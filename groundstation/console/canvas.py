"""A drawing surface of braille dots on numpy: 2 x 4 dots and one colour per terminal cell, with
text on top.
"""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np
from rich.cells import get_character_cell_size
from rich.segment import Segment
from rich.style import Style
from textual.strip import Strip

from groundstation.console.theme import TEXT, style
from onboard.arrays import Array

# Bit of each dot within a cell, by row and column (the Unicode braille block's own order).
_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], np.uint8)
_MAX_STEPS = 4000
_SPACE, _BRAILLE = 0x20, 0x2800
_TAIL = 0x10FFFF  # second cell of a wide character: taken, and not written


class Canvas:
    """Dots and text on ``width`` x ``height`` cells.

    Dot coordinates: x right, y down, origin top left.
    """

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = max(1, width), max(1, height)
        self.cells = np.zeros((self.height, self.width), np.uint8)
        self.colours = np.zeros((self.height, self.width), np.int32)
        self._chars = np.zeros((self.height, self.width), np.uint32)  # 0: no text here

    def dots(self, x: Array, y: Array, colour: str) -> None:
        """Set dots x, y (n,); dots outside and not finite ones are left out. The last colour of a
        cell wins.
        """
        with np.errstate(invalid="ignore"):
            # false for nan
            fits = (x >= 0) & (x < 2 * self.width) & (y >= 0) & (y < 4 * self.height)
        columns, rows = x[fits].astype(np.int64), y[fits].astype(np.int64)
        np.bitwise_or.at(self.cells, (rows >> 2, columns >> 1), _BITS[rows & 3, columns & 1])
        self.colours[rows >> 2, columns >> 1] = _index(colour, False)

    def line(
        self, start: tuple[float, float], end: tuple[float, float], colour: str, gap: int = 1
    ) -> None:
        """A straight line of dots; with ``gap`` n only every n-th dot is set."""
        if not np.isfinite([*start, *end]).all():
            return
        steps = int(min(_MAX_STEPS, max(abs(end[0] - start[0]), abs(end[1] - start[1]))))
        along = np.linspace(0.0, 1.0, steps + 1)[::gap]
        self.dots(
            start[0] + along * (end[0] - start[0]), start[1] + along * (end[1] - start[1]), colour
        )

    def lines(self, starts: Array, ends: Array, colour: str, gap: int = 1) -> None:
        """Straight lines of dots between points (n, 2) and (n, 2), all in one go."""
        along = ends - starts
        reach = np.abs(along).max(axis=1, initial=0.0)
        fits = reach < _MAX_STEPS
        if fits.any():
            longest = int(reach[fits].max()) + 1
            points = (
                starts[fits, None]
                + along[fits, None] * (np.arange(0, longest + 1, gap) / longest)[:, None]
            )
            self.dots(points[..., 0].ravel(), points[..., 1].ravel(), colour)

    def circles(self, centres: Array, radius: float, colour: str, gap: int = 1) -> None:
        """Circles of dots about centres (n, 2), radius in dots; with ``gap`` n only every n-th dot
        is set.
        """
        if 0.0 < radius < 1e4 and len(centres):
            x, y = _round(max(12, min(_MAX_STEPS, int(8 * radius))) // gap)
            self.dots(
                (centres[:, :1] + radius * x).ravel(), (centres[:, 1:] + radius * y).ravel(), colour
            )

    def copy(self) -> Canvas:
        """Return a copy to draw on."""
        twin = Canvas(self.width, self.height)
        twin.cells, twin.colours, twin._chars = (
            self.cells.copy(),
            self.colours.copy(),
            self._chars.copy(),
        )
        return twin

    def text(self, column: int, row: int, text: str, colour: str, bold: bool = False) -> None:
        """Text from a cell on; wide characters take two cells; text outside is left out."""
        if not 0 <= row < self.height:
            return
        kind = _index(colour, bold)
        line = self._chars[row]
        for char in text:
            width = get_character_cell_size(char)
            if width and column >= 0 and column + width <= self.width:
                if line[column] == _TAIL:  # half of a wide character would be left
                    line[column - 1] = _SPACE
                if column + width < self.width and line[column + width] == _TAIL:
                    line[column + width] = _SPACE
                line[column : column + width] = [ord(char), _TAIL][:width]
                self.colours[row, column : column + width] = kind
            column += width

    def is_free(self, column: int, row: int, width: int) -> bool:
        """Whether text of this width has room here without covering other text or leaving the
        picture.
        """
        is_inside = 0 <= row < self.height and column >= 0 and column + width <= self.width
        return is_inside and not self._chars[row, column : column + width].any()

    def strips(self) -> list[Strip]:
        """Return the picture, line by line."""
        chars = np.where(
            self._chars > 0,
            self._chars,
            np.where(self.cells > 0, np.uint32(_BRAILLE) + self.cells, np.uint32(_SPACE)),
        )
        # A blank takes the colour of its left neighbour: fewer pieces to write.
        is_blank = chars == _SPACE
        columns = np.where(is_blank, 0, np.arange(self.width))
        colours = np.take_along_axis(self.colours, np.maximum.accumulate(columns, axis=1), axis=1)
        # in one go: row by row it costs most of a picture
        rows, breaks = np.nonzero(colours[:, 1:] != colours[:, :-1])
        edges, kinds = (breaks + 1).tolist(), colours[rows, breaks + 1].tolist()
        begins, first_kinds = (
            np.searchsorted(rows, np.arange(self.height + 1)).tolist(),
            colours[:, 0].tolist(),
        )
        lines = chars.astype("<u4").tobytes().decode("utf-32-le")
        strips = []
        for row, (begin, end) in enumerate(itertools.pairwise(begins)):
            line = lines[row * self.width : (row + 1) * self.width]
            ends = [*edges[begin:end], self.width]
            segments = [
                Segment(line[left:right], _STYLES[kind])
                for left, right, kind in zip(
                    [0, *ends[:-1]], ends, [first_kinds[row], *kinds[begin:end]], strict=True
                )
            ]
            strip = Strip(segments, self.width)
            if chr(_TAIL) in line:
                whole = [
                    Segment(part.text.replace(chr(_TAIL), ""), part.style) for part in segments
                ]
                strip = Strip(whole).adjust_cell_length(self.width)
            strips.append(strip)
        return strips


_KINDS: dict[tuple[str, bool], int] = {(TEXT, False): 0}  # also of cells in which nothing was drawn
_STYLES: list[Style] = [style(TEXT)]


def _index(colour: str, bold: bool) -> int:
    """Return a small number for a colour, the same in every picture."""
    kind = _KINDS.get((colour, bold))
    if kind is None:
        kind = _KINDS[(colour, bold)] = len(_STYLES)
        _STYLES.append(style(colour, bold=bold))
    return kind


@lru_cache(256)
def _round(count: int) -> tuple[Array, Array]:
    """Return points x, y (count,) of the unit circle."""
    angle = np.linspace(0.0, 2.0 * np.pi, max(4, count), endpoint=False)
    return np.cos(angle), np.sin(angle)
