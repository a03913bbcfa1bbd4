"""The line for written orders: history on the arrows, completion on tab.

Pasted text becomes one line and waits for Enter.
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

from groundstation.fleet.operator_control import FORCE_WORD
from groundstation.formations.slots import formation_names
from groundstation.mission_files.names import mission_names
from groundstation.missions import mission_words
from groundstation.orders.intents import INTENTS
from onboard.config.file_reading import FileKind, read_bytes
from onboard.config.fleet import ConfigError, FleetConfig

CONTROL_ORDERS = ("take control", f"take control {FORCE_WORD}", "give control", "keep control")
MAX_LENGTH = 200
_KEPT = 200  # orders of the history
_HISTORY_FILE = FileKind("file of orders", 1_000_000)
_RESTING = "press :  and write an order, e.g. takeoff all 1.0"
_WRITING = "now write: every key goes here, enter gives the order"


def completions(text: str, fleet: FleetConfig) -> list[str]:
    """Return whole lines that begin with ``text`` and complete its last word.

    In a list of names it is the last name that is completed.
    """
    *done, last = text.split(" ")
    if not last:
        return []
    if not done:
        return _verbs(last)
    if done[0] == "mission" and len(done) == 1:
        return [f"mission {name}" for name in mission_names(last) if _continues(name, last)]
    if done[0] in ("take", "give", "keep"):
        return [order for order in CONTROL_ORDERS if _continues(order, text)]

    is_formation = done[0] == "formation"
    if is_formation and len(done) == 1:
        names = formation_names(fleet)
        return [f"formation {name}" for name in names if _continues(name, last)]

    words_before_vehicles = 1
    if is_formation:
        words_before_vehicles = 2  # with the formation's name
    if len(done) != words_before_vehicles:
        return []
    return [" ".join([*done, names]) for names in _vehicles(last, fleet)]


def _continues(word: str, start: str) -> bool:
    return word.startswith(start) and word != start


def _verbs(start: str) -> list[str]:
    """Return the verbs with this start; the rare ones only when no other verb has it."""
    verbs: list[str] = [verb for verb in INTENTS if _continues(verb, start)]
    if verbs:
        return verbs

    rare = ["reset", *mission_words.WORDS]
    for order in CONTROL_ORDERS:
        verb = order.partition(" ")[0]
        if verb not in rare:
            rare.append(verb)
    return [verb for verb in rare if _continues(verb, start)]


def _vehicles(text: str, fleet: FleetConfig) -> list[str]:
    """Return lists of vehicles that complete the last name of such a list."""
    before, comma, start = text.rpartition(",")
    names = fleet.enabled_names if comma else ("all", *fleet.enabled_names)
    already = before.split(",")
    return [
        f"{before}{comma}{name}"
        for name in names
        if _continues(name, start) and name not in already
    ]


def history_file() -> Path:
    """Return the file that keeps orders between runs: ``$XDG_STATE_HOME/covey/orders``."""
    state_home = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state_home) / "covey" / "orders"


class OrderHistory:
    """Orders that were written, oldest first, without repetitions in a row.

    They are kept in a file where one can be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            text = read_bytes(path, _HISTORY_FILE).decode("utf-8", "replace")
        except (ConfigError, RuntimeError):
            text = ""

        # whatever else stands in the file was not written here
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
        super().__init__(
            placeholder=_RESTING,
            suggester=_OrderSuggester(fleet),
            id="order",
            compact=True,
            select_on_focus=False,  # the next key goes on with the line and does not replace it
            max_length=MAX_LENGTH,
        )
        self._fleet = fleet
        # in the empty line: while keys go elsewhere, and while they go here
        self._resting_hint = _RESTING
        self._writing_hint = _WRITING

        self._history: OrderHistory | None = None  # loaded with the first focus
        self._position = 0  # in the history; its length stands for the line being written
        self._draft = ""  # the line being written, while an earlier one is shown

    def disable(self, hint: str) -> None:
        """Say in the empty line that nothing can be ordered."""
        self._resting_hint = hint
        self._writing_hint = hint
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
        self.placeholder = self._writing_hint if is_writing else self._resting_hint
        if self.parent is not None:
            self.parent.set_class(is_writing, "writing")

    def _load(self) -> OrderHistory:
        self._history = OrderHistory(history_file())
        self._position = len(self._history.lines)
        return self._history

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
        self.value = ""
        self._draft = ""
        if not text:
            return

        history = self._history or self._load()
        history.add(text)
        self._position = len(history.lines)
        self.post_message(self.Submitted(self, text))

    def action_history(self, step: int) -> None:
        """Show an earlier or later order; the line being written comes after the newest."""
        lines = (self._history or self._load()).lines
        if self._position >= len(lines):
            self._draft = self.value

        self._position = max(0, min(len(lines), self._position + step))
        if self._position < len(lines):
            self.value = lines[self._position]
        else:
            self.value = self._draft
        self.cursor_position = len(self.value)

    def action_complete(self) -> None:
        """Write the only completion, or the start that all completions have in common."""
        lines = completions(self.value, self._fleet)
        start = os.path.commonprefix(lines)  # noqa: RUF071 - of words
        if len(start) > len(self.value):
            self.value = start
            self.cursor_position = len(start)

        if len(lines) > 1:
            last_words = [line.rpartition(" ")[2] for line in lines]
            self.post_message(self.Completions(last_words))

    def action_leave(self) -> None:
        """Drop the line and go back to the fleet."""
        self.value = ""
        self._draft = ""
        self.screen.set_focus(self.screen.query_one("#fleet"))

    def on_paste(self, event: events.Paste) -> None:
        """Insert pasted text as one line: line breaks become spaces, and only Enter sends it."""
        event.stop()
        event.prevent_default()
        text = " ".join(event.text.split())
        printable = "".join(char for char in text if char.isprintable())
        self.insert_text_at_cursor(printable[:MAX_LENGTH])
