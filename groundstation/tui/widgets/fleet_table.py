"""A row per vehicle: what it does, how it is, who is near, and why it cannot fly.

A ScrollView with its own ``render_line``: a stock table costs ten times as much at 10 Hz.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from rich.segment import Segment
from textual.binding import Binding, BindingType
from textual.geometry import Region, Size
from textual.scroll_view import ScrollView
from textual.strip import Strip

from groundstation.fleet import FleetState, VehicleView
from groundstation.tui import look
from groundstation.tui.look import BAD, CALM, FAINT, GOOD, TEXT, WARN, clean, number
from onboard.bus.schema import Telemetry
from onboard.config import FleetConfig

Cell = tuple[str, str]  # text and colour


@dataclass(frozen=True, slots=True)
class Column:
    """``rank`` decides who stays when the terminal is narrow: 0 always."""

    title: str
    width: int
    rank: int
    cell: Callable[[Telemetry, FleetConfig], Cell]
    right: bool = False


def _state(told: Telemetry, fleet: FleetConfig) -> Cell:
    sign, colour = look.STATE_SIGNS.get(told.state, ("?", WARN))
    return f"{sign} {clean(told.state, 20)}", colour


def _battery(told: Telemetry, fleet: FleetConfig) -> Cell:
    percent = told.battery_frac * 100.0
    text = f"{number(percent, 0, limit=999):>3}%" if number(percent, 0, limit=999) != "-" else "  - "
    if percent <= fleet.fleet.battery_land_pct:
        return f"✖{text}", BAD
    return (f"▲{text}", WARN) if percent <= fleet.fleet.battery_warning_pct else (f" {text}", TEXT)


def _battery_bar(told: Telemetry, fleet: FleetConfig) -> Cell:
    return look.meter(told.battery_frac, 5), _battery(told, fleet)[1].replace(TEXT, GOOD)


def _nearest(told: Telemetry, fleet: FleetConfig) -> Cell:
    if not told.nearest_vehicle or number(told.nearest_distance_m, 2) == "-":
        return "-", FAINT
    text = f"{number(told.nearest_distance_m, 2):>5} {clean(told.nearest_vehicle, 12)}"
    limit_m = fleet.fleet.safety_distance_m
    if told.nearest_distance_m < limit_m:
        return text, BAD if told.is_airborne else TEXT
    return text, WARN if told.nearest_distance_m < 1.25 * limit_m and told.is_airborne else TEXT


def _law(told: Telemetry, fleet: FleetConfig) -> Cell:
    status = clean(told.law_status, 12).lower()
    if told.law == "off":
        return "off", WARN
    if status in ("", "inactive"):
        return "·", FAINT
    bars = "▮" * max(1, min(4, round(told.intervention_m_s2 / 0.8))) if number(told.intervention_m_s2) != "-" else "▮"
    if status == "saturated":
        return f"{bars:<4} {number(told.intervention_m_s2)}", CALM
    return f"{bars:<4} {status}", WARN


def _order(told: Telemetry, fleet: FleetConfig) -> Cell:
    if not told.order_kind:
        return "·", FAINT
    phase = clean(told.order_phase, 20)
    colour = GOOD if phase == "done" else BAD if phase in ("failed", "refused") else TEXT
    return f"{clean(told.order_kind, 10)} {phase}".strip(), colour


def _why(told: Telemetry, fleet: FleetConfig) -> Cell:
    if told.not_ready and not told.is_airborne:
        more = f" (+{len(told.not_ready) - 1})" if len(told.not_ready) > 1 else ""
        return f"{clean(told.not_ready[0], 160)}{more}", WARN
    return clean(told.reason, 160), BAD if told.state == "failed" else FAINT


def _speed(told: Telemetry, fleet: FleetConfig) -> Cell:
    return number(sum(axis * axis for axis in told.velocity_enu_m_s) ** 0.5, 1), TEXT


def _position(told: Telemetry, fleet: FleetConfig) -> Cell:
    if not told.is_position_valid:
        return "no position", WARN
    return " ".join(f"{number(axis, 2, sign=True, limit=9999):>6}" for axis in told.position_enu_m[:2]), TEXT


def _height(told: Telemetry, fleet: FleetConfig) -> Cell:
    return (number(told.position_enu_m[2], 2, limit=9999) if told.is_position_valid else "-"), TEXT


COLUMNS = (
    Column("state", 12, 0, _state),
    Column("armed", 5, 2, lambda told, fleet: ("armed", WARN) if told.is_armed else ("·", FAINT)),
    Column("mode", 9, 5, lambda told, fleet: (clean(told.mode, 12) or "-", TEXT)),
    Column("x      y m", 13, 4, _position),
    Column("z m", 5, 1, _height, True),
    Column("m/s", 4, 2, _speed, True),
    Column(" bat", 5, 0, _battery),
    Column("", 5, 8, _battery_bar),
    Column("volt", 5, 6, lambda told, fleet: (number(told.battery_voltage_v, 1, limit=999), TEXT), True),
    Column("near m", 11, 1, _nearest),
    Column("law", 9, 3, _law),
    Column("order", 17, 3, _order),
    Column("loop p99", 8, 9, lambda told, fleet: (number(told.loop_period_p99_ms, 1, unit=" ms"), FAINT), True),
)
_AGE_WIDTH, _NUMBER_WIDTH, _WHY_WIDTH = 5, 3, 12


def choose_columns(width: int, name_width: int) -> tuple[tuple[Column, ...], int]:
    """Columns that fit, in their order, and what is left for the reason at the end (0: no room)."""
    left = width - _NUMBER_WIDTH - name_width - 1 - _AGE_WIDTH - 2
    kept: set[int] = set()
    for index in sorted(range(len(COLUMNS)), key=lambda index: COLUMNS[index].rank):
        if COLUMNS[index].width + 1 <= left:
            kept.add(index)
            left -= COLUMNS[index].width + 1
        else:
            break
    return tuple(COLUMNS[index] for index in sorted(kept)), left if left >= _WHY_WIDTH else 0


class FleetTable(ScrollView, can_focus=True):
    """The fleet, one line each; the cursor's row is the vehicle that the kill key means."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up,k", "cursor(-1)", "up", show=False),
        Binding("down,j", "cursor(1)", "down", show=False),
    ]

    def __init__(self, fleet: FleetConfig) -> None:
        super().__init__(id="fleet")
        self.fleet = fleet
        self.cursor = 0
        self._views: list[VehicleView] = []
        self._now_ns = 0
        self.border_title = "fleet"

    @property
    def selected(self) -> str | None:
        """Name of the vehicle under the cursor."""
        names = self.fleet.enabled_names
        return names[self.cursor] if 0 <= self.cursor < len(names) else None

    def show(self, state: FleetState, now_ns: int) -> None:
        """Draw this state; the age column changes even when nothing else does."""
        self._views, self._now_ns = list(state.vehicles.values()), now_ns
        height = len(self._views) + 1
        if self.virtual_size.height != height:
            self.virtual_size = Size(self.size.width, height)
        self.refresh()

    def action_cursor(self, step: int) -> None:
        """Move the cursor by ``step`` rows."""
        self.cursor = max(0, min(len(self.fleet.enabled_names) - 1, self.cursor + step))
        self.scroll_to_region(Region(0, self.cursor + 1, 1, 1), animate=False)
        self.refresh()

    def render_line(self, y: int) -> Strip:
        """The heading stays on the first line; the rows scroll below it."""
        width = self.size.width
        row = y + self.scroll_offset.y - 1 if y else -1
        names = [view.name for view in self._views] or list(self.fleet.enabled_names)
        name_width = max(4, min(16, max((len(name) for name in names), default=4)))
        columns, left = choose_columns(width, name_width)
        if row < 0:
            parts = [" " * _NUMBER_WIDTH + look.fit("name", name_width)]
            parts += [look.fit(column.title, column.width, right=column.right) for column in columns]
            age_width = _AGE_WIDTH if left else width - len(" ".join(parts)) - 2
            parts += [look.fit("age s", age_width, right=True)] + ([" why"] if left else [])
            return Strip([Segment(look.fit(" ".join(parts), width), look.style(FAINT))])
        if row >= len(self._views):
            return Strip.blank(width)
        segments = self._row(self._views[row], row, name_width, columns, left)
        return Strip(segments).adjust_cell_length(width)

    def _row(
        self, view: VehicleView, row: int, name_width: int, columns: tuple[Column, ...], left: int
    ) -> list[Segment]:
        told = view.telemetry
        is_here = row == self.cursor
        colour = look.vehicle_colour(row)
        gap = Segment(" ")
        segments = [
            Segment("▌" if is_here else " ", look.style(TEXT if self.has_focus else FAINT, bold=True)),
            Segment(f"{row:>1} "[:2], look.style(colour, bold=True)),
            Segment(look.fit(view.name, name_width), look.style(colour, bold=True)),
            gap,
        ]
        if told is None:
            return [*segments, Segment("… waiting: nothing heard from its agent yet", look.style(FAINT))]
        is_stale = not view.is_fresh(self._now_ns)
        if is_stale:
            silence = f"NO TELEM {number(view.age_s(self._now_ns), 1, limit=9999)} s"
            segments += [Segment(look.fit(silence, 18), look.style(BAD, bold=True)), gap]
        for index, column in enumerate(columns):
            # The silence takes the places of state and its neighbours; what was last heard follows, dimmed.
            if is_stale and sum(item.width + 1 for item in columns[: index + 1]) <= 19:
                continue
            text, tint = column.cell(told, self.fleet)
            segments += [
                Segment(look.fit(text, column.width, right=column.right), look.style(tint, dim=is_stale)),
                gap,
            ]
        if not is_stale:
            age_s = number(view.age_s(self._now_ns), 1, limit=9999)
            used = sum(segment.cell_length for segment in segments)
            age_width = _AGE_WIDTH if left else self.size.width - used - 1
            segments.append(Segment(look.fit(age_s, age_width, right=True), look.style(FAINT)))
            if left:
                text, tint = _why(told, self.fleet)
                segments += [Segment(" "), Segment(look.fit(text, left), look.style(tint))]
        return segments
