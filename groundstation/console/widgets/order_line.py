"""The line for written orders: the arrow keys show earlier orders, tab completes a word.

A pasted text becomes one line and is not sent before Enter.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Awaitable, Callable
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
_KEPT = 200  # orders that the history keeps
_HISTORY_FILE = FileKind("file of orders", 1_000_000)
_RESTING = "press :  and write an order, e.g. takeoff all 1.0"
_WRITING = "now write: every key goes here, enter gives the order"


def completions(text: str, fleet: FleetConfig) -> list[str]:
    """Return whole lines that begin with ``text`` and complete its last word.

    In a list of names, the last name is completed.
    """
    *earlier_words, last_word = text.split(" ")
    if not last_word:
        return []
    if not earlier_words:
        return _verbs(last_word)

    verb = earlier_words[0]
    if verb == "mission" and len(earlier_words) == 1:
        names = [name for name in mission_names(last_word) if _continues(name, last_word)]
        return [f"mission {name}" for name in names]
    if verb in ("take", "give", "keep"):
        return [order for order in CONTROL_ORDERS if _continues(order, text)]

    is_formation = verb == "formation"
    if is_formation and len(earlier_words) == 1:
        names = [name for name in formation_names(fleet) if _continues(name, last_word)]
        return [f"formation {name}" for name in names]

    words_before_vehicles = 1
    if is_formation:
        words_before_vehicles = 2  # with the formation's name
    if len(earlier_words) != words_before_vehicles:
        return []
    return [" ".join([*earlier_words, vehicles]) for vehicles in _vehicles(last_word, fleet)]


def _continues(word: str, start: str) -> bool:
    return word.startswith(start) and word != start


def _verbs(start: str) -> list[str]:
    """Return the verbs that begin with a text; rare ones only if no other verb does."""
    verbs: list[str] = [verb for verb in INTENTS if _continues(verb, start)]
    if verbs:
        return verbs

    rare = ["reset", *mission_words.WORDS]
    for order in CONTROL_ORDERS:
        verb, _, _ = order.partition(" ")
        if verb not in rare:
            rare.append(verb)
    return [verb for verb in rare if _continues(verb, start)]


def _vehicles(text: str, fleet: FleetConfig) -> list[str]:
    """Return lists of vehicles that complete the last name of such a list."""
    before, comma, start = text.rpartition(",")
    names = fleet.enabled_names if comma else ("all", *fleet.enabled_names)
    already_named = before.split(",")
    return [
        f"{before}{comma}{name}"
        for name in names
        if _continues(name, start) and name not in already_named
    ]


def history_file() -> Path | None:
    """Return the file that keeps orders between runs: ``$XDG_STATE_HOME/covey/orders``.

    None for a user without a home folder, for instance in a container.
    """
    state_home = os.environ.get("XDG_STATE_HOME")
    if state_home:
        return Path(state_home) / "covey" / "orders"
    try:
        return Path.home() / ".local" / "state" / "covey" / "orders"
    except RuntimeError:
        return None


class OrderHistory:
    """Earlier orders, oldest first, without immediate repetitions.

    They are kept in a file, if there is one and it can be written.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        text = ""
        if path is not None:
            with contextlib.suppress(ConfigError):
                text = read_bytes(path, _HISTORY_FILE).decode("utf-8", "replace")

        # Other lines were not written by this class, so they are left out.
        lines = [
            line
            for line in text.splitlines()
            if line and line.isprintable() and len(line) <= MAX_LENGTH
        ]
        self.lines = lines[-_KEPT:]

    def add(self, line: str) -> None:
        """Keep a line; if the file cannot be written, only for this run."""
        if self.lines[-1:] == [line]:
            return

        self.lines = [*self.lines, line][-_KEPT:]
        if self._path is not None:
            with contextlib.suppress(OSError):
                self._path.parent.mkdir(parents=True, exist_ok=True)
                self._path.write_text("\n".join(self.lines) + "\n", encoding="utf-8")


class _OrderSuggester(Suggester):
    def __init__(self, fleet: FleetConfig) -> None:
        super().__init__(use_cache=False, case_sensitive=True)
        self._fleet = fleet

    async def get_suggestion(self, value: str) -> str | None:
        return next(iter(completions(value, self._fleet)), None)


