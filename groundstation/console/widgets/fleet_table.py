"""The fleet table: a row per vehicle, sorted, filtered and marked.

A ScrollView with its own ``render_line``: Textual's DataTable took 57 % of a core for 100 rows at
10 Hz. Cursor and marks belong to vehicles and not to rows: a row that moves takes them along.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import ClassVar

from rich.segment import Segment
from textual import events
from textual.binding import Binding, BindingType
from textual.geometry import Size
from textual.scroll_view import ScrollView
from textual.strip import Strip

from groundstation.console import theme
from groundstation.console.history import History
from groundstation.console.theme import FAINT, WARN, clean
from groundstation.console.widgets.fleet_choice import is_match, sort_key
from groundstation.console.widgets.fleet_columns import SORTS, VehicleRow
from groundstation.console.widgets.fleet_marks import FleetMarks
from groundstation.console.widgets.fleet_rows import RowLayout, RowMarks, draw_row
from groundstation.console.widgets.lines import Lines
from groundstation.fleet.state import FleetState, VehicleView
from onboard.config.fleet import ConfigError, FleetConfig

SORT_S = 1.0  # rows that change places many times a second cannot be read
BLINK_S, BLINK_PERIOD_S = 4.0, 0.6


class FleetTable(Lines, ScrollView, can_focus=True):
    """One line for each vehicle; the kill key means the one under the cursor, order keys mean the
    marked ones.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up,k", "cursor(-1)", "up", show=False),
        Binding("down,j", "cursor(1)", "down", show=False),
        Binding("home,g", "cursor(-1000000)", "first", show=False),
        Binding("end,G", "cursor(1000000)", "last", show=False),
        Binding("space", "mark", "mark", show=False),
        Binding("shift+up,K", "mark_along(-1)", "mark upward", show=False),
        Binding("shift+down,J", "mark_along(1)", "mark downward", show=False),
        Binding("asterisk,ctrl+a", "mark_all", "mark all or none", show=False),
        Binding("slash", "type('filter')", "filter", show=False),
        Binding("m", "type('mark')", "mark by id or range", show=False),
        Binding("s", "sort(1)", "sort by", show=False),
        Binding("S", "turn_sort", "sort the other way", show=False),
    ]

    def __init__(self, fleet: FleetConfig, history: History | None = None) -> None:
        super().__init__(id="fleet")
        self.fleet = fleet
        self.history = history or History()
        self.filter = ""
        self.sort, self.is_reversed = "place", False
        self._cursor = ""
        self._marks = FleetMarks()
        # "filter" or "mark"; its text; why it was refused
        self._typing, self._typed, self._refusal = "", "", ""
        self._views: list[VehicleView] = [VehicleView(name) for name in fleet.enabled_names]
        self._rows: list[VehicleView] = list(self._views)
        self._indices = {name: index for index, name in enumerate(fleet.enabled_names)}
        self._sorted_s = -math.inf
        self._has_nodes = False
        self._now_ns = 0
        self._titles = ("", "")
        self._blink_until_s: dict[str, float] = {}
        self._update_titles()

    @property
    def _now_s(self) -> float:
        return self._now_ns * 1e-9

    @property
    def selected(self) -> str | None:
        """Name of the vehicle under the cursor; None when no row is shown."""
        names = [view.name for view in self._rows]
        return self._cursor if self._cursor in names else names[0] if names else None

    @property
    def cursor(self) -> int:
        """Row of the cursor, as shown."""
        return next((row for row, view in enumerate(self._rows) if view.name == self.selected), 0)

    @property
    def marked(self) -> tuple[str, ...]:
        """Marked vehicles, in the order of the fleet file, also those that the filter hides."""
        return tuple(view.name for view in self._views if view.name in self._marks.names)

    @property
    def is_writing(self) -> bool:
        """Whether a filter or a list of vehicles is being written: every key belongs to it."""
        return bool(self._typing)

    def mark(self, names: Iterable[str]) -> None:
        """Mark these vehicles and no others; unknown names are left out."""
        self._marks.set(names, self._indices, self._now_s)
        self._update_titles()
        self.redraw()

    def blink(self, name: str) -> None:
        """Let a row blink for a while: this vehicle shows itself."""
        self._blink_until_s[name] = self._now_s + BLINK_S

    def keep_marks(self) -> None:
        """Keep marks on all vehicles for another five seconds."""
        self._marks.keep(self._now_s)

    def show(self, state: FleetState, now_ns: int) -> None:
        """Draw this state."""
        self._views, self._now_ns, self._has_nodes = (
            list(state.vehicles.values()),
            now_ns,
            bool(state.nodes),
        )
        if list(self._indices) != list(state.vehicles):
            self._indices = {name: index for index, name in enumerate(state.vehicles)}
        self._marks.update(self._indices, self._now_s)
        if self.is_due(now_ns, [_urgent_values(view, now_ns) for view in self._views]):
            self._arrange()
            self._update_titles()
            self.redraw()

    # -- keys --------------------------------------------------------------------------------------

    def action_cursor(self, step: int) -> None:
        """Move the cursor by ``step`` rows."""
        self._move_to(self.cursor + step)

    def action_mark(self) -> None:
        """Mark or unmark the vehicle under the cursor, and go to the next."""
        name = self.selected
        if name is not None:
            self.mark(self._marks.names ^ {name})
            self.action_cursor(1)

    def action_mark_along(self, step: int) -> None:
        """Mark this row and the next one, and go there."""
        names = [view.name for view in self._rows]
        if names:
            here = self.cursor
            there = max(0, min(len(names) - 1, here + step))
            self._move_to(there)
            self.mark(self._marks.names | {names[here], names[there]})

    def action_mark_all(self) -> None:
        """Mark all that are shown; when they are marked already, mark none."""
        shown, marked = {view.name for view in self._rows}, self._marks.names
        self.mark(() if shown <= marked else marked | shown)

    def action_sort(self, step: int) -> None:
        """Sort by the next column."""
        self.sort = SORTS[(SORTS.index(self.sort) + step) % len(SORTS)]
        self._resort()

    def action_turn_sort(self) -> None:
        """Sort in the other direction."""
        self.is_reversed = not self.is_reversed
        self._resort()

    def action_type(self, purpose: str) -> None:
        """Write a ``filter``, or vehicles to ``mark``, into the table's own title; enter takes it,
        escape leaves.
        """
        self._typing, self._typed, self._refusal = (
            purpose,
            self.filter if purpose == "filter" else "",
            "",
        )
        self._update_titles()

    def on_key(self, event: events.Key) -> None:
        """Add a key to what is being written; a digit begins a list of vehicles to mark."""
        if not self._typing:
            if event.character is None or not event.character.isdigit():
                if event.key == "escape" and (self.filter or self._marks.names):
                    event.stop()
                    self.filter = ""
                    self.mark(())
                    self._resort()
                return
            self.action_type("mark")
        event.stop()
        event.prevent_default()
        if event.key == "escape":
            self.filter = "" if self._typing == "filter" else self.filter
            self._typing = ""
        elif event.key == "enter":
            self._accept()
        elif event.key in ("backspace", "ctrl+h"):
            self._typed = self._typed[:-1]
        elif event.key == "ctrl+u":
            self._typed = ""
        elif event.is_printable and event.character is not None:
            self._typed = clean(self._typed + event.character, 60)
        if self._typing == "filter":
            self.filter = self._typed
        self._resort()

    def on_click(self, event: events.Click) -> None:
        """Move the cursor to the vehicle."""
        offset = event.get_content_offset(self)
        if offset is not None and offset.y > 0:
            self._move_to(offset.y - 1 + self.scroll_offset.y)

    def on_blur(self) -> None:
        """Drop what is half written."""
        self._typing = ""
        self._update_titles()
        self.redraw()

    def on_focus(self) -> None:
        """Show by the cursor that keys go here."""
        self.redraw()

    def _accept(self) -> None:
        """Keep the filter, or mark the vehicles that were written; a sentence says why not."""
        if self._typing == "mark" and self._typed.strip():
            try:
                names = self.fleet.select(self._typed.strip())
            except ConfigError as error:
                self._refusal = str(error)
                return
            self._typing = ""
            self.mark(names)
            marked = self._marks.names
            self._move_to(
                next(
                    (row for row, view in enumerate(self._rows) if view.name in marked), self.cursor
                )
            )
        self._typing = ""

    def _move_to(self, row: int) -> None:
        if not self._rows:
            return
        row = max(0, min(len(self._rows) - 1, row))
        self._cursor = self._rows[row].name
        body = max(1, self.size.height - 1)  # the heading stays where it is
        top = max(row - body + 1, min(row, round(self.scroll_offset.y)))
        self.scroll_to(y=top, animate=False, force=True)
        self.redraw()

    # -- rows and titles ---------------------------------------------------------------------------

    def _resort(self) -> None:
        self._sorted_s = -math.inf
        self._arrange()
        self._update_titles()
        self.redraw()

    def _arrange(self) -> None:
        """Filter and sort the rows; sorted once a second at most."""
        by_name = {
            view.name: view for view in self._views if not self.filter or self._is_match(view)
        }
        now_s = self._now_s
        if now_s - self._sorted_s >= SORT_S or {view.name for view in self._rows} != by_name.keys():
            self._sorted_s = now_s
            self._rows = sorted(by_name.values(), key=self._key)
        else:
            self._rows = [by_name[view.name] for view in self._rows]
        if self._cursor not in by_name:
            self._cursor = (
                self._rows[min(self.cursor, len(self._rows) - 1)].name if self._rows else ""
            )
        height = len(self._rows) + 1
        if self.virtual_size.height != height:
            self.virtual_size = Size(self.size.width, height)

    def _is_match(self, view: VehicleView) -> bool:
        return is_match(self._row(view), view.name, self._indices.get(view.name, 0), self.filter)

    def _key(self, view: VehicleView) -> tuple[bool, float, str, int]:
        index = self._indices.get(view.name, 0)
        return sort_key(self._row(view), view.name, index, self.sort, self.is_reversed)

    def _row(self, view: VehicleView) -> VehicleRow | None:
        if view.telemetry is None:
            return None
        drain = self.history.drains.get(view.name)
        is_stale = not view.is_fresh(self._now_ns)
        return VehicleRow(
            view, view.telemetry, self.fleet, drain, view.age_s(self._now_ns), is_stale
        )

    def _update_titles(self) -> None:
        """Show in the border what is written, filtered, sorted and marked."""
        title = "fleet" if len(self._views) < 10 else f"fleet of {len(self._views)}"
        if self._typing:
            title = f"{self._typing}: {self._typed}▏"
            title += f" {self._refusal}" if self._refusal else ""
        elif self.filter:
            title += f" · filter {self.filter}: {len(self._rows)} of {len(self._views)}"
        below = self._marks.text(len(self._views), [view.name for view in self._rows], self._now_s)
        if self.sort != "place" or self.is_reversed:
            below += f"{' · ' if below else ''}by {self.sort} {'↓' if self.is_reversed else '↑'}"
        if self._titles != (title, below):
            self._titles = title, below
            self.border_title, self.border_subtitle = (
                title.replace("[", "\\["),
                below.replace("[", "\\["),
            )

    # -- drawing -----------------------------------------------------------------------------------

    def draw(self, width: int, height: int) -> list[Strip]:
        """Return the heading, which stays on the first line, and the rows in the window below it."""
        layout = RowLayout.of([view.name for view in self._views], width)
        # A low terminal has no border to show what is written or marked.
        is_bare = self.size == self.outer_size and (self._typing or self._marks.names)
        heading = " ".join(reversed(self._titles)) if is_bare else layout.heading()
        lines = [Strip([Segment(theme.fit(heading, width), theme.style(FAINT))], width)]
        top, selected, now_s = round(self.scroll_offset.y), self.selected, self._now_s
        is_lit = int(now_s * 2.0 / BLINK_PERIOD_S) % 2 == 1
        for view in self._rows[top : top + height - 1]:
            name = view.name
            is_blinking = is_lit and now_s < self._blink_until_s.get(name, -math.inf)
            marks = RowMarks(
                name == selected,
                name in self._marks.names,
                is_blinking,
                self.has_focus,
                self._has_nodes,
            )
            segments = draw_row(layout, view, self._row(view), self._indices.get(name, 0), marks)
            lines.append(Strip(segments).adjust_cell_length(width))
        if not self._rows and height > 1:
            empty = (
                f"nobody matches '{clean(self.filter, 40)}'; esc shows all"
                if self.filter
                else "no vehicles"
            )
            lines.append(
                Strip([Segment(theme.fit(f"    {empty}", width), theme.style(WARN))], width)
            )
        return lines

    def watch_scroll_y(self, old_value: float, new_value: float) -> None:
        """Draw the rows that have come into the window."""
        super().watch_scroll_y(old_value, new_value)
        self.redraw()


def _urgent_values(view: VehicleView, now_ns: int) -> tuple[object, ...]:
    """Return the values whose change is drawn at once; numbers can wait a little."""
    last = view.telemetry
    values = (
        ()
        if last is None
        else (last.state, last.order_phase, last.not_ready, view.is_disarmed_by_px4)
    )
    return view.is_alive, view.is_fresh(now_ns), *values
