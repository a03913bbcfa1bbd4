"""A row per vehicle: what it does, how it is, who is near, and why it cannot fly; sorted, filtered, marked.

A ScrollView with its own ``render_line``: a stock table costs ten times as much at 10 Hz. Cursor and marks belong to
vehicles and not to rows: a row that moves takes them along.
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
from groundstation.console.widgets.fleet_choice import is_wanted, sort_key
from groundstation.console.widgets.fleet_columns import SORTS, Row
from groundstation.console.widgets.fleet_rows import Layout, Marks, draw_row
from groundstation.console.widgets.lines import Lines
from groundstation.fleet.state import FleetState, VehicleView
from onboard.config.fleet import ConfigError, FleetConfig

SORT_S = 1.0  # rows that change places many times a second cannot be read
ALL_MARKED_S = 5.0  # a selection of everybody is forgotten by itself
BLINK_S, BLINK_PERIOD_S = 4.0, 0.6


class FleetTable(Lines, ScrollView, can_focus=True):
    """The fleet, one line each; the cursor's row is the vehicle that the kill key means, marks are who orders mean."""

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
        self._marks: set[str] = set()
        self._forget_s = math.inf
        self._typing, self._typed, self._refusal = "", "", ""
        self._views: list[VehicleView] = [VehicleView(name) for name in fleet.enabled_names]
        self._rows: list[VehicleView] = list(self._views)
        self._places = {view.name: place for place, view in enumerate(self._views)}
        self._sorted_s = -math.inf
        self._has_nodes = False
        self._now_ns = 0
        self._titles = ("", "")
        self._blink_until_s: dict[str, float] = {}
        self._say()

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
        return tuple(view.name for view in self._views if view.name in self._marks)

    @property
    def is_writing(self) -> bool:
        """Whether a filter or a list of places is being written: every key belongs to it."""
        return bool(self._typing)

    def mark(self, names: Iterable[str]) -> None:
        """Mark these and nobody else; unknown names are left out. Marks of everybody are forgotten after 5 s."""
        known = {view.name for view in self._views}
        self._marks = known & set(names)
        is_all = len(self._marks) > 1 and self._marks == known
        self._forget_s = self._now_s + ALL_MARKED_S if is_all else math.inf
        self._say()
        self.redraw()

    def blink(self, name: str) -> None:
        """Let a row blink for a while: this vehicle is showing itself."""
        self._blink_until_s[name] = self._now_s + BLINK_S

    def keep_marks(self) -> None:
        """Count the 5 s of a selection of everybody from now: the operator is still about it."""
        if math.isfinite(self._forget_s):
            self._forget_s = self._now_s + ALL_MARKED_S

    def show(self, state: FleetState, now_ns: int) -> None:
        """Draw this state."""
        self._views, self._now_ns, self._has_nodes = list(state.vehicles.values()), now_ns, bool(state.nodes)
        if list(self._places) != list(state.vehicles):
            self._places = {name: place for place, name in enumerate(state.vehicles)}
            self._marks &= self._places.keys()
        if self._now_s >= self._forget_s:
            self._marks, self._forget_s = set(), math.inf
        if self.is_due(now_ns, [_gist(view, now_ns) for view in self._views]):
            self._arrange()
            self._say()
            self.redraw()

    # -- keys --------------------------------------------------------------------------------------------------------

    def action_cursor(self, step: int) -> None:
        """Move the cursor by ``step`` rows."""
        self._move_to(self.cursor + step)

    def action_mark(self) -> None:
        """Mark the vehicle under the cursor, or not any more, and go on to the next."""
        name = self.selected
        if name is not None:
            self.mark(self._marks ^ {name})
            self.action_cursor(1)

    def action_mark_along(self, step: int) -> None:
        """Mark from here to the next row: a range, row by row."""
        names = [view.name for view in self._rows]
        if names:
            here = self.cursor
            there = max(0, min(len(names) - 1, here + step))
            self._move_to(there)
            self.mark(self._marks | {names[here], names[there]})

    def action_mark_all(self) -> None:
        """Mark all that are shown; when they are, mark nobody."""
        shown = {view.name for view in self._rows}
        self.mark(() if shown <= self._marks else self._marks | shown)

    def action_sort(self, step: int) -> None:
        """Sort by the next column."""
        self.sort = SORTS[(SORTS.index(self.sort) + step) % len(SORTS)]
        self._resort()

    def action_turn_sort(self) -> None:
        """Sort the other way round."""
        self.is_reversed = not self.is_reversed
        self._resort()

    def action_type(self, what: str) -> None:
        """Write a filter, or names and places to mark, in the table's own title; enter takes it, escape leaves."""
        self._typing, self._typed, self._refusal = what, self.filter if what == "filter" else "", ""
        self._say()

    def on_key(self, event: events.Key) -> None:
        """While something is written every key belongs to it; a digit begins a list of places to mark."""
        if not self._typing:
            if event.character is None or not event.character.isdigit():
                if event.key == "escape" and (self.filter or self._marks):
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
            self._take()
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
        """A click chooses the vehicle."""
        offset = event.get_content_offset(self)
        if offset is not None and offset.y > 0:
            self._move_to(offset.y - 1 + self.scroll_offset.y)

    def on_blur(self) -> None:
        """What is half written is dropped."""
        self._typing = ""
        self._say()
        self.redraw()

    def on_focus(self) -> None:
        """The cursor shows it."""
        self.redraw()

    def _take(self) -> None:
        """Enter: the filter stays; the list of places and names is marked, or a sentence says why not."""
        if self._typing == "mark" and self._typed.strip():
            try:
                names = self.fleet.select(self._typed.strip())
            except ConfigError as error:
                self._refusal = str(error)
                return
            self._typing = ""
            self.mark(names)
            self._move_to(next((row for row, view in enumerate(self._rows) if view.name in self._marks), self.cursor))
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

    # -- order and choice --------------------------------------------------------------------------------------------

    def _resort(self) -> None:
        self._sorted_s = -math.inf
        self._arrange()
        self._say()
        self.redraw()

    def _arrange(self) -> None:
        """Which rows are shown, and in which order; sorted once a second at most."""
        by_name = {view.name: view for view in self._views if not self.filter or self._is_wanted(view)}
        now_s = self._now_s
        if now_s - self._sorted_s >= SORT_S or {view.name for view in self._rows} != by_name.keys():
            self._sorted_s = now_s
            self._rows = sorted(by_name.values(), key=self._key)
        else:
            self._rows = [by_name[view.name] for view in self._rows]
        if self._cursor not in by_name:
            self._cursor = self._rows[min(self.cursor, len(self._rows) - 1)].name if self._rows else ""
        height = len(self._rows) + 1
        if self.virtual_size.height != height:
            self.virtual_size = Size(self.size.width, height)

    def _is_wanted(self, view: VehicleView) -> bool:
        return is_wanted(self._row(view), view.name, self._places.get(view.name, 0), self.filter)

    def _key(self, view: VehicleView) -> tuple[bool, float, str, int]:
        place = self._places.get(view.name, 0)
        return sort_key(self._row(view), view.name, place, self.sort, self.is_reversed)

    def _row(self, view: VehicleView) -> Row | None:
        if view.telemetry is None:
            return None
        drain = self.history.drains.get(view.name)
        is_stale = not view.is_fresh(self._now_ns)
        return Row(view, view.telemetry, self.fleet, drain, view.age_s(self._now_ns), is_stale)

    def _say(self) -> None:
        """The border tells what is written, filtered, sorted and marked."""
        title = "fleet" if len(self._views) < 10 else f"fleet of {len(self._views)}"
        if self._typing:
            title = f"{self._typing}: {self._typed}▏"
            title += f" {self._refusal}" if self._refusal else ""
        elif self.filter:
            title += f" · filter {self.filter}: {len(self._rows)} of {len(self._views)}"
        marks = self.marked
        said = ""
        if marks:
            shown = {view.name for view in self._rows}
            hidden = sum(name not in shown for name in marks)
            said = f"{len(marks)} marked" if len(marks) < len(self._views) or len(marks) < 2 else "ALL marked"
            said += f", {hidden} hidden by the filter" if hidden else ""
            left_s = self._forget_s - self._now_s
            said += f", {math.ceil(max(0.0, left_s))} s" if math.isfinite(left_s) else ""
        if self.sort != "place" or self.is_reversed:
            said += f"{' · ' if said else ''}by {self.sort} {'↓' if self.is_reversed else '↑'}"
        if self._titles != (title, said):
            self._titles = title, said
            self.border_title, self.border_subtitle = _plain(title), _plain(said)

    # -- drawing -----------------------------------------------------------------------------------------------------

    def draw(self, width: int, height: int) -> list[Strip]:
        """The heading stays on the first line; the rows scroll below it."""
        layout = Layout.of([view.name for view in self._views], width)
        # on a low terminal there is no border to show what is written or marked
        is_bare = self.size == self.outer_size and (self._typing or self._marks)
        heading = " ".join(reversed(self._titles)) if is_bare else layout.heading()
        lines = [Strip([Segment(theme.fit(heading, width), theme.style(FAINT))], width)]
        top, here, now_s = round(self.scroll_offset.y), self.selected, self._now_s
        for view in self._rows[top : top + height - 1]:
            is_blinking = (
                now_s < self._blink_until_s.get(view.name, -math.inf) and int(now_s * 2.0 / BLINK_PERIOD_S) % 2
            )
            marks = Marks(
                view.name == here, view.name in self._marks, bool(is_blinking), self.has_focus, self._has_nodes
            )
            segments = draw_row(layout, view, self._row(view), self._places.get(view.name, 0), marks)
            lines.append(Strip(segments).adjust_cell_length(width))
        if not self._rows and height > 1:
            empty = f"nobody matches '{clean(self.filter, 40)}'; esc shows all" if self.filter else "no vehicles"
            lines.append(Strip([Segment(theme.fit(f"    {empty}", width), theme.style(WARN))], width))
        return lines

    def watch_scroll_y(self, old_value: float, new_value: float) -> None:
        """Other rows are seen."""
        super().watch_scroll_y(old_value, new_value)
        self.redraw()


def _gist(view: VehicleView, now_ns: int) -> tuple[object, ...]:
    """What is worth a new picture at once; numbers can wait a little."""
    told = view.telemetry
    if told is None:
        return (view.is_alive,)
    return told.state, told.order_phase, told.not_ready, view.is_alive, view.is_fresh(now_ns), view.is_disarmed_by_px4


def _plain(text: str) -> str:
    """Border titles read markup; what is written there is none."""
    return text.replace("[", "\\[")
