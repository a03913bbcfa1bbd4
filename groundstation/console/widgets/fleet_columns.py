"""The columns of the fleet table: their cells, and the columns that stay when the terminal is
narrow. Pure.
"""

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
_LIVE_S = 0.3  # the exact age of younger telemetry would only flicker


@dataclass(frozen=True, slots=True)
class VehicleRow:
    """Everything that the cells of a row are made of."""

    view: VehicleView
    telemetry: Telemetry  # the last one received, however old
    fleet: FleetConfig
    drain: Drain | None
    age_s: float
    is_stale: bool


@dataclass(frozen=True, slots=True)
class Column:
    """One column."""

    title: str
    width: int
    rank: int  # columns of a low rank stay when the terminal is narrow; 0 always
    cell: Callable[[VehicleRow], Cell]
    right: bool = False
    sort: Callable[[VehicleRow], float] | None = None  # smaller first, nan last
    # on the ground a reason not to fly may cover it: 2 always, 1 where the reason has little room
    cover: int = 0


def _state(row: VehicleRow) -> Cell:
    sign, colour = theme.STATE_SIGNS.get(row.telemetry.state, ("?", WARN))
    return f"{sign} {clean(row.telemetry.state, 20)}", colour


def _mode(row: VehicleRow) -> Cell:
    return clean(row.telemetry.mode, 12) or "-", TEXT


def _armed(row: VehicleRow) -> Cell:
    return ("ARMED", WARN) if row.view.is_armed else ("·", FAINT)


def _position(row: VehicleRow) -> Cell:
    if not row.telemetry.is_position_valid:
        return "no position", WARN
    x_m, y_m, _ = row.telemetry.position_enu_m
    return (
        f"{number(x_m, 2, sign=True, limit=9999):>6} {number(y_m, 2, sign=True, limit=9999):>6}",
        TEXT,
    )


def _height(row: VehicleRow) -> Cell:
    if not row.telemetry.is_position_valid:
        return "-", WARN
    height_m = row.telemetry.position_enu_m[2]
    return number(height_m, 2, limit=9999), theme.height_colour(
        height_m, row.fleet.fleet.geofence_m.z
    )


def _speed_m_s(row: VehicleRow) -> float:
    east, north, up = row.telemetry.velocity_enu_m_s
    return math.hypot(east, north, up) if row.telemetry.is_position_valid else math.nan


def _speed(row: VehicleRow) -> Cell:
    return number(_speed_m_s(row), 1), TEXT


def _battery(row: VehicleRow) -> Cell:
    percent = row.telemetry.battery_frac * 100.0
    text = number(percent, 0, limit=999)
    if text == "-" or percent < 0.0:
        return "  -", FAINT
    if percent <= row.fleet.fleet.battery_land_pct:
        return f"✖{text:>3}%", BAD
    return (
        (f"▲{text:>3}%", WARN)
        if percent <= row.fleet.fleet.battery_warning_pct
        else (f" {text:>3}%", TEXT)
    )


def _voltage(row: VehicleRow) -> Cell:
    return number(row.telemetry.battery_voltage_v, 1, limit=999), TEXT


def _trend(row: VehicleRow) -> Cell:
    if row.drain is None:
        return "·", FAINT
    per_min = 100.0 * row.drain.per_min_frac
    sign = "↓" if per_min < -0.05 else "↑" if per_min > 0.05 else "→"
    return f"{sign}{number(abs(per_min), 1, limit=99)}", TEXT


def _left(row: VehicleRow) -> Cell:
    left_min = math.inf if row.drain is None else row.drain.left_min
    if not math.isfinite(left_min):
        return "·", FAINT
    if left_min < _SHORT_MIN:
        return f"▲{60.0 * left_min:.0f} s", WARN
    return ("> 99", TEXT) if left_min > 99.0 else (f"{left_min:.0f} min", TEXT)


def _link(row: VehicleRow) -> Cell:
    age_s = row.telemetry.autopilot_age_s
    if not math.isfinite(age_s):
        return "no PX4", WARN
    if age_s > _LOST_LINK_S:
        return f"✖{number(age_s, 1, limit=999)} s", BAD
    return (f"▲{age_s:.1f} s", WARN) if age_s > _SLOW_LINK_S else ("ok", GOOD)


def _age(row: VehicleRow) -> Cell:
    return (f"<{_LIVE_S:g}" if row.age_s < _LIVE_S else number(row.age_s, 1, limit=9999)), FAINT


def _near(row: VehicleRow) -> Cell:
    telemetry, limit_m = row.telemetry, row.fleet.fleet.safety_distance_m
    if not telemetry.nearest_vehicle or number(telemetry.nearest_distance_m, 2) == "-":
        return "-", FAINT
    is_below, is_close = (
        telemetry.nearest_distance_m < limit_m,
        telemetry.nearest_distance_m < 1.1 * limit_m,
    )
    sign = " " if not telemetry.is_airborne else "✖" if is_below else "▲" if is_close else " "
    colour = BAD if sign == "✖" else WARN if sign == "▲" else TEXT
    return (
        f"{sign}{number(telemetry.nearest_distance_m, 2):>5} {clean(telemetry.nearest_vehicle, 40)}",
        colour,
    )


