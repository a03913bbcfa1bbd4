"""Two dialogs: the help, and the question before the console leaves a flying fleet."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.widgets import Static

from groundstation.console.screens.live import Dialog
from groundstation.console.widgets.fleet_table import FleetTable

HELP = files(__package__).joinpath("help.txt").read_text(encoding="utf-8").rstrip()
REPLAY_HELP = files(__package__).joinpath("replay_help.txt").read_text(encoding="utf-8").rstrip()
_MAX_NAMED = 6


class HelpScreen(Dialog[None]):
    """Shows keys and orders.

    Args:
        text: text in Textual's markup; by default all keys and orders of the console.
        table: table of the fleet, which stays in sight.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,question_mark,enter", "dismiss", "back", show=False)
    ]

    def __init__(self, text: str = HELP, table: FleetTable | None = None) -> None:
        super().__init__(table)
        self._text = text

    def boxes(self) -> ComposeResult:
        """Yield the box of the help."""
        with VerticalScroll(id="help") as box:
            box.border_title = "help"
            box.border_subtitle = "↑ ↓ scroll · esc back"
            yield Static(self._text)


class QuitScreen(Dialog[str]):
    """Asks before the console ends while vehicles fly.

    The result is ``land`` to land and end, ``leave`` to end and leave them flying, or empty to
    stay.

    Args:
        airborne: returns the names of the vehicles that fly now.
        can_stay_up: whether the vehicles can fly on without this console; False if this console has
            started their agents.
        table: table of the fleet, which stays in sight.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y,l", "answer('land')", "land and quit", show=False),
        Binding("f", "answer('leave')", "leave them flying", show=False),
        Binding("escape,n,q", "drop", "stay", show=False),
    ]

    def __init__(
        self,
        airborne: Callable[[], tuple[str, ...]],
        *,
        can_stay_up: bool = False,
        table: FleetTable | None = None,
    ) -> None:
        super().__init__(table)
        self._airborne = airborne
        self._can_stay_up = can_stay_up
        self._text = Static()

    def boxes(self) -> ComposeResult:
        """Yield the box of the question."""
        with VerticalScroll(id="question") as box:
            box.border_title = "leave the fleet?"
            yield self._text
        self._show_question()

    def show_fleet(self) -> None:
        """Draw the present rows of the fleet's table, and name the vehicles that still fly."""
        super().show_fleet()
        self._show_question()

    def _show_question(self) -> None:
        self._text.update("\n".join(self._lines(self._airborne())))

    def _lines(self, names: tuple[str, ...]) -> list[str]:
        if not names:
            return ["All are down.", "", "[b]y[/b]    quit", "[b]esc[/b]  stay"]

        count = len(names)
        shown = ", ".join(names[:_MAX_NAMED])
        if count > _MAX_NAMED:
            shown += " …"

        flies = "fly"
        pronoun = "them"
        pronoun_are = "they are"
        if count == 1:
            flies = "flies"
            pronoun = "it"
            pronoun_are = "it is"

        lines = [
            f"{shown} {flies}.",
            "",
            f"[b]y[/b]    land {pronoun} on the spot, wait until {pronoun_are} down, then quit",
        ]
        if self._can_stay_up:
            lines.append(
                f"[b]f[/b]    leave {pronoun} flying and quit: each ends its order and stays there"
            )
            twice = "ctrl+c twice leaves at once, with the landing under way"
        else:
            twice = "ctrl+c twice leaves at once; what this console started lands or ends with it."
        return [*lines, "[b]esc[/b]  stay", "", twice]

    def action_answer(self, answer: str) -> None:
        """Close with the answer."""
        if answer != "leave" or self._can_stay_up:
            self.dismiss(answer)

    def action_drop(self) -> None:
        """Close and stay."""
        self.dismiss("")
