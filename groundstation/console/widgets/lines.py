"""A widget that is a list of lines; only lines that have changed are drawn again."""

from __future__ import annotations

from typing import ClassVar

from rich.segment import Segment
from rich.style import Style
from textual.binding import Binding, BindingType
from textual.geometry import Region, Size
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget

_PACE_NS = 150_000_000  # shortest time between two pictures, since faster changes are not readable


class Lines(Widget):
    """Draws the lines that :meth:`draw` returns; only changed lines are sent to the terminal."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("z", "alone", "this alone", show=False),
        Binding("escape", "together", "all panels", show=False),
    ]

    _lines: list[Strip]  # as drawn, without the widget's background
    _drawn_size: Size | None = None
    _shown: tuple[int, object] = (0, None)  # time of the last picture, and the urgent values in it
    _styles: dict[Style | None, Style]  # style -> the same on the widget's background
    _background: Style | None = None  # kept, because it takes too long to look up for every line

    def draw(self, width: int, height: int) -> list[Strip]:
        """Return the lines of a picture of this size, each ``width`` cells wide.

        Missing lines stay empty.
        """
        raise NotImplementedError

    def is_due(self, now_ns: int, urgent: object) -> bool:
        """Whether to draw again: at most every _PACE_NS, but at once if ``urgent`` has changed."""
        last_ns, last_urgent = self._shown
        is_early = 0 < now_ns - last_ns < _PACE_NS
        if is_early and urgent == last_urgent:
            return False
        self._shown = now_ns, urgent
        return True

    class Alone(Message):
        """Request that a panel gets all the room; `name` is its id, or "" for none."""

        def __init__(self, name: str) -> None:
            super().__init__()
            self.name = name

    def action_alone(self) -> None:
        """Give this panel all the room, or share the room again."""
        own_class = f"only-{self.id}"
        is_alone = self.screen.has_class(own_class)

        enlarged = [name for name in self.screen.classes if name.startswith("only-")]
        self.screen.remove_class(*enlarged)
        self.screen.set_class(not is_alone, own_class)
        self.post_message(self.Alone("" if is_alone else str(self.id)))

    async def action_together(self) -> None:
        """Show all panels again; if they are all shown, go back to the fleet."""
        if self.screen.has_class(f"only-{self.id}"):
            self.action_alone()
        else:
            await self.app.run_action("back")

    def redraw(self) -> None:
        """Draw now; unchanged lines are not sent to the terminal."""
        size = self.size
        if not size.width or not size.height or not self.is_mounted:
            return

        before: list[Strip] = []
        if self._drawn_size == size:
            before = self._lines
        self._lines = self.draw(size.width, size.height)
        self._drawn_size = size
        if not before:
            self.refresh()
            return

        changed = [y for y in range(size.height) if _line(before, y) != _line(self._lines, y)]
        regions = self._whole_lines(changed)
        if regions:
            self.refresh(*regions)

    def _whole_lines(self, rows: list[int]) -> list[Region]:
        """Return the regions of these rows; adjacent rows share one region.

        A region is as wide as the widget with its border. A narrower region would be cut out line
        by line, which takes longer.
        """
        left = -self.gutter.left
        width = self.size.width + self.gutter.width

        regions: list[Region] = []
        for y in rows:
            if regions and regions[-1].bottom == y:
                above = regions[-1]
                regions[-1] = Region(left, above.y, width, above.height + 1)
            else:
                regions.append(Region(left, y, width, 1))
        return regions

    def render_line(self, y: int) -> Strip:
        """Return one line; ``y`` is counted from the top of the window."""
        if self._drawn_size != self.size:
            self._lines = self.draw(*self.size)
            self._drawn_size = self.size
        if self._background is None:
            self._background = self.rich_style
            self._styles = {}

        line = _line(self._lines, y)
        if line is None:
            return Strip.blank(self.size.width, self._background)
        segments = [Segment(text, self._on_background(style)) for text, style, _ in line]
        return Strip(segments, line.cell_length)

    def forget_picture(self) -> None:
        """Draw all lines again at the next refresh."""
        self._drawn_size = None
        self.refresh()

    def _on_background(self, style: Style | None) -> Style:
        """Return a style on this widget's background.

        The result is kept, because adding styles takes most of the time of a line.
        """
        if style not in self._styles:
            self._styles[style] = (self._background or Style.null()) + style
        return self._styles[style]

    def notify_style_update(self) -> None:
        """Forget the background, so that it is looked up again."""
        self._background = None
        super().notify_style_update()


def _line(lines: list[Strip], y: int) -> Strip | None:
    if 0 <= y < len(lines):
        return lines[y]
    return None
