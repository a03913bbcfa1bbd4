"""Finds the moment of a flight that an incident is about.

If the smallest distance by ground truth is below the promise (the safety distance of the fleet
file), it is the moment of that distance. Otherwise it is the first critical event of a vehicle, or
of the ground about one, or else the first warning of a vehicle. If there is none of these, it is
the moment of the smallest distance, which is then not an incident.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path
from typing import Literal, NamedTuple

from groundstation.fleet.state import Separation
from groundstation.recording.flight_report import report
from groundstation.recording.timeline import Timeline
from onboard.bus.schema import Event
from onboard.config.fleet import FleetConfig
from onboard.plain_text import numbered

# a list of names where sentences have names and no quantities: "Nothing heard from 1, 2 for 2 s"
_NAMES = re.compile(
    r"(?:^|\(|heard from |has ended for |pilot has |Pilots have )"
    r"([\w-]+(?:, [\w-]+)*)"
    r"(?='|:|\)|\. | for | is | are )"
)

MomentKind = Literal["distance", "event", "none"]


class Moment(NamedTuple):
    """One moment of a record."""

    kind: MomentKind
    stamp_ns: int  # on the record's clock
    vehicles: tuple[str, ...]  # names of the vehicles that it is about
    sentence: str


def find_moment(folder: Path, fleet: FleetConfig, timeline: Timeline) -> Moment:
    """Return the moment of a flight that needs an explanation.

    Args:
        folder: flight folder.
        fleet: fleet file of the flight.
        timeline: timeline of its record.

    Raises:
        ConfigError: there is no record.
    """
    promise_m = fleet.fleet.safety_distance_m
    flight = report(folder, fleet.fleet.height_share)
    smallest = flight.smallest

    if smallest is not None and smallest.distance_m < promise_m:
        return _broken_promise(smallest, promise_m)
    event = _first_alarming(timeline, fleet)
    if event is not None:
        return event
    if smallest is not None:
        return _kept_promise(smallest, promise_m, flight.in_air_at_end)
    return Moment(
        kind="none",
        stamp_ns=timeline.end_ns,
        vehicles=(),
        sentence="The record holds no true distance of two vehicles in the air, and no vehicle has "
        "said that anything is wrong.",
    )


def _broken_promise(smallest: Separation, promise_m: float) -> Moment:
    return Moment(
        kind="distance",
        stamp_ns=smallest.stamp_ns,
        vehicles=(smallest.first, smallest.second),
        sentence=(
            f"{smallest.first} and {smallest.second} came to {smallest.distance_m:.2f} m;"
            f" {promise_m:.2f} m were promised."
        ),
    )


def _kept_promise(smallest: Separation, promise_m: float, in_air_at_end: Collection[str]) -> Moment:
    kept = "was kept"
    end = ""
    if in_air_at_end:
        kept = "was kept as far as the record goes"
        end = f" The record ends with {numbered(len(in_air_at_end), 'vehicle')} in the air."
    return Moment(
        kind="none",
        stamp_ns=smallest.stamp_ns,
        vehicles=(smallest.first, smallest.second),
        sentence=(
            f"The promise of {promise_m:.2f} m {kept}: nearest were {smallest.first} and"
            f" {smallest.second} with {smallest.distance_m:.2f} m.{end}"
        ),
    )


def vehicles_of(event: Event, fleet: FleetConfig) -> tuple[str, ...]:
    """Return the vehicles that an event is about: the one that says it, then those that it names.

    Of a vehicle whose agent hangs or is cut off only the others and the ground speak. A number is a
    vehicle's name only where it cannot be a quantity.
    """
    words = set(re.split(r"[^\w-]+", event.sentence))
    surely_names = set(", ".join(_NAMES.findall(event.sentence)).split(", "))
    named = []
    for name in fleet.vehicles:
        is_named = name in (surely_names if name.isdecimal() else words)
        if is_named and name != event.vehicle:
            named.append(name)
    if event.vehicle in fleet.vehicles:
        return (event.vehicle, *named)
    return tuple(named)


def _first_alarming(timeline: Timeline, fleet: FleetConfig) -> Moment | None:
    """Return the first critical event about a vehicle, or else the first warning of one."""
    warning: Moment | None = None
    for stamp_ns, event in timeline.events:
        vehicles = vehicles_of(event, fleet)
        if not vehicles:
            continue
        if event.severity == "critical":
            return _event_moment(stamp_ns, event, vehicles)
        if event.severity == "warning" and event.vehicle in fleet.vehicles and warning is None:
            warning = _event_moment(stamp_ns, event, vehicles)
    return warning


def _event_moment(stamp_ns: int, event: Event, vehicles: tuple[str, ...]) -> Moment:
    speaker = event.vehicle
    if speaker not in vehicles:
        speaker = "the ground"
    return Moment(
        kind="event",
        stamp_ns=stamp_ns,
        vehicles=vehicles,
        sentence=f"{speaker} said: {event.sentence}",
    )
