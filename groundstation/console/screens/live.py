"""Bases of the screens and dialogs over the console.

The worst alarm is on the last line of each.
"""

from __future__ import annotations

from typing import TypeVar

from textual.app import ComposeResult
from textual.screen import ModalScreen, Screen
from textual.widget import Widget

from groundstation.alarms.alarms import Alarms
from groundstation.console.widgets.bars import URGENT_KEYS, StatusBar
from groundstation.fleet.state import FleetState

Answer = TypeVar("Answer")


class Dialog(ModalScreen[Answer]):
    """A box over the console.

    The console below is not drawn: shading it costs as much as drawing it, and an emergency key
    would wait for that.
    """

    def __init__(self) -> None:
        super().__init__()
        self.status = StatusBar("status", URGENT_KEYS)

    def compose(self) -> ComposeResult:
        """The last line; the box comes before it."""
        yield self.status


class LiveScreen(Screen[None]):
    """The console calls :meth:`show_fleet` eight times a second on the screen in front."""

    def __init__(self, alarms: Alarms) -> None:
        super().__init__()
        self.alarms = alarms
        self.status = StatusBar("status")

    def body(self) -> Widget:
        """Return the widget above the last line."""
        raise NotImplementedError

    def compose(self) -> ComposeResult:
        """The body, and below it the same last line as everywhere."""
        yield self.body()
        yield self.status

    def show_fleet(self, state: FleetState, now_ns: int) -> None:
        """Draw the fleet as it is now."""
        raise NotImplementedError