class OrderLine(Input):
    """An input with history and completion; escape leaves it without an order."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "history(-1)", "earlier order", show=False),
        Binding("down", "history(1)", "later order", show=False),
        Binding("tab", "complete", "complete", show=False),
        # Priority, so that each has its effect before the next key is read, also while the console
        # is busy: otherwise a colon after it would still belong to this line, and its letters would
        # be keys of the fleet table.
        Binding("escape", "drop", "leave", show=False, priority=True),
        Binding("enter", "submit", "order", show=False, priority=True),
    ]

    class Completions(Message):
        """Message: tab has found several words that complete the line."""

        def __init__(self, words: list[str]) -> None:
            super().__init__()
            self.words = words

    def __init__(self, fleet: FleetConfig) -> None:
        super().__init__(
            placeholder=_RESTING,
            suggester=_OrderSuggester(fleet),
            id="order",
            compact=True,
            select_on_focus=False,  # so that the next key does not replace the line
            max_length=MAX_LENGTH,
        )
        # Carries out a line. It is awaited, so that the next key finds what the order has changed.
        self.on_order: Callable[[str], Awaitable[None]] | None = None
        self.refused = ""  # the last line that was refused; a sentence says why
        self._fleet = fleet
        # Hints in the empty line: without and with the focus.
        self._resting_hint = _RESTING
        self._writing_hint = _WRITING

        self._history: OrderHistory | None = None  # loaded at the first focus
        self._position = 0  # index in the history; its length stands for the new line
        self._draft = ""  # the new line, while an earlier one is shown

    def disable(self, hint: str) -> None:
        """Show a hint that nothing can be ordered."""
        self._resting_hint = hint
        self._writing_hint = hint
        self.placeholder = hint

    def on_focus(self) -> None:
        """Show that keys go here, and load the orders of earlier runs."""
        self._show_writing(True)
        self._loaded_history()

    def on_blur(self) -> None:
        """Show that keys go elsewhere."""
        self._show_writing(False)

    def _show_writing(self, is_writing: bool) -> None:
        self.placeholder = self._writing_hint if is_writing else self._resting_hint
        if self.parent is not None:
            self.parent.set_class(is_writing, "writing")

    def _loaded_history(self) -> OrderHistory:
        """Return the history; the first call loads it."""
        if self._history is None:
            self._history = OrderHistory(history_file())
            self._position = len(self._history.lines)
        return self._history

    def write(self, text: str) -> None:
        """Begin a line, which the operator completes."""
        self.screen.set_focus(self)  # without delay, since the next key is for this widget
        self.value = text
        self.cursor_position = len(text)

    def take_back(self, text: str) -> None:
        """Show a refused line again, to be corrected."""
        self.refused = text
        with self.prevent(self.Changed):
            self.write(text)

    async def action_submit(self) -> None:
        """Hand the line over and clear it, so that a second Enter does not send it again."""
        await self._take_letters()
        # ":" opens the line; another one at its start is ignored.
        text = self.value.strip().removeprefix(":").strip()
        self.value = ""
        self._draft = ""
        if not text:
            return

        history = self._loaded_history()
        history.add(text)
        self._position = len(history.lines)
        if self.on_order is not None:
            await self.on_order(text)

    async def action_drop(self) -> None:
        """Leave the line without an order."""
        await self._take_letters()
        self.action_leave()

    async def _take_letters(self) -> None:
        """Wait until the line has taken the letters that were typed before the present key."""
        has_taken = asyncio.Event()
        if self.call_later(has_taken.set):
            await has_taken.wait()

    def action_history(self, step: int) -> None:
        """Show an earlier or later order; the new line comes after the newest order."""
        lines = self._loaded_history().lines
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
        start = os.path.commonprefix(lines)  # noqa: RUF071 - these texts are not paths
        if len(start) > len(self.value):
            self.value = start
            self.cursor_position = len(start)

        if len(lines) > 1:
            last_words = [line.split(" ")[-1] for line in lines]
            self.post_message(self.Completions(last_words))

    def action_leave(self) -> None:
        """Drop the line and go back to the fleet."""
        self.value = ""
        self._draft = ""
        self.screen.set_focus(self.screen.query_one("#fleet"))

    def on_paste(self, event: events.Paste) -> None:
        """Insert a pasted text as one line; line breaks become spaces, and Enter is needed."""
        event.stop()
        event.prevent_default()
        text = " ".join(event.text.split())
        printable = "".join(char for char in text if char.isprintable())
        self.insert_text_at_cursor(printable[:MAX_LENGTH])
