"""Everything about one vehicle as blocks of lines. Pure.

A block is drawn for a width; :func:`blocks` returns them in the order of importance, the screen
puts them into columns.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

from rich.segment import Segment
from textual.strip import Strip

from groundstation.console import theme
from groundstation.console.pipeline_drawing import attitude_block, thrust_block
from groundstation.console.theme import BAD, CALM, FAINT, GOOD, RULE, TEXT, WARN, clean, number
from groundstation.console.vehicle_subject import Text, VehicleSubject
from groundstation.fleet.state import FleetState
from onboard.bus.schema import Telemetry
from onboard.config.pair_separation import separation_m
from onboard.message_counts import in_words
from onboard.safety.failsafe_table import WORDS, Action

MAX_LOG = 40
_SEVERITIES = (("…", CALM), ("▲", WARN), ("✖", BAD))


def heading(subject: VehicleSubject) -> Text:
    """Return the vehicle in one line."""
    view, telemetry = subject.view, subject.telemetry
    name = (clean(view.name, 40), theme.vehicle_colour(subject.index))
    if telemetry is None:
        return [name, ("  nothing heard from its agent yet", FAINT)]
    sign, colour = theme.STATE_SIGNS.get(telemetry.state, ("?", WARN))
    if not view.is_fresh(subject.now_ns):
        silence = number(view.age_s(subject.now_ns), 1, limit=1e6)
        last = (
            "PX4 says disarmed"
            if view.is_disarmed_by_px4
            else f"last heard: {clean(telemetry.state, 20)}"
        )
        return [name, (f"  NO TELEM {silence} s", BAD), (f"  {last}", FAINT)]
    armed = ("  ARMED", WARN) if view.is_armed else ("  disarmed", FAINT)
    return [
        name,
        (f"  {sign} {clean(telemetry.state, 20)}", colour),
        armed,
        (f"  {clean(telemetry.mode, 16) or '-'}", TEXT),
    ]


def blocks(subject: VehicleSubject, width: int) -> list[list[Strip]]:
    """Return the page's blocks, each ``width`` cells wide."""
    parts: tuple[tuple[str, Callable[[VehicleSubject, int], list[Text | Strip]]], ...] = (
        ("state", _state),
        ("go / no-go", _checks),
        ("neighbours", _neighbours),
        ("thrust before and after OIST, m/s²", thrust_block),
        ("attitude setpoint and measured", attitude_block),
        ("orders", _orders),
        ("log", _log),
    )
    lines = []
    for title, draw in parts:
        rule = [(f"── {title} ", FAINT), ("─" * max(0, width - len(title) - 4), RULE)]
        lines.append(
            [
                _strip(rule, width),
                *(_strip(line, width) for line in draw(subject, width)),
                Strip.blank(width),
            ]
        )
    return lines


def _strip(line: Text | Strip, width: int) -> Strip:
    if isinstance(line, Strip):
        return line.adjust_cell_length(width)
    return Strip([Segment(text, theme.style(colour)) for text, colour in line]).adjust_cell_length(
        width
    )


def _wrapped(head: Text, text: str, width: int, colour: str) -> list[Text | Strip]:
    """Return ``text`` beside ``head``, further lines below it."""
    indent = sum(len(piece) for piece, _ in head)
    lines = theme.wrap(clean(text), max(8, width - indent), most=4)
    return [
        [*head, (lines[0], colour)],
        *([(" " * indent, FAINT), (line, colour)] for line in lines[1:]),
    ]


# -- the blocks ------------------------------------------------------------------------------------


