"""Draws everything about one vehicle as blocks of lines. Pure.

Each block is drawn for a given width. :func:`blocks` returns them in the order of importance, and
the screen arranges them in columns. OIST, in the title of a block, is the avoidance law.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

from rich.segment import Segment
from textual.strip import Strip

from groundstation.alarms.alarms import NOT_RECORDED
from groundstation.console import theme
from groundstation.console.pipeline_drawing import attitude_block, thrust_block
from groundstation.console.theme import BAD, CALM, FAINT, GOOD, RULE, TEXT, WARN, clean, number
from groundstation.console.vehicle_subject import Text, VehicleSubject
from groundstation.console.widgets.fleet_columns import shown_state
from groundstation.fleet.satellite_words import satellite_words
from groundstation.fleet.state import FleetState, PersonView
from onboard.bus.schema import Telemetry
from onboard.config.pair_separation import separation_m
from onboard.message_counts import in_words
from onboard.safety.failsafe_table import WORDS, Action

MAX_LOG = 40
_MAX_NEIGHBOURS = 8
_MAX_ORDERS = 8
_MAX_LINES = 8  # lines of one sentence; remedies with a command and a path need most of them
_MAX_ORDER_LINES = 2  # lines of one order
_MAX_REASONS = 8
_NEAR_FACTOR = 1.25  # distance over the safety distance below which a neighbour is marked
_REMARK_WIDTH = 56  # width from which the avoided neighbour has a remark
_SEVERITIES = (("…", CALM), ("▲", WARN), ("✖", BAD))  # sign and colour by AlarmSeverity

Block = list[Text | Strip]  # lines, either as text or as a piece of a chart


def heading(subject: VehicleSubject) -> Text:
    """Return the vehicle's name and state in one line."""
    view = subject.view
    telemetry = subject.telemetry
    name = (clean(view.name, 40), theme.vehicle_colour(subject.index))
    if telemetry is None:
        return [name, ("  nothing heard from its agent yet", FAINT)]

    state = clean(shown_state(telemetry, is_latched=subject.is_latched), 20)
    if not view.is_fresh(subject.now_ns):
        silence = number(view.age_s(subject.now_ns), 1, limit=1e6)
        last = "PX4 says disarmed" if view.is_disarmed_by_px4 else f"last heard: {state}"
        return [name, (f"  NO TELEM {silence} s", BAD), (f"  {last}", FAINT)]

    sign, colour = theme.STATE_SIGNS.get(state, ("?", WARN))
    armed = ("  ARMED", WARN) if view.is_armed else ("  disarmed", FAINT)
    mode = clean(telemetry.mode, 16) or "-"
    return [name, (f"  {sign} {state}", colour), armed, (f"  {mode}", TEXT)]


def blocks(subject: VehicleSubject, width: int) -> list[list[Strip]]:
    """Return the page's blocks, each ``width`` cells wide."""
    parts: tuple[tuple[str, Callable[[VehicleSubject, int], Block]], ...] = (
        ("state", _state),
        ("go / no-go", _checks),
        ("neighbours", _neighbours),
        ("thrust before and after OIST, m/s²", thrust_block),
        ("attitude setpoint and measured", attitude_block),
        ("orders", _orders),
        ("log", _log),
    )

    drawn = []
    for title, draw in parts:
        rule = [(f"── {title} ", FAINT), ("─" * max(0, width - len(title) - 4), RULE)]
        lines = [_strip(rule, width)]
        lines += [_strip(line, width) for line in draw(subject, width)]
        lines.append(Strip.blank(width))
        drawn.append(lines)
    return drawn


def _strip(line: Text | Strip, width: int) -> Strip:
    if not isinstance(line, Strip):
        line = Strip([Segment(text, theme.style(colour)) for text, colour in line])
    return line.adjust_cell_length(width)


def _wrapped(head: Text, text: str, width: int, colour: str) -> Block:
    """Return ``text`` beside ``head``; further lines are indented by the width of the head."""
    indent = sum(len(piece) for piece, _ in head)
    first, *others = theme.wrap(clean(text), max(8, width - indent), most=_MAX_LINES)

    lines: Block = [[*head, (first, colour)]]
    for line in others:
        lines.append([(" " * indent, FAINT), (line, colour)])
    return lines


# -- state -----------------------------------------------------------------------------------------