def _oist(row: VehicleRow) -> Cell:
    telemetry = row.telemetry
    if telemetry.law == "off":
        return "▲ law off", WARN
    status = clean(telemetry.law_status, 12).lower()
    if status in ("", "inactive"):
        return "·", FAINT
    authority_m_s2 = _GRAVITY_M_S2 * math.tan(math.radians(row.fleet.vehicles[row.view.name].max_tilt_deg)) if (
        row.view.name in row.fleet.vehicles
    ) else _GRAVITY_M_S2  # fmt: skip
    share = (
        telemetry.intervention_m_s2 / authority_m_s2
        if math.isfinite(telemetry.intervention_m_s2)
        else 1.0
    )
    bar = "▮" * min(4, max(1, math.ceil(4.0 * share)))
    if status == "saturated":
        return f"{bar:▯<4} {number(telemetry.intervention_m_s2)}", CALM
    return f"▲{bar:▯<4} {status}", WARN


def _order(row: VehicleRow) -> Cell:
    if not row.telemetry.order_kind:
        return "·", FAINT
    phase = clean(row.telemetry.order_phase, 20)
    colour = GOOD if phase == "done" else BAD if phase in ("failed", "refused") else TEXT
    return f"{clean(row.telemetry.order_kind, 10)} {phase}".strip(), colour


def reason(row: VehicleRow) -> Cell:
    """Return the first reason why it is not ready, else the reason for its state."""
    telemetry = row.telemetry
    if telemetry.not_ready and not telemetry.is_airborne:
        more = f" (+{len(telemetry.not_ready) - 1})" if len(telemetry.not_ready) > 1 else ""
        return f"{clean(telemetry.not_ready[0], 160)}{more}", WARN
    if telemetry.show_id:
        rate = (
            f", clock at {telemetry.path_rate_frac:.0%}" if telemetry.path_rate_frac < 0.99 else ""
        )
        words = f"{number(telemetry.path_lag_m, 2)} m behind its path at {number(telemetry.path_time_s, 0)} s{rate}"
        return words, WARN if telemetry.is_behind else FAINT
    return clean(telemetry.reason, 160), BAD if telemetry.state == "failed" else FAINT


def _position_in(order: tuple[str, ...]) -> Callable[[VehicleRow], float]:
    return lambda row: (
        float(order.index(row.telemetry.state)) if row.telemetry.state in order else -1.0
    )


def _near_m(row: VehicleRow) -> float:
    return row.telemetry.nearest_distance_m if row.telemetry.nearest_vehicle else math.nan


_BY_URGENCY = (
    "failed",
    "landing",
    "taking off",
    "flying",
    "holding",
    "armed",
    "waiting",
    "ready",
    "landed",
)
COLUMNS = (
    Column("state", 12, 0, _state, sort=_position_in(_BY_URGENCY)),
    Column("mode", 9, 9, _mode),
    Column("armed", 5, 7, _armed),
    Column("x      y m", 13, 8, _position),
    Column("z m", 5, 1, _height, True, sort=lambda row: -row.telemetry.position_enu_m[2]),
    Column("m/s", 4, 5, _speed, True, sort=lambda row: -_speed_m_s(row)),
    Column("bat", 5, 0, _battery, sort=lambda row: row.telemetry.battery_frac),
    Column("volt", 4, 10, _voltage, True),
    Column("%/min", 5, 11, _trend, True),
    Column(
        "left",
        6,
        6,
        _left,
        True,
        sort=lambda row: row.drain.left_min if row.drain is not None else math.nan,
    ),
    Column("PX4", 6, 4, _link, True, cover=1),
    Column("age s", 5, 2, _age, True, sort=lambda row: -row.age_s, cover=1),
    Column("near m", 11, 1, _near, sort=_near_m, cover=2),
    Column("OIST", 10, 3, _oist, sort=lambda row: -row.telemetry.intervention_m_s2, cover=2),
    Column("order", 16, 3, _order, cover=2),
)
SORTS = ("place", "name", *(column.title for column in COLUMNS if column.sort is not None))
REASON_WIDTH = 24
WIDE_REASON_WIDTH = 48  # most reasons fit into it


def fit_columns(width: int) -> tuple[tuple[Column, ...], int]:
    """Return the columns that fit into ``width`` cells, a blank after each, and the cells left for
    the reason, or 0.
    """
    left, kept = width, set[int]()
    for index in sorted(range(len(COLUMNS)), key=lambda index: COLUMNS[index].rank):
        if COLUMNS[index].width + 1 > left:
            continue
        kept.add(index)
        left -= COLUMNS[index].width + 1
    return tuple(COLUMNS[index] for index in sorted(kept)), left if left >= REASON_WIDTH else 0