def _state(subject: VehicleSubject, width: int) -> list[Text | Strip]:
    last = subject.telemetry
    if last is None:
        return [[(" Is its agent running? covey agent status says more.", FAINT)]]
    lines: list[Text | Strip] = []
    for line in subject.alarms:
        sign, colour = _SEVERITIES[line.alarm.severity]
        head: Text = [(f" {'✓' if line.is_acknowledged else sign} ", colour)]
        lines += _wrapped(
            head, line.text(subject.now_ns), width, FAINT if line.is_acknowledged else colour
        )
    action = clean(last.action, 80)
    if action and action != WORDS[Action.GO_ON]:
        lines.append([(" failsafe   ", FAINT), (action, WARN)])
    if last.reason:
        lines += _wrapped([(" because    ", FAINT)], last.reason, width, TEXT)
    is_old = not subject.view.is_fresh(subject.now_ns)
    tint = FAINT if is_old else TEXT
    if last.is_position_valid:
        x, y, z = (number(axis, 2, sign=True) for axis in last.position_enu_m)
        at = " was at     " if is_old else " at         "
        lines.append(
            [(at, FAINT), (f"{x} {y} {z} m", tint), (f"   yaw {number(last.yaw_deg, 0)}°", tint)]
        )
    else:
        lines.append([(" at         ", FAINT), ("no valid position", WARN)])
    goal = " ".join(number(axis, 2, sign=True) for axis in last.goal_position_enu_m)
    lines.append(
        [(" goes to    ", FAINT), (f"{goal} m" if subject.view.is_airborne else "·", tint)]
    )
    speed = math.sqrt(sum(axis * axis for axis in last.velocity_enu_m_s))
    lines.append([(" speed      ", FAINT), (f"{number(speed, 2)} m/s", tint)])
    battery = f"{number(last.battery_frac * 100.0, 0, limit=999)} %  {number(last.battery_voltage_v, 1, limit=999)} V"
    low = last.battery_frac * 100.0 <= subject.fleet.fleet.battery_warning_pct
    lines.append([(" battery    ", FAINT), (battery, WARN if low else tint)])
    ages = (
        (last.state_age_s, "own"),
        (last.autopilot_age_s, "PX4"),
        (last.neighbour_age_s, "neighbours"),
    )
    message_ages = "  ".join(
        f"{label} {number(1e3 * age_s, 0, limit=1e6)}" for age_s, label in ages
    )
    lines.append([(" ages, ms   ", FAINT), (message_ages, tint)])
    periods = (last.loop_period_p50_ms, last.loop_period_p99_ms, last.loop_period_max_ms)
    loop = "/".join(number(value, 0, limit=1e6) for value in periods)
    lines.append([(" loop, ms   ", FAINT), (f"p50/p99/max {loop}  late {last.late_ticks}", tint)])
    return lines + _counts(last, subject.state, tint)


def _counts(last: Telemetry, ground: FleetState, tint: str) -> list[Text | Strip]:
    """Messages that the vehicle and this ground did not use, since their start; no line where there
    are none.
    """
    refused = last.refused_messages + sum(last.refused_orders.values())
    theirs = in_words(last.malformed_messages, refused, last.dropped_messages, last.late_messages)
    ours = in_words(ground.malformed, ground.refused, ground.dropped, ground.late)
    rows = ((" not used   ", theirs), (" …this side ", ours))
    return [[(label, FAINT), (text, tint)] for label, text in rows if text]


def _checks(subject: VehicleSubject, width: int) -> list[Text | Strip]:
    view, telemetry = subject.view, subject.telemetry
    lines: list[Text | Strip] = []
    if view.preflight is not None and view.has_preflight(subject.now_ns):
        report = view.preflight
        bad = [check for check in report.checks if not check[1]]
        advice = [check for check in report.checks if check[1] and check[3]]
        go = (
            (" ✔ GO", GOOD)
            if not bad
            else (f" ✖ NO-GO: {len(bad)} of {len(report.checks)} refuse", BAD)
        )
        lines.append([go, (f"   {len(report.checks) - len(bad)} fine", FAINT)])
        for (name, _, sentence, remedy), (sign, colour) in [
            *((check, ("✖", BAD)) for check in bad),
            *((check, ("▲", WARN)) for check in advice),
        ]:
            lines += _wrapped([(f" {sign} ", colour)], f"{name}: {sentence}", width, colour)
            if remedy:
                lines += _wrapped([("   → ", FAINT)], remedy, width, TEXT)
        rest = [clean(name, 24) for name, is_ok, _, remedy in report.checks if is_ok and not remedy]
        if rest:
            lines += _wrapped([(" ✔ ", GOOD)], ", ".join(rest), width, FAINT)
        return lines
    if telemetry is None:
        return [[(" not heard yet", FAINT)]]
    for reason in telemetry.not_ready[:8]:
        lines += _wrapped([(" ✖ ", BAD)], reason, width, WARN)
    if not lines:
        lines.append(
            [
                (
                    " · checked on the ground, before it arms"
                    if telemetry.is_airborne
                    else " ✔ ready",
                    FAINT,
                )
            ]
        )
    return lines


