"""How a row of the fleet table is drawn: its columns, or what stands in their place."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from rich.cells import cell_len
from rich.segment import Segment
from rich.style import Style

from groundstation.console import theme
from groundstation.console.theme import BAD, CALM, FAINT, TEXT, clean, number
from groundstation.console.widgets.fleet_columns import READ_WIDTH, Cell, Column, Row, choose_columns, reason
from groundstation.fleet.state import VehicleView

_SILENCE_WIDTH = 18
_NO_SIGNS = str.maketrans("✖▲", "  ")
_WIDE, _LONG_NAME, _SHORT_NAME = 150, 24, 16
_FEW_COLUMNS = 10


@dataclass(frozen=True, slots=True)
class Layout:
    """What has room in a row: digits of the number, cells of the name, columns, cells left for the reason."""

    digits: int
    name_width: int
    columns: tuple[Column, ...]
    left: int

    @classmethod
    def of(cls, names: Iterable[str], width: int) -> Layout:
        """The layout for these vehicles in a table of this width."""
        cells = [cell_len(name) for name in names]
        digits = max(2, len(str(max(0, len(cells) - 1))))
        name_width = max(4, min(_LONG_NAME if width >= _WIDE else _SHORT_NAME, max(cells, default=4)))
        return cls(digits, name_width, *choose_columns(width - digits - name_width - 4))

    def heading(self) -> str:
        """The titles above the columns."""
        parts = [" " * (self.digits + 3) + theme.fit("name", self.name_width)]
        parts += [theme.fit(column.title, column.width, right=column.right) for column in self.columns]
        return " ".join(parts) + (" why" if self.left else "")


@dataclass(frozen=True, slots=True)
class Marks:
    """What is to be seen on a row besides its values; ``has_nodes``: the bus tells who is on it."""

    is_here: bool
    is_marked: bool
    is_blinking: bool
    has_focus: bool
    has_nodes: bool


def draw_row(layout: Layout, view: VehicleView, row: Row | None, place: int, marks: Marks) -> list[Segment]:
    """One row; ``row`` is None where nothing was ever heard."""
    tint = theme.style(theme.vehicle_colour(place), bold=True)
    name = theme.fit_name(clean(view.name, 80), layout.name_width)
    segments = [
        Segment("▌" if marks.is_here else " ", theme.style(TEXT if marks.has_focus else FAINT, bold=True)),
        Segment("✓" if marks.is_marked else " ", theme.style(CALM, bold=True)),
        Segment(f"{place:>{layout.digits}} {name} ", tint + Style(reverse=True) if marks.is_blinking else tint),
    ]
    if row is None:
        gone = "" if not marks.has_nodes or view.is_alive else " (not on the bus)"
        return [*segments, Segment(f"… waiting: nothing heard from its agent yet{gone}", theme.style(FAINT))]
    return segments + (_silent(layout, row, marks.has_nodes) if row.is_stale else _fresh(layout, row))


def _fresh(layout: Layout, row: Row) -> list[Segment]:
    """Values of now. On the ground the reason not to fly is worth more than numbers of a flight."""
    segments: list[Segment] = []
    told, left = row.told, layout.left
    has_reason = bool(told.not_ready or told.state == "failed") and not told.is_airborne and left < READ_WIDTH
    for index, column in enumerate(layout.columns):
        if has_reason and column.cover >= (1 if len(layout.columns) < _FEW_COLUMNS else 2):
            left += sum(other.width + 1 for other in layout.columns[index:])
            break
        segments.append(_cell(column.cell(row), column))
    if left:
        text, colour = reason(row)
        segments.append(Segment(theme.fit(text, left), theme.style(colour)))
    return segments


def _silent(layout: Layout, row: Row, has_nodes: bool) -> list[Segment]:
    """The silence takes the places of the first columns; of the others what was last heard, faint.

    A warning about the past is none, nor is its all clear: both go. Once PX4 itself says that it is disarmed, what was
    heard in the air holds no more, except about where to look for it.
    """
    silence = theme.fit(f"NO TELEM {number(row.age_s, 1, limit=99_999)} s", _SILENCE_WIDTH)
    segments = [Segment(f"{silence} ", theme.style(BAD, bold=True))]
    where = "" if not has_nodes else ", its agent is there" if row.view.is_alive else ", its agent has gone"
    if row.view.is_disarmed_by_px4:
        east_m, north_m, _ = row.told.position_enu_m
        spot = f"{number(east_m, 2, sign=True, limit=9999)} {number(north_m, 2, sign=True, limit=9999)}"
        place = f", last heard at {spot}" if row.told.is_position_valid else ""
        return [*segments, Segment(f"PX4 says disarmed{place}{where}", theme.style(TEXT))]
    end = 0
    for column in layout.columns:
        begin, end = end, end + column.width + 1
        if begin > _SILENCE_WIDTH:
            text, colour = column.cell(row)
            segments.append(_cell(("?" if text == "ok" else text.translate(_NO_SIGNS), colour), column, dim=True))
        elif end > _SILENCE_WIDTH + 1:  # begins below the silence: what is left of its width stays empty
            segments.append(Segment(" " * (end - _SILENCE_WIDTH - 1)))
    if layout.left:
        text = theme.fit(f"was {clean(row.told.state, 20)}{where}", layout.left)
        segments.append(Segment(text, theme.style(FAINT, dim=True)))
    return segments


def _cell(cell: Cell, column: Column, *, dim: bool = False) -> Segment:
    text, colour = cell
    return Segment(f"{theme.fit(text, column.width, right=column.right)} ", theme.style(colour, dim=dim))
