"""Lines that stay until they are dealt with: killed vehicles, who operates, who asks for control."""

from __future__ import annotations

from rich.segment import Segment
from textual.strip import Strip
from textual.widget import Widget

from groundstation.console import theme
from groundstation.console.theme import CALM, KILL, WARN, clean
from groundstation.fleet.control_authority import FORCE_WORD, SILENCE_S, Control

Notice = tuple[str, str]


def notices(killed: tuple[str, ...], control: Control | None) -> list[Notice]:
    """Text and colour of each line, the most urgent first."""
    found = []
    if killed:
        who = ", ".join(killed)
        found.append((f"✖ KILLED {who}. Latched: look at it, then write: reset {','.join(killed)}", KILL))
    if control is None:
        return found
    if control.requester is not None and control.is_operator:
        found.append((f"▲ {control.requester.label} asks for control: ctrl+y gives it, ctrl+n keeps it", WARN))
    if control.is_waiting and control.holder is not None:
        found.append(
            (
                f"… asking {control.holder.author} for control. No answer for {SILENCE_S:.0f} s? Write: take control "
                f"{FORCE_WORD}",
                WARN,
            )
        )
    elif not control.is_operator and control.refusal("move") is not None:
        who = f"{control.holder.label} operates" if control.holder is not None else "nobody operates"
        found.append((f"· You watch; to order, write: take control. {who}. Land, hold and kill work", CALM))
    return found


class NoticeLines(Widget):
    """As many lines as there are notices; none is the usual case."""

    def __init__(self) -> None:
        super().__init__(id="notices")
        self._notices: list[Notice] = []

    def show(self, found: list[Notice]) -> None:
        """Show these; nothing is drawn when nothing changed."""
        if found != self._notices:
            self._notices = found
            self.display = bool(found)
            self.styles.height = len(found)
            self.refresh()

    @property
    def sentences(self) -> list[str]:
        """What stands there."""
        return [text for text, _ in self._notices]

    def render_line(self, y: int) -> Strip:
        """One of them."""
        if y >= len(self._notices):
            return Strip.blank(self.size.width)
        text, colour = self._notices[y]
        line = theme.fit(f" {clean(text, 200)}", self.size.width)
        return Strip([Segment(line, theme.style(colour, bold=True))])