def _state(subject: VehicleSubject, width: int) -> Block:
    telemetry = subject.telemetry
    if telemetry is None:
        words = "Is its agent running? covey agent status says more."
        if subject.is_replay:
            words = NOT_RECORDED
        return _wrapped([(" ", FAINT)], words, width, FAINT)

    lines = _alarms(subject, width)

    action = clean(telemetry.action, 80)
    if action and action != WORDS[Action.GO_ON]:
        lines.append([(" failsafe   ", FAINT), (action, WARN)])
    if telemetry.reason:
        lines += _wrapped([(" because    ", FAINT)], telemetry.reason, width, TEXT)
    if telemetry.stands_in_for:
        words = f"stands in for {clean(telemetry.stands_in_for, 40)}"
        lines += _wrapped([(" place      ", FAINT)], words, width, TEXT)

    is_old = not subject.view.is_fresh(subject.now_ns)
    tint = FAINT if is_old else TEXT
    lines.append(_position(telemetry, is_old=is_old, tint=tint))

    goal = "·"
    if subject.view.is_airborne:
        axes = " ".join(number(axis, 2, sign=True) for axis in telemetry.goal_position_enu_m)
        goal = f"{axes} m"
    lines.append([(" goes to    ", FAINT), (goal, tint)])

    speed_m_s = math.sqrt(sum(axis * axis for axis in telemetry.velocity_enu_m_s))
    lines.append([(" speed      ", FAINT), (f"{number(speed_m_s, 2)} m/s", tint)])

    lines.append([(" wind       ", FAINT), (_wind(telemetry), tint)])
    satellites = satellite_words(telemetry)
    if satellites:
        lines += _wrapped([(" satellites ", FAINT)], satellites, width, tint)

    charge_pct = telemetry.battery_frac * 100.0
    is_low = charge_pct <= subject.fleet.fleet.battery_warning_pct
    charge = number(charge_pct, 0, limit=999)
    voltage = number(telemetry.battery_voltage_v, 1, limit=999)
    lines.append([(" battery    ", FAINT), (f"{charge} %  {voltage} V", WARN if is_low else tint)])

    lines.append([(" ages, ms   ", FAINT), (_message_ages(telemetry), tint)])

    periods_ms = (
        telemetry.loop_period_p50_ms,
        telemetry.loop_period_p99_ms,
        telemetry.loop_period_max_ms,
    )
    loop = "/".join(number(period_ms, 0, limit=1e6) for period_ms in periods_ms)
    words = f"p50/p99/max {loop}  late {telemetry.late_ticks}"
    lines.append([(" loop, ms   ", FAINT), (words, tint)])

    return lines + _counts(telemetry, subject.state, tint)


def _alarms(subject: VehicleSubject, width: int) -> Block:
    lines: Block = []
    for line in subject.alarms:
        sign, colour = _SEVERITIES[line.alarm.severity]
        head: Text = [(f" {sign} ", colour)]
        text_colour = colour
        if line.is_acknowledged:
            head = [(" ✓ ", colour)]
            text_colour = FAINT
        lines += _wrapped(head, line.text(subject.now_ns), width, text_colour)
    return lines


def _wind(telemetry: Telemetry) -> str:
    """Return the wind that the vehicle feels, its direction, the gusts and the limit."""
    east_m_s, north_m_s = telemetry.wind_enu_m_s
    speed_m_s = math.hypot(east_m_s, north_m_s)
    if math.isnan(speed_m_s):
        return "not known"

    from_deg = math.degrees(math.atan2(-east_m_s, -north_m_s)) % 360.0
    speed = number(speed_m_s, 1)
    gusts = number(telemetry.gust_m_s, 1)
    limit = number(telemetry.max_wind_m_s, 1)
    return f"{speed} m/s from {from_deg:.0f}°, gusts {gusts}, limit {limit}"


def _position(telemetry: Telemetry, *, is_old: bool, tint: str) -> Text:
    if not telemetry.is_position_valid:
        return [(" at         ", FAINT), ("no valid position", WARN)]

    label = " was at     " if is_old else " at         "
    x, y, z = (number(axis, 2, sign=True) for axis in telemetry.position_enu_m)
    yaw = number(telemetry.yaw_deg, 0)
    return [(label, FAINT), (f"{x} {y} {z} m", tint), (f"   yaw {yaw}°", tint)]


def _message_ages(telemetry: Telemetry) -> str:
    ages_s = {
        "own": telemetry.state_age_s,
        "PX4": telemetry.autopilot_age_s,
        "neighbours": telemetry.neighbour_age_s,
    }
    words = [f"{label} {number(1e3 * age_s, 0, limit=1e6)}" for label, age_s in ages_s.items()]
    return "  ".join(words)


