"""Everything about one vehicle as blocks of lines: what it does, what it may do, what the law made of its wish. Pure.

A block is drawn for a width; :func:`blocks` gives them in the order of importance, the screen puts them into columns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from rich.segment import Segment
from textual.strip import Strip

from groundstation.alarms.alarms import Line
from groundstation.console import theme
from groundstation.console.canvas import Canvas, FloatArray
from groundstation.console.theme import BAD, CALM, FAINT, GOOD, RULE, TEXT, WARN, clean, number
from groundstation.fleet.state import FleetState, LoggedEvent, VehicleView
from onboard.bus.schema import Telemetry, TickSample, Vec3, Vec4
from onboard.config.fleet import FleetConfig
from onboard.safety.failsafe_table import WORDS, Action

CHART_S = 20.0
MAX_LOG = 40
_SEVERITIES = (("…", CALM), ("▲", WARN), ("✖", BAD))
_FRESH_S = 2.0

Text = list[tuple[str, str]]  # pieces and their colours


@dataclass(frozen=True, slots=True)
class Subject:
    """What a page is drawn from. time_text: when something was heard, in words. chart_rows: height of a chart."""

    view: VehicleView
    place: int
    state: FleetState
    fleet: FleetConfig
    now_ns: int
    ticks: Sequence[TickSample]
    alarms: Sequence[Line] = ()
    time_text: Callable[[int], str] = field(default=str)
    chart_rows: int = 5

    @property
    def told(self) -> Telemetry | None:
        """The last telemetry, however old."""
        return self.view.telemetry

    @property
    def tick(self) -> TickSample | None:
        """The newest pass of its pipeline."""
        return self.ticks[-1] if self.ticks else None


def heading(subject: Subject) -> Text:
    """The vehicle in one line."""
    view, told = subject.view, subject.told
    name = (clean(view.name, 40), theme.vehicle_colour(subject.place))
    if told is None:
        return [name, ("  nothing heard from its agent yet", FAINT)]
    sign, colour = theme.STATE_SIGNS.get(told.state, ("?", WARN))
    if not view.is_fresh(subject.now_ns):
        silence = number(view.age_s(subject.now_ns), 1, limit=1e6)
        last = "PX4 says disarmed" if view.is_disarmed_by_px4 else f"last heard: {clean(told.state, 20)}"
        return [name, (f"  NO TELEM {silence} s", BAD), (f"  {last}", FAINT)]
    armed = ("  ARMED", WARN) if view.is_armed else ("  disarmed", FAINT)
    return [name, (f"  {sign} {clean(told.state, 20)}", colour), armed, (f"  {clean(told.mode, 16) or '-'}", TEXT)]


def blocks(subject: Subject, width: int) -> list[list[Strip]]:
    """The page's blocks, each ``width`` cells wide."""
    parts: tuple[tuple[str, Callable[[Subject, int], list[Text | Strip]]], ...] = (
        ("state", _state),
        ("go / no-go", _checks),
        ("neighbours", _neighbours),
        ("thrust before and after OIST, m/s²", _thrust),
        ("attitude asked and flown", _attitude),
        ("orders", _orders),
        ("log", _log),
    )
    found = []
    for title, draw in parts:
        rule = [(f"── {title} ", FAINT), ("─" * max(0, width - len(title) - 4), RULE)]
        found.append([_strip(rule, width), *(_strip(line, width) for line in draw(subject, width)), Strip.blank(width)])
    return found


def _strip(line: Text | Strip, width: int) -> Strip:
    if isinstance(line, Strip):
        return line.adjust_cell_length(width)
    return Strip([Segment(text, theme.style(colour)) for text, colour in line]).adjust_cell_length(width)


def _wrapped(head: Text, text: str, width: int, colour: str) -> list[Text | Strip]:
    """``text`` beside ``head``, further lines below it."""
    indent = sum(len(piece) for piece, _ in head)
    lines = theme.wrap(clean(text), max(8, width - indent), most=4)
    return [[*head, (lines[0], colour)], *([(" " * indent, FAINT), (line, colour)] for line in lines[1:])]


