"""A widget that is a list of lines: only the lines that changed are drawn again."""

from __future__ import annotations

from typing import ClassVar

from rich.segment import Segment
from rich.style import Style
from textual.binding import Binding, BindingType
from textual.geometry import Region, Size
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget

_PACE_NS = 150_000_000  # of pictures, in which nothing is read that moves faster


class Lines(Widget):
    """Draws what :meth:`draw` gives, and asks the screen for the changed lines only."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("z", "alone", "this alone", show=False),
        Binding("escape", "together", "all panels", show=False),
    ]

    _lines: list[Strip]  # as drawn, without the widget's ground
    _drawn: Size | None = None
    _shown: tuple[int, object] = (0, None)
    _on_ground: dict[Style | None, Style]
    _ground: Style | None = None  # the widget's own colours, which cost too much to look up for every line

    def draw(self, width: int, height: int) -> list[Strip]:
        """The lines of a picture of this size, each ``width`` cells long; fewer lines leave the rest empty."""
        raise NotImplementedError

    def is_due(self, now_ns: int, seen: object) -> bool:
        """Whether to draw again: five times a second, and at once when what is ``seen`` is another thing."""
        last_ns, last = self._shown
        if 0 < now_ns - last_ns < _PACE_NS and seen == last:
            return False
        self._shown = now_ns, seen
        return True

    class Alone(Message):
        """A panel (its id, or "" for none) is to have all the room."""

        def __init__(self, name: str) -> None:
            super().__init__()
            self.name = name

    def action_alone(self) -> None:
        """Give this panel all the room, or give it back."""
        own = f"only-{self.id}"
        is_alone = self.screen.has_class(own)
        self.screen.remove_class(*(name for name in self.screen.classes if name.startswith("only-")))
        self.screen.set_class(not is_alone, own)
        self.post_message(self.Alone("" if is_alone else str(self.id)))

    async def action_together(self) -> None:
        """Escape gives the room back first, and then means what it means everywhere."""
        if self.screen.has_class(f"only-{self.id}"):
            self.action_alone()
        else:
            await self.app.run_action("back")

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
        # Whole lines with the border: what is asked for in part is cut out line by line, which costs more.
        left, width = -self.gutter.left, size.width + self.gutter.width
        regions: list[Region] = []
        for y in changed:
            if regions and regions[-1].bottom == y:
                regions[-1] = Region(left, regions[-1].y, width, regions[-1].height + 1)
            else:
                regions.append(Region(left, y, width, 1))
        if regions:
            self.refresh(*regions)

    def render_line(self, y: int) -> Strip:
        """One line, ``y`` counted from the top of what is seen."""
        if self._drawn != self.size:
            self._lines, self._drawn = self.draw(*self.size), self.size
        if self._ground is None:
            self._ground, self._on_ground = self.rich_style, {}
        line = _line(self._lines, y)
        if line is None:
            return Strip.blank(self.size.width, self._ground)
        return Strip([Segment(text, self._grounded(style)) for text, style, _ in line], line.cell_length)

    def _grounded(self, style: Style | None) -> Style | None:
        """A style on this widget's ground; there are few, and adding them anew for every piece costs most of a line."""
        found = self._on_ground.get(style)
        if found is None:
            found = self._on_ground[style] = (self._ground or Style.null()) + style
        return found

    def notify_style_update(self) -> None:
        """Another ground, perhaps."""
        self._ground = None
        super().notify_style_update()


def _line(lines: list[Strip], y: int) -> Strip | None:
    return lines[y] if 0 <= y < len(lines) else None