def _counts(telemetry: Telemetry, ground: FleetState, tint: str) -> Block:
    """Return the numbers of messages that the vehicle and this ground did not use.

    A side that has used all messages has no line.
    """
    refused = telemetry.refused_messages + sum(telemetry.refused_orders.values())
    agent_counts = in_words(
        telemetry.malformed_messages, refused, telemetry.dropped_messages, telemetry.late_messages
    )
    ground_counts = in_words(ground.malformed, ground.refused, ground.dropped, ground.late)

    lines: Block = []
    if agent_counts:
        lines.append([(" not used   ", FAINT), (agent_counts, tint)])
    if ground_counts:
        lines.append([(" …this side ", FAINT), (ground_counts, tint)])
    return lines


# -- go or no-go -----------------------------------------------------------------------------------


class _Check(NamedTuple):
    """One preflight check, in the order of the message's values."""

    name: str
    is_ok: bool
    sentence: str
    remedy: str  # what to do; if the check is fine, advice or nothing


def _checks(subject: VehicleSubject, width: int) -> Block:
    view = subject.view
    telemetry = subject.telemetry
    if subject.is_latched:
        advice = f"killed from here. Look at it, then write: reset {view.name}"
        return _wrapped([(" ✖ NO-GO: ", BAD)], advice, width, BAD)
    if view.preflight is not None and view.has_preflight(subject.now_ns):
        return _preflight([_Check(*check) for check in view.preflight.checks], width)
    if telemetry is None:
        return [[(" not heard yet", FAINT)]]

    lines: Block = []
    for reason in telemetry.not_ready[:_MAX_REASONS]:
        lines += _wrapped([(" ✖ ", BAD)], reason, width, WARN)
    if lines:
        return lines

    if telemetry.is_airborne:
        return [[(" · checked on the ground, before it arms", FAINT)]]
    return [[(" ✔ ready", FAINT)]]


def _preflight(checks: list[_Check], width: int) -> Block:
    refusing = [check for check in checks if not check.is_ok]
    advising = [check for check in checks if check.is_ok and check.remedy]
    fine = [clean(check.name, 24) for check in checks if check.is_ok and not check.remedy]

    verdict = (" ✔ GO", GOOD)
    if refusing:
        verdict = (f" ✖ NO-GO: {len(refusing)} of {len(checks)} refuse", BAD)
    lines: Block = [[verdict, (f"   {len(checks) - len(refusing)} fine", FAINT)]]

    for check in refusing:
        lines += _check_lines(check, "✖", BAD, width)
    for check in advising:
        lines += _check_lines(check, "▲", WARN, width)
    if fine:
        lines += _wrapped([(" ✔ ", GOOD)], ", ".join(fine), width, FAINT)
    return lines


def _check_lines(check: _Check, sign: str, colour: str, width: int) -> Block:
    lines = _wrapped([(f" {sign} ", colour)], f"{check.name}: {check.sentence}", width, colour)
    if check.remedy:
        lines += _wrapped([("   → ", FAINT)], check.remedy, width, TEXT)
    return lines


# -- neighbours ------------------------------------------------------------------------------------


class _Neighbour(NamedTuple):
    """A neighbour, or a person's circle; sorted by distance, then by name."""

    # distance by the ground's telemetry, or else by the vehicle itself; inf if neither is known
    sorting_m: float
    name: str
    own_view_m: float  # distance that the vehicle itself knows; NaN if it knows none
    age_s: float  # age of the neighbour's state at the vehicle; NaN if it has none


def _neighbours(subject: VehicleSubject, width: int) -> Block:
    neighbours = [
        _neighbour(subject, name, _reported_m(subject, name))
        for name in subject.state.vehicles
        if name != subject.view.name
    ]
    neighbours += [
        _neighbour(subject, person.name, _reported_person_m(subject, person))
        for person in subject.state.people
    ]
    if not neighbours:
        return [[(" none in this fleet", FAINT)]]

    lines: Block = [[(f"   {'name':<14}{'m':>6}{'it sees m':>11}{'age ms':>8}", FAINT)]]
    for neighbour in sorted(neighbours)[:_MAX_NEIGHBOURS]:
        lines.append(_neighbour_line(subject, neighbour, width))

    hidden = len(neighbours) - _MAX_NEIGHBOURS
    if hidden > 0:
        lines.append([(f"   and {hidden} further away", FAINT)])
    return lines


