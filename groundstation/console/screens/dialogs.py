"""Help, and the question before leaving a flying fleet."""

from __future__ import annotations

from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.widgets import Static

from groundstation.console.screens.live import Dialog

HELP = """[b]At once, from every screen[/b]
  [b]ctrl+l F9[/b]   LAND ALL            [b]ctrl+o F8[/b]   HOLD ALL
  [b]F7[/b] land  [b]F6[/b] hold     the marked, else the one at the cursor
  [b]F12 F12[/b]     KILL the one at the cursor: the same key twice
              within 1 s (or ctrl+\\ twice). It falls.
[b]Shown first[/b], with paths and distances; enter sends
  [b]F2[/b] arm  [b]F3[/b] take off  [b]F4[/b] move  [b]F5[/b] formation   [b]w[/b] locate
  [b]:[/b] an order   WHO is all, mav1, mav0,mav2 or numbers 0-1
    takeoff all 1.0       formation triangle 0 1.2 1.0
    move all 0 0 1.2      move mav1 1 0 1 in 8
    hold    land mav2     arm all    disarm all    kill mav1
    tab completes, ↑ ↓ fetch earlier orders
[b]Fleet[/b]
  [b]↑ ↓ j k home end[/b]   select          [b]enter[/b]   its page
  [b]space[/b] mark   [b]J K[/b] mark along   [b]*[/b] all (for 5 s) or none
  [b]3-7 enter[/b]   mark numbers   [b]m[/b] mark by name   [b]esc[/b] unmark
  [b]/[/b] filter    part of a name, 3-7, flying, armed, silent,
              unready, low; !word negates it; esc ends it
  [b]s S[/b]         sort by the next column, the other way
[b]Panels[/b]        [b]tab[/b] next panel, [b]z[/b] enlarges it
  [b]+ -[/b]         zoom the plan; in it also [b]arrows[/b] move,
              [b]f[/b] follow, [b]0[/b] the whole fence
  [b]pgup pgdn[/b]   earlier events    [b]v[/b]   verdict
  [b]a A[/b]         acknowledge alarms, all alarms with advice
  [b]t[/b]           light or dark     [b]ctrl+y[/b]   give the control
  [b]q[/b]           quit; asks when vehicles fly
[b]Plan[/b]          number in the fleet file, then height
  circles have half the safety distance: touching = limit
  [b]\\[1][/b] cursor  ✓ marked  ! too close  ? silent
  ✛ goal  × setpoint  ┄ way to go  ·→ avoids that one"""


class HelpScreen(Dialog[None]):
    """All keys and orders."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape,q,question_mark,enter", "dismiss", "back", show=False)]

    def compose(self) -> ComposeResult:
        """One box."""
        with VerticalScroll(id="help") as box:
            box.border_title = "help"
            box.border_subtitle = "esc back"
            yield Static(HELP)
        yield from super().compose()


class QuitScreen(Dialog[str]):
    """Asks before leaving while vehicles fly: ``land`` them and leave, ``leave`` them flying, or stay.

    Args:
        can_stay_up: they fly on without this console, which has not started their agents.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y,l", "answer('land')", "land and quit", show=False),
        Binding("f", "answer('leave')", "leave them flying", show=False),
        Binding("escape,n,q", "answer('')", "stay", show=False),
    ]

    def __init__(self, names: tuple[str, ...], *, can_stay_up: bool = False) -> None:
        super().__init__()
        self._names, self._can_stay_up = names, can_stay_up

    def compose(self) -> ComposeResult:
        """One box."""
        count = len(self._names)
        shown = ", ".join(self._names[:6]) + (" …" if count > 6 else "")
        them = "it" if count == 1 else "them"
        lines = [
            f"{shown} {'flies' if count == 1 else 'fly'}.",
            "",
            f"[b]y[/b]    land {them} on the spot, wait until {'it is' if count == 1 else 'they are'} down, then quit",
        ]
        if self._can_stay_up:
            lines.append(f"[b]f[/b]    leave {them} flying and quit: each ends its order and stays there")
            ending = "ctrl+c twice leaves at once, with the landing under way"
        else:
            ending = "ctrl+c twice leaves at once; what this console started lands or ends with it."
        with VerticalScroll(id="question") as box:
            box.border_title = "leave the fleet?"
            yield Static("\n".join([*lines, "[b]esc[/b]  stay", "", ending]))
        yield from super().compose()

    def action_answer(self, answer: str) -> None:
        """Close with the answer."""
        if answer != "leave" or self._can_stay_up:
            self.dismiss(answer)
