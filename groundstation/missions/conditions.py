"""Conditions that a mission waits for or reacts to. Pure.

Each public function returns a `WaitCondition`: a predicate of the fleet's state, the condition in
words, and a function that describes the present situation. The description appears in the sentence
about a wait that has timed out.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import NamedTuple

from groundstation.fleet.slot_owners import by_vehicle, out_of_service, vehicles_of_slots
from groundstation.fleet.state import FleetState, LoggedEvent, VehicleView
from groundstation.missions.argument_checks import as_mapping, as_position, check_number
from onboard.bus.schema import Event
from onboard.config.fleet import ConfigError
from onboard.config.pair_separation import separation_m
from onboard.tuples import Xyz

ARRIVED_M = 0.15  # default distance from a goal at which a vehicle has arrived
# Largest difference between the times of the last telemetry of two vehicles that fall silent for
# the same reason.
_AT_ONCE_S = 0.7


class FleetMoment(NamedTuple):
    """The fleet at one time, as a condition sees it."""

    state: FleetState
    now_ns: int  # the ground's monotonic clock
    begin_ns: int  # start of the wait on the same clock
    # events since the start of the wait: the first of each vehicle, code and severity
    events: Collection[Event] = ()
    left_out: Collection[str] = ()  # vehicles that the mission goes on without


class EventsOfWait:
    """The events since the start of a wait, however many there are: one of each kind.

    Args:
        begin_ns: start of the wait, on the ground's monotonic clock [ns].
    """

    def __init__(self, begin_ns: int) -> None:
        self._begin_ns = begin_ns
        self._last: LoggedEvent | None = None  # the newest one that was read
        self._events: dict[tuple[str, str, str], Event] = {}  # vehicle, code, severity -> event

    def until(self, state: FleetState) -> Collection[Event]:
        """Return the events until now; called with every state, since states keep the newest only.

        Args:
            state: the fleet as known now.
        """
        for logged in state.events_after(self._last):
            event = logged.event
            if logged.received_ns >= self._begin_ns:
                self._events.setdefault((event.vehicle, event.code, event.severity), event)
            self._last = logged
        return self._events.values()


class WaitCondition(NamedTuple):
    """A predicate of the fleet, and its description for people."""

    words: str
    holds: Callable[[FleetMoment], bool]
    # the present situation in words, for the sentence about a wait that has timed out
    value: Callable[[FleetMoment], str]
    # the vehicles that are lost when the condition holds, each with the reason
    lost: Callable[[FleetMoment], Mapping[str, str]] = lambda _: {}


class ConditionTimeout(TimeoutError):
    """A condition did not come true in time; the text describes the situation at the timeout."""


def reached(goals: Mapping[str, Xyz], within_m: float = ARRIVED_M) -> WaitCondition:
    """Every vehicle reports to be at its goal, but for those that the mission goes on without.

    Args:
        goals: goal of each vehicle [m], ENU.
        within_m: distance from the goal that counts as arrived [m].

    Raises:
        ConfigError: the goals are no dictionary of positions, or the distance is no number.
    """
    check_number(within_m, "reached", "metres")
    given = as_mapping(goals, "reached", "goal", example="mav0")
    goals = {str(name): as_position(goal, "reached") for name, goal in given.items()}

    def distances_m(moment: FleetMoment) -> dict[str, float]:
        """Return the distance of each vehicle; infinite where its position is not known."""
        distances = {}
        for name, goal in by_vehicle(goals, moment.state).items():
            if name in moment.left_out:
                continue
            view = _view(name, moment.state)
            telemetry = view.telemetry
            distances[name] = math.inf
            if telemetry is None or not view.is_fresh(moment.now_ns):
                continue
            if telemetry.is_position_valid:  # the reported position, without extrapolation to now
                distances[name] = math.dist(telemetry.position_enu_m, goal)
        return distances

    def holds(moment: FleetMoment) -> bool:
        return all(distance_m <= within_m for distance_m in distances_m(moment).values())

    def value(moment: FleetMoment) -> str:
        return ", ".join(
            f"{name} {distance_m:.2f} m away" for name, distance_m in distances_m(moment).items()
        )

    return WaitCondition(f"{', '.join(goals)} within {within_m:g} m of their goals", holds, value)


def separation_above(distance_m: float) -> WaitCondition:
    """No two vehicles, at least one of which flies, are closer than this, by telemetry.

    Args:
        distance_m: distance between centres [m].
    """
    check_number(distance_m, "separation_above", "metres")
    return WaitCondition(
        f"all more than {distance_m:g} m apart",
        lambda moment: _closest_m(moment) > distance_m,
        _closest_words,
    )


def separation_below(distance_m: float) -> WaitCondition:
    """Two vehicles, at least one of which flies, are closer than this, by telemetry.

    Args:
        distance_m: distance between centres [m].
    """
    check_number(distance_m, "separation_below", "metres")
    return WaitCondition(
        f"two less than {distance_m:g} m apart",
        lambda moment: _closest_m(moment) < distance_m,
        _closest_words,
    )


def battery_below(percent: float, vehicles: Iterable[str] | str | None = None) -> WaitCondition:
    """One of these vehicles reports less charge than this.

    Args:
        percent: limit in percent of a full battery.
        vehicles: names, or one; None: any vehicle.
    """
    check_number(percent, "battery_below", "percent")
    names = _names(vehicles)

    def least_pct(moment: FleetMoment) -> float:
        """Return the least charge; 100 % while no vehicle reports."""
        least_frac = 1.0
        for view in _views(moment, names).values():
            if view.telemetry is not None:
                least_frac = min(least_frac, view.telemetry.battery_frac)
        return 100.0 * least_frac

    return WaitCondition(
        f"{_vehicle_words(names)} below {percent:g} % of battery",
        lambda moment: least_pct(moment) < percent,
        lambda moment: f"the least is {least_pct(moment):.0f} %",
    )


def landed(vehicles: Iterable[str] | str | None = None) -> WaitCondition:
    """Each of these vehicles is down and disarmed.

    Args:
        vehicles: names, or one; None: all.
    """

    def is_landed(moment: FleetMoment, name: str) -> bool:
        return moment.state.is_landed(name)

    return _each(vehicles, is_landed, words="landed", otherwise="not")


def flying(vehicles: Iterable[str] | str | None = None) -> WaitCondition:
    """Each of these vehicles is in the air, but for those that the mission goes on without.

    Args:
        vehicles: names, or one; None: all.
    """

    def is_flying(moment: FleetMoment, name: str) -> bool:
        return name in moment.left_out or moment.state.vehicles[name].is_airborne

    return _each(vehicles, is_flying, words="in the air", otherwise="on the ground:")


def fails(vehicles: Iterable[str] | str | None = None) -> WaitCondition:
    """One of these vehicles is lost: it has failed, lands without an order, or is silent in flight.

    Several vehicles that fall silent at once are not lost: this ground has lost its own link.

    Args:
        vehicles: names, or one; None: any vehicle.
    """
    names = _names(vehicles)

    def failed(moment: FleetMoment) -> dict[str, str]:
        """Return the vehicles that are lost, each with the reason."""
        return {
            name: _failure_words(view, moment)
            for name, view in _views(moment, names).items()
            if _has_failed(view, moment)
        }

    return WaitCondition(
        f"{_vehicle_words(names)} failing",
        lambda moment: bool(failed(moment)),
        lambda moment: ", ".join(failed(moment)) or "none",
        failed,
    )


def event(code: str, vehicles: Iterable[str] | str | None = None) -> WaitCondition:
    """An event with this code has come since the wait began.

    Args:
        code: code of the event, as in events.txt of a record; ``*`` for any warning or worse.
        vehicles: vehicles that the event is about, or one; None: any event, including the ground's
            own.
    """
    names = _names(vehicles)

    def has_code(event: Event) -> bool:
        if code == "*":
            return event.severity in ("warning", "critical")
        return event.code == code

    def has_come(moment: FleetMoment) -> bool:
        events = [event for event in moment.events if has_code(event)]
        if names is None:
            return bool(events)
        views = _views(moment, names)
        return any(event.vehicle in views for event in events)

    return WaitCondition(
        f"event '{code}' of {_vehicle_words(names)}", has_come, lambda _: "none has come"
    )


def any_of(*conditions: WaitCondition) -> WaitCondition:
    """At least one of these conditions holds."""
    _check_not_empty(conditions, "any_of")
    return WaitCondition(
        " or ".join(condition.words for condition in conditions),
        lambda moment: any(condition.holds(moment) for condition in conditions),
        lambda moment: "; ".join(condition.value(moment) for condition in conditions),
        lambda moment: _all_lost(conditions, moment),
    )


def all_of(*conditions: WaitCondition) -> WaitCondition:
    """All of these conditions hold at once."""
    _check_not_empty(conditions, "all_of")

    def value(moment: FleetMoment) -> str:
        missing = [condition for condition in conditions if not condition.holds(moment)]
        return "; ".join(condition.value(moment) for condition in missing)

    return WaitCondition(
        " and ".join(condition.words for condition in conditions),
        lambda moment: all(condition.holds(moment) for condition in conditions),
        value,
        lambda moment: _all_lost(conditions, moment),
    )


def _check_not_empty(conditions: Sequence[WaitCondition], name: str) -> None:
    """Refuse a combination of no conditions, which would hold always or never."""
    if not conditions:
        raise ConfigError(f"{name}: there is no condition to combine. Give it at least one.")


def _each(
    vehicles: Iterable[str] | str | None,
    holds: Callable[[FleetMoment, str], bool],
    *,
    words: str,
    otherwise: str,
) -> WaitCondition:
    """Return the condition that something holds for each of these vehicles.

    Args:
        vehicles: names, or one; None: all.
        holds: function that returns whether it holds for one vehicle.
        words: words after the names of the vehicles for which it is to hold.
        otherwise: words before the names of those for which it does not hold.
    """
    names = _names(vehicles)

    def exceptions(moment: FleetMoment) -> list[str]:
        return [name for name in _views(moment, names) if not holds(moment, name)]

    return WaitCondition(
        f"{_vehicle_words(names, without_names='all')} {words}",
        lambda moment: not exceptions(moment),
        lambda moment: f"{otherwise} {', '.join(exceptions(moment))}",
    )


def _closest_m(moment: FleetMoment) -> float:
    """Return the smallest separation of two vehicles, at least one of which flies.

    It is infinite when there is no such pair with known positions.
    """
    known = []  # whether a vehicle flies, and its position
    for view in moment.state.vehicles.values():
        position_enu_m = view.position_enu_m(moment.now_ns)
        if position_enu_m is not None:
            known.append((view.is_airborne, position_enu_m))

    closest_m = math.inf
    for (flies, position), (other_flies, other_position) in itertools.combinations(known, 2):
        if flies or other_flies:
            distance_m = separation_m(other_position, position, moment.state.height_share)
            closest_m = min(closest_m, distance_m)
    return closest_m


def _closest_words(moment: FleetMoment) -> str:
    return f"the closest pair is {_closest_m(moment):.2f} m apart"


def _has_failed(view: VehicleView, moment: FleetMoment) -> bool:
    """Whether a vehicle is lost: failed, silent in flight, or landing without an order."""
    telemetry = view.telemetry
    if telemetry is None:
        return False
    if telemetry.state == "failed":
        return True
    if telemetry.is_armed and not view.is_fresh(moment.now_ns):
        return not _is_own_silence(view, moment)
    return telemetry.state == "landing" and not telemetry.order_id


def _failure_words(view: VehicleView, moment: FleetMoment) -> str:
    """Return why a vehicle counts as lost."""
    telemetry = view.telemetry
    if telemetry is None:
        return "not heard yet"
    if not view.is_fresh(moment.now_ns):
        silent_s = (moment.now_ns - view.received_ns) * 1e-9
        return f"silent for {silent_s:.1f} s in flight"
    return f"{telemetry.state}, {telemetry.reason}".rstrip(" ,.")


def _all_lost(conditions: Sequence[WaitCondition], moment: FleetMoment) -> dict[str, str]:
    """Return the vehicles that are lost by any of these conditions, each with the reason."""
    lost: dict[str, str] = {}
    for condition in conditions:
        lost.update(condition.lost(moment))
    return lost


def _is_own_silence(silent: VehicleView, moment: FleetMoment) -> bool:
    """Whether this ground causes a silence: it has lost its link, or has itself stalled.

    When this ground loses its link, the last telemetry of the vehicles arrives at slightly
    different times. Another vehicle therefore counts as heard only if its last telemetry came at
    least `_AT_ONCE_S` after the last telemetry of the silent vehicle.
    """
    if moment.state.is_after_stall(moment.now_ns):
        return True

    others = [view for view in moment.state.vehicles.values() if view is not silent]
    last_telemetry_ns = [view.received_ns for view in others if view.is_armed]
    if not last_telemetry_ns:
        return False
    return (max(last_telemetry_ns) - silent.received_ns) * 1e-9 < _AT_ONCE_S


def _views(moment: FleetMoment, names: Sequence[str] | None) -> dict[str, VehicleView]:
    """Return the vehicles that a condition is about.

    A condition without names is about all vehicles that take part. The name of a vehicle that was
    swapped means the spare that has its place.

    Raises:
        ConfigError: a name is not that of a vehicle.
    """
    state = moment.state
    if names is None:
        excluded = state.disabled | out_of_service(state)
        return {name: view for name, view in state.vehicles.items() if name not in excluded}
    return {name: _view(name, state) for name in vehicles_of_slots(names, state)}


def _view(name: str, state: FleetState) -> VehicleView:
    if name not in state.vehicles:
        known = ", ".join(state.vehicles)
        raise ConfigError(f"A condition names '{name}', which is not a vehicle: {known}.")
    return state.vehicles[name]


def _names(vehicles: Iterable[str] | str | None) -> tuple[str, ...] | None:
    """Return the names that a condition is given, which it reads many times; None without names."""
    if vehicles is None:
        return None
    if isinstance(vehicles, str):
        return tuple(word.strip() for word in vehicles.split(","))
    return tuple(vehicles)


def _vehicle_words(names: Sequence[str] | None, without_names: str = "anybody") -> str:
    """Return the names of vehicles, or another word for a condition that names none."""
    if names is None:
        return without_names
    return ", ".join(names)
