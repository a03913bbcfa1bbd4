"""The line where orders are written: history on the arrows, completion on tab; a pasted text is one line or nothing."""

from __future__ import annotations

from typing import ClassVar

from textual import events
from textual.binding import Binding, BindingType
from textual.message import Message
from textual.suggester import Suggester
from textual.widgets import Input

from groundstation.orders import VERBS
from onboard.config import FleetConfig


def completions(text: str, fleet: FleetConfig) -> list[str]:
    """Whole lines that begin with ``text`` and complete its last word."""
    words = text.split(" ")
    done, last = words[:-1], words[-1]
    who = ["all", *fleet.enabled_names]
    if not done:
        choices: list[str] = list(VERBS)
    elif done[0] == "formation":
        choices = list(fleet.formations) if len(done) == 1 else who if len(done) == 2 else []
    else:
        choices = who if len(done) == 1 else []
    return [" ".join([*done, choice]) for choice in choices if last and choice.startswith(last) and choice != last]


class _OrderSuggester(Suggester):
    def __init__(self, fleet: FleetConfig) -> None:
        super().__init__(use_cache=False, case_sensitive=True)
        self._fleet = fleet

    async def get_suggestion(self, value: str) -> str | None:
        return next(iter(completions(value, self._fleet)), None)


class OrderLine(Input):
    """An Input with history. Enter posts :class:`Given`; escape leaves without an order."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "history(-1)", "earlier order", show=False),
        Binding("down", "history(1)", "later order", show=False),
        Binding("tab", "complete", "complete", show=False),
        Binding("escape", "leave", "leave", show=False),
    ]

    class Given(Message):
        """A line was entered."""

        def __init__(self, text: str) -> None:
            super().__init__()
            self.text = text

    def __init__(self, fleet: FleetConfig) -> None:
        super().__init__(
            placeholder="press :  and write an order, e.g. takeoff all 1.0",
            suggester=_OrderSuggester(fleet),
            id="order",
            compact=True,
            max_length=200,
        )
        self._history: list[str] = []
        self._at = 0

    async def action_submit(self) -> None:
        """Give the order and clear the line."""
        text = self.value.strip().removeprefix(":").strip()  # ":" opens the line; typed once more it means nothing
        self.value = ""
        if text:
            self._history = [*self._history[-199:], text]
            self._at = len(self._history)
            self.post_message(self.Given(text))

    def action_history(self, step: int) -> None:
        """Fetch an earlier or later order."""
        self._at = max(0, min(len(self._history), self._at + step))
        self.value = self._history[self._at] if self._at < len(self._history) else ""
        self.cursor_position = len(self.value)

    def action_complete(self) -> None:
        """Take the suggestion."""
        self.action_cursor_right()

    def action_leave(self) -> None:
        """Back to the fleet; what was written is dropped."""
        self.value = ""
        self.screen.query_one("#fleet").focus()

    def _on_paste(self, event: events.Paste) -> None:
        """Of several pasted lines none is taken: an order must be one that somebody meant."""
        event.stop()
        event.prevent_default()
        text = event.text.strip()
        if text and len(text.splitlines()) == 1:
            self.insert_text_at_cursor("".join(char for char in text if char.isprintable()))
        elif text:
            self.notify("The pasted text has several lines. Paste one order.", severity="warning")
