"""Bases of the screens and dialogs over the console.

The worst alarm is on the last line of each.
"""

from __future__ import annotations

from typing import TypeVar

from textual import events
from textual.app import ComposeResult
from textual.containers import Container
from textual.screen import ModalScreen, Screen
from textual.widget import Widget

from groundstation.alarms.alarms import Alarms
from groundstation.console.widgets.bars import URGENT_KEYS, StatusBar
from groundstation.console.widgets.fleet_glance import FleetGlance
from groundstation.console.widgets.fleet_table import FleetTable
from groundstation.fleet.state import FleetState

AnswerT = TypeVar("AnswerT")


class Dialog(ModalScreen[AnswerT]):
    """A box below the fleet, which goes on being drawn.

    The console behind is not drawn: shading it costs as much as drawing it, and an emergency key
    would wait for that. The rows of its table stand above the box instead.

    Args:
        table: table of the fleet; None leaves it out.
    """

    def __init__(self, table: FleetTable | None = None) -> None:
        super().__init__()
        self.status = StatusBar("status", URGENT_KEYS)
        self.glance: FleetGlance | None = None
        if table is not None:
            self.glance = FleetGlance(table)

    def boxes(self) -> ComposeResult:
        """Yield what the dialog itself shows."""
        raise NotImplementedError

    def compose(self) -> ComposeResult:
        """The fleet above, the box, and the last line."""
        if self.glance is not None:
            yield self.glance
        with Container(id="room"):
            yield from self.boxes()
        yield self.status

    def on_resize(self, event: events.Resize) -> None:
        """Leave the box more than half of the terminal."""
        if self.glance is not None:
            self.glance.fit(event.size.height)

    def room_height(self, height: int) -> int:
        """Return the rows that the box has in a terminal of this height."""
        glance_rows = 0 if self.glance is None else self.glance.height_in(height)
        return height - glance_rows - 1

    def show_fleet(self) -> None:
        """Draw the fleet as its table has it now."""
        if self.glance is not None:
            self.glance.show()


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
