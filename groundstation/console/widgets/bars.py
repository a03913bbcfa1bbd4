"""The single lines of the console: the title, and the worst alarm with the keys."""

from __future__ import annotations

from rich.cells import cell_len
from rich.segment import Segment
from rich.style import Style
from textual.strip import Strip
from textual.widget import Widget

from groundstation.alarms.alarm_table import AlarmSeverity
from groundstation.alarms.alarms import AlarmLine, Alarms
from groundstation.console import theme
from groundstation.console.panel_sizes import NARROW
from groundstation.console.theme import BAD, CALM, FAINT, GOOD, KILL, TEXT, WARN, clean

# The keys on the last line: for a wide, a narrow and a very narrow terminal.
KEYS = (
    "ctrl+l LAND ALL   ctrl+o HOLD ALL   : order   ? help   q quit",
    "^l LAND ALL  ? help",
    "^l LAND ALL",
)
URGENT_KEYS = ("ctrl+l LAND ALL   ctrl+o HOLD ALL", "^l LAND ALL", "^l LAND ALL")  # in dialogs
VIEW_KEYS = ("? help   q quit", "? help", "? help")  # in a console that cannot give orders
SEVERITY = {
    AlarmSeverity.CRITICAL: ("✖", BAD),
    AlarmSeverity.WARNING: ("▲", WARN),
    AlarmSeverity.NOTE: ("…", CALM),
}


class Bar(Widget):
    """One line of segments, or two."""

    def __init__(self, name: str) -> None:
        super().__init__(id=name)
        self._lines: tuple[list[Segment], ...] = ()

    def put(self, *lines: list[Segment]) -> None:
        """Show these lines; they are drawn only if they have changed."""
        if lines != self._lines:
            self._lines = lines
            self.refresh()

    def render_line(self, y: int) -> Strip:
        """Return one line."""
        segments: list[Segment] = []
        if y < len(self._lines):
            segments = self._lines[y]
        line = Strip(segments).adjust_cell_length(self.size.width)
        return line.apply_style(self.rich_style)


class TitleBar(Bar):
    """The fleet, how many of its vehicles are heard and how many fly, and the mission."""

    def show(
        self,
        title: str,
        *,
        fresh: int,
        vehicles: int,
        flying: int,
        flight_s: float | None,
        right: str,
    ) -> None:
        """Update the line.

        Args:
            title: title of the fleet.
            fresh: number of vehicles that are heard.
            vehicles: number of all vehicles of the fleet.
            flying: number of vehicles in the air.
            flight_s: duration of the present flight or of the last one [s]; None before the first.
            right: text at the right end.
        """
        colour = WARN
        if fresh == vehicles:
            middle = f"   {flying} of {vehicles} fly"
            colour = GOOD
        elif fresh:
            middle = f"   {fresh} of {vehicles} heard"
        else:
            middle = f"   waiting for {vehicles} vehicles"

        if flight_s is not None:
            minutes, seconds = divmod(int(flight_s), 60)
            flown = "" if flying else " flown"
            middle += f",{flown} {minutes}:{seconds:02d}"

        brand = " COVEY "
        name = f" {clean(title, 60)}"
        room = self.size.width - cell_len(brand) - cell_len(name) - cell_len(middle) - 1
        segments = [
            Segment(brand, theme.style(CALM, bold=True)),
            Segment(name, theme.style(TEXT, bold=True)),
            Segment(middle, theme.style(colour)),
            Segment(theme.fit(f"  {clean(right, 120)} ", room, right=True), theme.style(TEXT)),
        ]
        self.put(segments)


class StatusBar(Bar):
    """The worst alarm, on every screen, and the keys if there is room."""

    def __init__(self, name: str, keys: tuple[str, str, str] = KEYS) -> None:
        super().__init__(name)
        self._keys = keys

    def show(self, alarms: Alarms, now_ns: int, kill: str | None, *, can_order: bool) -> None:
        """Update the line.

        Args:
            alarms: the present alarms.
            now_ns: the clock of the alarms [ns].
            kill: vehicle that the next press of the kill key stops; it is shown instead of alarms.
            can_order: whether this console can give orders.
        """
        width = self.size.width
        if kill is not None:
            text = f" KILL {kill}? The same key again within 1 s stops its motors: it falls."
            self.put([Segment(theme.fit(text, width), theme.style(KILL, bold=True))])
            return

        lines = alarms.lines
        worst = None
        text = f" ● {alarms.words_without_alarm}"
        more = ""
        if lines:
            worst = lines[0]
            sign, _ = SEVERITY[worst.alarm.severity]
            text = f" {sign} {clean(worst.text(now_ns))}"
        if len(lines) > 1:
            more = f" (+{len(lines) - 1}: A)"  # the key A opens the list of all alarms

        has_two_lines = self.size.height > 1  # in a narrow terminal the keys are below the alarm
        keys = self._fitting_keys(
            cell_len(text) + cell_len(more), can_order=can_order, has_two_lines=has_two_lines
        )
        room = width
        if not has_two_lines:
            room = max(0, width - len(keys) - 2)

        # Only the sentence is cut, so that the number of further alarms stays visible.
        room_for_sentence = max(0, room - cell_len(more))
        if cell_len(text) > room_for_sentence:
            text = theme.fit(text, room_for_sentence)
        text += more
        style = _alarm_style(worst)
        if worst is None and alarms.starting:
            style = theme.style(FAINT)
        alarm = Segment(theme.fit(text, room), style)
        hint = Segment(f" {keys} ", theme.style(FAINT))
        if has_two_lines:
            self.put([alarm], [hint])
        else:
            self.put([alarm, hint])

    def _fitting_keys(self, text_width: int, *, can_order: bool, has_two_lines: bool) -> str:
        """Return the keys that have room beside a text of this width."""
        width = self.size.width
        all_keys, some_keys, least_keys = self._keys if can_order else VIEW_KEYS
        if width < len(some_keys) + 2:
            return least_keys
        if width < NARROW and not has_two_lines:
            return least_keys
        if text_width + len(all_keys) + 2 <= width:
            return all_keys
        return some_keys


def _alarm_style(worst: AlarmLine | None) -> Style:
    if worst is None:
        return theme.style(GOOD)
    if worst.is_acknowledged:
        return theme.style(FAINT)
    _, colour = SEVERITY[worst.alarm.severity]
    return theme.style(colour, bold=worst.alarm.severity > AlarmSeverity.NOTE)
