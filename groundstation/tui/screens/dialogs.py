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


class QuitScreen(ModalScreen[bool]):
    """Asks before leaving while vehicles fly; true: land them and leave."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y,l", "answer(True)", "land and quit", show=False),
        Binding("escape,n,q", "answer(False)", "stay", show=False),
    ]

    def __init__(self, names: tuple[str, ...]) -> None:
        super().__init__()
        self._names = names

    def compose(self) -> ComposeResult:
        """One box."""
        count = len(self._names)
        shown = ", ".join(self._names[:6]) + (" …" if count > 6 else "")
        who = f"{shown} {'flies' if count == 1 else 'fly'}"
        with VerticalScroll(id="question") as box:
            box.border_title = "leave the fleet?"
            yield Static(
                f"{who}.\n\n[b]y[/b]    land {'it' if count == 1 else 'all of them'} where they are, wait "
                "until they are down, then quit\n[b]esc[/b]  stay\n\nctrl+c twice leaves at once; "
                "what this console started lands or ends with it."
            )

    def action_answer(self, answer: bool) -> None:
        """Close with the answer."""
        self.dismiss(answer)
