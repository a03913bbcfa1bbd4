"""The question before a mission that starts at a time of the world's clock.

It says in how long that is, whose clocks agree, how long the mission takes, and whose battery is
weakest. Enter begins the countdown, escape drops it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.widgets import Static

from groundstation.console.screens.live import Dialog
from groundstation.console.theme import clean
from groundstation.console.widgets.fleet_table import FleetTable
from groundstation.missions.mission_orders import CountdownQuestion


class CountdownScreen(Dialog[bool]):
    """Closes with whether the countdown begins.

    Args:
        question: returns what is shown, several times a second.
        table: table of the fleet, which stays in sight.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "begin", "begin", show=False),
        Binding("escape,q,n", "drop", "drop", show=False),
    ]

    def __init__(
        self, question: Callable[[], CountdownQuestion], table: FleetTable | None = None
    ) -> None:
        super().__init__(table)
        self._question = question
        self._box = Vertical(id="preview")
        self._words = Static(id="vehicles", markup=False)
        self._answer = Static(id="answer", markup=False)

    def boxes(self) -> ComposeResult:
        """Words, and the answer below."""
        with self._box:
            yield self._words
            yield self._answer

    def on_mount(self) -> None:
        """Show the question as it is now."""
        self.show_fleet()

    def show_fleet(self) -> None:
        """Draw fleet and question as they are now."""
        super().show_fleet()
        question = self._question()

        self._box.border_title = question.title.replace("[", "\\[")
        self._words.update("\n".join(clean(line, 200) for line in question.lines))
        self._answer.set_class(bool(question.reasons), "bad")
        if question.reasons:
            reasons = [f"✖ {clean(reason, 300)}" for reason in question.reasons]
            self._answer.update("\n".join([*reasons, "Not begun. esc drops it"]))
        else:
            self._answer.update("✔ enter begins the countdown    esc drops it")

    def action_begin(self) -> None:
        """Begin, unless something speaks against it."""
        if not self._question().reasons:
            self.dismiss(True)

    def action_drop(self) -> None:
        """Begin nothing."""
        self.dismiss(False)
