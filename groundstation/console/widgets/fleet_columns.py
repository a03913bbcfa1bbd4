"""The columns of the fleet table: their cells, and which columns fit into a terminal. Pure.

OIST, the title of a column, is the avoidance law.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from groundstation.console import theme
from groundstation.console.history import Drain
from groundstation.console.theme import BAD, CALM, FAINT, GOOD, TEXT, WARN, clean, number
from groundstation.fleet.satellite_words import distance_words
from groundstation.fleet.state import VehicleView
from onboard.bus.schema import Telemetry
from onboard.config.fleet import FleetConfig
from onboard.constants import GRAVITY_M_S2
from onboard.safety.failsafe_table import Condition

Cell = tuple[str, str]  # text and colour
KILLED = "killed"  # state of a vehicle on the ground that was killed from here, until it is reset
_STARTABLE = ("waiting", "ready", "landed")  # states in which a vehicle would take off when ordered
_PAUSABLE = ("flying", "holding")  # states of which a pause is shown instead
_FIX_CONDITIONS = {Condition.FIX_FELL_BACK.value, Condition.FIX_COARSE.value}
_SLOW_LINK_S = 0.3  # age of PX4's last message to the agent from which the link counts as slow
_LOST_LINK_S = 1.0  # the age from which it counts as lost
_SHORT_MIN = 2.0  # remaining flight time below which it is marked
_LIVE_S = 0.3  # age below which the exact age is not shown, because it would only flicker
_STEADY_PER_MIN_PCT = 0.05  # change of a charge below which it counts as steady
_BAR_CELLS = 4  # width of the bar of the law's intervention
_NEAR_FACTOR = 1.1  # distance over the safety distance below which a neighbour is marked
_FULL_RATE_FRAC = 0.99  # rate of a path's clock below which it is shown


@dataclass(frozen=True, slots=True)
class VehicleRow:
    """All values that the cells of a row need."""

    view: VehicleView
    telemetry: Telemetry  # the last telemetry, however old
    fleet: FleetConfig
    drain: Drain | None
    age_s: float
    is_stale: bool
    is_latched: bool = False  # whether it was killed from here, and not reset since

    @property
    def state(self) -> str:
        """The vehicle's state. On the ground, a latched vehicle is `killed` and never ready."""
        return shown_state(self.telemetry, is_latched=self.is_latched)


@dataclass(frozen=True, slots=True)
class Column:
    """One column."""

    title: str
    width: int
    rank: int  # a narrow terminal shows the columns with the lowest ranks; 0 is always shown
    cell: Callable[[VehicleRow], Cell]
    right: bool = False  # whether the cells are aligned to the right
    sort: Callable[[VehicleRow], float] | None = None  # sort key; smaller first, NaN last
    of_corrections: bool = False  # whether it is shown only if the fleet uses RTK corrections
    # Whether a reason not to fly that has too little room covers the column on the ground: 0 never,
    # 1 only where few columns are shown, 2 always.
    cover: int = 0


def shown_state(telemetry: Telemetry, *, is_latched: bool) -> str:
    """Return the state of a vehicle: what it reports, or `killed` if it looks startable.

    Args:
        telemetry: the vehicle's last telemetry.
        is_latched: whether this ground has killed it and refuses it orders until it is reset.
    """
    if is_latched and telemetry.state in _STARTABLE:
        return KILLED
    return telemetry.state


# -- cells -----------------------------------------------------------------------------------------


def _state(row: VehicleRow) -> Cell:
    if row.telemetry.is_path_paused and row.state in _PAUSABLE:
        return "■ paused", WARN
    sign, colour = theme.STATE_SIGNS.get(row.state, ("?", WARN))
    return f"{sign} {clean(row.state, 20)}", colour


def _mode(row: VehicleRow) -> Cell:
    return clean(row.telemetry.mode, 12) or "-", TEXT


def _armed(row: VehicleRow) -> Cell:
    if row.view.is_armed:
        return "ARMED", WARN
    return "·", FAINT


def _position(row: VehicleRow) -> Cell:
    if not row.telemetry.is_position_valid:
        return "no position", WARN
    x_m, y_m, _ = row.telemetry.position_enu_m
    x = number(x_m, 2, sign=True, limit=9999)
    y = number(y_m, 2, sign=True, limit=9999)
    return f"{x:>6} {y:>6}", TEXT


