"""A widget that is a list of lines: only the lines that changed are drawn again."""

from __future__ import annotations

from textual.geometry import Region, Size
from textual.strip import Strip
from textual.widget import Widget


class Lines(Widget):
    """Draws what :meth:`draw` gives, and asks the screen for the changed lines only."""

    _lines: list[Strip]
    _drawn: Size | None = None

    def draw(self, width: int, height: int) -> list[Strip]:
        """The lines of a picture of this size, each ``width`` cells long; fewer lines leave the rest empty."""
        raise NotImplementedError

    def redraw(self) -> None:
        """Draw now; what looks as before costs the terminal nothing."""
        size = self.size
        if not size.width or not size.height or not self.is_mounted:
            return
        before = self._lines if self._drawn == size else []
        self._lines, self._drawn = self.draw(size.width, size.height), size
        if not before:
            self.refresh()
            return
        changed = [y for y in range(size.height) if _line(before, y) != _line(self._lines, y)]
        regions: list[Region] = []
        for y in changed:
            if regions and regions[-1].bottom == y:
                regions[-1] = Region(0, regions[-1].y, size.width, regions[-1].height + 1)
            else:
                regions.append(Region(0, y, size.width, 1))
        if regions:
            self.refresh(*regions)

    def render_line(self, y: int) -> Strip:
        """One line, ``y`` counted from the top of what is seen."""
        if self._drawn != self.size:
            self._lines, self._drawn = self.draw(*self.size), self.size
        return _line(self._lines, y) or Strip.blank(self.size.width)


def _line(lines: list[Strip], y: int) -> Strip | None:
    return lines[y] if 0 <= y < len(lines) else None