# -- the blocks --------------------------------------------------------------------------------------------------------


def _state(subject: Subject, width: int) -> list[Text | Strip]:
    told = subject.told
    if told is None:
        return [[(" Is its agent running? covey agent status says more.", FAINT)]]
    found: list[Text | Strip] = []
    for line in subject.alarms:
        sign, colour = _SEVERITIES[line.alarm.severity]
        head: Text = [(f" {'✓' if line.is_acknowledged else sign} ", colour)]
        found += _wrapped(head, line.text(subject.now_ns), width, FAINT if line.is_acknowledged else colour)
    action = clean(told.action, 80)
    if action and action != WORDS[Action.GO_ON]:
        found.append([(" failsafe   ", FAINT), (action, WARN)])
    if told.reason:
        found += _wrapped([(" because    ", FAINT)], told.reason, width, TEXT)
    is_old = not subject.view.is_fresh(subject.now_ns)
    tint = FAINT if is_old else TEXT
    if told.is_position_valid:
        x, y, z = (number(axis, 2, sign=True) for axis in told.position_enu_m)
        at = " was at     " if is_old else " at         "
        found.append([(at, FAINT), (f"{x} {y} {z} m", tint), (f"   yaw {number(told.yaw_deg, 0)}°", tint)])
    else:
        found.append([(" at         ", FAINT), ("no valid position", WARN)])
    goal = " ".join(number(axis, 2, sign=True) for axis in told.goal_position_enu_m)
    found.append([(" goes to    ", FAINT), (f"{goal} m" if subject.view.is_airborne else "·", tint)])
    speed = math.sqrt(sum(axis * axis for axis in told.velocity_enu_m_s))
    found.append([(" speed      ", FAINT), (f"{number(speed, 2)} m/s", tint)])
    battery = f"{number(told.battery_frac * 100.0, 0, limit=999)} %  {number(told.battery_voltage_v, 1, limit=999)} V"
    low = told.battery_frac * 100.0 <= subject.fleet.fleet.battery_warning_pct
    found.append([(" battery    ", FAINT), (battery, WARN if low else tint)])
    ages = ((told.state_age_s, "own"), (told.autopilot_age_s, "PX4"), (told.neighbour_age_s, "neighbours"))
    news = "  ".join(f"{label} {number(1e3 * age_s, 0, limit=1e6)}" for age_s, label in ages)
    found.append([(" news, ms   ", FAINT), (news, tint)])
    periods = (told.loop_period_p50_ms, told.loop_period_p99_ms, told.loop_period_max_ms)
    loop = "/".join(number(value, 0, limit=1e6) for value in periods)
    found.append([(" loop, ms   ", FAINT), (f"p50/p99/max {loop}  late {told.late_ticks}", tint)])
    return found


def _checks(subject: Subject, width: int) -> list[Text | Strip]:
    view, told = subject.view, subject.told
    found: list[Text | Strip] = []
    if view.preflight is not None and view.has_preflight(subject.now_ns):
        report = view.preflight
        bad = [check for check in report.checks if not check[1]]
        advice = [check for check in report.checks if check[1] and check[3]]
        go = (" ✔ GO", GOOD) if not bad else (f" ✖ NO-GO: {len(bad)} of {len(report.checks)} refuse", BAD)
        found.append([go, (f"   {len(report.checks) - len(bad)} fine", FAINT)])
        for (name, _, sentence, remedy), (sign, colour) in [
            *((check, ("✖", BAD)) for check in bad),
            *((check, ("▲", WARN)) for check in advice),
        ]:
            found += _wrapped([(f" {sign} ", colour)], f"{name}: {sentence}", width, colour)
            if remedy:
                found += _wrapped([("   → ", FAINT)], remedy, width, TEXT)
        rest = [clean(name, 24) for name, is_ok, _, remedy in report.checks if is_ok and not remedy]
        if rest:
            found += _wrapped([(" ✔ ", GOOD)], ", ".join(rest), width, FAINT)
        return found
    if told is None:
        return [[(" not heard yet", FAINT)]]
    for reason in told.not_ready[:8]:
        found += _wrapped([(" ✖ ", BAD)], reason, width, WARN)
    if not found:
        found.append([(" · checked on the ground, before it arms" if told.is_airborne else " ✔ ready", FAINT)])
    return found


