"""The place of each vehicle in the fleet, by the reports of spares that replace others. Pure.

A place is everything that a fleet file or mission assigns to a vehicle's name: a take-off spot,
slots of formations, paths, steps. Normally the vehicle with that name has the place. After ``swap
mav2 mav7`` the vehicle mav7 has the place mav2, and the place mav7 stays empty.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypeVar

from groundstation.fleet.state import FleetState, VehicleView
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.tuples import Xyz

Value = TypeVar("Value")
# A spare that has been silent for longer than this, while the vehicle that it replaced reports that
# it has its own place, has been replaced by it.
_SILENT_NS = 2_000_000_000


def stand_ins(state: FleetState | None) -> dict[str, str]:
    """Return the vehicles that stand in for others: name of the place -> vehicle.

    A spare whose agent has died may have been replaced since, by another spare or by the vehicle
    that has the place in the fleet file. Its last report still names the place, so the newest
    report about a place counts.

    Args:
        state: the fleet as known now; None: nothing is known, so the result is empty.
    """
    if state is None:
        return {}

    vehicle_by_place: dict[str, str] = {}
    for name, view in state.vehicles.items():
        telemetry = view.telemetry
        if telemetry is None or telemetry.disabled_by:
            continue
        # This is also false for an empty name, and for a name that is not of this fleet.
        place = telemetry.stands_in_for
        if place not in state.vehicles:
            continue
        other = vehicle_by_place.get(place)
        if other is None or view.received_ns >= state.vehicles[other].received_ns:
            vehicle_by_place[place] = name

    for place, name in tuple(vehicle_by_place.items()):
        owner = state.vehicles[place]
        silent_ns = owner.received_ns - state.vehicles[name].received_ns
        if _has_own_place(owner) and silent_ns > _SILENT_NS:
            del vehicle_by_place[place]
    return vehicle_by_place


def _has_own_place(view: VehicleView) -> bool:
    """Whether a vehicle reports that it is in service and stands in for nobody."""
    telemetry = view.telemetry
    return telemetry is not None and not telemetry.disabled_by and not telemetry.stands_in_for


def out_of_service(state: FleetState) -> set[str]:
    """Return the vehicles that take part in no flight.

    They are disabled, or gave their place to another vehicle and took no other place, be it their
    own place or one in which they stood in.

    Args:
        state: the fleet as known now.
    """
    disabled = {name for name, view in state.vehicles.items() if view.is_disabled}
    vehicle_by_place = stand_ins(state)
    gave_their_place = set(vehicle_by_place)
    for name, view in state.vehicles.items():
        if view.telemetry is not None and view.telemetry.stands_in_for in state.vehicles:
            gave_their_place.add(name)
    have_a_place = set(vehicle_by_place.values())
    return disabled | (gave_their_place - have_a_place)


def empty_places(state: FleetState) -> set[str]:
    """Return the places that no vehicle takes in a flight.

    Their vehicle is out of service, or stands in for another one.

    Args:
        state: the fleet as known now.
    """
    vehicle_by_place = stand_ins(state)
    standing_in = set(vehicle_by_place.values())
    return (out_of_service(state) | standing_in) - vehicle_by_place.keys()


def place_of(name: str, state: FleetState | None) -> str:
    """Return the name of the place that a vehicle has; mostly its own name.

    Args:
        name: name of the vehicle.
        state: the fleet as known now; None: nothing is known.
    """
    for place, vehicle in stand_ins(state).items():
        if vehicle == name:
            return place
    return name


def spot_of(name: str, fleet: FleetConfig, state: FleetState | None) -> Xyz:
    """Return the take-off spot of a vehicle [m], ENU.

    Args:
        name: name of the vehicle.
        fleet: the fleet file.
        state: the fleet as known now; None: nothing is known.
    """
    return fleet.vehicles[place_of(name, state)].start_enu_m


def vehicles_at(places: Iterable[str], state: FleetState | None) -> tuple[str, ...]:
    """Return the vehicles that have these places, each once.

    Args:
        places: names in the fleet file.
        state: the fleet as known now; None: nothing is known.
    """
    vehicle_by_place = stand_ins(state)
    vehicles = [vehicle_by_place.get(place, place) for place in places]
    return tuple(dict.fromkeys(vehicles))  # without repetitions, in the same order


def by_place(
    values: Iterable[tuple[str | tuple[str, ...], Value]], fleet: FleetConfig, what: str
) -> dict[str, Value]:
    """Return values of places that are named by name or by index, as place -> value.

    Args:
        values: name or index of a place, and its value, as a mission gives them.
        fleet: the fleet file.
        what: the kind of value in words, for the refusal.

    Raises:
        ConfigError: a name or an index is of no vehicle or of several, or a vehicle has more than
            one value.
    """
    value_by_place: dict[str, Value] = {}
    for key, value in values:
        names = fleet.select(key)
        if len(names) != 1:
            words = key if isinstance(key, str) else ", ".join(key)
            raise ConfigError(
                f"'{words}' names {len(names)} vehicles for one {what}. Give each vehicle its own."
            )
        (name,) = names
        if name in value_by_place:
            raise ConfigError(f"{name} has more than one {what}. Give each vehicle one.")
        value_by_place[name] = value
    return value_by_place


def by_vehicle(values: Mapping[str, Value], state: FleetState | None) -> dict[str, Value]:
    """Return values of places as values of the vehicles that have these places.

    A vehicle that stands in for another one gets the value of that one's place. The value of its
    own place is dropped.

    Args:
        values: place -> value.
        state: the fleet as known now; None: nothing is known.
    """
    vehicle_by_place = stand_ins(state)
    standing_in = {vehicle_by_place[place] for place in values if place in vehicle_by_place}

    vehicle_values = {}
    for place, value in values.items():
        if place in vehicle_by_place:
            vehicle_values[vehicle_by_place[place]] = value
        elif place not in standing_in:
            vehicle_values[place] = value
    return vehicle_values
