"""The console's screen as a test reads it."""

from __future__ import annotations

from typing import Any

from textual.app import App
from textual.css.query import NoMatches
from textual.pilot import Pilot
from textual.screen import Screen
from textual.strip import Strip
from textual.widget import Widget
from textual.widgets import Static

from groundstation.console.app import ConsoleApp
from groundstation.console.widgets.fleet_table import FleetTable
from groundstation.console.widgets.plan_view import PlanView

SIZES = [(80, 24), (120, 40), (200, 60)]


def lines(app: ConsoleApp, kind: type[Widget]) -> list[str]:
    """The lines of a widget of the main screen."""
    widget = app.screen_stack[0].query_one(kind)
    return [widget.render_line(y).text for y in range(widget.size.height)]


def strips(app: App[Any]) -> list[Strip]:
    """The front screen: each widget in the part of it that is visible, later ones over earlier
    ones.
    """
    screen = app.screen
    rows = [Strip.blank(screen.size.width)] * screen.size.height
    for widget in screen.walk_children(Widget, with_self=True):
        if not isinstance(widget, Screen) and not widget.is_on_screen:
            continue
        part = screen.find_widget(widget).visible_region
        for y, strip in enumerate(
            widget.render_lines(part.translate(-widget.region.offset)), part.y
        ):
            rows[y] = Strip.join([rows[y].crop(0, part.x), strip, rows[y].crop(part.right)])
    return rows


def screen(app: App[Any]) -> list[str]:
    """The text of the front screen."""
    return [strip.text for strip in strips(app)]


def words(app: App[Any], name: str) -> str:
    """The text of a Static of the front screen; empty where there is none."""
    try:
        return str(app.screen.query_one(f"#{name}", Static).render())
    except NoMatches:
        return ""


async def see(app: ConsoleApp, pilot: Pilot[int]) -> None:
    app.refresh_fleet()
    await pilot.pause()


def table_of(app: ConsoleApp) -> FleetTable:
    return app.screen_stack[0].query_one(FleetTable)


def plan_of(app: ConsoleApp) -> PlanView:
    return app.screen_stack[0].query_one(PlanView)