def _neighbours(subject: Subject, width: int) -> list[Text | Strip]:
    own = subject.view.position_enu_m(subject.now_ns)
    tick = _fresh_tick(subject)
    limit_m = subject.fleet.fleet.safety_distance_m
    rows: list[tuple[float, str, float, float]] = []
    for name, view in subject.state.vehicles.items():
        if name == subject.view.name:
            continue
        spot = view.position_enu_m(subject.now_ns)
        seen_m = tick.neighbour_distances_m.get(name, math.nan) if tick is not None else math.nan
        told_m = math.dist(own[:2], spot[:2]) if own is not None and spot is not None else math.nan
        age_s = tick.neighbour_ages_s.get(name, math.nan) if tick is not None else math.nan
        distance_m = told_m if math.isfinite(told_m) else seen_m
        rows.append((distance_m if math.isfinite(distance_m) else math.inf, name, seen_m, age_s))
    if not rows:
        return [[(" none in this fleet", FAINT)]]
    found: list[Text | Strip] = [[(f"   {'name':<14}{'m':>6}{'it sees m':>11}{'age ms':>8}", FAINT)]]
    for distance_m, name, seen_m, age_s in sorted(rows)[:8]:
        is_close = distance_m < limit_m and subject.view.is_airborne
        colour = BAD if is_close else WARN if distance_m < 1.25 * limit_m and subject.view.is_airborne else TEXT
        is_pushing = tick is not None and tick.active_neighbour == name
        numbers = f"{number(distance_m, 2):>6}{number(seen_m, 2):>11}{number(1e3 * age_s, 0, limit=1e6):>8}"
        found.append(
            [
                (" ◆ " if is_pushing else "   ", CALM),
                (theme.fit_name(clean(name, 40), 14), TEXT),
                (numbers, colour),
                ("  avoided now" if is_pushing and width >= 56 else "", CALM),
            ]
        )
    if len(rows) > 8:
        found.append([(f"   and {len(rows) - 8} further away", FAINT)])
    return found


def _thrust(subject: Subject, width: int) -> list[Text | Strip]:
    tick = _fresh_tick(subject)
    if tick is None:
        return [[(" no pipeline values heard yet", FAINT)]]
    found: list[Text | Strip] = [
        [(" asked      ", FAINT), (_vector(tick.thrust_baseline_enu_m_s2), WARN)],
        [(" safe       ", FAINT), (_vector(tick.thrust_safe_enu_m_s2), CALM)],
    ]
    held = tick.intervention_m_s2
    is_held = math.isfinite(held) and held > 0.01
    who = f" for {clean(tick.active_neighbour, 24)}" if tick.active_neighbour else ""
    words = f"{number(held, 2)}{who}, {clean(tick.law_status, 16)}" if is_held else "nothing: it passes unchanged"
    found.append([(" held back  ", FAINT), (words, CALM if is_held else FAINT)])
    times = _times(subject.ticks)
    asked = np.array([each.thrust_baseline_enu_m_s2[:2] for each in subject.ticks], dtype=float)
    safe = np.array([each.thrust_safe_enu_m_s2[:2] for each in subject.ticks], dtype=float)
    dial = 14 if width >= 52 else 0
    chart_width = width - dial - 1
    top = _top([np.hypot(asked[:, 0], asked[:, 1]), np.hypot(safe[:, 0], safe[:, 1])], 1.0)
    chart = _chart(
        chart_width,
        (0.0, top),
        times,
        ((np.hypot(asked[:, 0], asked[:, 1]), WARN), (np.hypot(safe[:, 0], safe[:, 1]), CALM)),
        rows=subject.chart_rows + 1,
    )
    if dial:
        picture = _dial(tick, dial, subject.chart_rows + 1, top)
        found += [Strip([*one, Segment(" "), *two]) for one, two in zip(picture, chart, strict=True)]
    else:
        found += chart
    legend: Text = [(" " * dial, FAINT), ("  ▬ asked", WARN), ("  ▬ safe", CALM)]
    found.append([*legend, (f"   horizontal, last {CHART_S:.0f} s", FAINT)])
    return found


