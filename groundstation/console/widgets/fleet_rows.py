"""Draws one row of the fleet table: its columns, or words instead of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from rich.cells import cell_len
from rich.segment import Segment
from rich.style import Style

from groundstation.console import theme
from groundstation.console.theme import BAD, CALM, FAINT, TEXT, clean, number
from groundstation.console.widgets.fleet_columns import (
    KILLED,
    WIDE_REASON_WIDTH,
    Cell,
    Column,
    VehicleRow,
    fit_columns,
    reason,
)
from groundstation.fleet.state import VehicleView

_SILENCE_WIDTH = 18
_NO_SIGNS = str.maketrans("✖▲", "  ")  # replaces warning signs by blanks
_WIDE = 150  # width from which there is room for long names
_LONG_NAME = 24
_SHORT_NAME = 16
_FEW_COLUMNS = 10

# A reason not to fly that has too little room is written over some columns. Their ``cover`` is at
# least one of these:
_COVERED_ALWAYS = 2
_COVERED_AMONG_FEW = 1  # where few columns are shown
_NEVER_COVERED = 3  # no column has this value


@dataclass(frozen=True, slots=True)
class RowLayout:
    """The parts of a row that have room."""

    digits: int  # digits of the number
    name_width: int
    columns: tuple[Column, ...]
    reason_width: int  # cells beside the columns for the reason of the state; 0: no room

    @classmethod
    def of(
        cls, names: Iterable[str], width: int, *, last_number: int, has_corrections: bool = False
    ) -> RowLayout:
        """Return the layout of a table of this width.

        Args:
            names: names of the shown vehicles.
            width: width of the table, in cells.
            last_number: largest number of a vehicle in the fleet file.
            has_corrections: whether the fleet uses RTK corrections.
        """
        name_widths = [cell_len(name) for name in names]
        digits = max(2, len(str(last_number)))

        most = _LONG_NAME if width >= _WIDE else _SHORT_NAME
        name_width = max(4, min(most, max(name_widths, default=4)))

        # in front of the columns: the cursor, the mark, the index, a blank, the name, a blank
        room = width - digits - name_width - 4
        columns, reason_width = fit_columns(room, has_corrections=has_corrections)
        return cls(digits, name_width, columns, reason_width)

    def heading(self) -> str:
        """Return the titles above the columns."""
        titles = [" " * (self.digits + 3) + theme.fit("name", self.name_width)]
        for column in self.columns:
            titles.append(theme.fit(column.title, column.width, right=column.right))
        if self.reason_width:
            titles.append("why")
        return " ".join(titles)


@dataclass(frozen=True, slots=True)
class RowMarks:
    """Marks of a row besides its values."""

    has_cursor: bool
    is_marked: bool
    is_blinking: bool
    has_focus: bool
    has_nodes: bool  # whether the agents on the bus are known


def draw_row(
    layout: RowLayout,
    view: VehicleView,
    row: VehicleRow | None,
    index: int,
    label: str,
    marks: RowMarks,
) -> list[Segment]:
    """Return one row.

    Args:
        layout: the parts of a row that have room.
        view: the vehicle.
        row: its values; None if no telemetry was received yet.
        index: its number in the fleet file, which gives its colour.
        label: its number, or its name, which is not written twice.
        marks: marks of the row besides its values.
    """
    number_text = "" if label == view.name else label
    tint = theme.style(theme.vehicle_colour(index), bold=True)
    if marks.is_blinking:
        tint += Style(reverse=True)
    cursor_tint = theme.style(TEXT if marks.has_focus else FAINT, bold=True)
    name = theme.fit_name(clean(view.name, 80), layout.name_width)

    segments = [
        Segment("▌" if marks.has_cursor else " ", cursor_tint),
        Segment("✓" if marks.is_marked else " ", theme.style(CALM, bold=True)),
        Segment(f"{number_text:>{layout.digits}} {name} ", tint),
    ]

    if row is None:
        text = "… waiting: nothing heard from its agent yet"
        if marks.has_nodes and not view.is_alive:
            text += " (not on the bus)"
        return [*segments, Segment(text, theme.style(FAINT))]
    if row.is_stale:
        return segments + _silent(layout, row, marks.has_nodes)
    return segments + _fresh(layout, row)


def _fresh(layout: RowLayout, row: VehicleRow) -> list[Segment]:
    """Return the present values; the reason not to fly may cover the last columns."""
    segments: list[Segment] = []
    least_cover = _least_cover(layout, row)
    reason_width = layout.reason_width
    for position, column in enumerate(layout.columns):
        if column.cover >= least_cover:
            covered = layout.columns[position:]
            reason_width += sum(other.width + 1 for other in covered)
            break
        segments.append(_cell(column.cell(row), column))

    if reason_width:
        text, colour = reason(row)
        segments.append(Segment(theme.fit(text, reason_width), theme.style(colour)))
    return segments


def _least_cover(layout: RowLayout, row: VehicleRow) -> int:
    """Return the ``cover`` from which columns give their room to the reason."""
    telemetry = row.telemetry
    is_refusing = telemetry.not_ready or row.state in ("failed", KILLED)
    if telemetry.is_airborne or not is_refusing:
        return _NEVER_COVERED
    if layout.reason_width >= WIDE_REASON_WIDTH:
        return _NEVER_COVERED
    if len(layout.columns) < _FEW_COLUMNS:
        return _COVERED_AMONG_FEW
    return _COVERED_ALWAYS


def _silent(layout: RowLayout, row: VehicleRow, has_nodes: bool) -> list[Segment]:
    """Return how long the vehicle has been silent, over the first columns, and its last values.

    Old values are faint, and show neither a warning nor an "ok". If PX4 itself has reported that it
    is disarmed, only the last position is shown.
    """
    silence = theme.fit(f"NO TELEM {number(row.age_s, 1, limit=99_999)} s", _SILENCE_WIDTH)
    segments = [Segment(f"{silence} ", theme.style(BAD, bold=True))]

    agent = ""
    if has_nodes:
        agent = ", its agent is there" if row.view.is_alive else ", its agent has gone"

    if row.view.is_disarmed_by_px4:
        text = f"PX4 says disarmed{_last_position(row)}{agent}"
        return [*segments, Segment(text, theme.style(TEXT))]

    end = 0
    for column in layout.columns:
        begin = end
        end = begin + column.width + 1
        if begin > _SILENCE_WIDTH:
            text, colour = column.cell(row)
            text = text.translate(_NO_SIGNS)
            if text == "ok":
                text = "?"
            segments.append(_cell((text, colour), column, dim=True))
        elif end > _SILENCE_WIDTH + 1:
            # The duration covers the start of this column, so the rest of the column stays empty.
            segments.append(Segment(" " * (end - _SILENCE_WIDTH - 1)))

    if layout.reason_width:
        text = theme.fit(f"was {clean(row.state, 20)}{agent}", layout.reason_width)
        segments.append(Segment(text, theme.style(FAINT, dim=True)))
    return segments


def _last_position(row: VehicleRow) -> str:
    if not row.telemetry.is_position_valid:
        return ""
    east_m, north_m, _ = row.telemetry.position_enu_m
    east = number(east_m, 2, sign=True, limit=9999)
    north = number(north_m, 2, sign=True, limit=9999)
    return f", last heard at {east} {north}"


def _cell(cell: Cell, column: Column, *, dim: bool = False) -> Segment:
    text, colour = cell
    fitted = theme.fit(text, column.width, right=column.right)
    return Segment(f"{fitted} ", theme.style(colour, dim=dim))
