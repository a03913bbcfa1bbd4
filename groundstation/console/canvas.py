"""A drawing surface of braille dots on numpy: 2 x 4 dots and one colour per terminal cell.

Text is drawn on top of the dots. A cell has only one colour: the colour that was drawn last in it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from rich.cells import cell_len, get_character_cell_size
from rich.segment import Segment
from rich.style import Style
from textual.strip import Strip

from groundstation.console.theme import TEXT, style
from onboard.arrays import Array

# Dots of a cell.
DOTS_ACROSS = 2
DOTS_DOWN = 4

# Bit of each dot within a cell, by row and column, in the order of Unicode's braille block.
_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], np.uint8)
_MAX_STEPS = 4000  # largest number of dots of one line or circle
_SPACE = 0x20
_BRAILLE = 0x2800  # first character of the braille block: no dot
_TAIL = 0x10FFFF  # marks the second cell of a wide character, for which nothing is written
_LARGEST_RADIUS = 1e4  # in dots; larger circles are not drawn
_NO_ROOM = "•"  # stands for a label that has no room
_OF_NUMBERS = frozenset(map(ord, "0123456789.-"))


class Label(NamedTuple):
    """A short text at a point, which means something only as a whole: a vehicle's number."""

    column: int  # cell of the point
    row: int
    text: str
    colour: str
    lead: int = 0  # cells of the text before the point


