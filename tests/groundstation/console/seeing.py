"""What is on the console's screen, for tests."""

from __future__ import annotations

from textual.pilot import Pilot

from groundstation.console.app import ConsoleApp
from groundstation.console.widgets.fleet_table import FleetTable
from groundstation.console.widgets.plan_view import PlanView

SIZES = [(80, 24), (120, 40), (200, 60)]


def lines(app: ConsoleApp, kind: type) -> list[str]:
    widget = app.screen_stack[0].query_one(kind)
    return [widget.render_line(y).text for y in range(widget.size.height)]


def screen(app: ConsoleApp) -> list[str]:
    """The whole screen as it goes to the terminal."""
    return [strip.text for strip in app.screen._compositor.render_strips()]


async def see(app: ConsoleApp, pilot: Pilot[int]) -> None:
    app.refresh_fleet()
    await pilot.pause()


def table_of(app: ConsoleApp) -> FleetTable:
    return app.screen_stack[0].query_one(FleetTable)


def plan_of(app: ConsoleApp) -> PlanView:
    return app.screen_stack[0].query_one(PlanView)