def _reported_m(subject: VehicleSubject, name: str) -> float:
    """Return the distance of another vehicle by the ground's telemetry; NaN if it is not known."""
    subject_enu_m = subject.view.position_enu_m(subject.now_ns)
    other_enu_m = subject.state.vehicles[name].position_enu_m(subject.now_ns)
    if subject_enu_m is None or other_enu_m is None:
        return math.nan
    return separation_m(subject_enu_m, other_enu_m, subject.state.height_share)


def _reported_person_m(subject: VehicleSubject, person: PersonView) -> float:
    """Return the horizontal distance to a person's circle; NaN while the person is not seen."""
    subject_enu_m = subject.view.position_enu_m(subject.now_ns)
    place_enu_m = person.position_enu_m
    if subject_enu_m is None or place_enu_m is None or not person.is_fresh(subject.now_ns):
        return math.nan
    radius_m = subject.fleet.people[person.name].radius_m
    return math.dist(subject_enu_m[:2], place_enu_m[:2]) - radius_m


def _neighbour(subject: VehicleSubject, name: str, reported_m: float) -> _Neighbour:
    """Return a neighbour; `reported_m` is its distance by the ground's own knowledge."""
    own_view_m = math.nan
    age_s = math.nan
    if subject.tick is not None:
        own_view_m = subject.tick.neighbour_distances_m.get(name, math.nan)
        age_s = subject.tick.neighbour_ages_s.get(name, math.nan)

    if math.isfinite(reported_m):
        sorting_m = reported_m
    elif math.isfinite(own_view_m):
        sorting_m = own_view_m
    else:
        sorting_m = math.inf
    return _Neighbour(sorting_m, name, own_view_m, age_s)


def _neighbour_line(subject: VehicleSubject, neighbour: _Neighbour, width: int) -> Text:
    limit_m = subject.fleet.fleet.safety_distance_m
    colour = TEXT
    if subject.view.is_airborne:
        if neighbour.sorting_m < limit_m:
            colour = BAD
        elif neighbour.sorting_m < _NEAR_FACTOR * limit_m:
            colour = WARN

    tick = subject.tick
    is_avoided = tick is not None and tick.active_neighbour == neighbour.name
    distance = number(neighbour.sorting_m, 2)
    own_view = number(neighbour.own_view_m, 2)
    age = number(1e3 * neighbour.age_s, 0, limit=1e6)
    sign = "   "
    remark = ""
    if is_avoided:
        sign = " ◆ "
    if is_avoided and width >= _REMARK_WIDTH:
        remark = "  avoided now"
    return [
        (sign, CALM),
        (theme.fit_name(clean(neighbour.name, 40), 14), TEXT),
        (f"{distance:>6}{own_view:>11}{age:>8}", colour),
        (remark, CALM),
    ]


# -- orders and log --------------------------------------------------------------------------------


def _orders(subject: VehicleSubject, width: int) -> Block:
    lines: Block = []
    telemetry = subject.telemetry
    if telemetry is not None and telemetry.order_kind:
        words = f"{clean(telemetry.order_kind, 16)} {clean(telemetry.order_phase, 30)}"
        lines.append([(" now        ", FAINT), (words, TEXT)])

    ended = [
        logged
        for logged in reversed(subject.state.events)
        if logged.event.vehicle == subject.view.name and logged.event.order_outcome
    ]
    for logged in ended[:_MAX_ORDERS]:
        event = logged.event
        sign, colour = theme.PHASE_SIGNS.get(event.order_outcome, ("·", TEXT))
        kind = clean(event.code.removeprefix("order-"), 12)
        head: Text = [
            (f" {subject.time_text(logged.received_ns)} ", FAINT),
            (f"{sign} {kind:<10} ", colour),
        ]
        sentence = f"{event.order_outcome}. {event.sentence}"
        lines += _wrapped(head, sentence, width, colour)[:_MAX_ORDER_LINES]

    if not lines:
        return [[(" none yet", FAINT)]]
    return lines


def _log(subject: VehicleSubject, width: int) -> Block:
    newest_first = (
        logged
        for logged in reversed(subject.state.events)
        if logged.event.vehicle == subject.view.name
    )

    lines: Block = []
    for logged in itertools.islice(newest_first, MAX_LOG):
        sign, colour = theme.SEVERITY_SIGNS.get(logged.event.severity, theme.SEVERITY_SIGNS["info"])
        head: Text = [(f" {subject.time_text(logged.received_ns)} ", FAINT), (f"{sign} ", colour)]
        lines += _wrapped(head, logged.event.sentence, width, colour)

    if not lines:
        return [[(" nothing yet", FAINT)]]
    return lines
