"""The page of one vehicle.

It always shows the vehicle under the cursor of the fleet table, so that the kill key applies to the
shown vehicle.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import ClassVar

from textual.binding import Binding, BindingType
from textual.geometry import Size
from textual.scroll_view import ScrollView
from textual.strip import Strip
from textual.widget import Widget

from groundstation.alarms.alarms import Alarms
from groundstation.console.screens.live import LiveScreen
from groundstation.console.vehicle_drawing import blocks, heading
from groundstation.console.vehicle_subject import VehicleSubject
from groundstation.console.widgets.fleet_table import FleetTable
from groundstation.console.widgets.lines import Lines
from groundstation.fleet.state import FleetState
from groundstation.fleet.tick_stream import TickStream
from onboard.config.fleet import FleetConfig

_COLUMN_WIDTH = 58
_GAP = 2  # cells between two columns
_LOW_PAGE = 45  # height of the page below which charts are low
_LOW_CHART = 5  # rows of a low chart
_HIGH_CHART = 9
# number of columns -> for each column the indices of its blocks in the result of :func:`blocks`
_ARRANGEMENTS = {
    1: ((0, 1, 2, 3, 4, 5, 6),),
    2: ((0, 1, 5, 6), (2, 3, 4)),
    3: ((0, 1), (2, 3, 4), (5, 6)),
}


class VehicleScreen(LiveScreen):
    """Everything about one vehicle.

    Escape or enter goes back; ``]`` and ``[`` show the next vehicle and the one before.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,enter,q", "back", "back", show=False),
        Binding("right_square_bracket,tab,l", "other(1)", "next vehicle", show=False),
        Binding("left_square_bracket,shift+tab,h", "other(-1)", "vehicle before", show=False),
    ]

    def __init__(
        self,
        fleet: FleetConfig,
        alarms: Alarms,
        stream: TickStream,
        table: FleetTable,
        time_text: Callable[[int], str],
    ) -> None:
        super().__init__(alarms)
        self._stream = stream
        self._table = table
        self._page = VehicleBlocks(fleet, alarms, stream, time_text)

    def body(self) -> Widget:
        """Return the page."""
        return self._page

    def on_mount(self) -> None:
        """Give the keys to the page."""
        self._page.focus()

    def on_unmount(self) -> None:
        """Stop the vehicle's stream of ticks."""
        self._stream.follow(None)

    def show_fleet(self, state: FleetState, now_ns: int) -> None:
        """Draw the present state of the vehicle."""
        name = self._table.selected
        self._stream.follow(name)
        self._page.show(name, state, now_ns, is_latched=name in self._table.latched)

    def action_back(self) -> None:
        """Go back to the fleet."""
        self.dismiss()

    def action_other(self, step: int) -> None:
        """Show another vehicle."""
        self._table.action_cursor(step)
        self._page.scroll_to(y=0, animate=False, force=True)


class VehicleBlocks(Lines, ScrollView, can_focus=True):
    """Draws the blocks in one, two or three columns that scroll together."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("down,j", "scroll_page(1, False)", "down", show=False),
        Binding("up,k", "scroll_page(-1, False)", "up", show=False),
        Binding("pagedown,space", "scroll_page(1, True)", "page down", show=False),
        Binding("pageup", "scroll_page(-1, True)", "page up", show=False),
    ]

    def __init__(
        self,
        fleet: FleetConfig,
        alarms: Alarms,
        stream: TickStream,
        time_text: Callable[[int], str],
    ) -> None:
        super().__init__(id="vehicle")
        self._fleet = fleet
        self._alarms = alarms
        self._stream = stream
        self._time_text = time_text
        self._subject: VehicleSubject | None = None

    def show(
        self, name: str | None, state: FleetState, now_ns: int, *, is_latched: bool = False
    ) -> None:
        """Draw this vehicle."""
        view = None if name is None else state.vehicles.get(name)
        if view is None:
            self._subject = None
            self.border_title = "no vehicle"
        else:
            is_low = self.size.height < _LOW_PAGE
            self._subject = VehicleSubject(
                view=view,
                index=self._fleet.numbers.get(view.name, 0),
                state=state,
                fleet=self._fleet,
                now_ns=now_ns,
                tick_samples=list(self._stream.values),
                alarms=self._alarms.of(view.name),
                time_text=self._time_text,
                chart_rows=_LOW_CHART if is_low else _HIGH_CHART,
                is_replay=self._alarms.is_replay,
                is_latched=is_latched,
            )
            title = "".join(text for text, _ in heading(self._subject))
            self.border_title = title.replace("[", "(")
        self.redraw()

    def draw(self, width: int, height: int) -> list[Strip]:
        """Draw the whole page, and return the part in the window."""
        if self._subject is None:
            return []

        rows = self._all_rows(self._subject, width)
        self.virtual_size = Size(width, len(rows))

        top = min(self.scroll_offset.y, max(0, len(rows) - height))
        more = "↓ more · " if top + height < len(rows) else ""
        self.border_subtitle = rf"{more}\[ ] other vehicle · esc back"
        return rows[top : top + height]

    def _all_rows(self, subject: VehicleSubject, width: int) -> list[Strip]:
        """Return the whole page; its number of columns depends on the width."""
        count = max(1, min(3, width // _COLUMN_WIDTH))
        column_width = (width - _GAP * (count - 1)) // count
        parts = blocks(subject, column_width)

        columns = []
        for block_indices in _ARRANGEMENTS[count]:
            column: list[Strip] = []
            for index in block_indices:
                column += parts[index]
            columns.append(column)

        # Missing lines of a short column are blank.
        blank = Strip.blank(column_width)
        rows = []
        for cells in itertools.zip_longest(*columns, fillvalue=blank):
            pieces = [cells[0]]
            for cell in cells[1:]:
                pieces += [Strip.blank(_GAP), cell]
            rows.append(Strip.join(pieces).adjust_cell_length(width))
        return rows

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Disable the keys that enlarge a panel: the page has all the room already.

        Escape then reaches the screen, which goes back.
        """
        return action not in ("alone", "together")

    def action_scroll_page(self, step: int, is_page: bool) -> None:
        """Scroll by lines or by pages."""
        lines = max(1, self.size.height - 2) if is_page else 1
        self.scroll_relative(y=step * lines, animate=False, force=True)

    def watch_scroll_y(self, old_value: float, new_value: float) -> None:
        """Show another part of the page."""
        super().watch_scroll_y(old_value, new_value)
        self.forget_picture()
