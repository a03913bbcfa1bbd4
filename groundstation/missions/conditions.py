"""Conditions that a mission waits for or reacts to: predicates of the fleet's state, with words.
Pure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from groundstation.fleet.state import FleetState, VehicleView
from onboard.config.fleet import Vec3
from onboard.config.pair_separation import separation_m

ARRIVED_M = 0.15


class Moment(NamedTuple):
    """The fleet at one time, as a condition sees it."""

    state: FleetState
    now_ns: int  # the ground's monotonic clock
    begin_ns: int  # when the wait began, on that clock


class WaitCondition(NamedTuple):
    """A predicate of the fleet, in words for people as well."""

    words: str
    holds: Callable[[Moment], bool]
    # what it is now, for the sentence about a wait that was too short
    value: Callable[[Moment], str]


class ConditionTimeout(TimeoutError):
    """A condition has not come true in time; the sentence says what it was then."""


def reached(goals: Mapping[str, Vec3], within_m: float = ARRIVED_M) -> WaitCondition:
    """Every vehicle reports to be at its goal.

    Args:
        goals: of vehicles [m], ENU.
        within_m: distance that counts as there [m].
    """

    def distances_m(moment: Moment) -> dict[str, float]:
        known = {name: moment.state.vehicles[name].position_enu_m(moment.now_ns) for name in goals}
        return {
            name: math.inf if at is None else math.dist(at, goals[name])
            for name, at in known.items()
        }

    return WaitCondition(
        f"{', '.join(goals)} within {within_m:g} m of their goals",
        lambda moment: all(away_m <= within_m for away_m in distances_m(moment).values()),
        lambda moment: ", ".join(
            f"{name} {away_m:.2f} m away" for name, away_m in distances_m(moment).items()
        ),
    )


def separation_above(distance_m: float) -> WaitCondition:
    """No two vehicles of which one flies are nearer to each other than this, by telemetry: their
    separation.

    Args:
        distance_m: between centres [m].
    """
    return WaitCondition(
        f"all more than {distance_m:g} m apart",
        lambda moment: _closest_m(moment) > distance_m,
        lambda moment: f"the closest pair is {_closest_m(moment):.2f} m apart",
    )


def separation_below(distance_m: float) -> WaitCondition:
    """Two vehicles of which one flies are nearer to each other than this, by telemetry: their
    separation.

    Args:
        distance_m: between centres [m].
    """
    return WaitCondition(
        f"two less than {distance_m:g} m apart",
        lambda moment: _closest_m(moment) < distance_m,
        lambda moment: f"the closest pair is {_closest_m(moment):.2f} m apart",
    )


def battery_below(percent: float, vehicles: Sequence[str] | str | None = None) -> WaitCondition:
    """One of these vehicles reports less charge than this.

    Args:
        percent: of a full battery.
        vehicles: names, or one; None: anybody.
    """

    def least(moment: Moment) -> float:
        views = _views(moment, vehicles).values()
        return 100.0 * min(
            (one.telemetry.battery_frac for one in views if one.telemetry is not None), default=1.0
        )

    return WaitCondition(
        f"{_who(vehicles)} below {percent:g} % of battery",
        lambda moment: least(moment) < percent,
        lambda moment: f"the least is {least(moment):.0f} %",
    )


def landed(vehicles: Sequence[str] | str | None = None) -> WaitCondition:
    """Each of these vehicles is down and disarmed.

    Args:
        vehicles: names, or one; None: all.
    """

    return _of_all(vehicles, "landed", "not", lambda moment, name: moment.state.is_landed(name))


def flying(vehicles: Sequence[str] | str | None = None) -> WaitCondition:
    """Each of these vehicles is in the air.

    Args:
        vehicles: names, or one; None: all.
    """

    return _of_all(
        vehicles,
        "in the air",
        "on the ground:",
        lambda moment, name: moment.state.vehicles[name].is_airborne,
    )


def fails(vehicles: Sequence[str] | str | None = None) -> WaitCondition:
    """One of these vehicles is lost: it has failed, lands without an order, or is silent in flight.

    Args:
        vehicles: names, or one; None: anybody.
    """

    def failed(moment: Moment) -> list[str]:
        return [
            name
            for name, view in _views(moment, vehicles).items()
            if _has_failed(view, moment.now_ns)
        ]

    return WaitCondition(
        f"{_who(vehicles)} failing",
        lambda moment: bool(failed(moment)),
        lambda moment: ", ".join(failed(moment)) or "none",
    )


def event(code: str, vehicles: Sequence[str] | str | None = None) -> WaitCondition:
    """An event with this code has come since the wait began.

    Args:
        code: of the event, as in events.txt of a record; ``*`` for any warning or worse.
        vehicles: that it is about, or one; None: anybody's, the ground's included.
    """

    def has_come(moment: Moment) -> bool:
        names = None if vehicles is None else _names(vehicles)
        return any(
            logged.received_ns >= moment.begin_ns
            and (
                logged.event.code == code
                or (code == "*" and logged.event.severity in ("warning", "critical"))
            )
            and (names is None or logged.event.vehicle in names)
            for logged in moment.state.events
        )

    return WaitCondition(f"event '{code}' of {_who(vehicles)}", has_come, lambda _: "none has come")


def any_of(*conditions: WaitCondition) -> WaitCondition:
    """At least one of these conditions holds."""
    return WaitCondition(
        " or ".join(one.words for one in conditions),
        lambda moment: any(one.holds(moment) for one in conditions),
        lambda moment: "; ".join(one.value(moment) for one in conditions),
    )


def all_of(*conditions: WaitCondition) -> WaitCondition:
    """All of these conditions hold at once."""
    return WaitCondition(
        " and ".join(one.words for one in conditions),
        lambda moment: all(one.holds(moment) for one in conditions),
        lambda moment: "; ".join(one.value(moment) for one in conditions if not one.holds(moment)),
    )


def _closest_m(moment: Moment) -> float:
    known = [(view, view.position_enu_m(moment.now_ns)) for view in moment.state.vehicles.values()]
    spots = [(view.is_airborne, at) for view, at in known if at is not None]
    return min(
        (
            separation_m(one, other, moment.state.height_share)
            for k, (flies, one) in enumerate(spots)
            for other_flies, other in spots[:k]
            if flies or other_flies
        ),
        default=math.inf,
    )


def _names(vehicles: Sequence[str] | str) -> list[str]:
    return (
        [word.strip() for word in vehicles.split(",")]
        if isinstance(vehicles, str)
        else list(vehicles)
    )


def _views(moment: Moment, vehicles: Sequence[str] | str | None) -> dict[str, VehicleView]:
    if vehicles is None:
        return {
            name: view
            for name, view in moment.state.vehicles.items()
            if name not in moment.state.disabled
        }
    return {name: moment.state.vehicles[name] for name in _names(vehicles)}


def _of_all(
    vehicles: Sequence[str] | str | None,
    what: str,
    otherwise: str,
    holds: Callable[[Moment, str], bool],
) -> WaitCondition:
    def others(moment: Moment) -> list[str]:
        return [name for name in _views(moment, vehicles) if not holds(moment, name)]

    return WaitCondition(
        f"{_who(vehicles, 'all')} {what}",
        lambda moment: not others(moment),
        lambda moment: f"{otherwise} {', '.join(others(moment))}",
    )


def _who(vehicles: Sequence[str] | str | None, everybody: str = "anybody") -> str:
    return everybody if vehicles is None else ", ".join(_names(vehicles))


def _has_failed(view: VehicleView, now_ns: int) -> bool:
    telemetry = view.telemetry
    if telemetry is None:
        return False
    if telemetry.state == "failed" or (telemetry.is_armed and not view.is_fresh(now_ns)):
        return True
    return telemetry.state == "landing" and not telemetry.order_id
