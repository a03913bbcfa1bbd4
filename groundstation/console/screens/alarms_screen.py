"""All alarms with duration and advice: open, acknowledged and past ones."""

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

_SINCE_WIDTH = 12


class AlarmsScreen(LiveScreen):
    """``a`` acknowledges the alarm under the cursor, ``shift+a`` or escape goes back."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,A,q", "dismiss", "back", show=False),
        Binding("a,enter,space", "acknowledge", "acknowledge", show=False),
    ]

    def __init__(self, alarms: Alarms) -> None:
        super().__init__(alarms)
        self._list = AlarmList(alarms)

    def body(self) -> Widget:
        """The list."""
        return self._list

    def on_mount(self) -> None:
        """Keys go to the list."""
        self._list.focus()

    def show_fleet(self, state: FleetState, now_ns: int) -> None:
        """Draw the alarms as they are now."""
        self._list.show(now_ns)

    def action_acknowledge(self) -> None:
        """Acknowledge the alarm under the cursor."""
        self._list.acknowledge()


class AlarmList(ScrollView, can_focus=True):
    """Each alarm as a sentence with its advice below; past alarms at the end, faint."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up,k", "cursor(-1)", "up", show=False),
        Binding("down,j", "cursor(1)", "down", show=False),
    ]

    def __init__(self, alarms: Alarms) -> None:
        super().__init__(id="alarms")
        self.alarms = alarms
        self.cursor = 0
        self._holding: list[AlarmLine] = []
        # index of the alarm (-1: none), one line of the screen
        self._rows: list[tuple[int, list[Segment]]] = []
        self.border_title = "alarms"
        self.border_subtitle = "a acknowledges · esc back"

    def show(self, now_ns: int) -> None:
        """Draw the alarms as they are now."""
        self._holding = self.alarms.lines
        self.cursor = max(0, min(self.cursor, len(self._holding) - 1))
        open_count = sum(not line.is_acknowledged for line in self._holding)
        self.border_title = (
            f"alarms: {open_count} open, {len(self._holding) - open_count} acknowledged"
        )
        width = max(20, self.size.width)
        rows: list[tuple[int, list[Segment]]] = []
        for index, line in enumerate(self._holding):
            rows += [(index, segments) for segments in self._open_alarm(index, line, now_ns, width)]
        if not self._holding:
            rows.append((-1, [Segment("  ● all well", theme.style(GOOD))]))
        over = self.alarms.over
        if over:
            rows += [(-1, []), (-1, [Segment("  over", theme.style(FAINT, bold=True))])]
        for line in over:
            ago = f"{lasting((now_ns - (line.over_ns or 0)) * 1e-9)} ago"
            text = f"{clean(line.alarm.sentence)}, lasted {lasting(line.duration_s(now_ns))}"
            rows += [
                (-1, segments)
                for segments in _wrapped(f"  · {ago:<{_SINCE_WIDTH}}", text, width, FAINT)
            ]
        self._rows = rows
        self.virtual_size = Size(width, len(rows))
        self.refresh()

    def acknowledge(self) -> None:
        """Acknowledge the alarm under the cursor."""
        if self._holding:
            self.alarms.acknowledge(self._holding[self.cursor])

    def action_cursor(self, step: int) -> None:
        """Move by ``step`` alarms; the list scrolls."""
        self.cursor = max(0, min(len(self._holding) - 1, self.cursor + step))
        lines = [y for y, (index, _) in enumerate(self._rows) if index == self.cursor]
        if lines:
            self.scroll_to_region(Region(0, lines[0], 1, len(lines)), animate=False)
        self.refresh()

    def render_line(self, y: int) -> Strip:
        """One line of the list."""
        row = y + self.scroll_offset.y
        segments = self._rows[row][1] if row < len(self._rows) else []
        return Strip(segments).adjust_cell_length(self.size.width).apply_style(self.rich_style)

    def _open_alarm(
        self, index: int, line: AlarmLine, now_ns: int, width: int
    ) -> list[list[Segment]]:
        sign, colour = SEVERITY[line.alarm.severity]
        if line.is_acknowledged:
            sign, colour = "✓", FAINT
        mark = "▌" if index == self.cursor else " "
        head = f"{mark} {sign} {lasting(line.duration_s(now_ns)):<{_SINCE_WIDTH}}"
        rows = _wrapped(
            head, clean(line.alarm.sentence), width, colour, bold=not line.is_acknowledged
        )
        advice = TEXT if not line.is_acknowledged else FAINT
        return rows + _wrapped(" " * len(head), clean(line.alarm.advice), width, advice)


def _wrapped(
    head: str, text: str, width: int, colour: str, *, bold: bool = False
) -> list[list[Segment]]:
    """``text`` beside ``head``, further lines below it."""
    lines = theme.wrap(text, max(8, width - len(head)), most=6)
    style = theme.style(colour, bold=bold)
    heads = [head, *(" " * len(head) for _ in lines[1:])]
    return [
        [Segment(start, style), Segment(line, style)]
        for start, line in zip(heads, lines, strict=True)
    ]
