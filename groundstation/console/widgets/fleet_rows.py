"""Drawing of one row of the fleet table: its columns, or the words that stand in place of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from rich.cells import cell_len
from rich.segment import Segment
from rich.style import Style

from groundstation.console import theme
from groundstation.console.theme import BAD, CALM, FAINT, TEXT, clean, number
from groundstation.console.widgets.fleet_columns import (
    WIDE_REASON_WIDTH,
    Cell,
    Column,
    VehicleRow,
    fit_columns,
    reason,
)
from groundstation.fleet.state import VehicleView

_SILENCE_WIDTH = 18
_NO_SIGNS = str.maketrans("✖▲", "  ")
_WIDE, _LONG_NAME, _SHORT_NAME = 150, 24, 16
_FEW_COLUMNS = 10


@dataclass(frozen=True, slots=True)
class RowLayout:
    """The parts of a row that have room."""

    digits: int  # of the index
    name_width: int
    columns: tuple[Column, ...]
    left: int  # cells for the reason

    @classmethod
    def of(cls, names: Iterable[str], width: int) -> RowLayout:
        """Return the layout for these vehicles in a table of this width."""
        cells = [cell_len(name) for name in names]
        digits = max(2, len(str(max(0, len(cells) - 1))))
        name_width = max(
            4, min(_LONG_NAME if width >= _WIDE else _SHORT_NAME, max(cells, default=4))
        )
        return cls(digits, name_width, *fit_columns(width - digits - name_width - 4))

    def heading(self) -> str:
        """Return the titles above the columns."""
        parts = [" " * (self.digits + 3) + theme.fit("name", self.name_width)]
        parts += [
            theme.fit(column.title, column.width, right=column.right) for column in self.columns
        ]
        return " ".join(parts) + (" why" if self.left else "")


@dataclass(frozen=True, slots=True)
class RowMarks:
    """Marks of a row besides its values."""

    has_cursor: bool
    is_marked: bool
    is_blinking: bool
    has_focus: bool
    has_nodes: bool  # the bus says which agents are on it


def draw_row(
    layout: RowLayout, view: VehicleView, row: VehicleRow | None, index: int, marks: RowMarks
) -> list[Segment]:
    """Return one row; ``row`` is None where no telemetry was ever received."""
    tint = theme.style(theme.vehicle_colour(index), bold=True)
    name = theme.fit_name(clean(view.name, 80), layout.name_width)
    segments = [
        Segment(
            "▌" if marks.has_cursor else " ",
            theme.style(TEXT if marks.has_focus else FAINT, bold=True),
        ),
        Segment("✓" if marks.is_marked else " ", theme.style(CALM, bold=True)),
        Segment(
            f"{index:>{layout.digits}} {name} ",
            tint + Style(reverse=True) if marks.is_blinking else tint,
        ),
    ]
    if row is None:
        gone = "" if not marks.has_nodes or view.is_alive else " (not on the bus)"
        return [
            *segments,
            Segment(f"… waiting: nothing heard from its agent yet{gone}", theme.style(FAINT)),
        ]
    return segments + (
        _silent(layout, row, marks.has_nodes) if row.is_stale else _fresh(layout, row)
    )


def _fresh(layout: RowLayout, row: VehicleRow) -> list[Segment]:
    """Current values; on the ground the reason not to fly may cover the columns about flying."""
    segments: list[Segment] = []
    telemetry, left = row.telemetry, layout.left
    is_refusing = (
        bool(telemetry.not_ready or telemetry.state == "failed") and not telemetry.is_airborne
    )
    cover = (
        3
        if not is_refusing or left >= WIDE_REASON_WIDTH
        else 1
        if len(layout.columns) < _FEW_COLUMNS
        else 2
    )
    for at, column in enumerate(layout.columns):
        if column.cover >= cover:
            left += sum(other.width + 1 for other in layout.columns[at:])
            break
        segments.append(_cell(column.cell(row), column))
    if left:
        text, colour = reason(row)
        segments.append(Segment(theme.fit(text, left), theme.style(colour)))
    return segments


def _silent(layout: RowLayout, row: VehicleRow, has_nodes: bool) -> list[Segment]:
    """The silence in place of the first columns, and the last values of the others, faint.

    Old values show neither a warning nor an all clear. Once PX4 itself says that it is disarmed,
    only the last position remains.
    """
    silence = theme.fit(f"NO TELEM {number(row.age_s, 1, limit=99_999)} s", _SILENCE_WIDTH)
    segments = [Segment(f"{silence} ", theme.style(BAD, bold=True))]
    agent = (
        ""
        if not has_nodes
        else ", its agent is there"
        if row.view.is_alive
        else ", its agent has gone"
    )
    if row.view.is_disarmed_by_px4:
        east_m, north_m, _ = row.telemetry.position_enu_m
        position = f"{number(east_m, 2, sign=True, limit=9999)} {number(north_m, 2, sign=True, limit=9999)}"
        last = f", last heard at {position}" if row.telemetry.is_position_valid else ""
        return [*segments, Segment(f"PX4 says disarmed{last}{agent}", theme.style(TEXT))]
    end = 0
    for column in layout.columns:
        begin, end = end, end + column.width + 1
        if begin > _SILENCE_WIDTH:
            text, colour = column.cell(row)
            segments.append(
                _cell(
                    ("?" if text == "ok" else text.translate(_NO_SIGNS), colour), column, dim=True
                )
            )
        # begins below the silence: what is left of its width stays empty
        elif end > _SILENCE_WIDTH + 1:
            segments.append(Segment(" " * (end - _SILENCE_WIDTH - 1)))
    if layout.left:
        text = theme.fit(f"was {clean(row.telemetry.state, 20)}{agent}", layout.left)
        segments.append(Segment(text, theme.style(FAINT, dim=True)))
    return segments


def _cell(cell: Cell, column: Column, *, dim: bool = False) -> Segment:
    text, colour = cell
    return Segment(
        f"{theme.fit(text, column.width, right=column.right)} ", theme.style(colour, dim=dim)
    )