def _neighbours(subject: VehicleSubject, width: int) -> list[Text | Strip]:
    own = subject.view.position_enu_m(subject.now_ns)
    tick = subject.tick
    limit_m = subject.fleet.fleet.safety_distance_m
    rows: list[tuple[float, str, float, float]] = []
    for name, view in subject.state.vehicles.items():
        if name == subject.view.name:
            continue
        spot = view.position_enu_m(subject.now_ns)
        own_view_m = (
            tick.neighbour_distances_m.get(name, math.nan) if tick is not None else math.nan
        )
        reported_m = math.nan
        if own is not None and spot is not None:
            reported_m = separation_m(own, spot, subject.state.height_share)
        age_s = tick.neighbour_ages_s.get(name, math.nan) if tick is not None else math.nan
        distance_m = reported_m if math.isfinite(reported_m) else own_view_m
        rows.append(
            (distance_m if math.isfinite(distance_m) else math.inf, name, own_view_m, age_s)
        )
    if not rows:
        return [[(" none in this fleet", FAINT)]]
    lines: list[Text | Strip] = [
        [(f"   {'name':<14}{'m':>6}{'it sees m':>11}{'age ms':>8}", FAINT)]
    ]
    for distance_m, name, own_view_m, age_s in sorted(rows)[:8]:
        is_close = distance_m < limit_m and subject.view.is_airborne
        colour = (
            BAD
            if is_close
            else WARN
            if distance_m < 1.25 * limit_m and subject.view.is_airborne
            else TEXT
        )
        is_pushing = tick is not None and tick.active_neighbour == name
        numbers = f"{number(distance_m, 2):>6}{number(own_view_m, 2):>11}{number(1e3 * age_s, 0, limit=1e6):>8}"
        lines.append(
            [
                (" ◆ " if is_pushing else "   ", CALM),
                (theme.fit_name(clean(name, 40), 14), TEXT),
                (numbers, colour),
                ("  avoided now" if is_pushing and width >= 56 else "", CALM),
            ]
        )
    if len(rows) > 8:
        lines.append([(f"   and {len(rows) - 8} further away", FAINT)])
    return lines


def _orders(subject: VehicleSubject, width: int) -> list[Text | Strip]:
    telemetry = subject.telemetry
    lines: list[Text | Strip] = []
    if telemetry is not None and telemetry.order_kind:
        lines.append(
            [
                (" now        ", FAINT),
                (f"{clean(telemetry.order_kind, 16)} {clean(telemetry.order_phase, 30)}", TEXT),
            ]
        )
    mine = [logged for logged in subject.state.events if logged.event.vehicle == subject.view.name]
    for logged in [logged for logged in reversed(mine) if logged.event.order_outcome][:8]:
        event = logged.event
        sign, colour = theme.PHASE_SIGNS.get(event.order_outcome, ("·", TEXT))
        kind = clean(event.code.removeprefix("order-"), 12)
        head: Text = [
            (f" {subject.time_text(logged.received_ns)} ", FAINT),
            (f"{sign} {kind:<10} ", colour),
        ]
        lines += _wrapped(head, f"{event.order_outcome}. {event.sentence}", width, colour)[:2]
    return lines or [[(" none yet", FAINT)]]


def _log(subject: VehicleSubject, width: int) -> list[Text | Strip]:
    mine = (
        logged
        for logged in reversed(subject.state.events)
        if logged.event.vehicle == subject.view.name
    )
    lines: list[Text | Strip] = []
    for logged in itertools.islice(mine, MAX_LOG):
        sign, colour = theme.SEVERITY_SIGNS.get(logged.event.severity, theme.SEVERITY_SIGNS["info"])
        head: Text = [(f" {subject.time_text(logged.received_ns)} ", FAINT), (f"{sign} ", colour)]
        lines += _wrapped(head, logged.event.sentence, width, colour)
    return lines or [[(" nothing yet", FAINT)]]
