"""An account of the seconds before a moment: events, orders, what vehicles knew, and what they did.

All of it comes from the record. Nothing is computed that a vehicle could not have known; only the
ground truth is shown beside it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from groundstation.incident.moment import Moment, vehicles_of
from groundstation.recording.timeline import RecordedMessage, Timeline
from onboard.bus.schema import Event, Order, Telemetry, TickSample, Truth
from onboard.config.fleet import FleetConfig
from onboard.config.pair_separation import separation_m

_TOPICS = frozenset(("tick", "telemetry", "truth", "event", "order"))
AFTER_S = 2.0  # what is done about a silent vehicle, and most falls, come later than in a second

# larger values are mentioned
_SILENT_S = 0.2  # time since the last tick of a vehicle
_OLD_S = 0.1  # age of a neighbour's state
_LATE_S = 0.030  # time since the tick before
_ERROR_M = 0.15  # error of a vehicle's own position
_INACTIVE = "inactive"


class Line(NamedTuple):
    """One thing that happened."""

    stamp_ns: int
    sentence: str


class Account(NamedTuple):
    """An account of the seconds before a moment."""

    facts: tuple[str, ...]  # about the moment itself, a sentence each
    lines: tuple[Line, ...]  # what happened before it and shortly after, in order


class _Seen:
    """The messages of one vehicle in these seconds, and the largest values in them."""

    def __init__(self, name: str) -> None:
        self.name = name
        # the newest messages up to the moment
        self.tick: TickSample | None = None
        self.tick_ns = 0  # stamp of that tick, on the record's clock
        self.telemetry: Telemetry | None = None
        self.truth: Truth | None = None

        self.largest_error_m = 0.0  # error of its own position
        self.largest_ages_s: dict[str, float] = {}  # neighbour -> age of its state
        self.longest_period_s = 0.0
        self.first_avoided_ns: dict[str, int] = {}  # neighbour -> when its law first avoided it
        self.conditions: tuple[str, ...] = ()


def account_of(timeline: Timeline, fleet: FleetConfig, moment: Moment, before_s: float) -> Account:
    """Return the account of the seconds before a moment.

    Args:
        timeline: timeline of the record.
        fleet: fleet file of the flight.
        moment: the moment.
        before_s: number of seconds before it.
    """
    seen = {name: _Seen(name) for name in moment.vehicles if name in fleet.vehicles}
    lines: list[Line] = []

    begin_ns = moment.stamp_ns - round(before_s * 1e9)
    for recorded in _messages(timeline, begin_ns, moment.stamp_ns + round(AFTER_S * 1e9)):
        lines.extend(_lines_of(recorded, seen, fleet))
        if recorded.stamp_ns <= moment.stamp_ns and recorded.name in seen:
            lines.extend(_take(seen[recorded.name], recorded))

    facts: list[str] = []
    for vehicle in seen.values():
        silent_s = (moment.stamp_ns - vehicle.tick_ns) * 1e-9
        if vehicle.tick is not None and silent_s > _SILENT_S:
            at_s = (vehicle.tick_ns - timeline.begin_ns) * 1e-9
            facts.append(_last_heard(vehicle.name, vehicle.tick, at_s))
        else:
            facts.extend(_facts_of(vehicle, seen, fleet.fleet.height_share))
    return Account(facts=tuple(facts), lines=tuple(sorted(lines)))


def _messages(timeline: Timeline, begin_ns: int, end_ns: int) -> Iterator[RecordedMessage]:
    return timeline.read(begin_ns, _TOPICS).until(end_ns)


def _lines_of(recorded: RecordedMessage, seen: dict[str, _Seen], fleet: FleetConfig) -> list[Line]:
    """Return the line about an order, or about an event that is critical or of these vehicles.

    Of these vehicles is an event that one of them says, and a warning that names one of them.
    """
    message = recorded.message
    if isinstance(message, Order):
        return [Line(recorded.stamp_ns, f"{recorded.name}: is ordered: {message.text}")]

    if isinstance(message, Event) and message.severity != "debug":
        is_concerned = message.vehicle in seen or message.severity == "critical"
        if message.severity == "warning":
            is_concerned = not seen.keys().isdisjoint(vehicles_of(message, fleet))
        if is_concerned and not message.order_id:
            return [Line(recorded.stamp_ns, f"{message.vehicle}: {message.sentence}")]
    return []


def _take(vehicle: _Seen, recorded: RecordedMessage) -> list[Line]:
    """Note a message of a vehicle; return lines about what is new in it."""
    message = recorded.message
    if isinstance(message, Truth):
        vehicle.truth = message
        return []
    if isinstance(message, TickSample):
        return _take_tick(vehicle, message, recorded.stamp_ns)
    if isinstance(message, Telemetry):
        former = vehicle.conditions
        vehicle.telemetry = message
        vehicle.conditions = message.conditions
        return [
            Line(recorded.stamp_ns, f"{vehicle.name}: notices '{condition}'")
            for condition in message.conditions
            if condition not in former
        ]
    return []


def _take_tick(vehicle: _Seen, tick: TickSample, stamp_ns: int) -> list[Line]:
    """Note a tick of a vehicle; return a line if its law begins to avoid another vehicle."""
    vehicle.tick = tick
    vehicle.tick_ns = stamp_ns
    vehicle.longest_period_s = max(vehicle.longest_period_s, tick.period_s)
    for name, age_s in tick.neighbour_ages_s.items():
        vehicle.largest_ages_s[name] = max(vehicle.largest_ages_s.get(name, 0.0), age_s)

    if vehicle.truth is not None:
        error_m = math.dist(tick.position_enu_m, vehicle.truth.position_enu_m)
        vehicle.largest_error_m = max(vehicle.largest_error_m, error_m)

    other = tick.active_neighbour
    if other and other not in vehicle.first_avoided_ns:
        vehicle.first_avoided_ns[other] = stamp_ns
        gap_m = tick.neighbour_distances_m.get(other, math.nan)
        return [
            Line(stamp_ns, f"{vehicle.name}: its law begins to avoid {other}, {gap_m:.2f} m off")
        ]
    return []


def _last_heard(name: str, tick: TickSample, at_s: float) -> str:
    """Return a sentence about the last tick of a vehicle whose agent was silent at the moment.

    Args:
        name: name of the vehicle.
        tick: its last tick.
        at_s: time of that tick, since the start of the record.
    """
    place = ", ".join(f"{axis_m:.2f}" for axis_m in tick.position_enu_m)
    text = f"{name}: its agent was last heard at {at_s:.2f} s, at ({place}) m"

    distances_m = tick.neighbour_distances_m
    if distances_m:
        nearest = min(distances_m, key=lambda other: distances_m[other])
        text += f", {distances_m[nearest]:.2f} m from {nearest}, the nearest"
    return f"{text}."


def _facts_of(vehicle: _Seen, seen: dict[str, _Seen], height_share: float) -> Iterator[str]:
    """Yield sentences about what a vehicle knew and did at the moment.

    Args:
        vehicle: the vehicle.
        seen: all vehicles that the moment is about.
        height_share: metres that one metre of height counts as.
    """
    name = vehicle.name
    tick = vehicle.tick
    if tick is None:
        yield f"{name}: its agent has recorded nothing in these seconds: it was silent or gone."
        return

    for other in seen.values():
        if other is not vehicle:
            yield from _knowledge(vehicle, tick, other, height_share)

    if vehicle.largest_error_m > _ERROR_M:
        yield (
            f"{name}: its own position was wrong by up to {vehicle.largest_error_m:.2f} m,"
            " which only the ground truth shows."
        )
    if vehicle.longest_period_s > _LATE_S:
        yield f"{name}: its loop stood still for up to {1e3 * vehicle.longest_period_s:.0f} ms."

    telemetry = vehicle.telemetry
    if telemetry is None:
        return
    wind_m_s = math.hypot(*telemetry.wind_enu_m_s)
    if wind_m_s > 1.0:
        yield (
            f"{name}: it felt {wind_m_s:.1f} m/s of wind; its limit is"
            f" {telemetry.max_wind_m_s:.1f} m/s."
        )
    if telemetry.conditions:
        action = telemetry.action
        if not action:
            action = "going on"
        yield f"{name}: in force were {', '.join(telemetry.conditions)}; its answer: {action}."


def _knowledge(
    vehicle: _Seen, tick: TickSample, other: _Seen, height_share: float
) -> Iterator[str]:
    """Yield sentences about what a vehicle knew of another one."""
    name = vehicle.name
    believed_m = tick.neighbour_distances_m.get(other.name)
    if believed_m is None:
        yield f"{name}: it knew nothing of {other.name}."
        return

    age_s = tick.neighbour_ages_s.get(other.name, math.nan)
    text = f"{name}: it took {other.name} to be {believed_m:.2f} m away"
    if vehicle.truth is not None and other.truth is not None:
        # the agent's distance is a separation, too
        true_m = separation_m(
            vehicle.truth.position_enu_m, other.truth.position_enu_m, height_share
        )
        text += f" ({true_m:.2f} m in truth)"
    yield f"{text}, by a state {1e3 * age_s:.0f} ms old."

    largest_s = vehicle.largest_ages_s.get(other.name, 0.0)
    if largest_s > _OLD_S:
        yield f"{name}: its newest state of {other.name} was up to {largest_s:.2f} s old before."

    if tick.law_status == _INACTIVE:
        yield f"{name}: its law let the thrust of the trajectory pass unchanged."
    else:
        text = (
            f"{name}: its law ({tick.law_status}) changed the thrust by"
            f" {tick.intervention_m_s2:.1f} m/s²"
        )
        # no neighbour: a person, an obstacle or a fence, or a law of one's own, which names nobody
        if tick.active_neighbour:
            text += f", mostly for {tick.active_neighbour}"
        yield f"{text}."
