"""Base classes of the screens and dialogs in front of the console.

Each of them shows the worst alarm on its last line.
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
    """A box with the rows of the fleet above it, which are still updated.

    The console behind the box is not drawn. Shading it would take as long as drawing it, and an
    emergency key would have to wait for that.

    Args:
        table: table of the fleet; None: no fleet is shown.
    """

    def __init__(self, table: FleetTable | None = None) -> None:
        super().__init__()
        self.status = StatusBar("status", URGENT_KEYS)
        self.glance: FleetGlance | None = None
        if table is not None:
            self.glance = FleetGlance(table)

    def boxes(self) -> ComposeResult:
        """Yield the widgets of the dialog itself."""
        raise NotImplementedError

    def compose(self) -> ComposeResult:
        """Yield the fleet, the box, and the last line."""
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
        """Return the rows that are left for the box in a terminal of this height."""
        glance_rows = 0 if self.glance is None else self.glance.height_in(height)
        return height - glance_rows - 1

    def show_fleet(self) -> None:
        """Draw the present rows of the fleet's table."""
        if self.glance is not None:
            self.glance.show()


class LiveScreen(Screen[None]):
    """A screen that replaces the console; :meth:`show_fleet` is called eight times a second."""

    def __init__(self, alarms: Alarms) -> None:
        super().__init__()
        self.alarms = alarms
        self.status = StatusBar("status")

    def body(self) -> Widget:
        """Return the widget above the last line."""
        raise NotImplementedError

    def compose(self) -> ComposeResult:
        """Yield the body and the last line."""
        yield self.body()
        yield self.status

    def show_fleet(self, state: FleetState, now_ns: int) -> None:
        """Draw the present state of the fleet."""
        raise NotImplementedError