def _attitude(subject: Subject, width: int) -> list[Text | Strip]:
    tick = _fresh_tick(subject)
    if tick is None:
        return [[(" no pipeline values heard yet", FAINT)]]
    asked, flown = tick.setpoint_quaternion_enu_flu_wxyz, tick.attitude_quaternion_enu_flu_wxyz
    found: list[Text | Strip] = [[(f"            {'roll':>7}{'pitch':>8}{'yaw':>8}{'thrust':>9}", FAINT)]]
    for label, quaternion, thrust, colour in (
        ("asked", asked, f"{number(100 * tick.setpoint_thrust_frac, 0)} %", WARN),
        ("flown", flown, f"({number(100 * tick.hover_thrust_frac, 0)} % hovers)", CALM),
    ):
        angles = "".join(f"{number(angle, 1, sign=True):>7}°" for angle in euler_deg(quaternion))
        found.append([(f" {label:<10}", FAINT), (angles, colour), (f"  {thrust}", TEXT)])
    times = _times(subject.ticks)
    series = [
        (np.array([euler_deg(each.setpoint_quaternion_enu_flu_wxyz) for each in subject.ticks]), WARN),
        (np.array([euler_deg(each.attitude_quaternion_enu_flu_wxyz) for each in subject.ticks]), CALM),
    ]
    top = _top([values[:, :2] for values, _ in series], 5.0)
    is_beside = width >= 60
    each_width = width // 2 if is_beside else width
    charts = [
        _chart(
            each_width,
            (-top, top),
            times,
            [(values[:, axis], colour) for values, colour in series],
            rows=subject.chart_rows,
        )
        for axis in (0, 1)
    ]
    if is_beside:
        found.append([(f" {'roll, °':<{each_width - 1}} pitch, °", FAINT)])
        found += [Strip([*one, *two]) for one, two in zip(*charts, strict=True)]
    else:
        for title, chart in zip(("roll", "pitch"), charts, strict=True):
            found += [[(f" {title}, °", FAINT)], *chart]
    return found


def _orders(subject: Subject, width: int) -> list[Text | Strip]:
    told = subject.told
    found: list[Text | Strip] = []
    if told is not None and told.order_kind:
        found.append([(" now        ", FAINT), (f"{clean(told.order_kind, 16)} {clean(told.order_phase, 30)}", TEXT)])
    mine = [logged for logged in subject.state.events if logged.event.vehicle == subject.view.name]
    for logged in [logged for logged in reversed(mine) if logged.event.order_outcome][:8]:
        event = logged.event
        sign, colour = theme.PHASE_SIGNS.get(event.order_outcome, ("·", TEXT))
        kind = clean(event.code.removeprefix("order-"), 12)
        head: Text = [(f" {subject.time_text(logged.received_ns)} ", FAINT), (f"{sign} {kind:<10} ", colour)]
        found += _wrapped(head, f"{event.order_outcome}. {event.sentence}", width, colour)[:2]
    return found or [[(" none yet", FAINT)]]


def _log(subject: Subject, width: int) -> list[Text | Strip]:
    mine: list[LoggedEvent] = []
    for logged in reversed(subject.state.events):
        if logged.event.vehicle == subject.view.name:
            mine.append(logged)
            if len(mine) == MAX_LOG:
                break
    found: list[Text | Strip] = []
    for logged in mine:
        sign, colour = theme.SEVERITY_SIGNS.get(logged.event.severity, theme.SEVERITY_SIGNS["info"])
        head: Text = [(f" {subject.time_text(logged.received_ns)} ", FAINT), (f"{sign} ", colour)]
        found += _wrapped(head, logged.event.sentence, width, colour)
    return found or [[(" nothing yet", FAINT)]]