def _height(row: VehicleRow) -> Cell:
    if not row.telemetry.is_position_valid:
        return "-", WARN
    _, _, height_m = row.telemetry.position_enu_m
    colour = theme.height_colour(height_m, row.fleet.fleet.geofence_m.z)
    return number(height_m, 2, limit=9999), colour


def _speed(row: VehicleRow) -> Cell:
    return number(_speed_m_s(row), 1), TEXT


def _wind_m_s(row: VehicleRow) -> float:
    return math.hypot(*row.telemetry.wind_enu_m_s)


def _wind(row: VehicleRow) -> Cell:
    """Return the wind that the vehicle feels; a dash if it is not known."""
    wind_m_s = _wind_m_s(row)
    if math.isnan(wind_m_s):
        return "-", FAINT
    colour = WARN if wind_m_s > row.telemetry.max_wind_m_s else TEXT
    return number(wind_m_s, 1, limit=99), colour


def _fix(row: VehicleRow) -> Cell:
    """Return the fix and the number of satellites; marked if the fleet requires a better fix."""
    telemetry = row.telemetry
    if not telemetry.fix:
        return "-", FAINT
    text = clean(telemetry.fix, 9)
    if telemetry.satellites >= 0:
        text += f" {min(telemetry.satellites, 99)}"
    is_too_coarse = bool(_FIX_CONDITIONS & set(telemetry.conditions))
    if is_too_coarse:
        return f"▲{text}", WARN
    return f" {text}", TEXT


def _corrections(row: VehicleRow) -> Cell:
    """Return the age of the newest corrections that PX4 has received."""
    age_s = row.telemetry.corrections_age_s
    if not math.isfinite(age_s):
        return "none", FAINT
    corrections = row.fleet.corrections
    text = number(age_s, 1, limit=999)
    if corrections is not None and age_s > corrections.max_age_s:
        return f"▲{text}", WARN
    return text, TEXT


def _base(row: VehicleRow) -> Cell:
    """Return the station of the corrections and its distance."""
    telemetry = row.telemetry
    if telemetry.base_id < 0:
        return "-", FAINT
    text = f"{min(telemetry.base_id, 9999)}"
    if math.isfinite(telemetry.base_distance_m):
        text += f" {distance_words(telemetry.base_distance_m)}"
    if Condition.BASE_FAULT.value in telemetry.conditions:
        return f"▲{text}", WARN
    return text, TEXT


def _battery(row: VehicleRow) -> Cell:
    charge_pct = row.telemetry.battery_frac * 100.0
    text = number(charge_pct, 0, limit=999)  # a dash for a charge that is not known
    if text == "-" or charge_pct < 0.0:
        return "  -", FAINT
    if charge_pct <= row.fleet.fleet.battery_land_pct:
        return f"✖{text:>3}%", BAD
    if charge_pct <= row.fleet.fleet.battery_warning_pct:
        return f"▲{text:>3}%", WARN
    return f" {text:>3}%", TEXT


def _voltage(row: VehicleRow) -> Cell:
    return number(row.telemetry.battery_voltage_v, 1, limit=999), TEXT


def _trend(row: VehicleRow) -> Cell:
    if row.drain is None:
        return "·", FAINT
    per_min_pct = 100.0 * row.drain.per_min_frac
    if per_min_pct < -_STEADY_PER_MIN_PCT:
        sign = "↓"
    elif per_min_pct > _STEADY_PER_MIN_PCT:
        sign = "↑"
    else:
        sign = "→"
    return f"{sign}{number(abs(per_min_pct), 1, limit=99)}", TEXT


def _time_left(row: VehicleRow) -> Cell:
    left_min = math.inf
    if row.drain is not None:
        left_min = row.drain.left_min

    if not math.isfinite(left_min):
        return "·", FAINT
    if left_min < _SHORT_MIN:
        return f"▲{60.0 * left_min:.0f} s", WARN
    if left_min > 99.0:
        return "> 99", TEXT
    return f"{left_min:.0f} min", TEXT


