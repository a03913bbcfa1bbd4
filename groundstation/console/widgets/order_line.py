"""The line where orders are written: history on the arrows, completion on tab; what is pasted waits for Enter."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

from textual import events
from textual.binding import Binding, BindingType
from textual.message import Message
from textual.suggester import Suggester
from textual.widgets import Input

from groundstation.fleet.control_authority import FORCE_WORD
from groundstation.orders.grammar import VERBS
from onboard.config.fleet import FleetConfig

CONTROL_ORDERS = ("take control", f"take control {FORCE_WORD}", "give control", "keep control")
MAX_LENGTH = 200
_KEPT = 200


def completions(text: str, fleet: FleetConfig) -> list[str]:
    """Whole lines that begin with ``text`` and complete its last word, or the last name of a list of names."""
    words = text.split(" ")
    done, last = words[:-1], words[-1]
    if not last:
        return []
    if not done:
        rare = ["reset", *dict.fromkeys(order.partition(" ")[0] for order in CONTROL_ORDERS)]
        found: list[str] = [verb for verb in VERBS if verb.startswith(last) and verb != last]
        return found or [word for word in rare if word.startswith(last) and word != last]
    if done[0] in ("take", "give", "keep"):
        return [order for order in CONTROL_ORDERS if order.startswith(text) and order != text]
    if done[0] == "formation" and len(done) == 1:
        return [f"formation {name}" for name in fleet.formations if name.startswith(last) and name != last]
    place = 2 if done[0] == "formation" else 1
    if len(done) != place:
        return []
    before, comma, name = last.rpartition(",")
    chosen = before.split(",")
    names = fleet.enabled_names if comma else ("all", *fleet.enabled_names)
    fits = [known for known in names if known.startswith(name) and known != name and known not in chosen]
    return [" ".join([*done, f"{before}{comma}{known}"]) for known in fits]


def common_start(lines: Iterable[str]) -> str:
    """What all of them begin with."""
    words = sorted(lines)
    first, last = words[0], words[-1]
    return next((first[:place] for place, char in enumerate(first) if char != last[place : place + 1]), first)


def history_file() -> Path:
    """Where orders are remembered between runs: ``$XDG_STATE_HOME/covey/orders``."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "covey" / "orders"


class History:
    """Orders that were written, oldest first, without repetitions in a row; kept in a file where one can be written."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            text = path.read_text(encoding="utf-8", errors="replace")
        except (OSError, RuntimeError):
            text = ""
        lines = [line for line in text.splitlines() if line and line.isprintable() and len(line) <= MAX_LENGTH]
        self.lines = lines[-_KEPT:]

    def add(self, line: str) -> None:
        """Remember a line; a disk that is full or read-only costs the memory and nothing else."""
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
    """An Input with history. Enter posts :class:`Given`; escape leaves without an order.

    ``resting`` and ``writing`` stand in an empty line that keys do not, or do, go to.
    """

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

    class Choices(Message):
        """Tab found several ways to go on."""

        def __init__(self, words: list[str]) -> None:
            super().__init__()
            self.words = words

    def __init__(self, fleet: FleetConfig) -> None:
        self.resting = "press :  and write an order, e.g. takeoff all 1.0"
        self.writing = "now write: every key goes here, enter gives the order"
        super().__init__(
            placeholder=self.resting,
            suggester=_OrderSuggester(fleet),
            id="order",
            compact=True,
            select_on_focus=False,  # what stands there is to be gone on with, not to be typed over
            max_length=MAX_LENGTH,
        )
        self._fleet = fleet
        self._history: History | None = None
        self._at = 0
        self._draft = ""

    def on_focus(self) -> None:
        """Earlier runs are fetched when they may be wanted."""
        self._show_writing(True)
        if self._history is None:
            self._fetch()

    def _show_writing(self, is_so: bool) -> None:
        self.placeholder = self.writing if is_so else self.resting
        if self.parent is not None:
            self.parent.set_class(is_so, "writing")

    def _fetch(self) -> None:
        self._history = History(history_file())
        self._at = len(self._history.lines)

    def on_blur(self) -> None:
        """Keys go elsewhere."""
        self._show_writing(False)

    def write(self, text: str) -> None:
        """Begin a line, for the operator to go on with."""
        self.screen.set_focus(self)  # at once: the next key is meant for it
        self.value = text
        self.cursor_position = len(text)

    def take_back(self, text: str) -> None:
        """What was given needs another look: the line as it was, below the sentence that says why."""
        with self.prevent(self.Changed):
            self.write(text)

    async def action_submit(self) -> None:
        """Give the order and clear the line: a second Enter gives it no second time. Who takes it leaves the line."""
        text = self.value.strip().removeprefix(":").strip()  # ":" opens the line; typed once more it means nothing
        self.value = self._draft = ""
        if text:
            if self._history is None:
                self._fetch()
            assert self._history is not None
            self._history.add(text)
            self._at = len(self._history.lines)
            self.post_message(self.Given(text))

    def action_history(self, step: int) -> None:
        """Fetch an earlier or later order; what was being written waits below the newest."""
        lines = self._history.lines if self._history is not None else []
        if self._at >= len(lines):
            self._draft = self.value
        self._at = max(0, min(len(lines), self._at + step))
        self.value = lines[self._at] if self._at < len(lines) else self._draft
        self.cursor_position = len(self.value)

    def action_complete(self) -> None:
        """Write what is certain: the only way to go on, or what all of them have in common."""
        found = completions(self.value, self._fleet)
        if not found:
            return
        certain = found[0] if len(found) == 1 else common_start(found)
        if len(certain) > len(self.value):
            self.value = certain
            self.cursor_position = len(certain)
        if len(found) > 1:
            self.post_message(self.Choices([line.rpartition(" ")[2] for line in found]))

    def action_leave(self) -> None:
        """Back to the fleet; what was written is dropped."""
        self.value = self._draft = ""
        self.screen.set_focus(self.screen.query_one("#fleet"))

    def _on_paste(self, event: events.Paste) -> None:
        """Pasted line breaks become spaces: one line, and only Enter sends it."""
        event.stop()
        event.prevent_default()
        text = " ".join(event.text.split())
        self.insert_text_at_cursor("".join(char for char in text if char.isprintable())[:MAX_LENGTH])