# -- numbers and pictures ----------------------------------------------------------------------------------------------


def euler_deg(quaternion_wxyz: Vec4) -> tuple[float, float, float]:
    """Roll, pitch and yaw in degrees of a rotation from body FLU to ENU (yaw, then pitch, then roll); nan for none."""
    w, x, y, z = quaternion_wxyz
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not math.isfinite(norm) or norm < 1e-9:
        return (math.nan, math.nan, math.nan)
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return (math.degrees(roll), math.degrees(pitch), math.degrees(yaw))


def _fresh_tick(subject: Subject) -> TickSample | None:
    """The newest values, unless the vehicle has fallen silent since."""
    told = subject.told
    is_old = told is None or subject.view.age_s(subject.now_ns) > _FRESH_S
    return None if is_old else subject.tick


def _vector(vector: Vec3) -> str:
    norm = math.sqrt(sum(axis * axis for axis in vector))
    return "  ".join(f"{number(axis, 2, sign=True, limit=999):>6}" for axis in vector) + f"   |{number(norm, 2)}|"


def _times(ticks: Sequence[TickSample]) -> FloatArray:
    """Seconds before the newest tick (n,)."""
    stamps = np.array([tick.stamp_ns for tick in ticks], dtype=np.int64)
    seconds: FloatArray = (stamps - stamps[-1]) * 1e-9
    return seconds


def _top(values: Sequence[FloatArray], least: float) -> float:
    """A round top of the scale for all of these."""
    most = max((float(np.nanmax(np.abs(array))) for array in values if np.isfinite(array).any()), default=least)
    return next(
        (step for step in (1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 90.0) if step >= max(least, most)), 180.0
    )


def _chart(
    width: int,
    limits: tuple[float, float],
    times: FloatArray,
    series: Sequence[tuple[FloatArray, str]],
    *,
    rows: int,
) -> list[Strip]:
    """Lines over the last CHART_S seconds, the last of ``series`` on top; the scale at the left."""
    canvas = Canvas(width, rows)
    left, (low, high) = 12, limits
    columns, height = 2 * width - left - 1, 4 * rows - 1
    if columns < 8:
        return canvas.strips()
    for value in {low, 0.0, high}:
        row = height * (high - value) / (high - low)
        canvas.line((left, row), (2 * width, row), RULE, gap=4)
        canvas.text(0, min(rows - 1, int(row // 4)), f"{value:>5.0f}", FAINT)
    is_shown = times >= -CHART_S
    x = left + columns * (1.0 + times[is_shown] / CHART_S)
    for values, colour in series:
        y = height * (high - np.clip(values[is_shown], low, high)) / (high - low)
        # between two samples the line is filled up, so that steep changes do not fall apart into dots
        fine = np.linspace(0, max(0, len(x) - 1), max(2, 4 * columns))
        if len(x) > 1:
            canvas.dots(np.interp(fine, np.arange(len(x)), x), np.interp(fine, np.arange(len(x)), y), colour)
    return canvas.strips()


def _dial(tick: TickSample, width: int, rows: int, top: float) -> list[Strip]:
    """Asked and safe thrust from above: north is up, the ring is the top of the scale."""
    canvas = Canvas(width, rows)
    middle = (width - 1.0, 2.0 * rows - 0.5)
    radius = min(middle) - 0.5
    canvas.circles(np.array([middle]), radius, RULE, gap=2)
    for vector, colour in ((tick.thrust_baseline_enu_m_s2, WARN), (tick.thrust_safe_enu_m_s2, CALM)):
        end = (middle[0] + radius * vector[0] / top, middle[1] - radius * vector[1] / top)
        canvas.line(middle, end, colour)
    return canvas.strips()
