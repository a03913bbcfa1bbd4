"""A whole screen that follows the fleet while it is in front, with the worst alarm on its last line."""

from __future__ import annotations

from textual.app import ComposeResult
from textual.screen import Screen
from textual.widget import Widget

from groundstation.alerts import Alarms
from groundstation.fleet import FleetState
from groundstation.tui.widgets.bars import StatusBar


class LiveScreen(Screen[None]):
    """The console calls :meth:`show_fleet` ten times a second on the screen in front."""

    def __init__(self, alarms: Alarms) -> None:
        super().__init__()
        self.alarms = alarms
        self._status_bar = StatusBar("status")

    def body(self) -> Widget:
        """What fills the screen above the last line."""
        raise NotImplementedError

    def compose(self) -> ComposeResult:
        """The body, and below it the same last line as everywhere."""
        yield self.body()
        yield self._status_bar

    def show_fleet(self, state: FleetState, now_ns: int, kill: str | None = None) -> None:
        """Draw the fleet as it is now; ``kill``: the vehicle that the next press of the kill key means."""
        self._status_bar.show(self.alarms, now_ns, kill)
