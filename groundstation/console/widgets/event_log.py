"""The events, newest at the bottom: Textual's RichLog with sign, time and a hanging indent.

Lines are broken here and written as segments, all those of a refresh at once. That takes 30 us an
event, where RichLog takes 140 us to break and measure a rich text: 500 events at once hold up a key
by 15 ms.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from rich.segment import Segment, Segments
from textual import events
from textual.widgets import RichLog

from groundstation.console import theme
from groundstation.console.theme import FAINT, SEVERITY_SIGNS, clean

MAX_ENTRIES = 500
MAX_LINES = 2000
_TIME_WIDTH = 46  # cells from which on there is room for the time

# Cells before the sentence, with the time and without it.
_WIDE_INDENT = 12
_NARROW_INDENT = 3


@dataclass(frozen=True, slots=True)
class EventEntry:
    """One event."""

    sentence: str
    sign: tuple[str, str] = SEVERITY_SIGNS["info"]  # and its colour
    stamp: str = ""  # time of day, by default now

    @classmethod
    def of(
        cls, sentence: str, sign: tuple[str, str], *, vehicle: str = "", stamp: str = ""
    ) -> EventEntry:
        """Return an entry that names its vehicle, if it does not do so already."""
        text = clean(sentence)
        if vehicle and not text.startswith(vehicle):
            text = f"{clean(vehicle, 40)}: {text}"
        return cls(text, sign, stamp or time.strftime("%H:%M:%S"))


class EventLog(RichLog, can_focus=False):
    """Bounded, so that a flood of events costs no memory; page up and page down look back."""

    def __init__(self) -> None:
        super().__init__(id="events", max_lines=MAX_LINES, min_width=0)
        self._entries: deque[EventEntry] = deque(maxlen=MAX_ENTRIES)
        self._width = 0
        self.border_title = "events"

    @property
    def sentences(self) -> list[str]:
        """All that is kept, oldest first."""
        return [entry.sentence for entry in self._entries]

    def add(
        self, sentence: str, sign: tuple[str, str] = SEVERITY_SIGNS["info"], *, vehicle: str = ""
    ) -> None:
        """Add one sentence that happened now."""
        self.extend([EventEntry.of(sentence, sign, vehicle=vehicle)])

    def extend(self, entries: Iterable[EventEntry]) -> None:
        """Add entries; a log that is scrolled back stays there."""
        new = list(entries)
        self._entries.extend(new)
        if self._width and new:
            self._write(new, is_end=self.is_vertical_scroll_end)

    def forget(self) -> None:
        """Forget all."""
        self._entries.clear()
        self.clear()

    def scroll_pages(self, pages: int) -> None:
        """Scroll by pages, earlier (-1) or later (+1)."""
        self.scroll_relative(y=pages * max(1, self.size.height - 1), animate=False)

    def on_resize(self, event: events.Resize) -> None:
        """Break the lines for another width; Textual also calls RichLog's own ``on_resize``."""
        width = self.scrollable_content_region.width
        if width not in (0, self._width):
            self._width = width
            self.clear()
            self._write(self._entries, is_end=True)

    def watch_scroll_y(self, old_value: float, new_value: float) -> None:
        """Say how much lies below."""
        super().watch_scroll_y(old_value, new_value)
        below = self.max_scroll_y - round(new_value)
        self.border_subtitle = ""
        if below > 0:
            self.border_subtitle = f"{below} lines below"

    def _write(self, entries: Iterable[EventEntry], *, is_end: bool) -> None:
        """Write entries; with ``is_end`` the log goes on showing its end."""
        has_time = self._width >= _TIME_WIDTH
        indent = _NARROW_INDENT
        if has_time:
            indent = _WIDE_INDENT
        text_width = max(8, self._width - indent - 1)

        segments: list[Segment] = []
        for entry in entries:
            sign, colour = entry.sign
            stamp = f" {entry.stamp} " if has_time else " "
            head = [
                Segment(stamp, theme.style(FAINT)),
                Segment(f"{sign} ", theme.style(colour, bold=True)),
            ]
            for line in theme.wrap(entry.sentence, text_width, most=12):
                segments += [*head, Segment(line, theme.style(colour)), Segment.line()]
                head = [Segment(" " * indent)]

        if segments:
            self.write(Segments(segments), width=self._width, scroll_end=is_end)
