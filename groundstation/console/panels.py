"""The widgets of the main screen, and their arrangement."""

from __future__ import annotations

from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.widgets import Static

from groundstation.console.history import History
from groundstation.console.widgets.bars import StatusBar, TitleBar
from groundstation.console.widgets.event_log import EventLog
from groundstation.console.widgets.fleet_table import FleetTable
from groundstation.console.widgets.notices import NoticeLines
from groundstation.console.widgets.order_line import OrderLine
from groundstation.console.widgets.plan_view import PlanView
from groundstation.console.widgets.result_lines import ResultLines
from groundstation.console.widgets.separation_view import SeparationView
from onboard.config.fleet import FleetConfig


class Panels:
    """All widgets of the main screen.

    They are created once and kept as attributes. A query of the screen would find nothing if a
    timer fires while the screen is being closed.
    """

    def __init__(self, fleet: FleetConfig, history: History) -> None:
        self.title = TitleBar("title")
        self.table = FleetTable(fleet, history)
        self.plan = PlanView(fleet, history)
        self.separation = SeparationView(fleet, history)
        self.verdict = Static(id="verdict", markup=False)
        self.events = EventLog()
        self.notices = NoticeLines()
        self.results = ResultLines()
        self.order_line = OrderLine(fleet)
        self.status = StatusBar("status")

    def compose(self) -> ComposeResult:
        """Yield the widgets from the top to the bottom.

        The separation and the events are beside the plan; the verdict is below.
        """
        yield self.title
        yield self.table
        with Horizontal(id="middle"):
            yield self.plan
            with Vertical(id="right"):
                yield self.separation
                yield self.events
        yield self.verdict
        yield self.notices
        yield self.results
        with Horizontal(id="line"):
            yield Static(" : ", id="prompt", markup=False)
            yield self.order_line
            yield Static("esc leaves ", id="leave", markup=False)
        yield self.status
