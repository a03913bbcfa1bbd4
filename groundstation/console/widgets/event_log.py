"""The event log: Textual's RichLog with sign, time and a hanging indent; the newest is at the end.

Lines are broken here and written as segments, since RichLog breaks a rich text five times slower.
"""

from __future__ import annotations

import re
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
_TIME_WIDTH = 46  # width from which the time is shown

# Cells before the sentence, with the time and without it.
_WIDE_INDENT = 12
_NARROW_INDENT = 3


@dataclass(frozen=True, slots=True)
class EventEntry:
    """One event."""

    sentence: str
    sign: tuple[str, str] = SEVERITY_SIGNS["info"]  # sign and its colour
    stamp: str = ""  # time of day

    @classmethod
    def of(
        cls, sentence: str, sign: tuple[str, str], *, vehicle: str = "", stamp: str = ""
    ) -> EventEntry:
        """Return an entry whose sentence begins with the vehicle's name; an empty stamp is now."""
        text = clean(sentence)
        begins_with_name = re.match(rf"{re.escape(vehicle)}(?![\w-])", text)
        if vehicle and not begins_with_name:
            text = f"{clean(vehicle, 40)}: {text}"
        return cls(text, sign, stamp or time.strftime("%H:%M:%S"))


class EventLog(RichLog, can_focus=False):
    """The log of the newest MAX_ENTRIES events; page up and page down scroll it."""

    def __init__(self) -> None:
        super().__init__(id="events", max_lines=MAX_LINES, min_width=0)
        self._entries: deque[EventEntry] = deque(maxlen=MAX_ENTRIES)
        self._width = 0
        self.border_title = "events"

    @property
    def sentences(self) -> list[str]:
        """The sentences of all kept events, oldest first."""
        return [entry.sentence for entry in self._entries]

    def add(
        self, sentence: str, sign: tuple[str, str] = SEVERITY_SIGNS["info"], *, vehicle: str = ""
    ) -> None:
        """Add one sentence with the present time."""
        self.extend([EventEntry.of(sentence, sign, vehicle=vehicle)])

    def extend(self, entries: Iterable[EventEntry]) -> None:
        """Add entries; if the operator has scrolled back, the log does not move."""
        new_entries = list(entries)
        self._entries.extend(new_entries)
        if self._width and new_entries:
            self._write(new_entries, scrolls_to_end=self.is_vertical_scroll_end)

    def forget(self) -> None:
        """Remove all entries."""
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
            self._write(self._entries, scrolls_to_end=True)

    def watch_scroll_y(self, old_value: float, new_value: float) -> None:
        """Show the number of lines below the visible part."""
        super().watch_scroll_y(old_value, new_value)
        below = self.max_scroll_y - round(new_value)
        self.border_subtitle = ""
        if below > 0:
            self.border_subtitle = f"{below} lines below"

    def _write(self, entries: Iterable[EventEntry], *, scrolls_to_end: bool) -> None:
        """Break the sentences of these entries into lines, and write them."""
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
            self.write(Segments(segments), width=self._width, scroll_end=scrolls_to_end)
