"""Lines that stay until the operator acts: killed vehicles, and the control of the fleet."""

from __future__ import annotations

from collections.abc import Collection

from rich.text import Text
from textual.widgets import Static

from groundstation.console import theme
from groundstation.console.theme import CALM, KILL, WARN, clean
from groundstation.fleet.operator_control import FORCE_WORD, SILENCE_S, Control

Notice = tuple[str, str]  # text and colour


def notices(
    killed: Collection[str], control: Control | None, *, is_mission_flying: bool
) -> list[Notice]:
    """Return the lines, the most urgent first.

    Args:
        killed: names of the vehicles that were killed from here.
        control: control of the fleet; None for a record.
        is_mission_flying: whether a mission flies that was started here.
    """
    lines = []
    if killed:
        lines.append(_killed(sorted(killed)))
    if control is not None:
        lines += _control(control, is_mission_flying=is_mission_flying)
    return lines


def _killed(names: list[str]) -> Notice:
    listed = ", ".join(names)
    text = f"✖ KILLED {listed}. Latched: look at it, then write: reset {','.join(names)}"
    return text, KILL


def _control(control: Control, *, is_mission_flying: bool) -> list[Notice]:
    """Return a line about requests for control, and one if this ground may not order a move."""
    lines = []
    if control.requester is not None and control.is_operator:
        label = control.requester.label
        gives = "gives it and ends the mission" if is_mission_flying else "gives it"
        lines.append((f"▲ {label} asks for control: ctrl+y {gives}, ctrl+n keeps it", WARN))

    if control.is_waiting and control.holder is not None:
        author = control.holder.author
        silence = f"No answer for {SILENCE_S:.0f} s? Write: take control {FORCE_WORD}"
        lines.append((f"… asking {author} for control. {silence}", WARN))
    elif not control.is_operator and control.refusal("move") is not None:
        operator = "nobody operates"
        if control.holder is not None:
            operator = f"{control.holder.label} operates"
        text = f"· You watch; to order, write: take control. {operator}. Land, hold and kill work"
        lines.append((text, CALM))
    return lines


class NoticeLines(Static):
    """Shows the notices, one line each; usually there are none."""

    def __init__(self) -> None:
        super().__init__(id="notices")
        self._notices: list[Notice] = []

    def show(self, lines: list[Notice]) -> None:
        """Show these notices; they are drawn only if they have changed."""
        if lines == self._notices:
            return

        self._notices = lines
        self.display = bool(lines)
        parts = [
            Text(f" {clean(text, 200)}", theme.style(colour, bold=True)) for text, colour in lines
        ]
        self.update(Text("\n").join(parts))

    @property
    def sentences(self) -> list[str]:
        """The texts of the notices."""
        return [text for text, _ in self._notices]
