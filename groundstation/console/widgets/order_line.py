"""The line for written orders: history on the arrows, completion on tab; pasted text waits for
Enter.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import ClassVar

from textual import events
from textual.binding import Binding, BindingType
from textual.message import Message
from textual.suggester import Suggester
from textual.widgets import Input

from groundstation.fleet.control_authority import FORCE_WORD
from groundstation.formations.slots import formation_names
from groundstation.orders.grammar import VERBS
from onboard.config.fleet import FleetConfig

CONTROL_ORDERS = ("take control", f"take control {FORCE_WORD}", "give control", "keep control")
MAX_LENGTH = 200
_KEPT = 200
_RESTING = "press :  and write an order, e.g. takeoff all 1.0"
_WRITING = "now write: every key goes here, enter gives the order"


def completions(text: str, fleet: FleetConfig) -> list[str]:
    """Return whole lines that begin with ``text`` and complete its last word, or the last name of a
    list of names.
    """
    words = text.split(" ")
    done, last = words[:-1], words[-1]
    if not last:
        return []
    if not done:
        rare = ["reset", *dict.fromkeys(order.partition(" ")[0] for order in CONTROL_ORDERS)]
        verbs: list[str] = [verb for verb in VERBS if verb.startswith(last) and verb != last]
        return verbs or [word for word in rare if word.startswith(last) and word != last]
    if done[0] in ("take", "give", "keep"):
        return [order for order in CONTROL_ORDERS if order.startswith(text) and order != text]
    if done[0] == "formation" and len(done) == 1:
        return [
            f"formation {name}"
            for name in formation_names(fleet)
            if name.startswith(last) and name != last
        ]
    if len(done) != (2 if done[0] == "formation" else 1):
        return []
    before, comma, start = last.rpartition(",")
    names = fleet.enabled_names if comma else ("all", *fleet.enabled_names)
    fits = [
        name
        for name in names
        if name.startswith(start) and name != start and name not in before.split(",")
    ]
    return [" ".join([*done, f"{before}{comma}{name}"]) for name in fits]


def history_file() -> Path:
    """Return the file that keeps orders between runs: ``$XDG_STATE_HOME/covey/orders``."""
    return (
        Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
        / "covey"
        / "orders"
    )


class OrderHistory:
    """Orders that were written, oldest first, without repetitions in a row; kept in a file where
    one can be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            text = path.read_text(encoding="utf-8", errors="replace")
        except (OSError, RuntimeError):
            text = ""
        lines = [
            line
            for line in text.splitlines()
            if line and line.isprintable() and len(line) <= MAX_LENGTH
        ]
        self.lines = lines[-_KEPT:]

    def add(self, line: str) -> None:
        """Remember a line; on a disk that is full or read-only for this run only."""
        if self.lines[-1:] == [line]:
            return
        self.lines = [*self.lines[1 - _KEPT :], line]
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._path.write_text("\n".join(self.lines) + "\n", encoding="utf-8")
        except OSError:
            return


class _OrderSuggester(Suggester):
    def __init__(self, fleet: FleetConfig) -> None:
        super().__init__(use_cache=False, case_sensitive=True)
        self._fleet = fleet

    async def get_suggestion(self, value: str) -> str | None:
        return next(iter(completions(value, self._fleet)), None)


class OrderLine(Input):
    """An Input with history and completion; escape leaves it without an order."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "history(-1)", "earlier order", show=False),
        Binding("down", "history(1)", "later order", show=False),
        Binding("tab", "complete", "complete", show=False),
        Binding("escape", "leave", "leave", show=False),
    ]

    class Completions(Message):
        """Tab has several words to go on with."""

        def __init__(self, words: list[str]) -> None:
            super().__init__()
            self.words = words

    def __init__(self, fleet: FleetConfig) -> None:
        self._hints = _RESTING, _WRITING
        super().__init__(
            placeholder=_RESTING,
            suggester=_OrderSuggester(fleet),
            id="order",
            compact=True,
            select_on_focus=False,  # the next key goes on with the line and does not replace it
            max_length=MAX_LENGTH,
        )
        self._fleet = fleet
        self._history: OrderHistory | None = None
        self._at = 0
        self._draft = ""

    def disable(self, hint: str) -> None:
        """Say in the empty line that nothing can be ordered."""
        self._hints = hint, hint
        self.placeholder = hint

    def on_focus(self) -> None:
        """Show that keys go here, and load the orders of earlier runs."""
        self._show_writing(True)
        if self._history is None:
            self._load()

    def on_blur(self) -> None:
        """Show that keys go elsewhere."""
        self._show_writing(False)

    def _show_writing(self, is_writing: bool) -> None:
        self.placeholder = self._hints[is_writing]
        if self.parent is not None:
            self.parent.set_class(is_writing, "writing")

    def _load(self) -> OrderHistory:
        history = self._history = OrderHistory(history_file())
        self._at = len(history.lines)
        return history

    def write(self, text: str) -> None:
        """Begin a line, for the operator to go on with."""
        self.screen.set_focus(self)  # at once: the next key is meant for it
        self.value = text
        self.cursor_position = len(text)

    def take_back(self, text: str) -> None:
        """Show a refused line again, to be corrected."""
        with self.prevent(self.Changed):
            self.write(text)

    async def action_submit(self) -> None:
        """Post the line and clear it, so that a second Enter sends it no second time."""
        # ":" opens the line; typed once more it means nothing
        text = self.value.strip().removeprefix(":").strip()
        self.value = self._draft = ""
        if text:
            history = self._history or self._load()
            history.add(text)
            self._at = len(history.lines)
            self.post_message(self.Submitted(self, text))

    def action_history(self, step: int) -> None:
        """Show an earlier or later order; the line that was being written comes after the newest."""
        lines = self._history.lines if self._history is not None else []
        if self._at >= len(lines):
            self._draft = self.value
        self._at = max(0, min(len(lines), self._at + step))
        self.value = lines[self._at] if self._at < len(lines) else self._draft
        self.cursor_position = len(self.value)

    def action_complete(self) -> None:
        """Write the only completion, or the start that all completions have in common."""
        lines = completions(self.value, self._fleet)
        start = os.path.commonprefix(lines)  # noqa: RUF071 - of words
        if len(start) > len(self.value):
            self.value = start
            self.cursor_position = len(start)
        if len(lines) > 1:
            self.post_message(self.Completions([line.rpartition(" ")[2] for line in lines]))

    def action_leave(self) -> None:
        """Drop the line and go back to the fleet."""
        self.value = self._draft = ""
        self.screen.set_focus(self.screen.query_one("#fleet"))

    def on_paste(self, event: events.Paste) -> None:
        """Insert pasted text as one line: line breaks become spaces, and only Enter sends it."""
        event.stop()
        event.prevent_default()
        text = " ".join(event.text.split())
        self.insert_text_at_cursor(
            "".join(char for char in text if char.isprintable())[:MAX_LENGTH]
        )
