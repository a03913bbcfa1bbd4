"""The list of all alarms with duration and advice: open, acknowledged and past ones."""

from __future__ import annotations

from typing import ClassVar

from rich.segment import Segment
from textual.binding import Binding, BindingType
from textual.geometry import Region, Size
from textual.scroll_view import ScrollView
from textual.strip import Strip
from textual.widget import Widget

from groundstation.alarms.alarms import AlarmLine, Alarms, lasting
from groundstation.console import theme
from groundstation.console.screens.live import LiveScreen
from groundstation.console.theme import FAINT, GOOD, TEXT, clean
from groundstation.console.widgets.bars import SEVERITY
from groundstation.fleet.state import FleetState

_SINCE_WIDTH = 16  # cells of the duration: "59 min 59 s ago" and a space
_NO_ALARM = -1  # index of a line that is not part of an alarm
_Row = tuple[int, list[Segment]]  # index of the alarm, and one line of the screen


class AlarmsScreen(LiveScreen):
    """The screen of alarms: ``a`` acknowledges one, ``shift+a`` or escape goes back."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,A,q", "dismiss", "back", show=False),
        Binding("a,enter,space", "acknowledge", "acknowledge", show=False),
    ]

    def __init__(self, alarms: Alarms) -> None:
        super().__init__(alarms)
        self._list = AlarmList(alarms)

    def body(self) -> Widget:
        """Return the list."""
        return self._list

    def on_mount(self) -> None:
        """Give the keys to the list."""
        self._list.focus()

    def show_fleet(self, state: FleetState, now_ns: int) -> None:
        """Draw the present alarms."""
        self._list.show(now_ns)

    def action_acknowledge(self) -> None:
        """Acknowledge the alarm under the cursor."""
        self._list.acknowledge()


class AlarmList(ScrollView, can_focus=True):
    """Draws each alarm as a sentence with its advice below; past alarms are faint, at the end."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up,k", "cursor(-1)", "up", show=False),
        Binding("down,j", "cursor(1)", "down", show=False),
    ]

    def __init__(self, alarms: Alarms) -> None:
        super().__init__(id="alarms")
        self.alarms = alarms
        self.cursor = 0
        self._present: list[AlarmLine] = []
        self._rows: list[_Row] = []
        self._now_ns = 0
        self.border_title = "alarms"
        self.border_subtitle = "a acknowledges · esc back"

    def show(self, now_ns: int) -> None:
        """Draw the present alarms."""
        self._now_ns = now_ns
        former_lines = self._present
        self._present = self.alarms.lines
        self.cursor = self._moved_cursor(former_lines)

        open_count = sum(1 for line in self._present if not line.is_acknowledged)
        acknowledged_count = len(self._present) - open_count
        self.border_title = f"alarms: {open_count} open, {acknowledged_count} acknowledged"

        width = self.size.width
        if not width:
            return  # the list has no size yet: :meth:`on_resize` draws it

        self._rows = self._present_rows(now_ns, width) + self._past_rows(now_ns, width)
        self.virtual_size = Size(width, len(self._rows))
        self.refresh()

    def _moved_cursor(self, former_lines: list[AlarmLine]) -> int:
        """Return the present place of the alarm under the cursor.

        If that alarm is over or was just acknowledged, the cursor stays where it is.
        """
        if self.cursor < len(former_lines):
            chosen = _identity(former_lines[self.cursor])
            for index, line in enumerate(self._present):
                if _identity(line) == chosen:
                    return index
        return max(0, min(self.cursor, len(self._present) - 1))

    def on_resize(self) -> None:
        """Break the lines for this width."""
        self.show(self._now_ns)

    def _present_rows(self, now_ns: int, width: int) -> list[_Row]:
        if not self._present:
            style = theme.style(GOOD)
            if self.alarms.starting:
                style = theme.style(FAINT)
            return [(_NO_ALARM, [Segment(f"  ● {self.alarms.words_without_alarm}", style)])]

        rows: list[_Row] = []
        for index, line in enumerate(self._present):
            for segments in self._lines_of(index, line, now_ns, width):
                rows.append((index, segments))
        return rows

    def _past_rows(self, now_ns: int, width: int) -> list[_Row]:
        over = self.alarms.over
        if not over:
            return []

        heading = [Segment("  over", theme.style(FAINT, bold=True))]
        rows: list[_Row] = [(_NO_ALARM, []), (_NO_ALARM, heading)]
        for line in over:
            over_ns = line.over_ns or now_ns  # never None: these alarms are over
            ended_ago = f"{lasting((now_ns - over_ns) * 1e-9)} ago"
            duration = lasting(line.duration_s(now_ns))
            text = f"{clean(line.alarm.sentence)}, lasted {duration}"
            for segments in _wrapped(f"  · {ended_ago:<{_SINCE_WIDTH}}", text, width, FAINT):
                rows.append((_NO_ALARM, segments))
        return rows

    def acknowledge(self) -> None:
        """Acknowledge the alarm under the cursor."""
        if self._present:
            self.alarms.acknowledge(self._present[self.cursor])

    def action_cursor(self, step: int) -> None:
        """Move the cursor by ``step`` alarms, and scroll the list to it."""
        self.cursor = max(0, min(len(self._present) - 1, self.cursor + step))
        lines = [y for y, (index, _) in enumerate(self._rows) if index == self.cursor]
        if lines:
            self.scroll_to_region(Region(0, lines[0], 1, len(lines)), animate=False)
        self.refresh()

    def render_line(self, y: int) -> Strip:
        """Return one line of the list."""
        row = y + self.scroll_offset.y
        segments: list[Segment] = []
        if row < len(self._rows):
            _, segments = self._rows[row]
        return Strip(segments).adjust_cell_length(self.size.width).apply_style(self.rich_style)

    def _lines_of(
        self, index: int, line: AlarmLine, now_ns: int, width: int
    ) -> list[list[Segment]]:
        """Return the lines of a present alarm, with its advice below."""
        sign, colour = SEVERITY[line.alarm.severity]
        advice_colour = TEXT
        if line.is_acknowledged:
            sign = "✓"
            colour = FAINT
            advice_colour = FAINT

        mark = "▌" if index == self.cursor else " "
        head = f"{mark} {sign} {lasting(line.duration_s(now_ns)):<{_SINCE_WIDTH}}"
        sentence = _wrapped(
            head, clean(line.alarm.sentence), width, colour, bold=not line.is_acknowledged
        )
        advice = _wrapped(" " * len(head), clean(line.alarm.advice), width, advice_colour)
        return sentence + advice


def _identity(line: AlarmLine) -> tuple[object, ...]:
    """Return a key of a line that stays the same while the line counts more and more vehicles."""
    alarm = line.alarm
    subject = alarm.subject if line.count == 1 else ""
    return alarm.kind, alarm.severity, subject, line.is_acknowledged


def _wrapped(
    head: str, text: str, width: int, colour: str, *, bold: bool = False
) -> list[list[Segment]]:
    """Return ``text`` beside ``head``; further lines are indented by the width of the head."""
    style = theme.style(colour, bold=bold)
    start = head
    rows = []
    for line in theme.wrap(text, max(8, width - len(head)), most=6):
        rows.append([Segment(start, style), Segment(line, style)])
        start = " " * len(head)
    return rows
