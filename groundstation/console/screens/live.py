"""Bases of the screens and dialogs over the console: the worst alarm is on the last line of each."""

from __future__ import annotations

from typing import TypeVar

from textual.app import ComposeResult
from textual.screen import ModalScreen, Screen
from textual.widget import Widget

from groundstation.alarms.alarms import Alarms
from groundstation.console.widgets.bars import KEYS, URGENT_KEYS, VIEW_KEYS, StatusBar
from groundstation.fleet.state import FleetState

Answer = TypeVar("Answer")


class Dialog(ModalScreen[Answer]):
    """A box over the console.

    The console below is not drawn: to shade it costs as much as to draw it, and an emergency key would wait for that.
    """

    def __init__(self) -> None:
        super().__init__()
        self._status_bar = StatusBar("status")

    def compose(self) -> ComposeResult:
        """The last line; the box comes before it."""
        yield self._status_bar

    def show_alarms(self, alarms: Alarms, now_ns: int, kill: str | None, *, can_order: bool) -> None:
        """Show the worst of them, or the vehicle ``kill`` that the next press of the kill key means."""
        self._status_bar.show(alarms, now_ns, kill, URGENT_KEYS if can_order else VIEW_KEYS)


class LiveScreen(Screen[None]):
    """The console calls :meth:`show_fleet` eight times a second on the screen in front."""

    def __init__(self, alarms: Alarms) -> None:
        super().__init__()
        self.alarms = alarms
        self._status_bar = StatusBar("status")

    def body(self) -> Widget:
        """Return the widget above the last line."""
        raise NotImplementedError

    def compose(self) -> ComposeResult:
        """The body, and below it the same last line as everywhere."""
        yield self.body()
        yield self._status_bar

    def show_fleet(self, state: FleetState, now_ns: int, kill: str | None = None, *, can_order: bool = True) -> None:
        """Draw the fleet as it is now; ``kill``: the vehicle that the next press of the kill key means."""
        self._status_bar.show(self.alarms, now_ns, kill, KEYS if can_order else VIEW_KEYS)
