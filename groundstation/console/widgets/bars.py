"""The single lines: title, and worst alarm with the keys."""

from __future__ import annotations

from rich.cells import cell_len
from rich.segment import Segment
from textual.strip import Strip
from textual.widget import Widget

from groundstation.alarms.alarm_table import Severity
from groundstation.alarms.alarms import Alarms
from groundstation.console import theme
from groundstation.console.panel_sizes import NARROW
from groundstation.console.theme import BAD, CALM, FAINT, GOOD, KILL, TEXT, WARN, clean

# The keys on the last line, as there is room for them: of a console, of a question, where nothing
# can be ordered.
KEYS = (
    "ctrl+l LAND ALL   ctrl+o HOLD ALL   : order   ? help   q quit",
    "^l LAND ALL  ? help",
    "^l LAND ALL",
)
URGENT_KEYS = ("ctrl+l LAND ALL   ctrl+o HOLD ALL", "^l LAND ALL", "^l LAND ALL")
VIEW_KEYS = ("? help   q quit", "? help", "? help")
SEVERITY = {
    Severity.CRITICAL: ("✖", BAD),
    Severity.WARNING: ("▲", WARN),
    Severity.NOTE: ("…", CALM),
}


class Bar(Widget):
    """One line of segments, or two."""

    def __init__(self, name: str) -> None:
        super().__init__(id=name)
        self._lines: tuple[list[Segment], ...] = ()

    def put(self, *lines: list[Segment]) -> None:
        """Show these; nothing is drawn when nothing changed."""
        if lines != self._lines:
            self._lines = lines
            self.refresh()

    def render_line(self, y: int) -> Strip:
        """Return one line."""
        line = Strip(self._lines[y] if y < len(self._lines) else []).adjust_cell_length(
            self.size.width
        )
        return line.apply_style(self.rich_style)


class TitleBar(Bar):
    """The fleet, its vehicles that are heard and that fly, and the mission."""

    def show(self, title: str, heard: int, of: int, flying: int, right: str) -> None:
        """Update the line."""
        left = f" COVEY  {clean(title, 60)}"
        missing = f"   waiting for {of} vehicles" if not heard else f"   {heard} of {of} heard"
        middle = f"   {flying} of {of} fly" if heard == of else missing
        room = self.size.width - cell_len(left) - cell_len(middle) - 1
        self.put(
            [
                Segment(" COVEY ", theme.style(CALM, bold=True)),
                Segment(left[7:], theme.style(TEXT, bold=True)),
                Segment(middle, theme.style(GOOD if heard == of else WARN)),
                Segment(theme.fit(f"  {clean(right, 120)} ", room, right=True), theme.style(TEXT)),
            ]
        )


class StatusBar(Bar):
    """The worst alarm, on every screen; the keys where there is room."""

    def __init__(self, name: str, keys: tuple[str, str, str] = KEYS) -> None:
        super().__init__(name)
        self._keys = keys

    def show(self, alarms: Alarms, now_ns: int, kill: str | None, *, can_order: bool) -> None:
        """Update the line; ``kill``, the vehicle that the next press of the kill key means, comes
        before everything.
        """
        width = self.size.width
        if kill is not None:
            text = f" KILL {kill}? The same key again within 1 s stops its motors: it falls."
            self.put([Segment(theme.fit(text, width), theme.style(KILL, bold=True))])
            return
        lines = alarms.lines
        worst = lines[0] if lines else None
        sign, colour = ("●", GOOD) if worst is None else SEVERITY[worst.alarm.severity]
        is_pressing = worst is not None and not worst.is_acknowledged
        more = f" (+{len(lines) - 1}: A)" if len(lines) > 1 else ""
        text = f" {sign} {clean(worst.text(now_ns)) if worst else 'all well'}"
        has_two = self.size.height > 1  # a narrow terminal: the keys below the alarm
        all_keys, some_keys, least_keys = self._keys if can_order else VIEW_KEYS
        keys = (
            all_keys if cell_len(text) + cell_len(more) + len(all_keys) + 2 <= width else some_keys
        )
        if width < len(some_keys) + 2 or (width < NARROW and not has_two):
            keys = least_keys
        room = max(0, width - (0 if has_two else len(keys) + 2))
        # how many more there are must stay in sight when the sentence is cut
        text = theme.fit(text, min(cell_len(text), max(0, room - cell_len(more)))) + more
        is_bold = is_pressing and worst is not None and worst.alarm.severity > Severity.NOTE
        alarm = Segment(
            theme.fit(text, room),
            theme.style(colour if is_pressing or not worst else FAINT, bold=is_bold),
        )
        hint = Segment(f" {keys} ", theme.style(FAINT))
        self.put(*([alarm], [hint]) if has_two else ([alarm, hint],))
