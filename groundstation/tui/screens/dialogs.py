"""Help, and the question before leaving a flying fleet."""

from __future__ import annotations

from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.screen import ModalScreen
from textual.widgets import Static

HELP = """[b]Keys[/b]
  [b]:[/b]            order line          [b]esc[/b]   back
  [b]ctrl+l[/b]  [b]F9[/b]   LAND ALL, at once, from anywhere
  [b]ctrl+o[/b]  [b]F8[/b]   HOLD ALL, at once, from anywhere
  [b]F12 F12[/b]      KILL the vehicle under the cursor: same key
               twice within 1 s (or ctrl+\\ twice). It falls.
  [b]↑ ↓ j k[/b]      choose a vehicle
  [b]+ - 0[/b]        zoom the plan; 0 shows the whole fence
  [b]pgup pgdn[/b]    look back in the events
  [b]v[/b]            hide or show the verdict
  [b]q[/b]            quit; asks when vehicles fly, and lands them

[b]Orders[/b]   WHO is all, mav1, mav0,mav2 or places 0-1
  takeoff all 1.0          arm all      disarm all
  formation triangle 0 1.2 1.0
  move all 0 0 1.2         move mav1 1 0 1 in 8
  hold                     land mav2    kill mav1
  tab completes, ↑ ↓ fetch earlier orders

[b]Plan[/b]     number = place in the fleet file, height beside it
  circles have half the safety distance: touching = limit
  ✛ goal · dotted line: way to go · blue line: avoiding"""


class HelpScreen(ModalScreen[None]):
    """Everything that can be pressed or written."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape,q,question_mark,enter", "dismiss", "back", show=False)]

    def compose(self) -> ComposeResult:
        """One box."""
        with VerticalScroll(id="help") as box:
            box.border_title = "help"
            box.border_subtitle = "esc back"
            yield Static(HELP)


class QuitScreen(ModalScreen[str]):
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

    def action_answer(self, answer: str) -> None:
        """Close with the answer."""
        if answer != "leave" or self._can_stay_up:
            self.dismiss(answer)