def _link(row: VehicleRow) -> Cell:
    age_s = row.telemetry.autopilot_age_s
    if not math.isfinite(age_s):
        return "no PX4", WARN
    if age_s > _LOST_LINK_S:
        return f"✖{number(age_s, 1, limit=999)} s", BAD
    if age_s > _SLOW_LINK_S:
        return f"▲{age_s:.1f} s", WARN
    return "ok", GOOD


def _age(row: VehicleRow) -> Cell:
    if row.age_s < _LIVE_S:
        return f"<{_LIVE_S:g}", FAINT
    return number(row.age_s, 1, limit=9999), FAINT


def _near(row: VehicleRow) -> Cell:
    telemetry = row.telemetry
    distance_m = telemetry.nearest_distance_m
    distance = number(distance_m, 2)
    if not telemetry.nearest_vehicle or distance == "-":
        return "-", FAINT

    limit_m = row.fleet.fleet.safety_distance_m
    sign = " "
    colour = TEXT
    if telemetry.is_airborne:
        if distance_m < limit_m:
            sign = "✖"
            colour = BAD
        elif distance_m < _NEAR_FACTOR * limit_m:
            sign = "▲"
            colour = WARN
    return f"{sign}{distance:>5} {clean(telemetry.nearest_vehicle, 40)}", colour


def _oist(row: VehicleRow) -> Cell:
    telemetry = row.telemetry
    if telemetry.law == "off":
        return "▲ law off", WARN
    status = clean(telemetry.law_status, 12).lower()
    if status in ("", "inactive"):
        return "·", FAINT

    # The intervention as a share of the horizontal thrust at the largest tilt; 1 if not known.
    share = 1.0
    if math.isfinite(telemetry.intervention_m_s2):
        share = telemetry.intervention_m_s2 / _largest_horizontal_m_s2(row)
    filled = min(_BAR_CELLS, max(1, math.ceil(_BAR_CELLS * share)))
    bar = "▮" * filled

    if status == "saturated":
        return f"{bar:▯<4} {number(telemetry.intervention_m_s2)}", CALM
    return f"▲{bar:▯<4} {status}", WARN


def _largest_horizontal_m_s2(row: VehicleRow) -> float:
    """Return the horizontal thrust at the vehicle's largest tilt while it keeps its height."""
    vehicle = row.fleet.vehicles.get(row.view.name)
    if vehicle is None:
        return GRAVITY_M_S2
    return GRAVITY_M_S2 * math.tan(math.radians(vehicle.max_tilt_deg))


def _order(row: VehicleRow) -> Cell:
    if not row.telemetry.order_kind:
        return "·", FAINT

    phase = clean(row.telemetry.order_phase, 20)
    colour = TEXT
    if phase == "done":
        colour = GOOD
    elif phase in ("failed", "refused"):
        colour = BAD
    return f"{clean(row.telemetry.order_kind, 10)} {phase}".strip(), colour


def reason(row: VehicleRow) -> Cell:
    """Return why a vehicle is not ready, or for whom it stands in, and what it does and why."""
    telemetry = row.telemetry
    if row.state == KILLED:
        return f"reset {clean(row.view.name, 40)} after a look at it", BAD

    if telemetry.not_ready and not telemetry.is_airborne:
        text = clean(telemetry.not_ready[0], 160)
        hidden = len(telemetry.not_ready) - 1
        if hidden > 0:
            text += f" (+{hidden})"
        return text, WARN

    text, colour = _doing(telemetry)
    if telemetry.stands_in_for and telemetry.state != "failed":
        words = [f"stands in for {clean(telemetry.stands_in_for, 40)}", text]
        text = ", ".join(filter(None, words))
    return text, colour


def _doing(telemetry: Telemetry) -> Cell:
    """Return what a vehicle follows, or the reason for its state."""
    if telemetry.show_id:
        lag = number(telemetry.path_lag_m, 2)
        time = number(telemetry.path_time_s, 0)
        text = f"{lag} m behind its path at {time} s"
        if telemetry.is_path_paused:
            return f"{text}, paused", WARN
        if telemetry.path_rate_frac < _FULL_RATE_FRAC:
            text += f", clock at {telemetry.path_rate_frac:.0%}"
        if telemetry.is_behind:
            return text, WARN
        return text, FAINT

    if telemetry.follows:
        text = f"follows {clean(telemetry.follows, 60)}"
        if telemetry.is_path_paused:
            return f"{text}, paused", WARN
        return text, FAINT

    text = clean(telemetry.reason, 160)
    if telemetry.state == "failed":
        return text, BAD
    return text, FAINT


