"""The columns of the fleet table: what each says of a vehicle, and which stay when the terminal is narrow. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from groundstation.console import theme
from groundstation.console.history import Drain
from groundstation.console.theme import BAD, CALM, FAINT, GOOD, TEXT, WARN, clean, number
from groundstation.fleet.state import VehicleView
from onboard.bus.schema import Telemetry
from onboard.config.fleet import FleetConfig

Cell = tuple[str, str]  # text and colour
_GRAVITY_M_S2 = 9.81
_SLOW_LINK_S, _LOST_LINK_S = 0.3, 1.0  # between agent and PX4
_SHORT_MIN = 2.0
_LIVE_S = 0.3  # younger news is as good as new; its exact age would only flicker


@dataclass(frozen=True, slots=True)
class Row:
    """All that a cell may look at; ``told`` is the last telemetry, however old."""

    view: VehicleView
    told: Telemetry
    fleet: FleetConfig
    drain: Drain | None
    age_s: float
    is_stale: bool


@dataclass(frozen=True, slots=True)
class Column:
    """``rank`` decides who stays when the terminal is narrow: 0 always. ``sort``: key, smaller first, nan last."""

    title: str
    width: int
    rank: int
    cell: Callable[[Row], Cell]
    right: bool = False
    sort: Callable[[Row], float] | None = None
    cover: int = 0  # on the ground a reason not to fly takes its place: 2 always, 1 where the reason is short of room


def _state(row: Row) -> Cell:
    sign, colour = theme.STATE_SIGNS.get(row.told.state, ("?", WARN))
    return f"{sign} {clean(row.told.state, 20)}", colour


def _mode(row: Row) -> Cell:
    return clean(row.told.mode, 12) or "-", TEXT


def _armed(row: Row) -> Cell:
    return ("ARMED", WARN) if row.view.is_armed else ("·", FAINT)


def _position(row: Row) -> Cell:
    if not row.told.is_position_valid:
        return "no position", WARN
    x_m, y_m, _ = row.told.position_enu_m
    return f"{number(x_m, 2, sign=True, limit=9999):>6} {number(y_m, 2, sign=True, limit=9999):>6}", TEXT


def _height(row: Row) -> Cell:
    if not row.told.is_position_valid:
        return "-", WARN
    height_m = row.told.position_enu_m[2]
    return number(height_m, 2, limit=9999), theme.height_colour(height_m, row.fleet.fleet.geofence_m.z)


def _speed_m_s(row: Row) -> float:
    east, north, up = row.told.velocity_enu_m_s
    return math.hypot(east, north, up) if row.told.is_position_valid else math.nan


def _speed(row: Row) -> Cell:
    return number(_speed_m_s(row), 1), TEXT


def _battery(row: Row) -> Cell:
    percent = row.told.battery_frac * 100.0
    text = number(percent, 0, limit=999)
    if text == "-" or percent < 0.0:
        return "  -", FAINT
    if percent <= row.fleet.fleet.battery_land_pct:
        return f"✖{text:>3}%", BAD
    return (f"▲{text:>3}%", WARN) if percent <= row.fleet.fleet.battery_warning_pct else (f" {text:>3}%", TEXT)


def _voltage(row: Row) -> Cell:
    return number(row.told.battery_voltage_v, 1, limit=999), TEXT


def _trend(row: Row) -> Cell:
    if row.drain is None:
        return "·", FAINT
    per_min = 100.0 * row.drain.per_min_frac
    sign = "↓" if per_min < -0.05 else "↑" if per_min > 0.05 else "→"
    return f"{sign}{number(abs(per_min), 1, limit=99)}", TEXT


def _left(row: Row) -> Cell:
    left_min = math.inf if row.drain is None else row.drain.left_min
    if not math.isfinite(left_min):
        return "·", FAINT
    if left_min < _SHORT_MIN:
        return f"▲{60.0 * left_min:.0f} s", WARN
    return ("> 99", TEXT) if left_min > 99.0 else (f"{left_min:.0f} min", TEXT)


def _link(row: Row) -> Cell:
    age_s = row.told.autopilot_age_s
    if not math.isfinite(age_s):
        return "no PX4", WARN
    if age_s > _LOST_LINK_S:
        return f"✖{number(age_s, 1, limit=999)} s", BAD
    return (f"▲{age_s:.1f} s", WARN) if age_s > _SLOW_LINK_S else ("ok", GOOD)


def _age(row: Row) -> Cell:
    return (f"<{_LIVE_S:g}" if row.age_s < _LIVE_S else number(row.age_s, 1, limit=9999)), FAINT


def _near(row: Row) -> Cell:
    told, limit_m = row.told, row.fleet.fleet.safety_distance_m
    if not told.nearest_vehicle or number(told.nearest_distance_m, 2) == "-":
        return "-", FAINT
    is_below, is_close = told.nearest_distance_m < limit_m, told.nearest_distance_m < 1.1 * limit_m
    sign = " " if not told.is_airborne else "✖" if is_below else "▲" if is_close else " "
    colour = BAD if sign == "✖" else WARN if sign == "▲" else TEXT
    return f"{sign}{number(told.nearest_distance_m, 2):>5} {clean(told.nearest_vehicle, 40)}", colour


def _oist(row: Row) -> Cell:
    told = row.told
    if told.law == "off":
        return "▲ law off", WARN
    status = clean(told.law_status, 12).lower()
    if status in ("", "inactive"):
        return "·", FAINT
    authority_m_s2 = _GRAVITY_M_S2 * math.tan(math.radians(row.fleet.vehicles[row.view.name].max_tilt_deg)) if (
        row.view.name in row.fleet.vehicles
    ) else _GRAVITY_M_S2  # fmt: skip
    share = told.intervention_m_s2 / authority_m_s2 if math.isfinite(told.intervention_m_s2) else 1.0
    bar = "▮" * min(4, max(1, math.ceil(4.0 * share)))
    if status == "saturated":
        return f"{bar:▯<4} {number(told.intervention_m_s2)}", CALM
    return f"▲{bar:▯<4} {status}", WARN


def _order(row: Row) -> Cell:
    if not row.told.order_kind:
        return "·", FAINT
    phase = clean(row.told.order_phase, 20)
    colour = GOOD if phase == "done" else BAD if phase in ("failed", "refused") else TEXT
    return f"{clean(row.told.order_kind, 10)} {phase}".strip(), colour


def reason(row: Row) -> Cell:
    """Why it cannot fly, or why it does what it does."""
    told = row.told
    if told.not_ready and not told.is_airborne:
        more = f" (+{len(told.not_ready) - 1})" if len(told.not_ready) > 1 else ""
        return f"{clean(told.not_ready[0], 160)}{more}", WARN
    return clean(told.reason, 160), BAD if told.state == "failed" else FAINT


def _position_in(order: tuple[str, ...]) -> Callable[[Row], float]:
    return lambda row: float(order.index(row.told.state)) if row.told.state in order else -1.0


def _near_m(row: Row) -> float:
    return row.told.nearest_distance_m if row.told.nearest_vehicle else math.nan


_BY_URGENCY = ("failed", "landing", "taking off", "flying", "holding", "armed", "waiting", "ready", "landed")
COLUMNS = (
    Column("state", 12, 0, _state, sort=_position_in(_BY_URGENCY)),
    Column("mode", 9, 9, _mode),
    Column("armed", 5, 7, _armed),
    Column("x      y m", 13, 8, _position),
    Column("z m", 5, 1, _height, True, sort=lambda row: -row.told.position_enu_m[2]),
    Column("m/s", 4, 5, _speed, True, sort=lambda row: -_speed_m_s(row)),
    Column("bat", 5, 0, _battery, sort=lambda row: row.told.battery_frac),
    Column("volt", 4, 10, _voltage, True),
    Column("%/min", 5, 11, _trend, True),
    Column("left", 6, 6, _left, True, sort=lambda row: row.drain.left_min if row.drain is not None else math.nan),
    Column("PX4", 6, 4, _link, True, cover=1),
    Column("age s", 5, 2, _age, True, sort=lambda row: -row.age_s, cover=1),
    Column("near m", 11, 1, _near, sort=_near_m, cover=2),
    Column("OIST", 10, 3, _oist, sort=lambda row: -row.told.intervention_m_s2, cover=2),
    Column("order", 16, 3, _order, cover=2),
)
SORTS = ("place", "name", *(column.title for column in COLUMNS if column.sort is not None))
WHY_WIDTH = 24
READ_WIDTH = 48  # in which most reasons are read to their end


def choose_columns(width: int) -> tuple[tuple[Column, ...], int]:
    """Columns that fit into ``width`` cells, each followed by a blank, and what is left for the reason (0: no room)."""
    left, kept = width, set[int]()
    for index in sorted(range(len(COLUMNS)), key=lambda index: COLUMNS[index].rank):
        if COLUMNS[index].width + 1 > left:
            continue
        kept.add(index)
        left -= COLUMNS[index].width + 1
    return tuple(COLUMNS[index] for index in sorted(kept)), left if left >= WHY_WIDTH else 0
