"""A drawing surface of braille dots on numpy: 2 x 4 dots and one colour per terminal cell.

Text is drawn on top of the dots. A cell has only one colour: the colour that was drawn last in it.
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

# Dots of a cell.
DOTS_ACROSS = 2
DOTS_DOWN = 4

# Bit of each dot within a cell, by row and column (the Unicode braille block's own order).
_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], np.uint8)
_MAX_STEPS = 4000  # dots of one line or circle
_SPACE = 0x20
_BRAILLE = 0x2800
_TAIL = 0x10FFFF  # marks the second cell of a wide character, for which nothing is written
_LARGEST_RADIUS = 1e4  # larger circles are not drawn


class Canvas:
    """Dots and text on ``width`` x ``height`` cells.

    Dot coordinates: x right, y down, origin top left.
    """

    def __init__(self, width: int, height: int) -> None:
        self.width = max(1, width)
        self.height = max(1, height)
        shape = (self.height, self.width)
        self.cells = np.zeros(shape, np.uint8)  # the dots of each cell, as bits
        self.colours = np.zeros(shape, np.int32)  # numbers of :func:`_index`
        self._chars = np.zeros(shape, np.uint32)  # code of a character; 0: no text in this cell

    def copy(self) -> Canvas:
        """Return a copy to draw on."""
        twin = Canvas(self.width, self.height)
        twin.cells = self.cells.copy()
        twin.colours = self.colours.copy()
        twin._chars = self._chars.copy()
        return twin

    def dots(self, x: Array, y: Array, colour: str) -> None:
        """Set dots at x, y (n,); the last colour of a cell counts.

        Dots outside the canvas and dots that are not finite are left out.
        """
        with np.errstate(invalid="ignore"):
            # The comparisons are false for NaN.
            is_inside = (x >= 0) & (x < 2 * self.width) & (y >= 0) & (y < 4 * self.height)
        dot_columns = x[is_inside].astype(np.int64)
        dot_rows = y[is_inside].astype(np.int64)

        cells = (dot_rows >> 2, dot_columns >> 1)
        np.bitwise_or.at(self.cells, cells, _BITS[dot_rows & 3, dot_columns & 1])
        self.colours[cells] = _index(colour, False)

    def line(
        self, start: tuple[float, float], end: tuple[float, float], colour: str, gap: int = 1
    ) -> None:
        """Draw a straight line of dots; with ``gap`` n only every n-th dot is set."""
        if not np.isfinite([*start, *end]).all():
            return

        along_x = end[0] - start[0]
        along_y = end[1] - start[1]
        steps = int(min(_MAX_STEPS, max(abs(along_x), abs(along_y))))
        shares = np.linspace(0.0, 1.0, steps + 1)[::gap]
        self.dots(start[0] + shares * along_x, start[1] + shares * along_y, colour)

    def lines(self, starts: Array, ends: Array, colour: str, gap: int = 1) -> None:
        """Draw straight lines of dots from points (n, 2) to points (n, 2), all at once."""
        along = ends - starts
        lengths = np.abs(along).max(axis=1, initial=0.0)
        is_drawable = lengths < _MAX_STEPS
        if not is_drawable.any():
            return

        longest = int(lengths[is_drawable].max()) + 1
        shares = (np.arange(0, longest + 1, gap) / longest)[:, None]
        points = starts[is_drawable, None] + along[is_drawable, None] * shares
        self.dots(points[..., 0].ravel(), points[..., 1].ravel(), colour)

    def circles(self, centres: Array, radius: float, colour: str, gap: int = 1) -> None:
        """Draw circles of dots around centres (n, 2); the radius is in dots.

        With ``gap`` n only every n-th dot is set.
        """
        if not 0.0 < radius < _LARGEST_RADIUS or not len(centres):
            return

        dot_count = max(12, min(_MAX_STEPS, int(8 * radius)))
        unit_x, unit_y = _unit_circle(dot_count // gap)
        x = centres[:, :1] + radius * unit_x
        y = centres[:, 1:] + radius * unit_y
        self.dots(x.ravel(), y.ravel(), colour)

    def text(self, column: int, row: int, text: str, colour: str, bold: bool = False) -> None:
        """Write text from a cell on.

        Wide characters take two cells. Characters outside the canvas are left out.
        """
        if not 0 <= row < self.height:
            return

        kind = _index(colour, bold)
        line = self._chars[row]
        for char in text:
            width = get_character_cell_size(char)
            if width and column >= 0 and column + width <= self.width:
                # Blank the other half of a wide character that this one covers partly.
                if line[column] == _TAIL:
                    line[column - 1] = _SPACE
                if column + width < self.width and line[column + width] == _TAIL:
                    line[column + width] = _SPACE

                line[column : column + width] = [ord(char), _TAIL][:width]
                self.colours[row, column : column + width] = kind
            column += width

    def is_free(self, column: int, row: int, width: int) -> bool:
        """Whether text of this width fits here without covering other text."""
        is_inside = 0 <= row < self.height and column >= 0 and column + width <= self.width
        return is_inside and not self._chars[row, column : column + width].any()

    def strips(self) -> list[Strip]:
        """Return the picture, line by line."""
        chars = np.where(self.cells > 0, np.uint32(_BRAILLE) + self.cells, np.uint32(_SPACE))
        chars = np.where(self._chars > 0, self._chars, chars)
        text = chars.astype("<u4").tobytes().decode("utf-32-le")

        # A blank gets the colour of its left neighbour, so that there are fewer segments.
        columns = np.where(chars == _SPACE, 0, np.arange(self.width))
        colours = np.take_along_axis(self.colours, np.maximum.accumulate(columns, axis=1), axis=1)

        # The columns at which a new colour begins, for all rows at once. Row by row, this would
        # take most of the time of a picture.
        rows, breaks = np.nonzero(colours[:, 1:] != colours[:, :-1])
        starts = (breaks + 1).tolist()
        kinds = colours[rows, breaks + 1].tolist()
        first_kinds = colours[:, 0].tolist()
        row_begins = np.searchsorted(rows, np.arange(self.height + 1)).tolist()

        strips = []
        for row, (begin, end) in enumerate(itertools.pairwise(row_begins)):
            line = text[row * self.width : (row + 1) * self.width]
            edges = [0, *starts[begin:end], self.width]
            pieces = zip(
                itertools.pairwise(edges), [first_kinds[row], *kinds[begin:end]], strict=True
            )
            segments = [Segment(line[left:right], _STYLES[kind]) for (left, right), kind in pieces]
            strips.append(self._strip(segments, has_wide=chr(_TAIL) in line))
        return strips

    def _strip(self, segments: list[Segment], *, has_wide: bool) -> Strip:
        """Return a line of these segments without the marks of wide characters' second cells."""
        if not has_wide:
            return Strip(segments, self.width)
        whole = [Segment(part.text.replace(chr(_TAIL), ""), part.style) for part in segments]
        return Strip(whole).adjust_cell_length(self.width)


# Number of each colour and weight; empty cells have 0.
_KINDS: dict[tuple[str, bool], int] = {(TEXT, False): 0}
_STYLES: list[Style] = [style(TEXT)]


def _index(colour: str, bold: bool) -> int:
    """Return the number of a colour and weight, which is the same in every picture."""
    key = (colour, bold)
    if key not in _KINDS:
        _KINDS[key] = len(_STYLES)
        _STYLES.append(style(colour, bold=bold))
    return _KINDS[key]


@lru_cache(256)
def _unit_circle(count: int) -> tuple[Array, Array]:
    """Return points x, y (count,) of the unit circle."""
    angle = np.linspace(0.0, 2.0 * np.pi, max(4, count), endpoint=False)
    return np.cos(angle), np.sin(angle)
