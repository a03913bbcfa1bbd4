"""The question before a mission that starts at a given wall-clock time.

It shows the time until the start, which clocks agree, the duration of the mission, and the weakest
battery. Enter begins the countdown, escape drops it.
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
    """Dialog whose result is whether the countdown begins.

    Args:
        question: function that returns the content of the question; called several times a second.
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
        """Yield the box with the words, and the answer below."""
        with self._box:
            yield self._words
            yield self._answer

    def on_mount(self) -> None:
        """Show the question."""
        self.show_fleet()

    def show_fleet(self) -> None:
        """Draw the fleet and the question with their present content."""
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
        """Begin, unless there is a reason against it."""
        if not self._question().reasons:
            self.dismiss(True)

    def action_drop(self) -> None:
        """Close without beginning the countdown."""
        self.dismiss(False)
