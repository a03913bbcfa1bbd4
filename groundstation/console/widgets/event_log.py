"""What happened, newest at the bottom; bounded, so that a flood of events costs no memory."""

from __future__ import annotations

import time
from collections import deque

from rich.segment import Segment
from textual.strip import Strip
from textual.widget import Widget

from groundstation.console import theme
from groundstation.console.theme import FAINT, clean

MAX_LINES = 2000


class EventLog(Widget):
    """Sentences with their time, sign and vehicle; page up and down look back."""

    def __init__(self) -> None:
        super().__init__(id="events")
        self._entries: deque[tuple[str, str, str, str]] = deque(maxlen=MAX_LINES)
        self._lines: list[list[Segment]] | None = None
        self._back = 0
        self.border_title = "events"

    def write(self, sentence: str, *, severity: str = "info", vehicle: str = "", stamp: str = "") -> None:
        """Add one sentence."""
        sign, colour = theme.SEVERITY_SIGNS.get(severity, theme.SEVERITY_SIGNS["info"])
        self.add(sign, colour, sentence, vehicle=vehicle, stamp=stamp)

    def add(self, sign: str, colour: str, sentence: str, *, vehicle: str = "", stamp: str = "") -> None:
        """Add one sentence under a sign; ``stamp`` says when, by default now."""
        stamp = stamp or time.strftime("%H:%M:%S")
        text = clean(sentence)
        if vehicle and not text.startswith(vehicle):
            text = f"{clean(vehicle, 40)}: {text}"
        self._entries.append((stamp, sign, colour, text))
        self._lines = None
        self.refresh()

    def clear(self) -> None:
        """Forget all."""
        self._entries.clear()
        self._lines, self._back = None, 0
        self.refresh()

    @property
    def sentences(self) -> list[str]:
        """All that is kept, oldest first."""
        return [entry[3] for entry in self._entries]

    def look_back(self, pages: int) -> None:
        """Look back (+1) or forward (-1) by pages."""
        self._back = max(0, min(len(self._entries) - 1, self._back + pages * max(1, self.size.height - 1)))
        self._lines = None
        self.border_subtitle = f"{self._back} newer below" if self._back else ""
        self.refresh()

    def on_resize(self) -> None:
        """Another width breaks the lines elsewhere."""
        self._lines = None

    def render_line(self, y: int) -> Strip:
        """The tail of the log, wrapped; only what is seen is wrapped at all."""
        width, height = self.size
        if self._lines is None:
            self._lines = self._wrapped(width, height)
        line = Strip(self._lines[y] if y < len(self._lines) else []).adjust_cell_length(width)
        return line.apply_style(self.rich_style)

    def _wrapped(self, width: int, height: int) -> list[list[Segment]]:
        has_time = width >= 46
        indent = 12 if has_time else 3
        found: list[list[Segment]] = []
        last = len(self._entries) - self._back
        for index in range(last - 1, -1, -1):
            stamp, sign, colour, text = self._entries[index]
            lines = theme.wrap(text, max(8, width - indent - 1), most=12)
            block = [
                [
                    Segment(
                        (f" {stamp} " if has_time else " ") if number == 0 else " " * (indent - 2), theme.style(FAINT)
                    ),
                    Segment(f"{sign if number == 0 else ' '} ", theme.style(colour, bold=True)),
                    Segment(line, theme.style(colour)),
                ]
                for number, line in enumerate(lines)
            ]
            found = block + found
            if len(found) >= height:
                break
        return found[-height:] if height else []