class Canvas:
    """Dots and text on ``width`` x ``height`` cells.

    Dot coordinates: x right, y down, origin top left.
    """

    def __init__(self, width: int, height: int) -> None:
        self.width = max(1, width)
        self.height = max(1, height)
        shape = (self.height, self.width)
        self.cells = np.zeros(shape, np.uint8)  # the dots of each cell, as bits
        self.styles = np.zeros(shape, np.int32)  # style of each cell, by its :func:`_style_number`
        self._chars = np.zeros(shape, np.uint32)  # code of a character; 0: no text in this cell

    def copy(self) -> Canvas:
        """Return a copy to draw on."""
        twin = Canvas(self.width, self.height)
        twin.cells = self.cells.copy()
        twin.styles = self.styles.copy()
        twin._chars = self._chars.copy()
        return twin

    def dots(self, x: Array, y: Array, colour: str) -> None:
        """Set dots at x, y (n,); the last colour of a cell counts.

        Dots outside the canvas and dots that are not finite are left out.
        """
        with np.errstate(invalid="ignore"):
            # The comparisons are false for NaN.
            is_across = (x >= 0) & (x < DOTS_ACROSS * self.width)
            is_inside = is_across & (y >= 0) & (y < DOTS_DOWN * self.height)
        columns, columns_in_cell = np.divmod(x[is_inside].astype(np.int64), DOTS_ACROSS)
        rows, rows_in_cell = np.divmod(y[is_inside].astype(np.int64), DOTS_DOWN)

        np.bitwise_or.at(self.cells, (rows, columns), _BITS[rows_in_cell, columns_in_cell])
        self.styles[rows, columns] = _style_number(colour)

    def line(
        self, start: tuple[float, float], end: tuple[float, float], colour: str, gap: int = 1
    ) -> None:
        """Draw a straight line of dots; with ``gap`` n only every n-th dot is set."""
        if not np.isfinite([*start, *end]).all():
            return

        start_x, start_y = start
        end_x, end_y = end
        along_x = end_x - start_x
        along_y = end_y - start_y
        steps = int(min(_MAX_STEPS, max(abs(along_x), abs(along_y))))
        shares = np.linspace(0.0, 1.0, steps + 1)[::gap]
        self.dots(start_x + shares * along_x, start_y + shares * along_y, colour)

    def lines(self, starts: Array, ends: Array, colour: str, gap: int = 1) -> None:
        """Draw straight lines of dots from points (n, 2) to points (n, 2), all at once.

        Lines of _MAX_STEPS dots or more are left out. With ``gap`` n only every n-th dot is set.
        """
        along = ends - starts
        lengths = np.abs(along).max(axis=1, initial=0.0)
        is_drawable = lengths < _MAX_STEPS
        if not is_drawable.any():
            return

        steps = int(lengths[is_drawable].max()) + 1  # of the longest line, and used for all
        shares = (np.arange(0, steps + 1, gap) / steps)[:, None]
        # (lines, 1, 2) + (lines, 1, 2) * (steps, 1) gives points (lines, steps, 2).
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

        style_number = _style_number(colour, bold=bold)
        codes = self._chars[row]
        for char in text:
            width = get_character_cell_size(char)
            end = column + width
            if width and column >= 0 and end <= self.width:
                # Blank the other half of a wide character that this one covers partly.
                if codes[column] == _TAIL:
                    codes[column - 1] = _SPACE
                if end < self.width and codes[end] == _TAIL:
                    codes[end] = _SPACE

                codes[column] = ord(char)
                if width == 2:
                    codes[column + 1] = _TAIL
                self.styles[row, column:end] = style_number
            column = end

    def labels(self, labels: Sequence[Label]) -> list[int | None]:
        """Write labels, the most important first; return the column at which each begins.

        A label covers other text, but no label: it is written whole and with a free cell on both
        sides, or not at all. Instead of it there is a dot then, and its column is None. At the edge
        of the canvas it moves inwards. Another number that it touches is removed.
        """
        is_taken = np.zeros((self.height, self.width), bool)
        columns: list[int | None] = []
        for label in labels:
            width = cell_len(label.text)
            column = min(label.column - label.lead, self.width - width)
            column = max(0, column)
            around = slice(max(0, column - 1), column + width + 1)

            is_inside = 0 <= label.row < self.height and 0 <= label.column < self.width
            has_room = is_inside and width <= self.width and not is_taken[label.row, around].any()
            if not has_room:
                columns.append(None)
                continue
            self._remove_numbers(column, label.row, width)
            self.text(column, label.row, label.text, label.colour, bold=True)
            is_taken[label.row, column : column + width] = True
            columns.append(column)

        for label, written in zip(labels, columns, strict=True):
            is_inside = 0 <= label.row < self.height and 0 <= label.column < self.width
            if written is None and is_inside and not is_taken[label.row, label.column]:
                self.text(label.column, label.row, _NO_ROOM, label.colour, bold=True)
        return columns

    def _remove_numbers(self, column: int, row: int, width: int) -> None:
        """Remove numbers that touch some cells of a row, which would go on from text in them."""
        codes = self._chars[row]
        before = column - 1
        while before >= 0 and int(codes[before]) in _OF_NUMBERS:
            codes[before] = 0
            before -= 1

        after = column + width
        while after < self.width and int(codes[after]) in _OF_NUMBERS:
            codes[after] = 0
            after += 1

    def is_free(self, column: int, row: int, width: int) -> bool:
        """Whether text of this width fits here without covering other text."""
        is_inside = 0 <= row < self.height and column >= 0 and column + width <= self.width
        return is_inside and not self._chars[row, column : column + width].any()

    def strips(self) -> list[Strip]:
        """Return the picture, line by line."""
        chars = np.where(self.cells > 0, np.uint32(_BRAILLE) + self.cells, np.uint32(_SPACE))
        chars = np.where(self._chars > 0, self._chars, chars)
        text = chars.astype("<u4").tobytes().decode("utf-32-le")

        # A blank gets the style of the last character before it, so that there are fewer segments.
        columns = np.where(chars == _SPACE, 0, np.arange(self.width))
        source_columns = np.maximum.accumulate(columns, axis=1)
        styles = np.take_along_axis(self.styles, source_columns, axis=1)

        # Each cell whose style differs from that of its left neighbour.
        rows, left_columns = np.nonzero(styles[:, 1:] != styles[:, :-1])
        change_columns = (left_columns + 1).tolist()
        change_styles = styles[rows, left_columns + 1].tolist()
        first_styles = styles[:, 0].tolist()
        # The changes of row i are those from first_changes[i] to first_changes[i + 1].
        first_changes = np.searchsorted(rows, np.arange(self.height + 1)).tolist()

        strips = []
        for row, (begin, end) in enumerate(itertools.pairwise(first_changes)):
            line = text[row * self.width : (row + 1) * self.width]
            edges = [0, *change_columns[begin:end], self.width]
            row_styles = [first_styles[row], *change_styles[begin:end]]

            segments = []
            for (left, right), number in zip(itertools.pairwise(edges), row_styles, strict=True):
                segments.append(Segment(line[left:right], _STYLES[number]))
            strips.append(self._strip(segments, has_wide=chr(_TAIL) in line))
        return strips

    def _strip(self, segments: list[Segment], *, has_wide: bool) -> Strip:
        """Return a line of these segments without the marks of wide characters' second cells."""
        if not has_wide:
            return Strip(segments, self.width)
        whole = [Segment(part.text.replace(chr(_TAIL), ""), part.style) for part in segments]
        return Strip(whole).adjust_cell_length(self.width)


# (colour, whether it is bold) -> index of this style in _STYLES; empty cells have 0
_STYLE_NUMBERS: dict[tuple[str, bool], int] = {(TEXT, False): 0}
_STYLES: list[Style] = [style(TEXT)]


def _style_number(colour: str, *, bold: bool = False) -> int:
    """Return the index in _STYLES of a colour and weight."""
    key = (colour, bold)
    if key not in _STYLE_NUMBERS:
        _STYLE_NUMBERS[key] = len(_STYLES)
        _STYLES.append(style(colour, bold=bold))
    return _STYLE_NUMBERS[key]


@lru_cache(256)
def _unit_circle(count: int) -> tuple[Array, Array]:
    """Return points x, y (count,) of the unit circle."""
    angle = np.linspace(0.0, 2.0 * np.pi, max(4, count), endpoint=False)
    return np.cos(angle), np.sin(angle)
