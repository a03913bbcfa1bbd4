"""The fleet table: a row per vehicle, sorted, filtered and marked.

Cursor and marks belong to vehicles and not to rows: when rows are sorted, cursor and marks move
with their vehicles. So an order never reaches a vehicle that has just moved under the cursor.
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

SORT_S = 1.0  # time between two sortings; rows that change places faster cannot be read
BLINK_S = 4.0
BLINK_PERIOD_S = 0.6


class FleetTable(Lines, ScrollView, can_focus=True):
    """One line for each vehicle.

    The kill key applies to the vehicle under the cursor; order keys apply to the marked vehicles.
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
        self.sort = "place"
        self.is_reversed = False

        self._arranged_filter = ""  # filter of the rows as they are shown
        self._cursor = ""  # name of the vehicle under the cursor
        self._marks = FleetMarks()

        self._typing = ""  # purpose of the text that is typed now: "filter", "mark", or empty
        self._typed = ""  # the text so far
        self._refusal = ""  # reason why the text was refused

        self._views: list[VehicleView] = [VehicleView(name) for name in fleet.enabled_names]
        self._rows: list[VehicleView] = list(self._views)  # filtered and sorted
        self._numbers = fleet.numbers
        self._labels = fleet.labels
        self._sorted_s = -math.inf  # time of the last sorting
        self._has_nodes = False  # whether the agents on the bus are known
        self.latched: frozenset[str] = frozenset()  # vehicles that were killed from here
        self._now_ns = 0

        self._titles = ("", "")  # in the upper and in the lower border
        self._blink_until_s: dict[str, float] = {}
        self._update_titles()

    @property
    def _now_s(self) -> float:
        return self._now_ns * 1e-9

    @property
    def selected(self) -> str | None:
        """Name of the vehicle under the cursor; None if no row is shown."""
        names = [view.name for view in self._rows]
        if self._cursor in names:
            return self._cursor
        if names:
            return names[0]
        return None

    @property
    def cursor(self) -> int:
        """Index of the cursor's row among the shown rows."""
        return next((row for row, view in enumerate(self._rows) if view.name == self.selected), 0)

    @property
    def marked(self) -> tuple[str, ...]:
        """Marked vehicles in the order of the fleet file, including those that the filter hides."""
        return tuple(view.name for view in self._views if view.name in self._marks.names)

    @property
    def is_writing(self) -> bool:
        """Whether a filter or a list of vehicles is typed, so that every key belongs to it."""
        return bool(self._typing)

    def mark(self, names: Iterable[str]) -> None:
        """Mark these vehicles and no others; unknown names are left out."""
        self._marks.set(names, [view.name for view in self._views], self._now_s)
        self._update_titles()
        self.redraw()

    def blink(self, name: str) -> None:
        """Let the row of a vehicle blink for some seconds, because it was ordered to locate."""
        self._blink_until_s[name] = self._now_s + BLINK_S

    def keep_marks(self) -> None:
        """Keep marks on all vehicles for another five seconds."""
        self._marks.keep(self._now_s)

    def show(self, state: FleetState, now_ns: int, latched: frozenset[str] = frozenset()) -> None:
        """Draw this state of the fleet.

        Args:
            state: the fleet.
            now_ns: the ground's monotonic clock [ns].
            latched: vehicles that were killed from here, and not reset since.
        """
        self._views = list(state.vehicles.values())
        self._now_ns = now_ns
        self._has_nodes = bool(state.nodes)
        self.latched = latched

        self._marks.update(state.vehicles, self._now_s)

        urgent_values = [_urgent_values(view, now_ns) for view in self._views]
        if self.is_due(now_ns, [latched, *urgent_values]):
            self._arrange()
            self._update_titles()
            self.redraw()

    # -- keys --------------------------------------------------------------------------------------

    def action_cursor(self, step: int) -> None:
        """Move the cursor by ``step`` rows."""
        self._move_to(self.cursor + step)

    def action_mark(self) -> None:
        """Mark or unmark the vehicle under the cursor, and go to the next row."""
        name = self.selected
        if name is not None:
            self.mark(self._marks.names ^ {name})
            self.action_cursor(1)

    def action_mark_along(self, step: int) -> None:
        """Mark this row and the next one, and go there."""
        names = [view.name for view in self._rows]
        if not names:
            return

        this_row = self.cursor
        next_row = max(0, min(len(names) - 1, this_row + step))
        self._move_to(next_row)
        self.mark(self._marks.names | {names[this_row], names[next_row]})

    def action_mark_all(self) -> None:
        """Mark all shown vehicles; if they are marked already, remove all marks."""
        shown = {view.name for view in self._rows}
        if not shown:
            return
        marked = self._marks.names
        if shown <= marked:
            self.mark(())
        else:
            self.mark(marked | shown)

    def action_sort(self, step: int) -> None:
        """Sort by the next column."""
        self.sort = SORTS[(SORTS.index(self.sort) + step) % len(SORTS)]
        self._resort()

    def action_turn_sort(self) -> None:
        """Sort in the other direction."""
        self.is_reversed = not self.is_reversed
        self._resort()

    def action_type(self, purpose: str) -> None:
        """Begin to type a ``filter``, or vehicles to ``mark``, in the table's title.

        Enter accepts the text, escape drops it.
        """
        self._typing = purpose
        self._typed = self.filter if purpose == "filter" else ""
        self._refusal = ""
        self._update_titles()

    def on_key(self, event: events.Key) -> None:
        """Add a key to the text that is typed; a digit begins a list of vehicles to mark."""
        if not self._typing:
            is_digit = event.character is not None and event.character.isdigit()
            if is_digit:
                self.action_type("mark")
            elif event.key == "escape" and (self.filter or self._marks.names):
                event.stop()
                self._show_all_unmarked()
                return
            else:
                return

        event.stop()
        event.prevent_default()
        self._write_key(event)
        if self._typing == "filter":
            self.filter = self._typed
        self._resort()

    def _show_all_unmarked(self) -> None:
        self.filter = ""
        self.mark(())
        self._resort()

    def _write_key(self, event: events.Key) -> None:
        """Change the text that is typed by one key."""
        if event.key == "escape":
            if self._typing == "filter":
                self.filter = ""
            self._typing = ""
        elif event.key == "enter":
            self._accept()
        elif event.key in ("backspace", "ctrl+h"):
            self._typed = self._typed[:-1]
        elif event.key == "ctrl+u":
            self._typed = ""
        elif event.is_printable and event.character is not None:
            self._typed = clean(self._typed + event.character, 60)

    def on_click(self, event: events.Click) -> None:
        """Move the cursor to the clicked row."""
        offset = event.get_content_offset(self)
        if offset is not None and offset.y > 0:
            self._move_to(offset.y - 1 + self.scroll_offset.y)

    def on_blur(self) -> None:
        """Drop a text that was not accepted."""
        self._typing = ""
        self._update_titles()
        self.redraw()

    def on_focus(self) -> None:
        """Draw the cursor brightly, because keys go here now."""
        self.redraw()

    def _accept(self) -> None:
        """Keep the filter, or mark the typed vehicles; if that fails, show the reason."""
        if self._typing == "mark" and self._typed.strip():
            try:
                names = self.fleet.select(self._typed.strip())
            except ConfigError as error:
                self._refusal = str(error)
                return

            self._typing = ""
            self.mark(names)
            self._move_to(self._first_marked_row())
        self._typing = ""

    def _first_marked_row(self) -> int:
        """Return the first marked row, or the cursor's row if no marked vehicle is shown."""
        for row, view in enumerate(self._rows):
            if view.name in self._marks.names:
                return row
        return self.cursor

    def _move_to(self, row: int) -> None:
        if not self._rows:
            return

        row = max(0, min(len(self._rows) - 1, row))
        self._cursor = self._rows[row].name

        body_height = max(1, self.size.height - 1)  # the heading does not scroll
        top = max(row - body_height + 1, min(row, round(self.scroll_offset.y)))
        self.scroll_to(y=top, animate=False, force=True)
        self.redraw()

    # -- rows and titles ---------------------------------------------------------------------------

    def _resort(self) -> None:
        self._sorted_s = -math.inf
        self._arrange()
        self._update_titles()
        self.redraw()

    def _arrange(self) -> None:
        """Filter the rows, and sort them at most once a second, or if the rows have changed."""
        by_name = {view.name: view for view in self._views if self._is_shown(view)}
        self._arranged_filter = self.filter

        is_sort_due = self._now_s - self._sorted_s >= SORT_S
        has_changed = {view.name for view in self._rows} != by_name.keys()
        if is_sort_due or has_changed:
            self._sorted_s = self._now_s
            self._rows = sorted(by_name.values(), key=self._key)
        else:
            self._rows = [by_name[view.name] for view in self._rows]

        if self._cursor not in by_name:
            self._cursor = self._rows[0].name if self._rows else ""

        height = len(self._rows) + 1
        if self.virtual_size.height != height:
            self.virtual_size = Size(self.size.width, height)

    def _is_shown(self, view: VehicleView) -> bool:
        """Whether the filter lets a vehicle be shown.

        The row under the cursor stays although its vehicle no longer matches. Otherwise the
        cursor would jump, and the next order would reach another vehicle.
        """
        if not self.filter or self._is_match(view):
            return True
        is_new_filter = self.filter != self._arranged_filter
        return view.name == self._cursor and not is_new_filter

    def _is_match(self, view: VehicleView) -> bool:
        return is_match(self._row(view), view.name, self._labels.get(view.name, "?"), self.filter)

    def _key(self, view: VehicleView) -> tuple[bool, float, str, int]:
        return sort_key(
            self._row(view),
            name=view.name,
            index=self._numbers.get(view.name, 0),
            sort=self.sort,
            is_reversed=self.is_reversed,
        )

    def _row(self, view: VehicleView) -> VehicleRow | None:
        if view.telemetry is None:
            return None
        return VehicleRow(
            view=view,
            telemetry=view.telemetry,
            fleet=self.fleet,
            drain=self.history.drains.get(view.name),
            age_s=view.age_s(self._now_ns),
            is_stale=not view.is_fresh(self._now_ns),
            is_latched=view.name in self.latched,
        )

    def _update_titles(self) -> None:
        """Show the typed text, the filter, the sorting and the marks in the border."""
        titles = (self._upper_title(), self._lower_title())
        if self._titles != titles:
            self._titles = titles
            upper, lower = titles
            self.border_title = upper.replace("[", "\\[")
            self.border_subtitle = lower.replace("[", "\\[")

    def _upper_title(self) -> str:
        if self._typing:
            title = f"{self._typing}: {self._typed}▏"
            if self._refusal:
                title += f" {self._refusal}"
            return title

        title = "fleet"
        if len(self._views) >= 10:
            title += f" of {len(self._views)}"
        if self.filter:
            title += f" · filter {self.filter}: {len(self._rows)} of {len(self._views)}"
        return title

    def _lower_title(self) -> str:
        shown = [view.name for view in self._rows]
        title = self._marks.text(len(self._views), shown, self._now_s)

        if self.sort != "place" or self.is_reversed:
            if title:
                title += " · "
            arrow = "↓" if self.is_reversed else "↑"
            title += f"by {self.sort} {arrow}"

        hidden_words = self._hidden_words()
        if title and hidden_words:
            hidden_words += " · "
        return hidden_words + title

    def _hidden_words(self) -> str:
        """Return the numbers of vehicles above and below the visible part, in words."""
        rows_of_window = self.size.height - 1
        if rows_of_window < 1 or len(self._rows) <= rows_of_window:
            return ""
        above = round(self.scroll_offset.y)
        return _hidden_words(above, max(0, len(self._rows) - above - rows_of_window))

    # -- drawing -----------------------------------------------------------------------------------

    @property
    def row_count(self) -> int:
        """The number of vehicles that the filter shows."""
        return len(self._rows)

    def first_row(self, height: int) -> int:
        """Return the first row of a window of this height that contains the cursor."""
        rows_of_window = max(1, height - 1)
        if len(self._rows) > rows_of_window:
            rows_of_window = max(1, rows_of_window - 1)  # the last line says how many are hidden
        return max(0, self.cursor - rows_of_window + 1)

    def draw(self, width: int, height: int) -> list[Strip]:
        """Return the heading, which stays on the first line, and the rows in the window below."""
        has_border = self.size != self.outer_size
        return self.draw_from(
            round(self.scroll_offset.y), width, height, counts_hidden=not has_border
        )

    def draw_from(
        self, top: int, width: int, height: int, *, counts_hidden: bool = True
    ) -> list[Strip]:
        """Return the heading and the rows from a given one.

        Args:
            top: index of the first row.
            width: width of the picture, in cells.
            height: height of the picture, in cells.
            counts_hidden: whether the last line shows the number of vehicles without room.
        """
        names = [view.name for view in self._views]
        has_corrections = self.fleet.corrections is not None
        layout = RowLayout.of(
            names,
            width,
            last_number=max(self._numbers.values(), default=0),
            has_corrections=has_corrections,
        )
        lines = [self._heading(layout, width)]

        selected = self.selected
        now_s = self._now_s
        is_lit = int(now_s * 2.0 / BLINK_PERIOD_S) % 2 == 1

        shown = self._rows[top : top + height - 1]
        hidden_words = ""
        if counts_hidden and len(shown) < len(self._rows) and height > 2:
            shown = shown[: height - 2]
            hidden_words = _hidden_words(top, len(self._rows) - top - len(shown))

        for view in shown:
            name = view.name
            marks = RowMarks(
                has_cursor=name == selected,
                is_marked=name in self._marks.names,
                is_blinking=is_lit and now_s < self._blink_until_s.get(name, -math.inf),
                has_focus=self.has_focus,
                has_nodes=self._has_nodes,
            )
            segments = draw_row(
                layout,
                view,
                self._row(view),
                self._numbers.get(name, 0),
                self._labels.get(name, "?"),
                marks,
            )
            lines.append(Strip(segments).adjust_cell_length(width))

        if hidden_words:
            text = theme.fit(f"    {hidden_words}", width)
            lines.append(Strip([Segment(text, theme.style(WARN))], width))
        if not self._rows and height > 1:
            lines.append(self._empty_line(width))
        return lines

    def _heading(self, layout: RowLayout, width: int) -> Strip:
        # A low terminal has no border for these titles, so the heading shows them.
        is_bare = self.size == self.outer_size and (self._typing or self._marks.names)
        text = " ".join(reversed(self._titles)) if is_bare else layout.heading()
        return Strip([Segment(theme.fit(text, width), theme.style(FAINT))], width)

    def _empty_line(self, width: int) -> Strip:
        if self.filter:
            text = f"nobody matches '{clean(self.filter, 40)}'; esc shows all"
        else:
            text = "no vehicles"
        return Strip([Segment(theme.fit(f"    {text}", width), theme.style(WARN))], width)

    def watch_scroll_y(self, old_value: float, new_value: float) -> None:
        """Draw the rows that are visible now."""
        super().watch_scroll_y(old_value, new_value)
        self._update_titles()
        self.redraw()

    def on_resize(self) -> None:
        """Update the number of vehicles without room in the title."""
        self._update_titles()


def _hidden_words(above: int, below: int) -> str:
    """Return the numbers of hidden vehicles in words; empty if none is hidden."""
    words = []
    if above > 0:
        words.append(f"↑ +{above}")
    if below > 0:
        words.append(f"↓ +{below} more")
    return "  ".join(words)


def _urgent_values(view: VehicleView, now_ns: int) -> tuple[object, ...]:
    """Return the values whose change is drawn at once; other values can wait a little."""
    on_bus = (view.is_alive, view.is_fresh(now_ns))
    last = view.telemetry
    if last is None:
        return on_bus
    return (*on_bus, last.state, last.order_phase, last.not_ready, view.is_disarmed_by_px4)