# -- sort keys of columns --------------------------------------------------------------------------

_BY_URGENCY = (
    "failed",
    KILLED,
    "landing",
    "taking off",
    "flying",
    "holding",
    "armed",
    "waiting",
    "ready",
    "landed",
)


def _urgency(row: VehicleRow) -> float:
    """Return the position in the order of urgency; an unknown state comes first."""
    if row.state not in _BY_URGENCY:
        return -1.0
    return float(_BY_URGENCY.index(row.state))


def _speed_m_s(row: VehicleRow) -> float:
    if not row.telemetry.is_position_valid:
        return math.nan
    return math.hypot(*row.telemetry.velocity_enu_m_s)


def _left_min(row: VehicleRow) -> float:
    if row.drain is None:
        return math.nan
    return row.drain.left_min


def _near_m(row: VehicleRow) -> float:
    if not row.telemetry.nearest_vehicle:
        return math.nan
    return row.telemetry.nearest_distance_m


# -- the table -------------------------------------------------------------------------------------

COLUMNS = (
    Column(title="state", width=12, rank=0, cell=_state, sort=_urgency),
    Column(title="mode", width=9, rank=9, cell=_mode),
    Column(title="armed", width=5, rank=7, cell=_armed),
    Column(title="x      y m", width=13, rank=8, cell=_position),
    Column(
        title="z m",
        width=5,
        rank=1,
        cell=_height,
        right=True,
        sort=lambda row: -row.telemetry.position_enu_m[2],
    ),
    Column(
        title="m/s", width=4, rank=5, cell=_speed, right=True, sort=lambda row: -_speed_m_s(row)
    ),
    Column(
        title="wind",
        width=4,
        rank=12,
        cell=_wind,
        right=True,
        sort=lambda row: -_wind_m_s(row),
    ),
    Column(title="fix", width=13, rank=2, cell=_fix, of_corrections=True),
    Column(title="corr s", width=6, rank=6, cell=_corrections, right=True, of_corrections=True),
    Column(title="base", width=15, rank=12, cell=_base, of_corrections=True),
    Column(
        title="bat", width=5, rank=0, cell=_battery, sort=lambda row: row.telemetry.battery_frac
    ),
    Column(title="volt", width=4, rank=10, cell=_voltage, right=True),
    Column(title="%/min", width=5, rank=11, cell=_trend, right=True),
    Column(title="left", width=6, rank=6, cell=_time_left, right=True, sort=_left_min),
    Column(title="PX4", width=6, rank=4, cell=_link, right=True, cover=1),
    Column(
        title="age s",
        width=5,
        rank=2,
        cell=_age,
        right=True,
        sort=lambda row: -row.age_s,
        cover=1,
    ),
    Column(title="near m", width=11, rank=1, cell=_near, sort=_near_m, cover=2),
    Column(
        title="OIST",
        width=10,
        rank=3,
        cell=_oist,
        sort=lambda row: -row.telemetry.intervention_m_s2,
        cover=2,
    ),
    Column(title="order", width=16, rank=3, cell=_order, cover=2),
)
SORTS = ("place", "name", *(column.title for column in COLUMNS if column.sort is not None))
REASON_WIDTH = 24
WIDE_REASON_WIDTH = 48  # most reasons fit into it


def fit_columns(width: int, *, has_corrections: bool = False) -> tuple[tuple[Column, ...], int]:
    """Return the columns that fit into ``width`` cells, and the cells left for the reason.

    There is a blank after each column. If the reason would have too little room, it gets 0 cells.
    """
    left_cells = width
    shown_titles = set()
    for column in sorted(COLUMNS, key=lambda column: column.rank):
        if column.of_corrections and not has_corrections:
            continue
        if column.width + 1 <= left_cells:
            shown_titles.add(column.title)
            left_cells -= column.width + 1

    columns = tuple(column for column in COLUMNS if column.title in shown_titles)
    if left_cells < REASON_WIDTH:
        return columns, 0
    return columns, left_cells
